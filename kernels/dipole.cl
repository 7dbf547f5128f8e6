/* dipole.cl -- radiosity of every point from the light that enters at all samples of the surface.
 *
 *     M(x) = sum over samples of (power that enters there) R_d(distance)
 *     R_d(r) = sum over the real and the virtual source of strength (z (1 + sigma d) / d^2 + offset) exp(-sigma d) / d
 *
 * d^2 = r^2 + z^2. `gather` takes the samples as they are; `gather_tree` takes far groups of them as one, where
 * their area seen from the point is small (Jensen and Buhler 2002). Three channels per vector.
 */
#include "real.h"

typedef struct { REAL4 sigma, depth, strength, offset; } Pole;

REAL4 profile(const REAL r2, const Pole p) {
    const REAL4 d2 = r2 + p.depth * p.depth, d = sqrt(d2);
    return p.strength * (p.depth * (1 + p.sigma * d) / d2 + p.offset) * exp(-p.sigma * d) / d;
}

// cost gather: 8R B, 60 flop per sample
__kernel void gather(const int n, const int n_samples, const REAL4 sigma, const REAL4 real_depth,
                     const REAL4 real_strength, const REAL4 real_offset, const REAL4 virtual_depth,
                     const REAL4 virtual_strength, const REAL4 virtual_offset, __global const REAL4 *restrict place,
                     __global const REAL4 *restrict power, __global const REAL4 *restrict point,
                     __global REAL4 *restrict radiosity) {
    const int i = get_global_id(0);
    if (i >= n) return;
    const Pole real = {sigma, real_depth, real_strength, real_offset};
    const Pole image = {sigma, virtual_depth, virtual_strength, virtual_offset};
    const REAL4 x = point[i];
    REAL4 sum = 0;
    for (int k = 0; k < n_samples; k++) {
        const REAL4 to = place[k] - x;
        const REAL r2 = dot(to.xyz, to.xyz);
        sum += power[k] * (profile(r2, real) + profile(r2, image));
    }
    radiosity[i] = sum;
}

/* Nodes in depth-first order; `extent` is {half diagonal, area}, `skip` the node after the subtree. */
// cost gather_tree: 8R B, 20000 flop
__kernel void gather_tree(const int n, const int n_nodes, const REAL4 sigma, const REAL4 real_depth,
                          const REAL4 real_strength, const REAL4 real_offset, const REAL4 virtual_depth,
                          const REAL4 virtual_strength, const REAL4 virtual_offset, const REAL tolerance,
                          __global const int *restrict skip, __global const int2 *restrict samples,
                          __global const REAL2 *restrict extent, __global const REAL4 *restrict centre,
                          __global const REAL4 *restrict place, __global const REAL4 *restrict power,
                          __global const REAL4 *restrict total, __global const REAL4 *restrict point,
                          __global REAL4 *restrict radiosity) {
    const int i = get_global_id(0);
    if (i >= n) return;
    const Pole real = {sigma, real_depth, real_strength, real_offset};
    const Pole image = {sigma, virtual_depth, virtual_strength, virtual_offset};
    const REAL4 x = point[i];
    REAL4 sum = 0;
    for (int node = 0; node < n_nodes;) {
        const REAL4 to = centre[node] - x;
        const REAL r2 = dot(to.xyz, to.xyz);
        const bool far = extent[node].y < tolerance * r2 && extent[node].x * extent[node].x < r2 * (REAL)0.25;
        if (far) sum += total[node] * (profile(r2, real) + profile(r2, image));
        else
            for (int k = samples[node].x; k < samples[node].y; k++) {
                const REAL4 near = place[k] - x;
                const REAL s2 = dot(near.xyz, near.xyz);
                sum += power[k] * (profile(s2, real) + profile(s2, image));
            }
        node = far ? skip[node] : node + 1;
    }
    radiosity[i] = sum;
}
