/* crossing.cl -- where grid lines along x cross the surface, and the winding number that follows.
 *
 * Line (j, k) runs at y = j/2 + shift, z = k/2 + shift (lengths in cells). Summing the signed crossings below x
 * gives the winding number at x: an integer wherever the surface is a closed cycle, whatever overlaps, nests or
 * is flipped. Edge tests depend on the edge alone, not on the triangle, so no line slips between neighbours.
 */
#include "real.h"
#include "triangle.h"

#define SHIFT ((REAL)1.52587890625e-4)

/* Whether p lies left of the edge a -> b, the same answer (negated) for b -> a. */
int left(REAL2 a, REAL2 b, const REAL2 p, REAL *restrict area) {
    const int swap = a.x > b.x || (a.x == b.x && a.y > b.y);
    const REAL2 lo = (swap ? b : a) - p, hi = (swap ? a : b) - p;
    const REAL e = lo.x * hi.y - lo.y * hi.x;
    *area = swap ? -e : e;
    return swap ? !(e >= 0) : e >= 0;
}

void cross_lines(const int t, const int ny, const int nz, __global const REAL *restrict triangle,
                 __global int *restrict cursor, __global REAL2 *restrict crossing) {
    const Triangle face = triangle_at(t, triangle);
    const REAL4 a = face.a, b = face.b, c = face.c, low = lowest(face), high = highest(face);
    const int k1 = min(nz - 1, (int)floor(2 * high.z)), j1 = min(ny - 1, (int)floor(2 * high.y));
    for (int k = max(0, (int)floor(2 * low.z) - 1); k <= k1; k++)
        for (int j = max(0, (int)floor(2 * low.y) - 1); j <= j1; j++) {
            const REAL2 p = (REAL2)((REAL)0.5 * j + SHIFT, (REAL)0.5 * k + SHIFT);
            REAL wa, wb, wc;
            const int s = left(b.yz, c.yz, p, &wa) + left(c.yz, a.yz, p, &wb) + left(a.yz, b.yz, p, &wc);
            if (s != 0 && s != 3) continue;
            const int place = atomic_inc(cursor + k * ny + j);
            if (!crossing) continue;
            const REAL w = wa + wb + wc;
            const REAL x = w != 0 ? (wa * a.x + wb * b.x + wc * c.x) / w : a.x;
            crossing[place] = (REAL2)(clamp(x, low.x, high.x), s == 3 ? -1 : 1);
        }
}

// cost count_crossings: 9R B, 100 flop
__kernel void count_crossings(const int n, const int ny, const int nz, __global const REAL *restrict triangle,
                              __global int *restrict count) {
    const int t = get_global_id(0);
    if (t < n) cross_lines(t, ny, nz, triangle, count, 0);
}

// cost list_crossings: 11R B, 100 flop
__kernel void list_crossings(const int n, const int ny, const int nz, __global const REAL *restrict triangle,
                             __global int *restrict cursor, __global REAL2 *restrict crossing) {
    const int t = get_global_id(0);
    if (t < n) cross_lines(t, ny, nz, triangle, cursor, crossing);
}

/* Cells of one row whose centre is inside: a prefix sum of the crossings' signs. One work-item per row (y, z). */
// cost interior: 2 B, 1 flop
__kernel void interior(const int n, const int4 dims, __global const int *restrict start,
                       __global const REAL2 *restrict crossing, __global char *restrict inside) {
    const int row = get_global_id(0);
    if (row >= n) return;
    const int y = row % dims.y, z = row / dims.y, line = (2 * z + 1) * (2 * dims.y + 1) + 2 * y + 1;
    __global char *restrict out = inside + (size_t)row * dims.x;
    for (int x = 0; x < dims.x; x++) out[x] = 0;
    for (int c = start[line]; c < start[line + 1]; c++) {
        const int x = max(0, (int)floor(crossing[c].x + (REAL)0.5));
        if (x < dims.x) out[x] += (char)crossing[c].y;
    }
    int winding = 0;
    for (int x = 0; x < dims.x; x++) {
        winding += out[x];
        out[x] = winding != 0;
    }
}
