/* passage.cl -- light that passes between parts of the surface, as coarse cells over cut ones answer to it. */
#include "real.h"

/* y = x at some cells. */
// cost take_rows: 8R+4 B, 0 flop
__kernel void take_rows(const int n, __global const int *restrict cell, __global const REAL4 *restrict x,
                        __global REAL4 *restrict y) {
    const int i = get_global_id(0);
    if (i < n) y[i] = x[cell[i]];
}

/* x at some cells = y. */
// cost put_rows: 8R+4 B, 0 flop
__kernel void put_rows(const int n, __global const int *restrict cell, __global const REAL4 *restrict y,
                       __global REAL4 *restrict x) {
    const int i = get_global_id(0);
    if (i < n) x[cell[i]] = y[i];
}

/* J.n of the cells. */
// cost leave: 12R+4 B, 4 flop
__kernel void leave(const int n, __global const int *restrict cell, __global const REAL4 *restrict conductance,
                    __global const REAL4 *restrict x, __global REAL4 *restrict flux) {
    const int i = get_global_id(0);
    if (i < n) flux[i] = conductance[i] * x[cell[i]];
}

/* Add to their right-hand side what enters of the light that arrives. */
// cost enter: 16R+4 B, 8 flop
__kernel void enter(const int n, __global const int *restrict cell, __global const REAL4 *restrict conductance,
                    __global const REAL4 *restrict arriving, __global REAL4 *restrict r) {
    const int i = get_global_id(0);
    if (i < n) r[cell[i]] += conductance[i] * arriving[i];
}

/* y -= k x */
// cost subtract_scaled: 16R B, 8 flop
__kernel void subtract_scaled(const int n, __global const REAL4 *restrict k, __global const REAL4 *restrict x,
                              __global REAL4 *restrict y) {
    const int i = get_global_id(0);
    if (i < n) y[i] -= k[i] * x[i];
}
