/* bin.cl -- which cells of the finest grid a triangle may meet; lengths in cells. */
#include "real.h"
#include "triangle.h"
#include "brick.h"

// cost mark_blocks: 9R B, 60 flop
__kernel void mark_blocks(const int n, const int4 dims, const REAL reach, __global const REAL *restrict triangle,
                          __global uchar *restrict mark) {
    const int t = get_global_id(0);
    if (t >= n) return;
    const Triangle face = triangle_at(t, triangle);
    const REAL4 nrm = double_area(face);
    const int4 top = (dims >> 3) - 1;
    const int4 lo = clamp(convert_int4(floor((lowest(face) - reach) / 8)), (int4)(0), top);
    const int4 hi = clamp(convert_int4(floor((highest(face) + reach) / 8)), (int4)(0), top);
    for (int z = lo.z; z <= hi.z; z++)
        for (int y = lo.y; y <= hi.y; y++)
            for (int x = lo.x; x <= hi.x; x++)
                if (near_plane(face, nrm, (REAL4)(8 * x + 4, 8 * y + 4, 8 * z + 4, 0), 4 + reach))
                    mark[(z * (dims.y >> 3) + y) * (dims.x >> 3) + x] = 1;
}

// cost touch_cells: 9R+12 B, 100 flop
__kernel void touch_cells(const int n, const int4 dims, __global const int *restrict block,
                          __global const REAL *restrict triangle, __global uchar *restrict touched) {
    const int t = get_global_id(0);
    if (t >= n) return;
    const Triangle face = triangle_at(t, triangle);
    const REAL4 nrm = double_area(face), low = lowest(face), high = highest(face);
    const REAL slack = 1e-3;
    const int4 lo = max(convert_int4(ceil(low - 1 - slack)), (int4)(0));
    const int4 hi = min(convert_int4(floor(high + slack)), dims - 1);
    for (int z = lo.z; z <= hi.z; z++)
        for (int y = lo.y; y <= hi.y; y++)
            for (int x = lo.x; x <= hi.x; x++) {
                const REAL4 centre = (REAL4)(x + (REAL)0.5, y + (REAL)0.5, z + (REAL)0.5, 0);
                if (!near_plane(face, nrm, centre, 0.5 + slack)) continue;
                const int k = block[block_of(dims, x, y, z)];
                if (k >= 0) touched[512 * k + place_in_block(x, y, z)] = 1;
            }
}
