/* launch.h -- where photons start. A light is a direction of travel and 0, a position and 1, or anything and 2 for
 * emission, whose places were drawn beforehand. */
#define OFF (REAL)2e-6 /* of the radius: keeps rounding near an edge from starting a ray behind the next triangle */

/* Where a photon of a beam or lamp starts and which way it goes, for an object within `radius` about the origin and
 * nothing further than `reach`; a lamp aims at the object. */
Ray emitted(const REAL4 light, const REAL radius, const REAL reach, const REAL4 u) {
    if (light.w == 0) {
        const REAL3 aside = around(light.xyz, 0, u.y);
        return (Ray){radius * sqrt(u.x) * aside - 2 * reach * light.xyz, light.xyz, -1};
    }
    const REAL distance = length(light.xyz), ratio = radius / distance;
    if (!(ratio < 1)) return (Ray){light.xyz, around((REAL3)(0, 0, 1), 1 - 2 * u.x, u.y), -1};
    return (Ray){light.xyz, around(-light.xyz / distance, 1 - u.x * (1 - sqrt(1 - ratio * ratio)), u.y), -1};
}
