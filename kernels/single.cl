/* single.cl -- light scattered exactly once on its way from a light through a point of the surface.
 *
 *     L = T(mu) / eta^2  int sigma_s p(omega_light . omega) F(x - s omega) exp(-tau(s)) ds
 *
 * Depths s follow from the nodes of a quadrature (u, weight) in u ~ 1 - exp(-s rate), rate the mean extinction, up to
 * the first gap. F is traced to the light from each, as in attenuate.cl; p is the phase function.
 * BLOCKED: opaque triangles stand in the way of the light and of what it scatters.
 */
#include "real.h"
#include "lanes.h"
#include "body.h"
#include "beam.h"
#include "march.h"
#include "irradiance.h"

#ifdef BLOCKED
#include "bvh.h"
#define BLOCKERS \
    const int first_leaf, const int leaf_size, __global const REAL *restrict box, \
        __global const REAL *restrict triangle,
#define NEAR ((REAL)0.1) /* cells: a blocker that lines the wall is not in the way of what leaves there */
#else
#define BLOCKERS
#endif
#include "phase.h"

#ifdef HETEROGENEOUS
#define SCATTERING __global const REAL4 *restrict scattering
#define SCATTERING_OF(code) scattering[depth_start[(code) & 15] + ((code) >> 4)]
#else
#define SCATTERING const REAL4 scattering
#define SCATTERING_OF(code) scattering
#endif

#define FAR 9 /* mean free paths: less than exp(-9) comes from beyond */

/* Radiance leaving point i in its direction `out` (unit, outwards), added to the sum for other lights. */
// cost scattered_once: 20R B, 40000 flop
__kernel void scattered_once(const int n, const int n_depths, const REAL h, const REAL eta, const REAL g,
                             const REAL rate, const REAL4 light, const REAL4 strength, BODY, SCATTERING,
                             BLOCKERS __global const REAL4 *restrict points, __global const REAL4 *restrict normals,
                             __global const REAL4 *restrict out, __global const REAL2 *restrict nodes,
                             __global REAL4 *restrict radiance) {
    const int i = get_global_id(0);
    if (i >= n) return;
    const REAL4 n_i = normals[i], w = out[i], p = points[i];
    const REAL mu = dot(w.xyz, n_i.xyz);
    if (!(mu > 0)) return;
    const Body body = BODY_ARGUMENTS;
    /* Snell: the same ray inside, turned towards the normal */
    const REAL inner = sqrt(fmax((REAL)0, 1 - (1 - mu * mu) / (eta * eta)));
    const REAL4 inside = (w - mu * n_i) / eta + inner * n_i;
    REAL4 sum = (REAL4)(0);
    REAL clear = 1e30;
#ifdef BLOCKED
    const Surface blockers = {first_leaf, leaf_size, box, triangle};
    const Ray to_eye = {p.xyz - NEAR * n_i.xyz, -inside.xyz, -1};
    clear = next_hit(blockers, to_eye, (Hit){0, -1, 0}, clear).t;
#endif
    /* nodes only as deep as the body is: thin parts must not show where nodes fall behind them */
    const Beam whole = {-inside, FAR / rate};
    Rays deep;
    for (int l = 0; l < LANES; l++) set_ray(&deep, l, p, whole);
    const REAL top = 1 - exp(-rate * march(body, deep).solid.at[0]);
    for (int first = 0; first < n_depths; first += LANES) {
        Beam beam[LANES];
        Rays back, on;
        int code[LANES];
        for (int l = 0; l < LANES; l++) {
            const REAL s = -log(1 - top * nodes[min(first + l, n_depths - 1)].x) / rate;
            const REAL4 x = p - s * inside;
            const int4 c = convert_int4(floor(x));
            code[l] = first + l < n_depths && s < clear ? leaf_code(body.tree, c.x, c.y, c.z) : -1;
            const int cut = code[l] < 0 || code[l] & 15 ? -1 : cut_index[code[l] >> 4];
            if (cut >= 0) {
                const REAL4 above = x - convert_REAL4(c) - boundary[cut];
                if (dot(above.xyz, vector_at(cut, normal).xyz) > 0) code[l] = -1;
            }
            beam[l] = beam_at(light, x);
#ifdef BLOCKED
            const Ray to_light = {x.xyz, beam[l].towards.xyz, -1};
            if (code[l] >= 0 && next_hit(blockers, to_light, (Hit){0, -1, 0}, beam[l].distance).id >= 0) code[l] = -1;
#endif
            set_ray(&on, l, x, beam[l]);
            const Beam own = {-inside, s};
            set_ray(&back, l, p, own);
            if (code[l] < 0) on.distance.at[l] = back.distance.at[l] = 0;
        }
        const Passage from = march(body, back), to = march(body, on);
        for (int l = 0; l < LANES; l++) {
            const REAL s = back.distance.at[l];
            if (code[l] < 0 || from.solid.at[l] < s - 1) continue; /* beyond a gap is another part's light */
            const REAL4 F = reduced_irradiance(body, h, eta, light, strength, beam[l], to.tau[l], to.entry.at[l]);
            const REAL turn = -dot(beam[l].towards.xyz, inside.xyz);
            sum += SCATTERING_OF(code[l]) * F * exp(rate * s - from.tau[l]) *
                   (phase(g, turn) * top * nodes[first + l].y / rate);
        }
    }
    const REAL passes = eta == 1 ? 1 : transmittance(mu, eta) / (eta * eta);
    radiance[i] += passes * sum;
}
