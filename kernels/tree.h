/* tree.h -- which leaf holds a cell of the finest grid.
 *
 * The finest grid is cut into blocks of 8x8x8 cells. A block is empty (-1), a brick (>= 0), or covered by one leaf
 * (-2 - code). A brick has an entry for each 2x2x2 cells: the code of the leaf that holds them, -1 where none does, or
 * FINE where there are finest cells. Of bricks with such, each row along x has the first red and the first black
 * cell, and a bit for each cell that exists: those of one colour follow one another. Codes pack a leaf's place:
 * code = 16 index + depth, where index counts the cells of its level and depth is how many levels it lies above the
 * finest.
 */
#include "brick.h"
#define FINE -2

/* A kernel's parameters, and `const Tree tree = TREE_ARGUMENTS;` */
#define TREE \
    const int4 dims, __global const int *restrict block, __global const int *restrict brick, \
        __global const int2 *restrict row_start, __global const uchar *restrict filled
#define TREE_ARGUMENTS {dims, block, brick, row_start, filled}

typedef struct {
    int4 dims;
    __global const int *restrict block, *restrict brick;
    __global const int2 *restrict row_start;
    __global const uchar *restrict filled;
} Tree;

/* Index of the finest cell at a place in a brick, or -1. */
int finest_in(const Tree tree, const int b, const int place) {
    const int row = 64 * b + (place >> 3), x = place & 7, filled = tree.filled[row];
    const int2 first = tree.row_start[row];
    const int before = filled & (x & 1 ? 0xaa : 0x55) & ((1 << x) - 1);
    const int index = ((place ^ place >> 3 ^ place >> 6) & 1 ? first.y : first.x) + popcount(before);
    return filled >> x & 1 ? index : -1;
}

/* Code of the leaf at a place in a brick, or -1. */
int code_in(const Tree tree, const int b, const int place) {
    const int code = tree.brick[64 * b + (place >> 7) * 16 + (place >> 4 & 3) * 4 + (place >> 1 & 3)];
    if (code != FINE) return code;
    const int index = finest_in(tree, b, place);
    return index < 0 ? -1 : 16 * index;
}

/* Code of the leaf at a cell, or -1. */
int leaf_code(const Tree tree, const int x, const int y, const int z) {
    const int4 dims = tree.dims;
    if (x < 0 || y < 0 || z < 0 || x >= dims.x || y >= dims.y || z >= dims.z) return -1;
    const int b = tree.block[block_of(dims, x, y, z)];
    return b < 0 ? max(-2 - b, -1) : code_in(tree, b, place_in_block(x, y, z));
}
