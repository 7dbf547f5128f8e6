/* planes.cl -- planes of the boundary of cut cells, those of neighbours in space side by side: what rays meet stays in
 * a cache, and from a cell two loads lead to its plane (slice.h).
 */
#include "real.h"
#include "tree.h"
#include "cut.h"

/* Plane n . x = offset, x from a cell's corner; n = 0 where the boundary has two sheets, which have no one plane: there
 * `offset` is the share of the cell that is inside. */
REAL4 plane_of(const REAL4 boundary, const REAL4 normal, const REAL inside) {
    const int two_sheets = dot(normal, normal) < (REAL)0.25 * boundary.w * boundary.w;
    return two_sheets ? (REAL4)(0, 0, 0, inside) : (REAL4)(normal.xyz, dot(normal.xyz, boundary.xyz));
}

/* Planes of the cut cells, block by block: those of block m, as `near` counts, from number start[m] on. Also the first
 * number of each layer of 64 cells and, in `clearance`, CUT and how many of a cut cell's layer lie before it. One
 * work-item a block. */
// cost list_planes: 8R+150 B, 400 flop
__kernel void list_planes(const int n, TREE, __global const int *restrict near, __global uchar *restrict clearance,
                          __global const int *restrict cut_index, __global const REAL4 *restrict boundary,
                          __global const REAL *restrict normal, __global const REAL4 *restrict centroid,
                          __global const int *restrict start, __global int *restrict first_plane,
                          __global REAL4 *restrict plane, __global int *restrict plane_cell) {
    const int b = get_global_id(0), m = b < n ? near[b] : -1;
    if (m < 0) return;
    const Tree tree = TREE_ARGUMENTS;
    int k = start[m];
    for (int row = 0; row < 64; row++) {
        const int layer = 8 * m + (row >> 3);
        if ((row & 7) == 0) first_plane[layer] = k;
        if (all(vload8(64 * m + row, clearance) != (uchar8)(0))) continue;
        for (int x = 0; x < 8; x++) {
            const int place = 8 * row + x;
            if (clearance[512 * m + place]) continue;
            const int cell = finest_in(tree, block[b], place), c = cut_index[cell];
            clearance[512 * m + place] = CUT + k - first_plane[layer];
            plane_cell[k] = cell;
            plane[k++] = plane_of(boundary[c], vector_at(c, normal), centroid[c].w);
        }
    }
}
