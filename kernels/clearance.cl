/* clearance.cl -- how far every cell of the finest grid is from one of another kind, for rays to leap across (march.h).
 *
 * A cell is cut (0), full (128 + k) or empty (k): all cells within k - 1 of it, diagonals included, are of its kind.
 * Distances of this kind separate: along x first, then across rows, then across planes.
 */
#define FURTHEST 15 /* longer leaps would save less than it takes to find them */

/* Along x, one work-item a row: from 0 cut, 1 empty, 129 full. */
// cost clear_along: 2 B, 4 flop
__kernel void clear_along(const int n, const int4 dims, __global const uchar *restrict kind,
                          __global uchar *restrict clear) {
    const int row = get_global_id(0);
    if (row >= n) return;
    __global const uchar *restrict in = kind + (size_t)row * dims.x;
    __global uchar *restrict out = clear + (size_t)row * dims.x;
    int run = FURTHEST;
    for (int x = 0; x < dims.x; x++) {
        run = x == 0 || in[x] == in[x - 1] ? min(run + 1, FURTHEST) : 1;
        out[x] = in[x] == 0 ? 0 : (in[x] & 128) + run;
    }
    run = FURTHEST;
    for (int x = dims.x - 1; x >= 0; x--) {
        run = x == dims.x - 1 || in[x] == in[x + 1] ? min(run + 1, FURTHEST) : 1;
        if (in[x]) out[x] = (in[x] & 128) + min(run, out[x] & 127);
    }
}

/* Least distance of eight cells to another kind, by eight that lie `r` cells to one side and their own distances. */
uchar8 beside(const uchar8 least, const uchar8 own, const uchar8 other, const int r) {
    const uchar8 alike = ((own ^ other) & (uchar)128) == (uchar)0 ? other & (uchar)127 : (uchar8)(0);
    return min(least, max(alike, (uchar8)(r)));
}

/* Across y (axis 1) or z (axis 2), one work-item for eight cells; across z the result is in blocks of 8x8x8. */
// cost clear_across: 16 B, 300 flop
__kernel void clear_across(const int n, const int4 dims, const int axis, __global const uchar *restrict in,
                           __global uchar *restrict out) {
    const int i = get_global_id(0);
    if (i >= n) return;
    const int nx = dims.x >> 3, x = i % nx, y = i / nx % dims.y, z = i / nx / dims.y;
    const int place = axis == 1 ? y : z, end = axis == 1 ? dims.y : dims.z, step = axis == 1 ? nx : nx * dims.y;
    const uchar8 own = vload8(i, in);
    uchar8 least = own & (uchar)127;
    for (int r = 1; r < FURTHEST && any(least > (uchar)r); r++) {
        if (place >= r) least = beside(least, own, vload8(i - r * step, in), r);
        if (place + r < end) least = beside(least, own, vload8(i + r * step, in), r);
    }
    const int block = ((z >> 3) * (dims.y >> 3) + (y >> 3)) * nx + x;
    vstore8((own & (uchar)128) + least, axis == 1 ? i : block * 64 + (z & 7) * 8 + (y & 7), out);
}
