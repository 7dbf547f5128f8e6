/* reduce.cl -- sums over cells, by channel, in a fixed order: the same bits every time. */
#include "real.h"

/* Partial sums of squares; work-item g takes cells g, g + stride, ... */
// cost sum_squares: 4R B, 8 flop
__kernel void sum_squares(const int n, const int stride, __global const REAL4 *restrict x,
                          __global REAL4 *restrict partial) {
    const int g = get_global_id(0);
    if (g >= stride) return;
    REAL4 sum = (REAL4)(0), lost = (REAL4)(0);
    for (int i = g; i < n; i += stride) {
        const REAL4 term = x[i] * x[i] - lost, next = sum + term;
        lost = (next - sum) - term;
        sum = next;
    }
    partial[g] = sum;
}

// cost add: 12R B, 4 flop
__kernel void add(const int n, __global const REAL4 *restrict e, __global REAL4 *restrict x) {
    const int i = get_global_id(0);
    if (i < n) x[i] += e[i];
}
