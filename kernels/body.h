/* body.h -- what rays run through: leaves, cut cells, and what the medium takes from light; lengths in cells.
 *
 * Cut cells count up to the plane of their boundary; cavities and gaps hold no leaves and attenuate nothing. The
 * extinction is per cell width. `clearance` has 512 bytes (clearance.cl, planes.cl) for each block that `near` gives a
 * number; of others, which are of one kind, `near` has -1 - what their cells have at least. Needs real.h and lanes.h.
 */
#include "tree.h"
#include "cut.h"
#ifdef HETEROGENEOUS
#define EXTINCTION __global const REAL *restrict extinction, __global const int *restrict depth_start
#define EXTINCTION_MEMBERS __global const REAL *restrict extinction; __global const int *restrict depth_start;
#define EXTINCTION_ARGUMENTS extinction, depth_start
#else
#define EXTINCTION const REAL4 extinction
#define EXTINCTION_MEMBERS REAL4 extinction;
#define EXTINCTION_ARGUMENTS extinction
#endif

/* A kernel's parameters, and `const Body body = BODY_ARGUMENTS;` */
#define BODY \
    TREE, __global const int *restrict near, __global const uchar *restrict clearance, \
        __global const int *restrict cut_index, \
        __global const REAL4 *restrict boundary, __global const REAL *restrict normal, \
        __global const REAL4 *restrict centroid, __global const int *restrict first_plane, \
        __global const REAL4 *restrict plane, __global const int *restrict plane_cell, EXTINCTION
#define BODY_ARGUMENTS \
    {TREE_ARGUMENTS, near, clearance, cut_index, normal, first_plane, plane, plane_cell, EXTINCTION_ARGUMENTS}

typedef struct {
    Tree tree;
    __global const int *restrict near;
    __global const uchar *restrict clearance;
    __global const int *restrict cut_index;
    __global const REAL *restrict normal;
    __global const int *restrict first_plane;
    __global const REAL4 *restrict plane;
    __global const int *restrict plane_cell;
    EXTINCTION_MEMBERS
} Body;

/* Place of a cell in blocks of 8x8x8, all of them. */
INTN place_of(const int4 dims, const INTN x, const INTN y, const INTN z) {
    const INTN block = ((z >> 3) * (dims.y >> 3) + (y >> 3)) * (dims.x >> 3) + (x >> 3);
    return block * 512 + ((z & 7) * 8 + (y & 7)) * 8 + (x & 7);
}

/* Codes (tree.h) of the leaves at places where there are any. */
INTN codes_at(const Body body, const INTN place) {
    const Tree tree = body.tree;
    const INTN b = gather(tree.block, place >> 9), brick = max(b, 0);
    const INTN octant = (place >> 7 & 3) * 16 + (place >> 4 & 3) * 4 + (place >> 1 & 3);
    const INTN code = CHOOSE(gather(tree.brick, 64 * brick + octant), -2 - b, b < 0);
    const INTN row = CHOOSE((INTN)(0), 64 * brick + (place >> 3 & 63), code == FINE), x = place & 7;
    const INTN side = (place ^ place >> 3 ^ place >> 6) & 1;
    const INTN before = gather_bytes(tree.filled, row) & ((INTN)(0x55) << (x & 1)) & (((INTN)(1) << x) - 1);
    const INTN index = gather((__global const int *)tree.row_start, 2 * row + side) + popcount(before);
    return CHOOSE(code, 16 * index, code == FINE);
}
