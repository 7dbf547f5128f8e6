/* around.cl -- which cells lie around each cut cell. */
#include "real.h"
#include "tree.h"
#include "around.h"

/* Sets *too_far where a number has more than 16 bits; with `far` all are kept. */
// cost list_around: 270 B, 400 flop
__kernel void list_around(const int n, const int n_red, const int n_cells, TREE,
                          __global const ushort *restrict position, __global const int *restrict cut_cell,
                          __global ushort *restrict around, __global short *restrict far,
                          __global int *restrict too_far) {
    const int c = get_global_id(0);
    if (c >= n) return;
    const Tree tree = TREE_ARGUMENTS;
    const int i = cut_cell[c], other = opposite(i, n_red, n_cells);
    const int3 p = convert_int3(vload3(i, position));
    int exist = 0;
    for (int row = 0; row < 9; row++) {
        const int like = (row % 3 + row / 3) & 1 ? other : i, unlike = (row % 3 + row / 3) & 1 ? i : other;
        int at[3];
        for (int x = 0; x < 3; x++) {
            const int code = leaf_code(tree, p.x + x - 1, p.y + row % 3 - 1, p.z + row / 3 - 1);
            at[x] = code >= 0 && !(code & 15) ? code >> 4 : -1;
            exist |= (at[x] >= 0) << (3 * row + x);
        }
        const int side = at[0] >= 0 ? at[0] : at[2] >= 0 ? at[2] : unlike, middle = at[1] >= 0 ? at[1] : like;
        const int step[2] = {side - unlike + NEAR, middle - like + NEAR};
        for (int k = 0; k < 2; k++) {
            around[ENTRIES * (size_t)c + 2 * row + k] = step[k] & 0xffff;
            if (far) far[18 * (size_t)c + 2 * row + k] = step[k] >> 16;
            else if (step[k] >> 16) *too_far = 1;
        }
    }
    around[ENTRIES * (size_t)c + 18] = exist & 0xffff;
    around[ENTRIES * (size_t)c + 19] = exist >> 16;
}
