/* coarsest.cl -- the coarsest level, solved by its dense inverse: x = inverse b, channel by channel. */
#include "real.h"

// cost solve_coarsest: 4R B, 8 flop
__kernel void solve_coarsest(const int n, __global const REAL4 *restrict inverse, __global const REAL *restrict b,
                             __global REAL4 *restrict x) {
    const int i = get_global_id(0);
    if (i >= n) return;
    REAL4 sum = (REAL4)(0);
    for (int j = 0; j < n; j++) sum += inverse[i * n + j] * colours_at(j, b);
    x[i] = sum;
}
