/* distance.cl -- signed distance at the half-cell nodes that a cell owns; negative inside, lengths in cells.
 *
 * A cell at c owns the eight nodes c + {0, 1/2}^3. Distances beyond `reach` are cut there. The sign is the
 * winding number's (crossing.cl), or is given by the caller where the surface is no closed cycle.
 */
#include "real.h"
#include "triangle.h"
#include "brick.h"
#include "samples.h"
#include "lower.h"

/* Squared distance of eight points to the segment a + s e; p relative to a. */
REAL8 segment_distance2(const REAL8 px, const REAL8 py, const REAL8 pz, const REAL4 e) {
    const REAL8 s = clamp((px * e.x + py * e.y + pz * e.z) / fmax(dot(e, e), (REAL)1e-30), (REAL8)(0), (REAL8)(1));
    const REAL8 dx = px - s * e.x, dy = py - s * e.y, dz = pz - s * e.z;
    return dx * dx + dy * dy + dz * dz;
}

/* Squared distance of the eight nodes of the cell at the origin to the triangle a b d. */
REAL8 triangle_distance2(const REAL4 a, const REAL4 b, const REAL4 d) {
    const REAL8 half_x = (REAL8)(0, 0.5, 0, 0.5, 0, 0.5, 0, 0.5), half_y = (REAL8)(0, 0, 0.5, 0.5, 0, 0, 0.5, 0.5),
                half_z = (REAL8)(0, 0, 0, 0, 0.5, 0.5, 0.5, 0.5);
    const REAL4 ab = b - a, bd = d - b, da = a - d, m = cross(ab, d - a);
    const REAL8 ax = half_x - a.x, ay = half_y - a.y, az = half_z - a.z;
    const REAL8 bx = half_x - b.x, by = half_y - b.y, bz = half_z - b.z;
    const REAL8 dx = half_x - d.x, dy = half_y - d.y, dz = half_z - d.z;
    const REAL8 d2 = fmin(segment_distance2(ax, ay, az, ab),
                          fmin(segment_distance2(bx, by, bz, bd), segment_distance2(dx, dy, dz, da)));
    const REAL4 na = cross(m, ab), nb = cross(m, bd), nd = cross(m, da);
    const REAL8 least = fmin(ax * na.x + ay * na.y + az * na.z,
                             fmin(bx * nb.x + by * nb.y + bz * nb.z, dx * nd.x + dy * nd.y + dz * nd.z));
    const REAL8 height = ax * m.x + ay * m.y + az * m.z;
    const REAL8 plane = height * height / fmax(dot(m, m), (REAL)1e-30);
    return select(d2, fmin(d2, plane), least >= 0);
}

/* Lower the squared distances of the nodes near each triangle to it; one work-item a triangle, in any order. */
// cost distance_to_triangle: 100R+48 B, 3000 flop
__kernel void distance_to_triangle(const int n, const int4 dims, const REAL reach, __global const int *restrict block,
                                   __global const int *restrict slot, __global const REAL *restrict triangle,
                                   volatile __global REAL *distance2) {
    const int t = get_global_id(0);
    if (t >= n) return;
    const Triangle face = triangle_at(t, triangle);
    const REAL4 nrm = double_area(face), low = lowest(face), high = highest(face);
    const int4 lo = max(convert_int4(ceil(low - reach - (REAL)0.5)), (int4)(0));
    const int4 hi = min(convert_int4(floor(high + reach)), dims - 1);
    for (int z = lo.z; z <= hi.z; z++)
        for (int y = lo.y; y <= hi.y; y++)
            for (int x = lo.x; x <= hi.x; x++) {
                const REAL4 corner = (REAL4)(x, y, z, 0);
                if (!near_plane(face, nrm, corner + (REAL4)(0.25, 0.25, 0.25, 0), reach + 0.25)) continue;
                const int k = block[block_of(dims, x, y, z)];
                const int s = k < 0 ? -1 : slot[512 * k + place_in_block(x, y, z)];
                if (s < 0) continue;
                REAL found[8];
                vstore8(triangle_distance2(face.a - corner, face.b - corner, face.c - corner), 0, found);
                for (int node = 0; node < 8; node++)
                    if (found[node] < distance2[8 * s + node]) LOWER(distance2 + 8 * s + node, found[node]);
            }
}

/* From squared to signed distances of the nodes that a cell owns. */
// cost distance_at_nodes: 24R+16 B, 60 flop
__kernel void distance_at_nodes(const int n, const int ny, __global const int *restrict cell,
                                __global const int *restrict line_start, __global const REAL2 *restrict crossing,
                                __global REAL *restrict distance) {
    const int i = get_global_id(0);
    if (i >= n) return;
    const int4 c = vload4(i, cell);
    REAL value[8];
    vstore8(fmax(sqrt(vload8(i, distance)), (REAL)1e-4), 0, value);
    if (line_start)
        for (int s = 0; s < 8; s++) {
            const int line = (2 * c.z + (s >> 2)) * ny + 2 * c.y + ((s >> 1) & 1);
            int winding = 0;
            for (int k = line_start[line]; k < line_start[line + 1]; k++)
                winding += crossing[k].x <= c.x + (REAL)0.5 * (s & 1) ? (int)crossing[k].y : 0;
            if (winding) value[s] = -value[s];
        }
    vstore8(vload8(0, value), i, distance);
}

/* 0: the cell is outside, 1: inside, 2: the surface cuts it. */
// cost classify: 27R+33 B, 54 flop
__kernel void classify(const int n, __global const int *restrict owners, __global const REAL *restrict distance,
                       __global uchar *restrict state) {
    const int i = get_global_id(0);
    if (i >= n) return;
    REAL f[27];
    gather_samples(i, owners, distance, f);
    int n_inside = 0;
    for (int k = 0; k < 27; k++) n_inside += f[k] < 0;
    state[i] = n_inside == 0 ? 0 : n_inside == 27 ? 1 : 2;
}
