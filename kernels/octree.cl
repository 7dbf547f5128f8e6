/* octree.cl -- face neighbours of the finest cells. */
#include "real.h"
#include "tree.h"

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
