/* smooth.cl -- one colour of a relaxation sweep over one level; one work-item per cell of the colour.
 *
 *     x[i] <- (1 - omega) x[i] + omega (b[i] + sum_f T[i][f] x[nbr[i][f]]) / (absorb[i] + sum_f T[i][f])
 *
 * Cells of one colour are contiguous and never neighbours: the result does not depend on their order.
 */
#include "real.h"
#include "conductance.h"
#include "rows.h"

// cost smooth: 39R+6C+28 B, 68 flop
__kernel void smooth(const int first, const int n, const REAL omega, __global const int *restrict nbr,
                     TWO_POINT, __global const REAL *restrict b, __global REAL4 *restrict x) {
    const int i = first + get_global_id(0);
    if (i >= first + n) return;
    const int row = ROW_OF(i, rows);
    REAL4 sum = colours_at(i, b), diagonal = SINK_AT(absorb, min(row, last));
    for (int f = 0; f < 6; f++) {
        const COND t = T_AT(T, 6 * row + f);
        sum += t * x[nbr[6 * i + f]];
        diagonal += t;
    }
    x[i] = (1 - omega) * x[i] + omega * sum / diagonal;
}

/* The first half of the first sweep, from zero everywhere: neighbours have nothing to give. */
// cost smooth_from_zero: 11R+6C+4 B, 14 flop
__kernel void smooth_from_zero(const int first, const int n, const REAL omega, TWO_POINT,
                               __global const REAL *restrict b, __global REAL4 *restrict x) {
    const int i = first + get_global_id(0);
    if (i >= first + n) return;
    const int row = ROW_OF(i, rows);
    REAL4 diagonal = SINK_AT(absorb, min(row, last));
    for (int f = 0; f < 6; f++) diagonal += T_AT(T, 6 * row + f);
    x[i] = omega * colours_at(i, b) / diagonal;
}
