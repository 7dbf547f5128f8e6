/* exchange.cl -- what parts of the surface send to one another: products with sparse matrices, one row a work-item. */
#include "real.h"
#include "matrix.h"

/* y = scale A x, plus z where `added`, which may be y. */
// cost sparse_product: 25R+28 B, 56 flop
__kernel void sparse_product(const int n, const int added, const REAL scale, MATRIX(a), __global const REAL *restrict x,
                             __global const REAL *z, __global REAL *y) {
    const int i = get_global_id(0);
    if (i >= n) return;
    const REAL4 product = scale * row_times(i, MATRIX_OF(a), x);
    vstore3((product + (added ? colours_at(i, z) : (REAL4)(0))).xyz, i, y);
}

/* y = A x, plus w where `added`, and z = A' x of a matrix with entries in the same places. */
// cost sparse_products: 38R+62 B, 112 flop
__kernel void sparse_products(const int n, const int added, MATRIX(a), __global const ushort *restrict other_number,
                              __global const REAL *restrict other_unit, __global const REAL *restrict x,
                              __global const REAL *restrict w, __global REAL *restrict y,
                              __global REAL *restrict z) {
    const int i = get_global_id(0);
    if (i >= n) return;
    const Matrix a = MATRIX_OF(a);
    REAL4 sum = (REAL4)(0), other = (REAL4)(0);
    const int first = first_of_row(i, a), end = end_of_row(i, a);
    for (int k = first; k < end; k++) {
        const REAL4 value = colours_at(column_of(k, a), x);
        sum += spread(a.number[k]) * value;
        other += spread(other_number[k]) * value;
    }
    const REAL4 given = added ? colours_at(i, w) : (REAL4)(0);
    vstore3((unit_of_row(i, a.unit) * sum + given).xyz, i, y);
    vstore3((unit_of_row(i, other_unit) * other).xyz, i, z);
}
