/* surface.cl -- which cut cells a value at a point of the surface is fitted to: weighted linear fit in the tangent
 * plane.
 *
 * For point v the cut cells k within `radius` cells count, with weight alpha_B (1 - |v - x_B|^2 / radius^2)^2 and
 * only where n_k . n_v > 0: the two sides of a thin sheet stay apart. The fit's value at v has order two; it is linear
 * in the values at the boundary, so that the same shares of them do for every field.
 */
#include "real.h"
#include "tree.h"

#define MOST 216 /* cells that a ball of the wider radius touches at most */
#define ENOUGH 3 /* cut cells for the narrower radius to do */

/* The cut cell at a cell of the finest grid, or -1. */
int cut_at(const Tree tree, __global const int *restrict near, __global const uchar *restrict clearance,
           __global const int *restrict cut_index, const int x, const int y, const int z) {
    const int4 dims = tree.dims;
    if (x < 0 || y < 0 || z < 0 || x >= dims.x || y >= dims.y || z >= dims.z) return -1;
    const int b = block_of(dims, x, y, z), place = place_in_block(x, y, z);
    if (near[b] < 0 || clearance[512 * near[b] + place]) return -1;
    return cut_index[finest_in(tree, tree.block[b], place)];
}

/* Up to `width` cut cells that each point counts within the first of two radii that finds enough, their shares in
 * the value, and how many there are. */
// cost share_at_points: 250R+500 B, 2000 flop
__kernel void share_at_points(const int n, const int width, const REAL radius_near, const REAL radius_wide,
                              TREE, __global const int *restrict near, __global const uchar *restrict clearance,
                              __global const int *restrict cut_index,
                              __global const REAL4 *restrict boundary, __global const REAL *restrict normal,
                              __global const REAL *restrict points, __global const REAL *restrict point_normal,
                              __global int *restrict cut, __global REAL *restrict share, __global int *restrict used) {
    const int v = get_global_id(0);
    if (v >= n) return;
    const Tree tree = TREE_ARGUMENTS;
    const REAL4 p = (REAL4)(vload3(v, points), 0), n_v = (REAL4)(vload3(v, point_normal), 0);
    const REAL4 seed = fabs(n_v.x) < (REAL)0.6 ? (REAL4)(1, 0, 0, 0) : (REAL4)(0, 1, 0, 0);
    const REAL4 s_axis = normalize(cross(n_v, seed)), t_axis = cross(n_v, s_axis);
    __global int *restrict cuts = cut + (size_t)v * width;
    __global REAL *restrict shares = share + (size_t)v * width;
    REAL2 at[MOST];
    REAL m00, m01, m02, m11, m12, m22;
    int count = 0;
    for (int wider = 0; wider < 2 && count < ENOUGH; wider++) {
        const REAL radius = wider ? radius_wide : radius_near;
        const int4 low = convert_int4(floor(p - radius)), high = convert_int4(floor(p + radius));
        m00 = m01 = m02 = m11 = m12 = m22 = 0;
        count = 0;
        for (int z = low.z; z <= high.z; z++)
            for (int y = low.y; y <= high.y; y++)
                for (int x = low.x; x <= high.x; x++) {
                    const int k = cut_at(tree, near, clearance, cut_index, x, y, z);
                    if (k < 0) continue;
                    const REAL4 b = boundary[k];
                    const REAL4 d = (REAL4)(x + b.x - p.x, y + b.y - p.y, z + b.z - p.z, 0) / radius;
                    const REAL closeness = dot(vector_at(k, normal), n_v) > 0 ? fmax(1 - dot(d, d), (REAL)0) : 0;
                    const REAL w = b.w * closeness * closeness, s = dot(d, s_axis), t = dot(d, t_axis);
                    const int slot = min(count, width - 1); /* the next one's where this does not count */
                    cuts[slot] = k;
                    shares[slot] = w;
                    at[slot] = (REAL2)(s, t);
                    m00 += w;
                    m01 += w * s;
                    m02 += w * t;
                    m11 += w * s * s;
                    m12 += w * s * t;
                    m22 += w * t * t;
                    count += w > 0;
                }
    }
    used[v] = count;
    if (count == 0 || count > width) return;
    const REAL s = m01 / m00, t = m02 / m00;
    REAL along_s = 0, along_t = 0;
    if (count >= ENOUGH) {
        /* Centred moments first: their 2x2 system is well scaled, and its ridge leaves constants alone. */
        const REAL ridge = (REAL)1e-4 * m00;
        const REAL a = m11 - s * m01 + ridge, b = m12 - s * m02, d = m22 - t * m02 + ridge, det = a * d - b * b;
        along_s = (s * d - t * b) / det;
        along_t = (t * a - s * b) / det;
    }
    for (int k = 0; k < count; k++) shares[k] *= 1 / m00 - along_s * (at[k].x - s) - along_t * (at[k].y - t);
}
