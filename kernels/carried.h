/* carried.h -- what a medium makes of a beam. */
REAL4 albedo(MEDIUM sigma_a, MEDIUM sigma_s, const int i) { return AT(sigma_s, i) / (AT(sigma_a, i) + AT(sigma_s, i)); }

/* What a face carries per irradiance and area: a + 3 D g sigma_s. */
REAL4 carried(const REAL g, MEDIUM D, MEDIUM sigma_a, MEDIUM sigma_s, const int i) {
    return albedo(sigma_a, sigma_s, i) + 3 * g * AT(D, i) * AT(sigma_s, i);
}
