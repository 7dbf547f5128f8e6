/* prolong.cl -- corrections and values from a coarser level to a finer one. */
#include "real.h"
#include "conductance.h"
#include "rows.h"
#include "cycle.h"

// cost prolong: 24R+20 B, 36 flop
__kernel void prolong(const int first, const int n, __global const int *restrict nbr,
                      __global const int *restrict parent, __global const uchar4 *restrict weight,
                      __global const REAL4 *restrict x_coarse, __global REAL4 *restrict x) {
    const int i = first + get_global_id(0);
    if (i < first + n) x[i] = prolonged(i, weight[i - first], nbr, parent, x_coarse, x);
}

/* Ghosts of a correction: the coarse cell's own value. */
// cost copy_ghosts: 8R+4 B, 0 flop
__kernel void copy_ghosts(const int n, const int n_cells, __global const int *restrict parent,
                          __global const REAL4 *restrict x_coarse, __global REAL4 *restrict x) {
    const int k = get_global_id(0);
    if (k < n) x[n_cells + k] = x_coarse[parent[n_cells + k]];
}

/* Ghosts of the solution: the coarse cell's value carried along the face to the line through the fine centre, by
 * differences with neighbours whose value is that at their centre (`centred`). Two-point fluxes over 3h/2 are exact
 * then for linear fields. For second derivatives k across the face, k_s and k_t along it, that flux is off by
 * D h (k / 4 - k_s / 12 - k_t / 12); second differences make it D h (k / 4 - k_s / 8 - k_t / 8), which is nothing where
 * phi curves alike in all directions, as inside a body that glows.
 */
// cost carry_ghosts: 44R+46 B, 84 flop
__kernel void carry_ghosts(const int n, const int n_coarse, const int n_fine, __global const int *restrict interface,
                           __global const int *restrict interface_start, __global const int *restrict nbr_coarse,
                           __global const uchar *restrict centred, __global const int *restrict ghost_face,
                           __global const uchar *restrict octant, __global const REAL4 *restrict x_coarse,
                           __global REAL4 *restrict x) {
    const int m = get_global_id(0);
    if (m >= n) return;
    const int c = interface[m];
    const REAL4 own = x_coarse[c];
    REAL4 slope[3], curve[3];
    for (int d = 0; d < 3; d++) {
        const int low = nbr_coarse[6 * c + 2 * d], high = nbr_coarse[6 * c + 2 * d + 1];
        const int has_low = low < n_coarse && low != c && centred[low];
        const int has_high = high < n_coarse && high != c && centred[high];
        const REAL4 below = has_low ? own - x_coarse[low] : (REAL4)(0);
        const REAL4 above = has_high ? x_coarse[high] - own : (REAL4)(0);
        slope[d] = has_low && has_high ? (below + above) / 2 : below + above;
        curve[d] = has_low && has_high ? above - below : (REAL4)(0);
    }
    for (int k = interface_start[m]; k < interface_start[m + 1]; k++) {
        const int axis = (ghost_face[k] % 6) >> 1;
        REAL4 value = own;
        for (int d = 0; d < 3; d++)
            if (d != axis) value += slope[d] * (octant[k] >> d & 1 ? (REAL)0.25 : (REAL)-0.25) - curve[d] / 64;
        x[n_fine + k] = value;
    }
}
