/* reduce.cl -- sums and combinations of fields over cells, by channel; sums in a fixed order: the same bits every
 * time. */
#include "real.h"
#include "tile.h"

/* Partial inner products, one of each tile; rows are 3 or 4 numbers wide. */
// cost inner_product: 384R B, 512 flop
__kernel void inner_product(const int n, const int width, __global const REAL *restrict x,
                            __global const REAL *restrict y, __global REAL4 *restrict partial) {
    __local REAL4 part[GROUP];
    REAL4 sum = (REAL4)(0);
    for (int i = first_of_tile(); i < end_of_tile(n); i += GROUP)
        sum += colours(x + width * (size_t)i) * colours(y + width * (size_t)i);
    sum_of_group(sum, part, partial + get_group_id(0));
}

/* Partial sums, likewise. */
// cost total: 192R B, 256 flop
__kernel void total(const int n, const int width, __global const REAL *restrict x, __global REAL4 *restrict partial) {
    __local REAL4 part[GROUP];
    REAL4 sum = (REAL4)(0);
    for (int i = first_of_tile(); i < end_of_tile(n); i += GROUP) sum += colours(x + width * (size_t)i);
    sum_of_group(sum, part, partial + get_group_id(0));
}

/* y = a x + b y */
// cost combine: 12R B, 12 flop
__kernel void combine(const int n, const REAL4 a, const REAL4 b, __global const REAL4 *restrict x,
                      __global REAL4 *restrict y) {
    const int i = get_global_id(0);
    if (i < n) y[i] = a * x[i] + b * y[i];
}
