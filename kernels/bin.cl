/* bin.cl -- which cells of the finest grid a triangle may meet; lengths in cells. Cells live in bricks of 8x8x8. */
#include "real.h"
#include "plane.h"

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

// cost touch_cells: 9R+12 B, 100 flop
__kernel void touch_cells(const int n, const int4 dims, __global const int *restrict block,
                          __global const REAL *restrict triangle, __global uchar *restrict touched) {
    const int t = get_global_id(0);
    if (t >= n) return;
    const REAL4 a = (REAL4)(vload3(3 * t, triangle), 0), b = (REAL4)(vload3(3 * t + 1, triangle), 0),
                c = (REAL4)(vload3(3 * t + 2, triangle), 0);
    const REAL4 nrm = cross(b - a, c - a), low = fmin(a, fmin(b, c)), high = fmax(a, fmax(b, c));
    const REAL slack = 1e-3;
    const int4 lo = max(convert_int4(ceil(low - 1 - slack)), (int4)(0));
    const int4 hi = min(convert_int4(floor(high + slack)), dims - 1);
    for (int z = lo.z; z <= hi.z; z++)
        for (int y = lo.y; y <= hi.y; y++)
            for (int x = lo.x; x <= hi.x; x++) {
                if (!near_plane(a, nrm, (REAL4)(x + (REAL)0.5, y + (REAL)0.5, z + (REAL)0.5, 0), 0.5 + slack)) continue;
                const int k = block[((z >> 3) * (dims.y >> 3) + (y >> 3)) * (dims.x >> 3) + (x >> 3)];
                if (k >= 0) touched[k * 512 + ((z & 7) * 8 + (y & 7)) * 8 + (x & 7)] = 1;
            }
}
