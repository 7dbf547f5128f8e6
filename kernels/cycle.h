/* cycle.h -- what the steps of a V-cycle do to one cell or ghost: level by level (smooth.cl, restrict.cl, prolong.cl)
 * or on all levels of few cells in one launch (fused.cl). Needs rows.h.
 */
#include "child.h"
#include "junction.h"
#include "residual.h"
#include "weight.h"

REAL4 relaxed(const int i, const REAL omega, __global const int *restrict nbr, TWO_POINT,
              __global const REAL *restrict b, __global const REAL4 *x) {
    const int row = ROW_OF(i, rows);
    REAL4 sum = colours_at(i, b), diagonal = SINK_AT(absorb, min(row, last));
    for (int f = 0; f < 6; f++) {
        const COND t = T_AT(T, 6 * row + f);
        sum += t * x[nbr[6 * i + f]];
        diagonal += t;
    }
    return (1 - omega) * x[i] + omega * sum / diagonal;
}

REAL4 relaxed_from_zero(const int i, const REAL omega, TWO_POINT, __global const REAL *restrict b) {
    const int row = ROW_OF(i, rows);
    REAL4 diagonal = SINK_AT(absorb, min(row, last));
    for (int f = 0; f < 6; f++) diagonal += T_AT(T, 6 * row + f);
    return omega * colours_at(i, b) / diagonal;
}

/* The sum over the red children of the c-th covered cell. */
REAL4 sum_of_red(const int c, __global const int *restrict child, __global const int *restrict chain,
                 __global const REAL4 *restrict residual) {
    const int red[4] = {0, 3, 5, 6};
    REAL4 sum = (REAL4)(0);
    for (int o = 0; o < 4; o++)
        for (int next = child[8 * c + red[o]]; next != -1;) sum += residual[take_child(&next, chain)];
    return sum;
}

/* What the fine faces of the m-th leaf with finer neighbours bring it. */
REAL4 refluxed(const int m, const int n_fine, __global const int *restrict interface,
               __global const int *restrict interface_start, __global const int *restrict ghost_face,
               __global const int *restrict rows, __global const REAL *restrict T_fine,
               __global const REAL4 *restrict x_fine, __global const REAL *restrict r) {
    REAL4 sum = colours_at(interface[m], r);
    for (int k = interface_start[m]; k < interface_start[m + 1]; k++) {
        const int i = ghost_face[k] / 6, f = ghost_face[k] % 6;
        sum += T_AT(T_fine, 6 * ROW_OF(i, rows) + f) * (x_fine[i] - x_fine[n_fine + k]);
    }
    return sum;
}

/* x_i + (1 - sum_d w_d) X_parent + sum_d w_d X_d, X_d the coarse cell beyond the outward face along d. */
REAL4 prolonged(const int i, const uchar4 weight, __global const int *restrict nbr,
                __global const int *restrict parent, __global const REAL4 *restrict x_coarse,
                __global const REAL4 *restrict x) {
    const int4 share = convert_int4(weight), up = share.wwww >> (int4)(0, 1, 2, 3) & 1;
    const REAL4 w = convert_REAL4((int4)(share.xyz, WHOLE - share.x - share.y - share.z)) / WHOLE;
    return x[i] + (w.w * x_coarse[parent[i]] + w.x * x_coarse[parent[nbr[6 * i + up.x]]] +
                   w.y * x_coarse[parent[nbr[6 * i + 2 + up.y]]] + w.z * x_coarse[parent[nbr[6 * i + 4 + up.z]]]);
}

/* A row of the dense inverse times b, channel by channel. */
REAL4 solved_directly(const int i, const int n, __global const REAL4 *restrict inverse,
                      __global const REAL *restrict b) {
    REAL4 sum = (REAL4)(0);
    for (int j = 0; j < n; j++) sum += inverse[i * n + j] * colours_at(j, b);
    return sum;
}
