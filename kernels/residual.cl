/* residual.cl -- r = b - A x on one level. */
#include "real.h"
#include "conductance.h"
#include "rows.h"
#include "cycle.h"

// cost residual: 38R+6C+28 B, 76 flop
__kernel void residual(const int n, __global const int *restrict nbr, TWO_POINT,
                       __global const REAL *restrict b, __global const REAL4 *restrict x, __global REAL *restrict r) {
    const int i = get_global_id(0);
    if (i < n) vstore3(residual_at(i, nbr, rows, last, T, absorb, b, x).xyz, i, r);
}

/* The same on the leaves of a coarser level: faces to covered cells are left to their fine faces (reflux). */
// cost residual_of_leaves: 38R+6C+35 B, 76 flop
__kernel void residual_of_leaves(const int n, __global const int *restrict nbr, __global const uchar *restrict is_leaf,
                                 TWO_POINT, __global const REAL *restrict b, __global const REAL4 *restrict x,
                                 __global REAL *restrict r) {
    const int i = get_global_id(0);
    if (i >= n) return;
    if (!is_leaf[i]) {
        vstore3((REAL3)(0), i, r);
        return;
    }
    const int row = ROW_OF(i, rows);
    const REAL4 own = x[i];
    REAL4 sum = colours_at(i, b) - SINK_AT(absorb, min(row, last)) * own;
    for (int f = 0; f < 6; f++) {
        const int j = nbr[6 * i + f];
        if (j >= n || is_leaf[j]) sum += T_AT(T, 6 * row + f) * (x[j] - own);
    }
    vstore3(sum.xyz, i, r);
}

/* Add to leaves with finer neighbours what their fine faces bring: the same flux that the fine side loses. */
// cost reflux: 38R+4C+44 B, 64 flop
__kernel void reflux(const int n, const int n_fine, __global const int *restrict interface,
                     __global const int *restrict interface_start, __global const int *restrict ghost_face,
                     __global const int *restrict rows, __global const REAL *restrict T_fine,
                     __global const REAL4 *restrict x_fine, __global REAL *restrict r) {
    const int m = get_global_id(0);
    if (m < n)
        vstore3(refluxed(m, n_fine, interface, interface_start, ghost_face, rows, T_fine, x_fine, r).xyz, interface[m],
                r);
}
