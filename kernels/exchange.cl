/* exchange.cl -- what parts of the surface send to one another: products with sparse matrices, one row a work-item. */
#include "real.h"

/* y = scale A x, plus z where `added`. */
// cost sparse_product: 38R+28 B, 56 flop
__kernel void sparse_product(const int n, const int added, const REAL scale, __global const int *restrict start,
                             __global const int *restrict column, __global const REAL *restrict value,
                             __global const REAL4 *restrict x, __global const REAL4 *restrict z,
                             __global REAL4 *restrict y) {
    const int i = get_global_id(0);
    if (i >= n) return;
    REAL4 sum = (REAL4)(0);
    for (int k = start[i]; k < start[i + 1]; k++) sum += value[k] * x[column[k]];
    y[i] = scale * sum + (added ? z[i] : (REAL4)(0));
}

/* y = next + albedo A (x - last): B after one more passage, if each patch gives back `albedo` of what arrives anew. */
// cost anticipate: 74R+28 B, 76 flop
__kernel void anticipate(const int n, __global const int *restrict start, __global const int *restrict column,
                         __global const REAL *restrict value, __global const REAL4 *restrict albedo,
                         __global const REAL4 *restrict last, __global const REAL4 *restrict next,
                         __global const REAL4 *restrict x, __global REAL4 *restrict y) {
    const int i = get_global_id(0);
    if (i >= n) return;
    REAL4 sum = (REAL4)(0);
    for (int k = start[i]; k < start[i + 1]; k++) sum += value[k] * (x[column[k]] - last[column[k]]);
    y[i] = next[i] + albedo[i] * sum;
}
