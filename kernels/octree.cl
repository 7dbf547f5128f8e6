/* octree.cl -- face neighbours of the finest cells; where cells of finer levels are. */
#include "real.h"
#include "tree.h"
#include "child.h"

/* nbr: the index of the neighbour of the same size; -1 where there is none. */
// cost neighbours: 36+24 B, 60 flop
__kernel void neighbours(const int n, TREE, __global const int *restrict ijk, __global int *restrict nbr) {
    const int i = get_global_id(0);
    if (i >= n) return;
    const Tree tree = TREE_ARGUMENTS;
    const int x = ijk[3 * i], y = ijk[3 * i + 1], z = ijk[3 * i + 2];
    for (int f = 0; f < 6; f++) {
        const int step = 2 * (f & 1) - 1;
        const int code = leaf_code(tree, x + (f < 2 ? step : 0), y + (f >> 1 == 1 ? step : 0), z + (f > 3 ? step : 0));
        nbr[6 * i + f] = code == -1 ? -1 : code >> 4;
    }
}

/* Cells in covered ones (child.h) are at twice their place, in widths of each level, and further by their octant. */
// cost place_children: 94 B, 60 flop
__kernel void place_children(const int n, __global const int *restrict covered, __global const int *restrict child,
                             __global const int *restrict chain, __global const ushort *restrict coarse,
                             __global ushort *restrict position) {
    const int c = get_global_id(0);
    if (c >= n) return;
    const ushort3 corner = vload3(covered[c], coarse) * (ushort)2;
    for (int o = 0; o < 8; o++)
        for (int next = child[8 * c + o]; next != -1;)
            vstore3(corner + (ushort3)(o & 1, o >> 1 & 1, o >> 2), take_child(&next, chain), position);
}
