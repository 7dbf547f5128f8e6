/* paths.cl -- radiance that leaves the surface, by random walks backwards from points on it.
 *
 *     radiosity = int L cos dw = pi E[L], directions distributed as the cosine
 *     L = sum over collisions of (product of albedos) phase E_light exp(-optical depth to the light)
 *         + sum over collisions, those of no effect too, of (product of albedos) q0 / (4 pi majorant)
 *
 * For equal indices inside and outside: rays cross the surface straight. Collisions are found by delta tracking
 * (Woodcock 1965), so coefficients may vary; light that crosses cavities and gaps is followed.
 */
#include "real.h"
#include "random.h"
#include "phase.h"
#include "bvh.h"
#include "medium.h"

#define BLOCK 8 /* mean free paths at the majorant between two looks for the surface */

/* Share of light that reaches `o`, inside `count` bodies, along `d` over `reach`, estimated without bias.
 * Beyond the first two mean free paths it is a matter of chance whether a ray goes on: deep inside, most
 * collisions cannot be reached, and finding that out should cost little. */
REAL transmittance(const Surface s, const Medium m, Random *restrict random, const REAL3 o, const REAL3 d,
                   const REAL reach, int count, const int reenter) {
    const Ray ray = {o, d, -1};
    Hit last = {0, -1, 0};
    REAL share = 1, depth = 0;
    const REAL limit = 2 - log(1 - uniform4(random).x);
    for (int step = 0; step < 10000; step++) {
#ifdef HETEROGENEOUS
        const REAL end = count > 0 ? last.t + BLOCK / m.majorant : INFINITY;
#else
        const REAL end = count > 0 ? last.t + (limit - depth) / m.majorant : INFINITY;
#endif
        const Hit hit = next_hit(s, ray, last, fmin(end, reach));
#ifdef HETEROGENEOUS
        REAL t = last.t;
        while (count > 0 && (t += flight(m, uniform4(random).x)) < hit.t) {
            const REAL2 sigma = coefficients(m, o + t * d);
            share *= fmax((REAL)0, 1 - (sigma.x + sigma.y) / m.majorant);
            if (share < (REAL)0.1) {
                if (uniform4(random).x * (REAL)0.1 >= share) return 0;
                share = (REAL)0.1;
            }
        }
        if (hit.id < 0 && end >= reach) return share;
#else
        if (count > 0) depth += m.majorant * (hit.t - last.t);
        if (hit.id < 0) return end < reach ? 0 : exp(-fmin(depth, (REAL)2));
#endif
        last = hit;
        if (hit.id < 0) continue;
        if (absorbed(hit) || (!reenter && count == 0)) return 0;
        count = crossed(count, hit);
    }
    return 0;
}

/* One path per work-item; counters: lost outside, stopped at the cap. */
// cost paths: 12R+4 B, 100000 flop
__kernel void paths(const int n, const int first_path, const int offset, const int n_points, const int n_channels,
                    const int n_lights, const int cap, const int seed, const int reenter, const REAL4 box_low,
                    const REAL4 box_high, const int first_leaf, const int leaf_size, __global const REAL *restrict box,
                    __global const REAL *restrict triangle, __global const uchar *restrict opaque, const REAL g,
                    const int4 nodes, const REAL4 origin, const REAL4 inverse_spacing,
                    __global const REAL *restrict majorant, __global const REAL2 *restrict grid,
                    __global const REAL *restrict emission, __global const REAL4 *restrict light,
                    __global const REAL *restrict strength, __global const REAL *restrict cumulative,
                    __global const REAL *restrict point, __global const int *restrict face,
                    __global REAL2 *restrict radiosity, __global uint *restrict counters) {
    const int item = get_global_id(0);
    if (item >= n) return;
    const int i = (offset + item) % n_points, c = (offset + item) / n_points % n_channels;
    const Surface s = {first_leaf, leaf_size, box, triangle, opaque};
    const Medium m = {majorant[c], nodes, origin, inverse_spacing, grid + c * nodes.w};
    Random random = {(uint4)(first_path + (offset + item) / n_points / n_channels, i, 0, 0), (uint2)(seed, 1)};
    REAL4 u = uniform4(&random);
    Ray ray = {vload3(i, point), around(-face_normal(s, face[i]), sqrt(1 - u.x), u.y), face[i]};
    REAL weight = M_PI_F, total = 0, single = 0;
    int order = 0, count = 1, tracked = 0; /* order: collisions that scattered; count: bodies that hold the ray */
    for (; tracked < cap; tracked++) {
        Hit last = {0, -1, 0};
        while (true) {
            const REAL reach = count > 0 ? last.t + flight(m, uniform4(&random).x) : INFINITY;
            last = next_hit(s, ray, last, reach);
            if (last.id < 0 || absorbed(last)) break;
            count = crossed(count, last);
            if (count == 0 && !reenter) break;
        }
        if (last.id >= 0 || count == 0) break;
        ray.origin += last.t * ray.direction;
        ray.skip = -1;
        if (any(ray.origin < box_low.xyz) || any(ray.origin > box_high.xyz)) { atomic_inc(counters); break; }
        const REAL emitted = weight * emission[c] / (4 * M_PI_F * m.majorant);
        total += emitted;
        if (order == 0) single += emitted;
        u = uniform4(&random);
        const REAL2 sigma = coefficients(m, ray.origin);
        if (u.x * m.majorant >= sigma.x + sigma.y) continue;
        weight *= sigma.y / (sigma.x + sigma.y);
        if (n_lights > 0) {
            const int l = pick(n_lights, cumulative, u.y);
            const REAL3 to = light[l].w > 0 ? light[l].xyz - ray.origin : -light[l].xyz;
            const REAL distance = length(to);
            const REAL reach = light[l].w > 0 ? distance : INFINITY;
            const REAL E = strength[l * n_channels + c] / (light[l].w > 0 ? distance * distance : 1);
            const REAL seen = transmittance(s, m, &random, ray.origin, to / distance, reach, count, reenter);
            const REAL scattered = weight * phase(g, dot(to, ray.direction) / distance) * E * seen;
            total += scattered;
            if (order == 0) single += scattered;
        }
        order++;
        if (weight < (REAL)0.3) {
            if (u.z * (REAL)M_PI_F >= weight) break;
            weight = M_PI_F;
        }
        ray.direction = around(ray.direction, scattering_cosine(g, u.w), uniform4(&random).x);
    }
    if (tracked == cap) atomic_inc(counters + 1);
    radiosity[item] = (REAL2)(total, single);
}
