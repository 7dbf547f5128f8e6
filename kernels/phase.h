/* phase.h -- the phase function of Henyey and Greenstein 1941. Needs real.h. */

/* Its value [1/sr] at cosine mu of the scattering angle. */
REAL phase(const REAL g, const REAL mu) {
    const REAL s = 1 + g * g - 2 * g * mu;
    return (1 - g * g) / (4 * (REAL)3.14159265358979 * s * sqrt(s));
}

/* Cosine of a scattering angle that it distributes, from a uniform number. */
REAL scattering_cosine(const REAL g, const REAL u) {
    if (fabs(g) < (REAL)1e-3) return 1 - 2 * u;
    const REAL s = (1 - g * g) / (1 - g + 2 * g * u);
    return clamp((1 + g * g - s * s) / (2 * g), (REAL)-1, (REAL)1);
}
