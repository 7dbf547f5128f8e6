/* correct.cl -- the second-order terms of cut cells' fluxes. */
#include "real.h"
#include "conductance.h"
#include "fetch.h"
#include "layer.h"
#include "rows.h"
#include "slope.h"

/* g . tau from a cell's centroid to the point x of a face across the other axis than a and b. */
REAL4 rise_to(const int c, const int a, const int b, const REAL2 x, __global const REAL4 *restrict centroid,
              __global const REAL *restrict slope) {
    if (c < 0) return (REAL4)(0);
    __global const REAL *restrict from = (__global const REAL *)(centroid + c);
    return (x.x - from[a]) * slope_along(c, a, slope) + (x.y - from[b]) * slope_along(c, b, slope);
}

/* Distance [cells] of the centroids of a cell and its neighbour across face f, along the axis. */
REAL distance_across(const int f, const int c, const int other, __global const REAL4 *restrict centroid) {
    const REAL own = along_axis(cell_centroid(c, centroid), f >> 1);
    const REAL far = along_axis(cell_centroid(other, centroid), f >> 1);
    return fmax(1 + (f & 1 ? far - own : own - far), (REAL)0.25);
}

/* Add to r, on cells with an irregular face, what the gradients and fitting (layer.h) add to the two-point fluxes:
 *     T_f (phi_j - phi_i)  ->  T_f x / sinh(x) (phi_j + g_j . tau_j - phi_i - g_i . tau_i),
 *     and  C_B phi_i  with its clamp eased  ->  C_B (phi_i + g . (x_B - d n - x_i)).
 */
// cost correct_residual: 40R+6C+8M+88 B, 150 flop
__kernel void correct_residual(const int n, const int n_cells, const REAL h, const REAL fresnel_A, MEDIUM D,
                               MEDIUM fitted, __global const int *restrict irregular, __global const int *restrict nbr,
                               __global const int *restrict cut_index, __global const REAL4 *restrict centroid,
                               __global const REAL4 *restrict boundary, __global const REAL *restrict normal,
                               __global const Place *restrict face_centroid, __global const int *restrict rows,
                               __global const REAL *restrict T, __global const REAL *restrict slope,
                               __global const REAL4 *restrict x, __global REAL *restrict r) {
    const int m = get_global_id(0);
    if (m >= n) return;
    const int later = irregular[min(m + AHEAD, n - 1)];
    FETCH(nbr + 6 * later);
    FETCH(cut_index + later);
    FETCH(rows + later);
    FETCH(x + later);
    FETCH(r + 3 * later);
    const int i = irregular[m], c = cut_index[i], row = ROW_OF(i, rows);
    const REAL4 D_i = AT(D, max(c, 0)), k2 = FITTED_AT(fitted, i);
    REAL4 sum = colours_at(i, r);
#pragma unroll
    for (int f = 0; f < 6; f++) {
        const int j = nbr[6 * i + f];
        if (j == i || j >= n_cells) continue;
        const int other = cut_index[j];
        if (c < 0 && other < 0) continue;
        const int a = f < 2, b = f < 4 ? 2 : 1, low = f & 1 ? c : other;
        const REAL2 at = c >= 0 && other >= 0 ? coordinates(face_centroid[3 * low + (f >> 1)]) : (REAL2)(0.5);
        const REAL4 rise = rise_to(other, a, b, at, centroid, slope) - rise_to(c, a, b, at, centroid, slope);
        const REAL4 k2_j = FITTED_AT(fitted, j);
        if (any_fitted(k2 + k2_j)) {
            const REAL delta = distance_across(f, c, other, centroid);
            const REAL4 ease = 1 / sinh_over(link_width2(k2, k2_j, delta, f >> 1, c, other, boundary, normal));
            sum += T_AT(T, 6 * row + f) * (ease * rise + (ease - 1) * (x[j] - x[i]));
        } else {
            sum += T_AT(T, 6 * row + f) * rise;
        }
    }
    if (c >= 0) {
        const REAL4 nrm = unit_normal(vector_at(c, normal));
        const REAL clamped = depth_below(centroid[c], boundary[c], nrm, 0.1);
        const REAL d = depth_below(centroid[c], boundary[c], nrm, 0.05);
        const REAL4 p = value_below(c, x[i], d, nrm, centroid, boundary, slope);
        const REAL4 x2 = depth2(k2, clamped, vector_at(c, normal), boundary[c]);
        const REAL4 own = depth2(k2, d, vector_at(c, normal), boundary[c]);
        const REAL4 flux = x[i] / resistance(x2, clamped * h, D_i, fresnel_A) -
                           p / resistance(own, d * h, D_i, fresnel_A);
        sum += SCALE(boundary[c].w * h * h * flux, D_i);
    }
    vstore3(sum.xyz, i, r);
}
