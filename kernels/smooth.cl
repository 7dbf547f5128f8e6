/* smooth.cl -- one colour of a relaxation sweep over one level; one work-item per cell of the colour.
 *
 *     x[i] <- (1 - omega) x[i] + omega (b[i] + sum_f T[i][f] x[nbr[i][f]]) / (absorb[i] + sum_f T[i][f])
 *
 * Cells of one colour are contiguous and never neighbours: the result does not depend on their order.
 */
#include "real.h"
#include "conductance.h"
#include "rows.h"
#include "cycle.h"

// cost smooth: 39R+6C+28 B, 68 flop
__kernel void smooth(const int first, const int n, const REAL omega, __global const int *restrict nbr,
                     TWO_POINT, __global const REAL *restrict b, __global REAL4 *restrict x) {
    const int i = first + get_global_id(0);
    if (i >= first + n) return;
    x[i] = relaxed(i, omega, nbr, rows, last, T, absorb, b, x);
}

/* The first half of the first sweep, from zero everywhere: neighbours have nothing to give. */
// cost smooth_from_zero: 11R+6C+4 B, 14 flop
__kernel void smooth_from_zero(const int first, const int n, const REAL omega, TWO_POINT,
                               __global const REAL *restrict b, __global REAL4 *restrict x) {
    const int i = first + get_global_id(0);
    if (i >= first + n) return;
    x[i] = relaxed_from_zero(i, omega, rows, last, T, absorb, b);
}
