/* interpolation.cl -- weights of the prolongation (weight.h): linear between centres for constant D, by the resistances
 * between them otherwise.
 */
#include "real.h"
#include "conductance.h"
#include "weight.h"

// cost interpolation_weights: 9C+17 B, 30 flop
__kernel void interpolation_weights(const int first, const int n, const int n_cells,
                                    __global const uchar *restrict octant, __global const int *restrict nbr,
                                    __global const COND *restrict T, __global uchar4 *restrict weight) {
    const int k = get_global_id(0), i = first + k;
    if (k >= n) return;
    REAL w[3];
    for (int d = 0; d < 3; d++) {
        const int up = octant[k] >> d & 1, f = 2 * d + up, j = nbr[6 * i + f];
        const REAL out = MEAN(T[6 * i + f]), sibling = MEAN(T[6 * i + (f ^ 1)]);
        w[d] = 0;
        if (j == i || !(out > 0)) continue;
        const REAL in = sibling > 0 ? sibling : out;
        REAL beyond = 1 / out;
        const REAL next = j < n_cells ? MEAN(T[6 * j + f]) : 0;
        if (j < n_cells) beyond += 1 / (2 * (next > 0 ? next : out));
        w[d] = (1 / (2 * in)) / (1 / (2 * in) + beyond);
    }
    const REAL scale = WHOLE / fmax((REAL)1, w[0] + w[1] + w[2]);
    int share[3], left = WHOLE;
    for (int d = 0; d < 3; d++) left -= share[d] = min(left, convert_int_rte(scale * w[d]));
    weight[k] = convert_uchar4((int4)(share[0], share[1], share[2], octant[k]));
}
