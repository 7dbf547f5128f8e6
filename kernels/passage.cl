/* passage.cl -- light that passes between parts of the surface, as coarse cells over cut ones answer to it. */
#include "real.h"

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

/* J.n of the cells. */
// cost leave: 12R+4 B, 4 flop
__kernel void leave(const int n, __global const int *restrict cell, __global const REAL4 *restrict conductance,
                    __global const REAL4 *restrict x, __global REAL4 *restrict flux) {
    const int i = get_global_id(0);
    if (i < n) flux[i] = conductance[i] * x[cell[i]];
}

/* Add to their right-hand side what enters of the light that arrives. */
// cost enter: 14R+4 B, 8 flop
__kernel void enter(const int n, __global const int *restrict cell, __global const REAL4 *restrict conductance,
                    __global const REAL4 *restrict arriving, __global REAL *restrict r) {
    const int i = get_global_id(0);
    if (i < n) vstore3((colours_at(cell[i], r) + conductance[i] * arriving[i]).xyz, cell[i], r);
}

/* y -= k x */
// cost subtract_scaled: 16R B, 8 flop
__kernel void subtract_scaled(const int n, __global const REAL4 *restrict k, __global const REAL4 *restrict x,
                              __global REAL4 *restrict y) {
    const int i = get_global_id(0);
    if (i < n) y[i] -= k[i] * x[i];
}
