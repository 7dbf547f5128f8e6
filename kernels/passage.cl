/* passage.cl -- light that passes between parts of the surface, as coarse cells over cut ones answer to it.
 *
 * Conductances, which change the way to a solution alone, have 16 bits a number.
 */
#include "real.h"
#include "tile.h"
#include "matrix.h"

/* y = x at some cells. */
// cost take_rows: 6R+4 B, 0 flop
__kernel void take_rows(const int n, __global const int *restrict cell, __global const REAL *restrict x,
                        __global REAL *restrict y) {
    const int i = get_global_id(0);
    if (i < n) vstore3(colours_at(cell[i], x).xyz, i, y);
}

/* x at some cells = y. */
// cost put_rows: 6R+4 B, 0 flop
__kernel void put_rows(const int n, __global const int *restrict cell, __global const REAL *restrict y,
                       __global REAL *restrict x) {
    const int i = get_global_id(0);
    if (i < n) vstore3(colours_at(i, y).xyz, cell[i], x);
}

/* What leaves a patch: J.n of its cells, conductance times x, less `giving` times what has entered, and z, which may
 * be y. */
// cost leave: 14R+28 B, 20 flop
__kernel void leave(const int n, MATRIX(share), __global const int *restrict cell,
                    __global const ushort *restrict conductance, __global const REAL4 *restrict x,
                    __global const ushort *restrict giving, __global const REAL *restrict entered,
                    __global const REAL *z, __global REAL *y) {
    const int i = get_global_id(0);
    if (i >= n) return;
    const Matrix share = MATRIX_OF(share);
    REAL4 sum = (REAL4)(0);
    for (int k = first_of_row(i, share); k < end_of_row(i, share); k++) {
        const int c = column_of(k, share);
        sum += spread(share.number[k]) * lengthened_at(c, conductance) * x[cell[c]];
    }
    const REAL4 kept = lengthened_at(i, giving) * colours_at(i, entered);
    vstore3((unit_of_row(i, share.unit) * sum - kept + colours_at(i, z)).xyz, i, y);
}

/* Add to the cells' right-hand side what enters of the light that arrives. */
// cost enter: 13R+26 B, 24 flop
__kernel void enter(const int n, __global const int *restrict cell, __global const ushort *restrict conductance,
                    MATRIX(blend), __global const REAL *restrict entered, __global REAL *restrict r) {
    const int i = get_global_id(0);
    if (i >= n) return;
    const REAL4 here = row_times(i, MATRIX_OF(blend), entered);
    vstore3((colours_at(cell[i], r) + lengthened_at(i, conductance) * here).xyz, cell[i], r);
}

/* y -= k x */
// cost subtract_scaled: 9R+6 B, 6 flop
__kernel void subtract_scaled(const int n, __global const ushort *restrict k, __global const REAL *restrict x,
                              __global REAL *restrict y) {
    const int i = get_global_id(0);
    if (i < n) vstore3((colours_at(i, y) - lengthened_at(i, k) * colours_at(i, x)).xyz, i, y);
}

/* y += x */
// cost add_rows: 9R B, 3 flop
__kernel void add_rows(const int n, __global const REAL *restrict x, __global REAL *restrict y) {
    const int i = get_global_id(0);
    if (i < n) vstore3((colours_at(i, y) + colours_at(i, x)).xyz, i, y);
}

/* B becomes what `change` holds and `change` how far that is; partial sums of the squares of both, one of each tile. */
// cost advance: 768R B, 960 flop
__kernel void advance(const int n, __global REAL *restrict B, __global REAL *restrict change,
                      __global REAL4 *restrict partial) {
    __local REAL4 part[GROUP];
    REAL4 sum = (REAL4)(0), sum_moved = (REAL4)(0);
    for (int i = first_of_tile(); i < end_of_tile(n); i += GROUP) {
        const REAL4 now = colours_at(i, change), step = now - colours_at(i, B);
        vstore3(now.xyz, i, B);
        vstore3(step.xyz, i, change);
        sum += now * now;
        sum_moved += step * step;
    }
    sum_of_group(sum, part, partial + 2 * get_group_id(0));
    sum_of_group(sum_moved, part, partial + 2 * get_group_id(0) + 1);
}
