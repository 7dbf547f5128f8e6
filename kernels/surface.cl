/* surface.cl -- boundary fluence at points of the surface: weighted linear fit in the tangent plane.
 *
 * For point v the cut cells k within `radius` cells count, with weight alpha_B (1 - |v - x_B|^2 / radius^2)^2 and
 * only where n_k . n_v > 0: the two sides of a thin sheet stay apart. The fit's value at v has order two.
 */
#include "real.h"

/* The cut cell at a cell of the finest grid, or -1. */
int cut_at(const int4 dims, __global const int *restrict block, __global const int *restrict brick,
           __global const uchar *restrict clearance, __global const int *restrict cut_index, const int x, const int y,
           const int z) {
    if (x < 0 || y < 0 || z < 0 || x >= dims.x || y >= dims.y || z >= dims.z) return -1;
    const int b = ((z >> 3) * (dims.y >> 3) + (y >> 3)) * (dims.x >> 3) + (x >> 3);
    const int place = ((z & 7) * 8 + (y & 7)) * 8 + (x & 7);
    return clearance[512 * b + place] ? -1 : cut_index[brick[512 * block[b] + place] >> 4];
}

/* Two fields at once. */
// cost fit_at_points: 800R+400 B, 2500 flop
__kernel void fit_at_points(const int n, const REAL radius, const int4 dims, __global const int *restrict block,
                            __global const int *restrict brick, __global const uchar *restrict clearance,
                            __global const int *restrict cut_index, __global const REAL4 *restrict boundary,
                            __global const REAL4 *restrict normal, __global const REAL *restrict points,
                            __global const REAL *restrict point_normal, __global const REAL4 *restrict first_field,
                            __global const REAL4 *restrict second_field, __global REAL8 *restrict value,
                            __global int *restrict used) {
    const int v = get_global_id(0);
    if (v >= n) return;
    const REAL4 p = (REAL4)(vload3(v, points), 0), n_v = (REAL4)(vload3(v, point_normal), 0);
    const REAL4 seed = fabs(n_v.x) < (REAL)0.6 ? (REAL4)(1, 0, 0, 0) : (REAL4)(0, 1, 0, 0);
    const REAL4 s_axis = normalize(cross(n_v, seed)), t_axis = cross(n_v, s_axis);
    const int4 low = convert_int4(floor(p - radius)), high = convert_int4(floor(p + radius));
    REAL m00 = 0, m01 = 0, m02 = 0, m11 = 0, m12 = 0, m22 = 0;
    REAL8 r0 = (REAL8)(0), r1 = (REAL8)(0), r2 = (REAL8)(0);
    int count = 0;
    for (int z = low.z; z <= high.z; z++)
        for (int y = low.y; y <= high.y; y++)
            for (int x = low.x; x <= high.x; x++) {
                const int k = cut_at(dims, block, brick, clearance, cut_index, x, y, z);
                if (k < 0 || dot(normal[k].xyz, n_v.xyz) <= 0) continue;
                const REAL4 b = boundary[k];
                const REAL4 d = (REAL4)(x + b.x - p.x, y + b.y - p.y, z + b.z - p.z, 0) / radius;
                const REAL near = 1 - dot(d, d);
                if (near <= 0) continue;
                const REAL w = b.w * near * near, s = dot(d, s_axis), t = dot(d, t_axis);
                const REAL8 f = (REAL8)(first_field[k], second_field[k]);
                m00 += w;
                m01 += w * s;
                m02 += w * t;
                m11 += w * s * s;
                m12 += w * s * t;
                m22 += w * t * t;
                r0 += w * f;
                r1 += w * s * f;
                r2 += w * t * f;
                count += w > 0;
            }
    used[v] = m00 > 0 ? count : 0;
    REAL8 mean = m00 > 0 ? r0 / m00 : (REAL8)(0);
    if (m00 > 0 && count >= 3) {
        /* Centred moments first: their 2x2 system is well scaled, and its ridge leaves constants alone. */
        const REAL s = m01 / m00, t = m02 / m00, ridge = (REAL)1e-4 * m00;
        const REAL a = m11 - s * m01 + ridge, b = m12 - s * m02, d = m22 - t * m02 + ridge, det = a * d - b * b;
        const REAL8 u = r1 - s * r0, w = r2 - t * r0;
        mean -= s * (d * u - b * w) / det + t * (a * w - b * u) / det;
    }
    value[v] = mean;
}
