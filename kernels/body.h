/* body.h -- what rays run through: leaves, cut cells, and what the medium takes from light; lengths in cells.
 *
 * Cut cells count up to the plane of their boundary; cavities and gaps hold no leaves and attenuate nothing. The
 * extinction is per cell width. `clearance` has 512 bytes (clearance.cl) for each block that `near` gives a number; of
 * others, which are of one kind, `near` has -1 - what their cells have at least. Needs real.h and lanes.h.
 */
#include "tree.h"
#ifdef HETEROGENEOUS
#define EXTINCTION __global const REAL4 *restrict extinction, __global const int *restrict depth_start
#define EXTINCTION_MEMBERS __global const REAL4 *restrict extinction; __global const int *restrict depth_start;
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
        __global const REAL4 *restrict boundary, __global const REAL4 *restrict normal, \
        __global const REAL4 *restrict centroid, EXTINCTION
#define BODY_ARGUMENTS {TREE_ARGUMENTS, near, clearance, cut_index, boundary, normal, centroid, EXTINCTION_ARGUMENTS}

typedef struct {
    Tree tree;
    __global const int *restrict near;
    __global const uchar *restrict clearance;
    __global const int *restrict cut_index;
    __global const REAL4 *restrict boundary, *restrict normal, *restrict centroid;
    EXTINCTION_MEMBERS
} Body;

/* Place of a cell in blocks of 8x8x8, all of them. */
INTN place_of(const int4 dims, const INTN x, const INTN y, const INTN z) {
    const INTN block = ((z >> 3) * (dims.y >> 3) + (y >> 3)) * (dims.x >> 3) + (x >> 3);
    return block * 512 + ((z & 7) * 8 + (y & 7)) * 8 + (x & 7);
}

/* Code of the leaf at a place (tree.h). */
int code_at(const Body body, const int place) {
    const int b = body.tree.block[place >> 9];
    return b < 0 ? -2 - b : code_in(body.tree, b, place & 511);
}
