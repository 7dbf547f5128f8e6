/* irradiance.h -- what a beam has left inside an object. Needs body.h and beam.h. */
#include "fresnel.h"

/* Irradiance left after optical depth tau, of a beam that entered at cut cell `entry` (-1: nowhere). */
REAL4 reduced_irradiance(const Body body, const REAL h, const REAL eta, const REAL4 light, const REAL4 strength,
                         const Beam beam, const REAL4 tau, const int entry) {
    const REAL4 F = beam_strength(strength, light, beam, h) * exp(-tau);
    if (eta == 1 || entry < 0) return F;
    const REAL4 n = vector_at(entry, body.normal);
    const REAL size = length(n), mu = size > 0 ? fabs(dot(n.xyz, beam.towards.xyz)) / size : 1;
    return F * transmittance(fmin(mu, (REAL)1), eta);
}
