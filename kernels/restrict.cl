/* restrict.cl -- a covered cell's right-hand side is the sum of its children's residuals: totals are kept.
 *
 * The last half-sweep before it was black, and left black cells no residual but rounding: the four red children, those
 * whose octant has an even number of upper halves, hold all of it. The next half-sweep overwrites red cells from their
 * neighbours alone, so that until then their residuals may stand in the place of their values.
 */
#include "real.h"
#include "conductance.h"
#include "rows.h"
#include "cycle.h"

// cost leave_residual: 39R+6C+28 B, 76 flop
__kernel void leave_residual(const int n, __global const int *restrict nbr, TWO_POINT,
                             __global const REAL *restrict b, __global REAL4 *x) {
    const int i = get_global_id(0);
    if (i < n) x[i] = residual_at(i, nbr, rows, last, T, absorb, b, x);
}

// cost restrict_residual: 19R+36 B, 12 flop
__kernel void restrict_residual(const int n, __global const int *restrict covered, __global const int *restrict child,
                                __global const int *restrict chain, __global const REAL4 *restrict residual,
                                __global REAL *restrict b_coarse) {
    const int c = get_global_id(0);
    if (c < n) vstore3(sum_of_red(c, child, chain, residual).xyz, covered[c], b_coarse);
}

/* A covered cell's value is the mean of its children's. */
// cost average: 36R+36 B, 36 flop
__kernel void average(const int n, __global const int *restrict covered, __global const int *restrict child,
                      __global const REAL4 *restrict x, __global REAL4 *restrict x_coarse) {
    const int c = get_global_id(0);
    if (c >= n) return;
    REAL4 sum = (REAL4)(0);
    int count = 0;
    for (int o = 0; o < 8; o++) {
        const int i = child[8 * c + o];
        if (i < 0) continue;
        sum += x[i];
        count++;
    }
    x_coarse[covered[c]] = sum / max(count, 1);
}
