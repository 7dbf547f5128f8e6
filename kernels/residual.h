/* residual.h -- b - A x of a cell, as a sum of differences so that float32 keeps the small ones. Needs rows.h. */
REAL4 residual_at(const int i, __global const int *restrict nbr, TWO_POINT, __global const REAL *restrict b,
                  __global const REAL4 *x) {
    const int row = ROW_OF(i, rows);
    const REAL4 own = x[i];
    REAL4 sum = colours_at(i, b) - SINK_AT(absorb, min(row, last)) * own;
    for (int f = 0; f < 6; f++) sum += T_AT(T, 6 * row + f) * (x[nbr[6 * i + f]] - own);
    return sum;
}
