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

/* y = A x, plus w where `added`, and z = A' x of a matrix with entries in the same places. */
// cost sparse_products: 50R+40 B, 112 flop
__kernel void sparse_products(const int n, const int added, MATRIX, __global const ushort *restrict other_number,
                              __global const REAL *restrict other_unit, __global const REAL4 *restrict x,
                              __global const REAL4 *restrict w, __global REAL4 *restrict y,
                              __global REAL4 *restrict z) {
    const int i = get_global_id(0);
    if (i >= n) return;
    const int first = start ? start[i] : i * width, end = start ? start[i + 1] : first + width;
    REAL4 sum = (REAL4)(0), other = (REAL4)(0);
    for (int k = first; k < end; k++) {
        const REAL4 value = x[narrow ? narrow[k] : wide[k]];
        sum += spread(number[k]) * value;
        other += spread(other_number[k]) * value;
    }
    y[i] = (unit ? unit[i] : (REAL)1 / PARTS) * sum + (added ? w[i] : (REAL4)(0));
    z[i] = (other_unit ? other_unit[i] : (REAL)1 / PARTS) * other;
}
