/* brick.h -- blocks of 8x8x8 cells of the finest grid, which is cut into them: which one a cell is in, and where. */

int block_of(const int4 dims, const int x, const int y, const int z) {
    return ((z >> 3) * (dims.y >> 3) + (y >> 3)) * (dims.x >> 3) + (x >> 3);
}

int place_in_block(const int x, const int y, const int z) { return ((z & 7) * 8 + (y & 7)) * 8 + (x & 7); }
