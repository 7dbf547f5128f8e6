/* beam.h -- collimated light: where it comes from at a point, lengths in cells of the finest grid.
 *
 * A light is four numbers: the unit vector towards it and 0, or its position and 1.
 */
typedef struct {
    REAL4 towards; /* unit vector to the light */
    REAL distance; /* to the light */
} Beam;

/* The fourth component of p does not matter. */
Beam beam_at(const REAL4 light, const REAL4 p) {
    const REAL4 flat = (REAL4)(1, 1, 1, 0);
    Beam beam = {light * flat, (REAL)1e30};
    if (light.w > 0) {
        const REAL4 d = (light - p) * flat;
        beam.distance = fmax(length(d), (REAL)1e-6);
        beam.towards = d / beam.distance;
    }
    return beam;
}

/* Irradiance perpendicular to the beam before anything attenuates it: the light's own, or intensity / r^2. */
REAL4 beam_strength(const REAL4 strength, const REAL4 light, const Beam beam, const REAL h) {
    if (!(light.w > 0)) return strength;
    const REAL r = beam.distance * h;
    return strength / (r * r);
}
