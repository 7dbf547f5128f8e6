/* position.h -- where a cell is, in widths of its level: three numbers of 16 bits a cell. */

/* Its lower corner. */
REAL4 corner_of(const int i, __global const ushort *restrict position) {
    return (REAL4)(convert_REAL3(vload3(i, position)), 0);
}
