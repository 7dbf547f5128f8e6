/* distance.cl -- signed distance at the half-cell nodes that a cell owns; negative inside, lengths in cells.
 *
 * A cell at c owns the eight nodes c + {0, 1/2}^3. Distances beyond `reach` are cut there. The sign is the
 * winding number's (crossing.cl), or is given by the caller where the surface is no closed cycle.
 */
#include "real.h"
#include "samples.h"

/* Squared distance of eight points to the segment a + s e; ap = p - a. */
REAL8 segment_distance2(const REAL8 px, const REAL8 py, const REAL8 pz, const REAL4 e) {
    const REAL8 s = clamp((px * e.x + py * e.y + pz * e.z) / fmax(dot(e, e), (REAL)1e-30), (REAL8)(0), (REAL8)(1));
    const REAL8 dx = px - s * e.x, dy = py - s * e.y, dz = pz - s * e.z;
    return dx * dx + dy * dy + dz * dz;
}

// cost distance_at_nodes: 28R+12 B, 2000 flop
__kernel void distance_at_nodes(const int n, const int ny, const REAL reach, __global const int *restrict cell,
                                __global const int *restrict owner, __global const int *restrict list_start,
                                __global const int *restrict list, __global const int *restrict line_start,
                                __global const REAL2 *restrict crossing, __global const REAL *restrict triangle,
                                __global REAL *restrict distance) {
    const int i = get_global_id(0);
    if (i >= n) return;
    const int4 c = vload4(i, cell);
    const REAL8 half_x = (REAL8)(0, 0.5, 0, 0.5, 0, 0.5, 0, 0.5), half_y = (REAL8)(0, 0, 0.5, 0.5, 0, 0, 0.5, 0.5),
                half_z = (REAL8)(0, 0, 0, 0, 0.5, 0.5, 0.5, 0.5);
    REAL8 best = (REAL8)(reach * reach);
    for (int k = list_start[owner[i]]; k < list_start[owner[i] + 1]; k++) {
        const int t = list[k];
        const REAL4 origin = (REAL4)(c.x, c.y, c.z, 0);
        const REAL4 a = (REAL4)(vload3(3 * t, triangle), 0) - origin, b = (REAL4)(vload3(3 * t + 1, triangle), 0) - origin,
                    d = (REAL4)(vload3(3 * t + 2, triangle), 0) - origin;
        const REAL4 ab = b - a, bd = d - b, da = a - d, m = cross(ab, d - a);
        const REAL8 ax = half_x - a.x, ay = half_y - a.y, az = half_z - a.z;
        const REAL8 bx = half_x - b.x, by = half_y - b.y, bz = half_z - b.z;
        const REAL8 dx = half_x - d.x, dy = half_y - d.y, dz = half_z - d.z;
        REAL8 d2 = fmin(segment_distance2(ax, ay, az, ab),
                        fmin(segment_distance2(bx, by, bz, bd), segment_distance2(dx, dy, dz, da)));
        const REAL4 na = cross(m, ab), nb = cross(m, bd), nd = cross(m, da);
        const REAL8 least = fmin(ax * na.x + ay * na.y + az * na.z,
                                 fmin(bx * nb.x + by * nb.y + bz * nb.z, dx * nd.x + dy * nd.y + dz * nd.z));
        const REAL8 height = ax * m.x + ay * m.y + az * m.z;
        const REAL8 plane = height * height / fmax(dot(m, m), (REAL)1e-30);
        best = fmin(best, select(d2, fmin(d2, plane), least >= 0));
    }
    best = fmax(sqrt(best), (REAL)1e-4);
    REAL value[8];
    vstore8(best, 0, value);
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
