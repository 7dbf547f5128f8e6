/* layer.cl -- what exponential fitting (layer.h) makes of cells and boundaries, for sources and the energy balance. */
#include "real.h"
#include "absorbing.h"

// cost absorbing_volumes: 35R+9M+60 B, 120 flop
__kernel void absorbing_volumes(const int n, const REAL h, const REAL fresnel_A, MEDIUM D, MEDIUM sigma_a,
                                MEDIUM fitted, __global const int *restrict nbr, __global const int *restrict cut_index,
                                __global const REAL4 *restrict centroid, __global const REAL4 *restrict boundary,
                                __global const REAL *restrict normal, __global const REAL *restrict aperture,
                                __global const Place *restrict face_centroid, __global REAL4 *restrict volume) {
    const int i = get_global_id(0);
    if (i >= n) return;
    volume[i] = h * h * h * absorbing_volume(i, n, h, fresnel_A, D, sigma_a, fitted, nbr, cut_index, centroid, boundary,
                                             normal, aperture, face_centroid);
}

/* Per cut cell: conductance to the outside [mm^2], cosh(x) of the centroid's depth, r_B of an even source q0 = 1. */
// cost layer_factors: 24R+3M+4 B, 60 flop
__kernel void layer_factors(const int n, const REAL h, const REAL fresnel_A, MEDIUM D, MEDIUM sigma_a, MEDIUM fitted,
                            __global const int *restrict cut_cell, __global const REAL4 *restrict centroid,
                            __global const REAL4 *restrict boundary, __global const REAL *restrict normal,
                            __global REAL4 *restrict conductance, __global REAL4 *restrict swell,
                            __global REAL4 *restrict even) {
    const int c = get_global_id(0);
    if (c >= n) return;
    const int i = cut_cell[c];
    const REAL4 D_i = AT(D, i), k2 = FITTED_AT(fitted, i);
    const REAL d = depth_below(centroid[c], boundary[c], unit_normal(vector_at(c, normal)), 0.05);
    const REAL4 x2 = depth2(k2, d, vector_at(c, normal), boundary[c]), rise = sinh_over(x2 / 4);
    conductance[c] = boundary[c].w * h * h / resistance(x2, d * h, D_i, fresnel_A);
    swell[c] = cosh(sqrt(x2));
    even[c] = x2 * rise * rise / 2 / fmax(AT(sigma_a, i) * swell[c], (REAL4)(1e-30));
}
