/* fresnel.h -- unpolarised light at the boundary of the medium. Needs real.h. */

/* Reflectance between cosines on both sides, the same either way; eta: index of the `inner` over that of the other. */
REAL fresnel(const REAL inner, const REAL outer, const REAL eta) {
    const REAL s = (eta * inner - outer) / (eta * inner + outer), p = (eta * outer - inner) / (eta * outer + inner);
    return (s * s + p * p) / 2;
}

/* Share of light from outside that enters, at cosine mu there. */
REAL transmittance(const REAL mu, const REAL eta) {
    const REAL inner2 = 1 - (1 - mu * mu) / (eta * eta);
    return inner2 > 0 ? 1 - fresnel(sqrt(inner2), mu, eta) : 0;
}

/* Reflectance, and the cosine of what is refracted; eta: index of the side the light comes from over the other's. */
REAL reflectance(const REAL cosine, const REAL eta, REAL *restrict beyond) {
    const REAL sin2 = eta * eta * (1 - cosine * cosine);
    *beyond = sqrt(fmax((REAL)0, 1 - sin2));
    if (eta == 1) return 0;
    return sin2 < 1 ? fresnel(cosine, *beyond, eta) : 1;
}
