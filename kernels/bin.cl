/* bin.cl -- triangles near each cell of the finest grid; lengths in cells.
 *
 * Triangle t is listed at a cell when it may lie within `reach` of the half-cell nodes that the cell owns,
 * and the cell is touched when it may meet the cell itself. Cells live in bricks of 8x8x8 (see tree.h).
 */
#include "real.h"

/* Whether the triangle's plane passes within the box at c of half-width r. */
int near_plane(const REAL4 a, const REAL4 n, const REAL4 c, const REAL r) {
    return fabs(dot(n, c - a)) <= r * (fabs(n.x) + fabs(n.y) + fabs(n.z));
}

// cost mark_blocks: 9R B, 60 flop
__kernel void mark_blocks(const int n, const int4 dims, const REAL reach, __global const REAL *restrict triangle,
                          __global uchar *restrict mark) {
    const int t = get_global_id(0);
    if (t >= n) return;
    const REAL4 a = (REAL4)(vload3(3 * t, triangle), 0), b = (REAL4)(vload3(3 * t + 1, triangle), 0),
                c = (REAL4)(vload3(3 * t + 2, triangle), 0);
    const REAL4 nrm = cross(b - a, c - a);
    const int4 top = (dims >> 3) - 1;
    const int4 lo = clamp(convert_int4(floor((fmin(a, fmin(b, c)) - reach) / 8)), (int4)(0), top);
    const int4 hi = clamp(convert_int4(floor((fmax(a, fmax(b, c)) + reach) / 8)), (int4)(0), top);
    for (int z = lo.z; z <= hi.z; z++)
        for (int y = lo.y; y <= hi.y; y++)
            for (int x = lo.x; x <= hi.x; x++)
                if (near_plane(a, nrm, (REAL4)(8 * x + 4, 8 * y + 4, 8 * z + 4, 0), 4 + reach))
                    mark[(z * (dims.y >> 3) + y) * (dims.x >> 3) + x] = 1;
}

/* One pass over a triangle's cells: count them (list == 0), or append the triangle to their lists. */
void visit(const int t, const int4 dims, const REAL reach, __global const int *restrict block,
           __global const REAL *restrict triangle, __global int *restrict cursor, __global uchar *restrict touched,
           __global int *restrict list) {
    const REAL4 a = (REAL4)(vload3(3 * t, triangle), 0), b = (REAL4)(vload3(3 * t + 1, triangle), 0),
                c = (REAL4)(vload3(3 * t + 2, triangle), 0);
    const REAL4 nrm = cross(b - a, c - a), low = fmin(a, fmin(b, c)), high = fmax(a, fmax(b, c));
    const int4 lo = max(convert_int4(floor(low - reach - (REAL)0.5)), (int4)(0));
    const int4 hi = min(convert_int4(floor(high + reach)), dims - 1);
    const REAL slack = 1e-3;
    for (int z = lo.z; z <= hi.z; z++)
        for (int y = lo.y; y <= hi.y; y++)
            for (int x = lo.x; x <= hi.x; x++) {
                const REAL4 corner = (REAL4)(x, y, z, 0);
                if (!near_plane(a, nrm, corner + (REAL4)(0.25, 0.25, 0.25, 0), reach + 0.25)) continue;
                const int k = block[((z >> 3) * (dims.y >> 3) + (y >> 3)) * (dims.x >> 3) + (x >> 3)];
                if (k < 0) continue;
                const int cell = k * 512 + ((z & 7) * 8 + (y & 7)) * 8 + (x & 7);
                const int place = atomic_inc(cursor + cell);
                if (list) {
                    list[place] = t;
                } else if (low.x <= x + 1 + slack && low.y <= y + 1 + slack && low.z <= z + 1 + slack &&
                           high.x >= x - slack && high.y >= y - slack && high.z >= z - slack &&
                           near_plane(a, nrm, corner + (REAL4)(0.5, 0.5, 0.5, 0), 0.5 + slack)) {
                    touched[cell] = 1;
                }
            }
}

// cost count_triangles: 9R B, 200 flop
__kernel void count_triangles(const int n, const int4 dims, const REAL reach, __global const int *restrict block,
                              __global const REAL *restrict triangle, __global int *restrict count,
                              __global uchar *restrict touched) {
    const int t = get_global_id(0);
    if (t < n) visit(t, dims, reach, block, triangle, count, touched, 0);
}

// cost list_triangles: 9R B, 200 flop
__kernel void list_triangles(const int n, const int4 dims, const REAL reach, __global const int *restrict block,
                             __global const REAL *restrict triangle, __global int *restrict cursor,
                             __global int *restrict list) {
    const int t = get_global_id(0);
    if (t < n) visit(t, dims, reach, block, triangle, cursor, 0, list);
}
