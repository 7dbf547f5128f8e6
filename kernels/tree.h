/* tree.h -- which leaf holds a cell of the finest grid.
 *
 * The finest grid is cut into blocks of 8x8x8 cells. A block is empty (-1), a brick of 512 entries (>= 0), or
 * covered by one leaf (-2 - code). Codes pack a leaf's place: code = 16 index + depth, where index counts the
 * cells of its level and depth is how many levels it lies above the finest. Entries of -1 are outside.
 */
int leaf_code(const int4 dims, __global const int *restrict block, __global const int *restrict brick,
              const int x, const int y, const int z) {
    if (x < 0 || y < 0 || z < 0 || x >= dims.x || y >= dims.y || z >= dims.z) return -1;
    const int b = block[((z >> 3) * (dims.y >> 3) + (y >> 3)) * (dims.x >> 3) + (x >> 3)];
    if (b < 0) return b == -1 ? -1 : -2 - b;
    return brick[b * 512 + ((z & 7) * 8 + (y & 7)) * 8 + (x & 7)];
}
