/* exchange.cl -- what parts of the surface send to one another: products with sparse matrices, one row a work-item.
 *
 * A row has `width` entries, or as many as `start` says; of each its column, in 16 bits or in 32, and a number. Entries
 * are numbers times the row's unit; where there are no units, rows sum to one, and their numbers to PARTS.
 */
#include "real.h"
#define PARTS 65535

#define MATRIX \
    const int width, __global const int *restrict start, __global const ushort *restrict narrow, \
        __global const int *restrict wide, __global const ushort *restrict number, __global const REAL *restrict unit

/* One number as a vector: spread first, it converts at once. */
REAL4 spread(const ushort number) { return convert_REAL4((int4)(number)); }

/* y = scale A x, plus z where `added`. */
// cost sparse_product: 33R+28 B, 56 flop
__kernel void sparse_product(const int n, const int added, const REAL scale, MATRIX, __global const REAL4 *restrict x,
                             __global const REAL4 *restrict z, __global REAL4 *restrict y) {
    const int i = get_global_id(0);
    if (i >= n) return;
    const int first = start ? start[i] : i * width, end = start ? start[i + 1] : first + width;
    REAL4 sum = (REAL4)(0);
    if (narrow)
        for (int k = first; k < end; k++) sum += spread(number[k]) * x[narrow[k]];
    else
        for (int k = first; k < end; k++) sum += spread(number[k]) * x[wide[k]];
    y[i] = scale * (unit ? unit[i] : (REAL)1 / PARTS) * sum + (added ? z[i] : (REAL4)(0));
}
