/* irradiance.h -- what a beam has left inside an object. Needs body.h and beam.h. */

/* Unpolarised Fresnel transmittance for light that enters at cosine mu from outside. */
REAL transmittance(const REAL mu, const REAL eta) {
    const REAL inner2 = 1 - (1 - mu * mu) / (eta * eta);
    if (inner2 <= 0) return 0;
    const REAL inner = sqrt(inner2);
    const REAL s = (mu - eta * inner) / (mu + eta * inner), q = (eta * mu - inner) / (eta * mu + inner);
    return 1 - (s * s + q * q) / 2;
}

/* Irradiance left after optical depth tau, of a beam that entered at cut cell `entry` (-1: nowhere). */
REAL4 reduced_irradiance(const Body body, const REAL h, const REAL eta, const REAL4 light, const REAL4 strength,
                         const Beam beam, const REAL4 tau, const int entry) {
    const REAL4 F = beam_strength(strength, light, beam, h) * exp(-tau);
    if (eta == 1 || entry < 0) return F;
    const REAL4 n = body.normal[entry];
    const REAL size = length(n), mu = size > 0 ? fabs(dot(n.xyz, beam.towards.xyz)) / size : 1;
    return F * transmittance(fmin(mu, (REAL)1), eta);
}
