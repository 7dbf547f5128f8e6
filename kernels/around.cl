/* around.cl -- which cells lie around each cut cell. */
#include "real.h"
#include "tree.h"
#include "around.h"

/* Places of rows, counted as around.h says; NOWHERE where no cell is. */
#define NOWHERE INT_MIN

/* How sides and middles differ: as the cell's own row has it, or another that has both. */
int skew_of(const int side[9], const int middle[9]) {
    if (side[4] != NOWHERE) return side[4];
    for (int row = 0; row < 9; row++)
        if (side[row] != NOWHERE && middle[row] != NOWHERE) return (is_odd(row) ? -1 : 1) * (side[row] - middle[row]);
    return 0;
}

/* Sets *too_far where a number has more bits than it may; with `far` all are kept. */
// cost list_around: 260 B, 400 flop
__kernel void list_around(const int n, const int n_red, const int n_cells, TREE,
                          __global const ushort *restrict position, __global const int *restrict cut_cell,
                          __global ushort *restrict around, __global int *restrict far,
                          __global int *restrict too_far) {
    const int c = get_global_id(0);
    if (c >= n) return;
    const Tree tree = TREE_ARGUMENTS;
    const int i = cut_cell[c], other = opposite(i, n_red, n_cells);
    const int3 p = convert_int3(vload3(i, position));
    int exist = 0, side[9], middle[9];
    for (int row = 0; row < 9; row++) {
        int at[3];
        for (int x = 0; x < 3; x++) {
            const int code = leaf_code(tree, p.x + x - 1, p.y + row % 3 - 1, p.z + row / 3 - 1);
            at[x] = code >= 0 && !(code & 15) ? code >> 4 : -1;
            exist |= (at[x] >= 0) << (3 * row + x);
        }
        const int first = at[0] >= 0 ? at[0] : at[2];
        side[row] = first < 0 ? NOWHERE : first - (is_odd(row) ? i : other);
        middle[row] = at[1] < 0 ? NOWHERE : at[1] - (is_odd(row) ? other : i);
    }
    __global ushort *restrict entry = around + ENTRIES * (size_t)c;
    const int skew = clamp(skew_of(side, middle), -other, n_cells - 1 - other);
    const ushort skewed = skew + NEAR;
    int lacks = 0;
    entry[SKEW] = skewed;
    entry[BITS] = exist & 0xffff;
    entry[BITS + 1] = exist >> 16;
    for (int row = 0; row < 9; row++) {
        /* what stands for a missing cell is one, too */
        const int like = is_odd(row) ? other : i, unlike = is_odd(row) ? i : other;
        const int tilt = (is_odd(row) ? -1 : 1) * (skewed - NEAR);
        if (middle[row] == NOWHERE)
            middle[row] = clamp(side[row] == NOWHERE ? 0 : side[row] - tilt, -like, n_cells - 1 - like);
        if (side[row] == NOWHERE) side[row] = clamp(middle[row] + tilt, -unlike, n_cells - 1 - unlike);
        int sides_lack = side[row] - tilt, middle_lacks = 0;
        if (row != 4) {
            const ushort near = middle[row] + NEAR;
            const uchar close = clamp(side[row] - middle[row] - tilt + CLOSE, 0, 255);
            entry[row - (row > 4)] = near;
            ((__global uchar *)entry)[close_at(row)] = close;
            middle_lacks = middle[row] + NEAR - near;
            sides_lack = side[row] + NEAR - near - tilt - close + CLOSE;
        }
        lacks |= sides_lack | middle_lacks;
        if (far) {
            far[18 * (size_t)c + 2 * row] = sides_lack;
            far[18 * (size_t)c + 2 * row + 1] = middle_lacks;
        }
    }
    if (lacks && !far) *too_far = 1;
}
