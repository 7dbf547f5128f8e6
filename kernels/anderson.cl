/* anderson.cl -- combinations of the last three cycles. What each changed of phi and of the residual is kept by colour
 * channel, the residual's change in 16 bits a number (real.h): rounding phi's would leave a rough residual.
 */
#include "real.h"
#include "tile.h"

/* Complete the newest change d0 of the residual r, and take products over each tile: r.d0 r.d1 r.d2 d0.d0 d0.d1 d0.d2
 * and r.r. */
// cost change_products: 192R+1536 B, 4096 flop
__kernel void change_products(const int n, __global const REAL *restrict r, __global const ushort *restrict d1,
                              __global const ushort *restrict d2, __global ushort *restrict d0,
                              __global REAL4 *restrict partial) {
    __local REAL4 part[GROUP];
    REAL4 sum[7];
    for (int k = 0; k < 7; k++) sum[k] = (REAL4)(0);
    for (int i = first_of_tile(); i < end_of_tile(n); i += GROUP) {
        const REAL4 own = colours_at(i, r), second = lengthened_at(i, d1), third = lengthened_at(i, d2);
        const ushort4 kept = shorten(lengthened_at(i, d0) + own);
        const REAL4 first = lengthen(kept);
        vstore3(kept.xyz, i, d0);
        sum[0] += own * first;
        sum[1] += own * second;
        sum[2] += own * third;
        sum[3] += first * first;
        sum[4] += first * second;
        sum[5] += first * third;
        sum[6] += own * own;
    }
    for (int k = 0; k < 7; k++) sum_of_group(sum[k], part, partial + 7 * get_group_id(0) + k);
}

/* Move phi and r by -sum_k g_k of the last steps and changes; phi has more rows than r, for ghosts. The oldest of them
 * make room for the next: phi's move and -r, to which the next correction and the next residual are added. */
// cost move: 26R+24 B, 48 flop
__kernel void move(const int n, const int n_cells, const REAL4 g0, const REAL4 g1, const REAL4 g2,
                   __global const REAL *restrict s0, __global const REAL *restrict s1,
                   __global const ushort *restrict d0, __global const ushort *restrict d1, __global REAL *restrict s2,
                   __global ushort *restrict d2, __global REAL4 *restrict phi, __global REAL *restrict r) {
    const int i = get_global_id(0);
    if (i >= n) return;
    const REAL4 step = -(g0 * colours_at(i, s0) + g1 * colours_at(i, s1) + g2 * colours_at(i, s2));
    phi[i] += step;
    vstore3(step.xyz, i, s2);
    if (i >= n_cells) return;
    const REAL4 own = colours_at(i, r);
    vstore3((own - (g0 * lengthened_at(i, d0) + g1 * lengthened_at(i, d1) + g2 * lengthened_at(i, d2))).xyz, i, r);
    vstore3(shorten(-own).xyz, i, d2);
}

/* Add a correction to phi and to the step that it is part of. */
// cost add_correction: 18R B, 8 flop
__kernel void add_correction(const int n, __global const REAL4 *restrict e, __global REAL *restrict s,
                             __global REAL4 *restrict phi) {
    const int i = get_global_id(0);
    if (i >= n) return;
    phi[i] += e[i];
    vstore3(vload3(i, s) + e[i].xyz, i, s);
}
