/* reduce.cl -- sums and combinations of fields over cells, by channel; sums in a fixed order: the same bits every
 * time. */
#include "real.h"

/* Partial inner products; work-item g takes cells g, g + stride, ... and keeps what rounding loses (Kahan). */
// cost inner_product: 8R B, 12 flop
__kernel void inner_product(const int n, const int stride, __global const REAL4 *restrict x,
                            __global const REAL4 *restrict y, __global REAL4 *restrict partial) {
    const int g = get_global_id(0);
    if (g >= stride) return;
    REAL4 sum = (REAL4)(0), lost = (REAL4)(0);
    for (int i = g; i < n; i += stride) {
        const REAL4 term = x[i] * y[i] - lost, next = sum + term;
        lost = (next - sum) - term;
        sum = next;
    }
    partial[g] = sum;
}

/* y = a x + b y */
// cost combine: 12R B, 12 flop
__kernel void combine(const int n, const REAL4 a, const REAL4 b, __global const REAL4 *restrict x,
                      __global REAL4 *restrict y) {
    const int i = get_global_id(0);
    if (i < n) y[i] = a * x[i] + b * y[i];
}
