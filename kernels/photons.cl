/* photons.cl -- power that leaves the surface, by random walks forward from the lights.
 *
 *     radiosity of a bin = power of photons that leave through its pieces of triangles after scattering / its area
 *
 * A photon that meets the surface is reflected or refracted by chance, in the proportions of Fresnel's equations.
 * Sums are 64-bit fixed point, so their order does not matter.
 */
#include "real.h"
#include "random.h"
#include "phase.h"
#include "bvh.h"
#include "medium.h"
#include "launch.h"
#include "fresnel.h"

enum { INCIDENT, REFLECTED, ABSORBED, SCATTERED, UNSCATTERED, LOST, CAPPED, TALLIES };

/* Add to a sum of two words, in units of 2^-20. */
void add(__global uint *restrict sums, const int k, const REAL value) {
    const uint v = (uint)(value * 1048576 + (REAL)0.5), old = atomic_add(sums + 2 * k, v);
    if (old + v < old) atomic_inc(sums + 2 * k + 1);
}

// cost photons: 8R B, 100000 flop
__kernel void photons(const int n, const int first_photon, const int n_channels, const int n_lights,
                      const int n_bins, const int cap, const int seed, const int reenter, const REAL eta,
                      const REAL radius, const REAL outer, const int first_leaf, const int leaf_size,
                      __global const REAL *restrict box, __global const REAL *restrict triangle,
                      __global const uchar *restrict opaque, const REAL g, const int4 nodes, const REAL4 origin,
                      const REAL4 inverse_spacing, __global const REAL *restrict majorant,
                      __global const REAL2 *restrict grid, __global const REAL4 *restrict light,
                      __global const int *restrict inside, __global const REAL *restrict strength,
                      __global const REAL *restrict cumulative, const int n_births,
                      __global const REAL4 *restrict birth, __global const REAL *restrict birth_power,
                      __global const int2 *restrict cut, __global const int *restrict owner,
                      __global uint *restrict scores, __global uint *restrict tallies) {
    const int item = get_global_id(0);
    if (item >= n) return;
    const int c = item % n_channels;
    const Surface s = {first_leaf, leaf_size, box, triangle, opaque};
    const Medium m = {majorant[c], nodes, origin, inverse_spacing, grid + c * nodes.w};
    Random random = {(uint4)(first_photon + item / n_channels, 0, 0, 0), (uint2)(seed, 2)};
    REAL4 u = uniform4(&random);
    const int l = pick(n_lights, cumulative, u.x), born = (first_photon + item / n_channels) % n_births;
    REAL power = strength[l * n_channels + c], kept = 0;
    int count = inside[l], order = 0, tracked = 0, end = -1;
    Ray ray = emitted(light[l], radius, outer, u.yzwx);
    if (light[l].w > 1) {
        power *= birth_power[born * n_channels + c];
        count = (int)birth[born].w;
        order = 1;
        ray = (Ray){birth[born].xyz, around((REAL3)(0, 0, 1), 1 - 2 * u.y, u.z), -1};
    }
    REAL weight = power;
    bool met = count, entered = count;
    for (; tracked < cap && end < 0; tracked++) {
        Hit last = {0, -1, 0};
        bool boundary = false;
        while (true) {
            const REAL reach = count > 0 ? last.t + flight(m, uniform4(&random).x) : INFINITY;
            const Hit hit = next_hit(s, ray, last, reach);
            last = hit;
            boundary = hit.id >= 0 && (absorbed(hit) || count == 0 || crossed(count, hit) == 0);
            if (hit.id < 0 || boundary) break;
            count = crossed(count, hit);
        }
        if (absorbed(last) && count > 0) { kept += weight; weight = 0; }
        if (absorbed(last)) break;
        if (!boundary && count == 0) break;
        const REAL3 at = ray.origin + last.t * ray.direction;
        u = uniform4(&random);
        if (boundary) {
            const int out = count > 0;
            if (!out && entered && !reenter) break;
            met = true;
            if (!out && last.out > 0) { end = LOST; break; }
            const REAL3 normal = face_normal(s, last.id) * (REAL)(out ? 1 : -1); /* along the photon */
            const REAL ratio = out ? eta : 1 / eta, cosine = fmin((REAL)1, dot(ray.direction, normal));
            REAL beyond;
            const bool reflects = u.x < reflectance(cosine, ratio, &beyond);
            ray = (Ray){at + (reflects ? -OFF : OFF) * radius * normal, ray.direction, last.id};
            if (reflects) {
                ray.direction = normalize(ray.direction - 2 * cosine * normal);
                continue;
            }
            ray.direction = normalize(ratio * (ray.direction - cosine * normal) + beyond * normal);
            count = !out;
            entered = true;
            const int bin = out && order > 0 ? owner[piece(s, last.id, at, cut[last.id])] : -1;
            if (bin >= 0) add(scores, (c * n_bins + bin) * 2 + (order > 1), weight);
            continue;
        }
        ray = (Ray){at, ray.direction, -1};
        if (length(at) > (REAL)1.01 * radius) { end = LOST; break; }
        const REAL2 sigma = coefficients(m, at);
        if (u.x * m.majorant >= sigma.x + sigma.y) continue;
        kept += weight * sigma.x / (sigma.x + sigma.y);
        weight *= sigma.y / (sigma.x + sigma.y);
        order++;
        if (weight < (REAL)0.1) {
            if (u.y * (REAL)0.5 >= weight) { weight = 0; break; }
            weight = (REAL)0.5;
        }
        ray.direction = around(ray.direction, scattering_cosine(g, u.z), u.w);
    }
    if (!met) return;
    if (end < 0) end = tracked == cap ? CAPPED : order > 0 ? SCATTERED : entered ? UNSCATTERED : REFLECTED;
    add(tallies, c * TALLIES + INCIDENT, power);
    add(tallies, c * TALLIES + ABSORBED, kept);
    add(tallies, c * TALLIES + end, weight);
}
