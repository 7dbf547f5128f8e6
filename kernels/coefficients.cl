/* coefficients.cl -- transmissibilities and absorption of every level; widths in mm.
 *
 *     sum_f T_f (phi_i - phi_f) + absorb phi_i = b_i
 *
 * The finest level comes from the cut cells' moments; coarser ones need no geometry: a coarse face adds half the
 * fine faces' T, which is the arithmetic mean of area D over twice the distance; for absorb see pinning.h.
 */

/* Between a covered cell and a leaf the smooth part of a correction sees 3/4 of the fine faces' T (the distance grows
 * from 3h/2 to 2h), a leaf among fine cells all of it: measured, this share serves both. */
#define TO_LEAF ((REAL)0.85)
#include "real.h"
#include "face.h"
#include "conductance.h"
#include "child.h"
#include "pinning.h"
#include "absorbing.h"

COND across(const REAL area, const REAL d_i, const REAL d_j, const REAL4 D_i, const REAL4 D_j) {
#ifdef HETEROGENEOUS
    return area / (d_i / D_i + d_j / D_j);
#else
    return area / (d_i + d_j);
#endif
}

// cost finest_coefficients: 29R+6C+15M+28 B, 120 flop
__kernel void finest_coefficients(const int n, const REAL h, const REAL fresnel_A, MEDIUM D, MEDIUM D_coarse,
                                  MEDIUM sigma_a, MEDIUM fitted, __global const int *restrict nbr,
                                  __global const int *restrict parent, __global const int *restrict cut_index,
                                  __global const REAL4 *restrict centroid, __global const REAL4 *restrict boundary,
                                  __global const REAL *restrict normal, __global const REAL *restrict aperture,
                                  __global const Place *restrict face_centroid, __global COND *restrict T,
                                  __global REAL4 *restrict absorb) {
    const int i = get_global_id(0);
    if (i >= n) return;
    const int cut = cut_index[i];
    for (int f = 0; f < 6; f++) {
        const int j = nbr[6 * i + f];
        if (j == i) {
            T[6 * i + f] = 0;
        } else if (j >= n) {
            T[6 * i + f] = across(h * h, h / 2, h, AT(D, i), AT(D_coarse, parent[j]));
        } else {
            const int other = cut_index[j], up = f & 1;
            const int low = up ? cut : other, high = up ? other : cut;
            const Face face = face_between(f >> 1, low, high, centroid, aperture, face_centroid);
            T[6 * i + f] = across(face.area * h * h, face.delta * h / 2, face.delta * h / 2, AT(D, i), AT(D, j));
        }
    }
    const REAL4 volume = absorbing_volume(i, n, h, fresnel_A, D, sigma_a, fitted, nbr, cut_index, centroid, boundary,
                                          normal, aperture, face_centroid);
    REAL4 sink = AT(sigma_a, i) * (h * h * h) * volume;
    if (cut >= 0) {
        const REAL d = depth_below(centroid[cut], boundary[cut], unit_normal(vector_at(cut, normal)), 0.1);
        const REAL4 x2 = depth2(FITTED_AT(fitted, i), d, vector_at(cut, normal), boundary[cut]);
        sink += boundary[cut].w * h * h / resistance(x2, d * h, AT(D, i), fresnel_A);
    }
    absorb[i] = SCALE(sink, AT(D, i));
}

/* Sum over the children of cell i on side f. */
COND sum_side(const int i, const int f, const int side, __global const int *restrict child,
              __global const int *restrict chain, __global const COND *restrict T) {
    COND sum = 0;
    for (int o = 0; o < 8; o++)
        if (((o >> (f >> 1)) & 1) == side)
            for (int next = child[8 * i + o]; next != -1;) sum += T[6 * take_child(&next, chain) + f];
    return sum;
}

// cost coarse_coefficients: 174R+78C+260 B, 560 flop
__kernel void coarse_coefficients(const int n, const REAL h, MEDIUM D, MEDIUM D_coarse, MEDIUM sigma_a,
                                  __global const int *restrict nbr, __global const int *restrict parent,
                                  __global const uchar *restrict is_leaf,
                                  __global const int *restrict child, __global const int *restrict chain,
                                  const int n_fine, __global const int *restrict nbr_fine,
                                  __global const COND *restrict T_fine,
                                  __global const REAL4 *restrict absorb_fine, __global COND *restrict T,
                                  __global REAL4 *restrict absorb) {
    const int i = get_global_id(0);
    if (i >= n) return;
    for (int f = 0; f < 6; f++) {
        const int j = nbr[6 * i + f];
        COND t = 0;
        if (j == i) t = 0;
        else if (j >= n && is_leaf[i]) t = across(h * h, h / 2, h, AT(D, i), AT(D_coarse, parent[j]));
        else if (is_leaf[i] && is_leaf[j]) t = across(h * h, h / 2, h / 2, AT(D, i), AT(D, j));
        else if (is_leaf[i]) t = TO_LEAF * sum_side(j, f ^ 1, !(f & 1), child, chain, T_fine);
        else t = (j < n && is_leaf[j] ? TO_LEAF : (REAL)0.5) * sum_side(i, f, f & 1, child, chain, T_fine);
        T[6 * i + f] = t;
    }
    absorb[i] = is_leaf[i] ? SCALE(AT(sigma_a, i) * (h * h * h), AT(D, i))
                           : absorb_of_children(i, n_fine, child, chain, nbr_fine, T_fine, absorb_fine);
}
