/* thickness.cl -- rays from the surface inwards end where they leave the object; lengths in cells.
 *
 * A cell has one ray at most. Triangles that a ray meets from behind shorten it, in any order.
 */
#include "real.h"
#include "triangle.h"
#include "brick.h"
#include "lower.h"

/* How far along the unit vector d from p a triangle is met from behind, or -1. */
REAL met_from_behind(const REAL4 p, const REAL4 d, const Triangle face) {
    const REAL4 a = face.a, b = face.b, c = face.c, n = double_area(face);
    const REAL facing = dot(n, d);
    if (!(facing > 0)) return -1;
    const REAL t = dot(n, a - p) / facing;
    const REAL4 x = p + t * d;
    const int within = dot(n, cross(b - a, x - a)) >= 0 && dot(n, cross(c - b, x - b)) >= 0 &&
                       dot(n, cross(a - c, x - c)) >= 0;
    return within ? t : -1;
}

// cost shorten_rays: 15R+120 B, 300 flop
__kernel void shorten_rays(const int n, const int4 dims, const REAL reach, __global const int *restrict block,
                           __global const int *restrict ray_of_cell, __global const REAL *restrict ray,
                           __global const REAL *restrict triangle, volatile __global REAL *length) {
    const int t = get_global_id(0);
    if (t >= n) return;
    const Triangle face = triangle_at(t, triangle);
    const REAL4 nrm = double_area(face), low = lowest(face), high = highest(face);
    const int4 lo = max(convert_int4(ceil(low - reach - 1)), (int4)(0));
    const int4 hi = min(convert_int4(floor(high + reach)), dims - 1);
    for (int z = lo.z; z <= hi.z; z++)
        for (int y = lo.y; y <= hi.y; y++)
            for (int x = lo.x; x <= hi.x; x++) {
                const REAL4 centre = (REAL4)(x + (REAL)0.5, y + (REAL)0.5, z + (REAL)0.5, 0);
                if (!near_plane(face, nrm, centre, reach + (REAL)0.5)) continue;
                const int k = block[block_of(dims, x, y, z)];
                if (k < 0) continue;
                const int r = ray_of_cell[512 * k + place_in_block(x, y, z)];
                if (r < 0) continue;
                const REAL4 start = (REAL4)(vload3(2 * r, ray), 0), direction = (REAL4)(vload3(2 * r + 1, ray), 0);
                const REAL met = met_from_behind(start, direction, face);
                if (met > (REAL)1e-4 && met < reach) LOWER(length + r, met);
            }
}
