/* junction.cl -- where cells have several neighbours beyond one face (junction.h). */
#include "real.h"
#include "conductance.h"
#include "rows.h"
#include "cycle.h"

/* Shares of a junction's cells in the transmissibility of its face: the sums over the finer faces they lie behind. */
// cost junction_shares: 60R+60 B, 40 flop
__kernel void junction_shares(const int n, __global const int *restrict face, __global const int *restrict start,
                              __global const int *restrict cell, __global const int *restrict child,
                              __global const int *restrict chain, const int n_rows_fine,
                              __global const int *restrict nbr_fine, __global const int *restrict parent_fine,
                              __global const COND *restrict T_fine, __global const int *restrict start_fine,
                              __global const int *restrict cell_fine, __global const COND *restrict share_fine,
                              __global COND *restrict share) {
    const int q = get_global_id(0);
    if (q >= n) return;
    const int i = face[q] / 6, f = face[q] % 6;
    COND total = 0;
    for (int k = start[q]; k < start[q + 1]; k++) {
        COND sum = 0;
        for (int o = 0; o < 8; o++) {
            if (((o >> (f >> 1)) & 1) != (f & 1)) continue;
            for (int next = child[8 * i + o]; next != -1;) {
                const int c = take_child(&next, chain), j = nbr_fine[6 * c + f];
                const COND t = T_fine[6 * c + f];
                if (j < n_rows_fine) {
                    if (parent_fine[j] == cell[k]) sum += t;
                    continue;
                }
                for (int m = start_fine[j - n_rows_fine]; m < start_fine[j - n_rows_fine + 1]; m++)
                    if (parent_fine[cell_fine[m]] == cell[k]) sum += t * share_fine[m];
            }
        }
        share[k] = sum;
        total += sum;
    }
    for (int k = start[q]; k < start[q + 1]; k++) share[k] /= total;
}

/* The rows of junctions. */
// cost fill_junctions: 14R+24 B, 16 flop
__kernel void fill_junctions(const int n, const int first_row, __global const int *restrict start,
                             __global const int *restrict cell, __global const COND *restrict share,
                             __global REAL4 *x) {
    const int q = get_global_id(0);
    if (q < n) x[first_row + q] = mean_beyond(q, start, cell, share, x);
}
