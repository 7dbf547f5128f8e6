/* carried.h -- what a medium makes of a beam. */
REAL4 albedo(MEDIUM sigma_a, MEDIUM sigma_s, const int i) { return AT(sigma_s, i) / (AT(sigma_a, i) + AT(sigma_s, i)); }

/* 3 D q1 per irradiance: the flux of the first moment q1 = g sigma_s F. */
REAL4 first_moment(const REAL g, MEDIUM D, MEDIUM sigma_s, const int i) { return 3 * g * AT(D, i) * AT(sigma_s, i); }
