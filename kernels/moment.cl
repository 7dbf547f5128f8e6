/* moment.cl -- the part of a source that leaves at the boundary at once, and the right-hand side. */
#include "real.h"
#include "face.h"
#include "beam.h"
#include "position.h"
#include "conductance.h"
#include "layer.h"
#include "mean.h"
#include "carried.h"
#include "matrix.h"

/* First moment of the source between centroid and surface,
 *     r_B = (d/D) s (-omega . n) (a (F_B - LM(F_B, F_i)) - 3 D g sigma_s LM(F_B, F_i)),
 * s = tanh(x)/x and the near end's mean where the depth is fitted (layer.h), and the part 3 D q1 . n that the boundary
 * condition needs (wall; null where g = 0). */
// cost moment: 31R+4M+10 B, 60 flop
__kernel void moment(const int n, const REAL h, const REAL g, const REAL4 light, MEDIUM D, MEDIUM sigma_a,
                     MEDIUM sigma_s, MEDIUM fitted,
                     __global const ushort *restrict position, __global const int *restrict cut_cell,
                     __global const REAL4 *restrict centroid, __global const REAL4 *restrict boundary,
                     __global const REAL *restrict normal, __global const REAL *restrict F_B,
                     __global const REAL4 *restrict F, __global REAL *restrict r_B, __global REAL *restrict wall) {
    const int c = get_global_id(0);
    if (c >= n) return;
    const int i = cut_cell[c];
    const REAL4 nrm = unit_normal(vector_at(c, normal));
    const REAL d = h * depth_below(centroid[c], boundary[c], nrm, 0.05);
    const REAL4 x2 = depth2(FITTED_AT(fitted, i), d / h, vector_at(c, normal), boundary[c]);
    const REAL4 s = any_fitted(x2) ? sinh_over(x2) / cosh(sqrt(x2)) : (REAL4)(1);
    const REAL4 surface = colours_at(c, F_B), mean = near_mean(surface, F[i], x2);
    const REAL inward = dot(beam_at(light, corner_of(i, position) + boundary[c]).towards.xyz, nrm.xyz);
    const REAL4 first = -inward * 3 * g * AT(D, i) * AT(sigma_s, i) * mean;
    const REAL4 own = d / AT(D, i) * s * (inward * albedo(sigma_a, sigma_s, i) * (surface - mean) + first);
    vstore3((colours_at(c, r_B) + own).xyz, c, r_B);
    if (wall) vstore3((colours_at(c, wall) + first).xyz, c, wall);
}

/* What cells receive becomes a right-hand side in the operator's scale. */
// cost right_hand_side: 6R+1M B, 4 flop
__kernel void right_hand_side(const int n, MEDIUM D, __global REAL *restrict b) {
    const int i = get_global_id(0);
    if (i < n) vstore3(SCALE(colours_at(i, b), AT(D, i)).xyz, i, b);
}

/* What a moment at the boundary of a cut cell brings out of it, in the operator's scale. */
REAL4 taken_out(const int c, const int i, const REAL4 moment, const REAL h, const REAL fresnel_A, MEDIUM D,
                MEDIUM fitted, __global const REAL4 *restrict centroid, __global const REAL4 *restrict boundary,
                __global const REAL *restrict normal) {
    const REAL4 D_i = AT(D, c);
    const REAL d = depth_below(centroid[c], boundary[c], unit_normal(vector_at(c, normal)), 0.05);
    const REAL4 x2 = depth2(FITTED_AT(fitted, i), d, vector_at(c, normal), boundary[c]);
    return SCALE(boundary[c].w * h * h * moment / resistance(x2, d * h, D_i, fresnel_A), D_i);
}

// cost subtract_moment: 21R+2M+4 B, 20 flop
__kernel void subtract_moment(const int n, const REAL h, const REAL fresnel_A, MEDIUM D, MEDIUM fitted,
                              __global const int *restrict cut_cell, __global const REAL4 *restrict centroid,
                              __global const REAL4 *restrict boundary, __global const REAL *restrict normal,
                              __global const REAL *restrict r_B, __global REAL *restrict b) {
    const int c = get_global_id(0);
    if (c >= n) return;
    const int i = cut_cell[c];
    const REAL4 out = taken_out(c, i, colours_at(c, r_B), h, fresnel_A, D, fitted, centroid, boundary, normal);
    vstore3((colours_at(i, b) - out).xyz, i, b);
}

/* The moment is what light that has entered patches takes, `gain` times its blend at a cell. */
// cost add_entered: 36R+2M+28 B, 70 flop
__kernel void add_entered(const int n, const REAL h, const REAL fresnel_A, MEDIUM D, MEDIUM fitted,
                          __global const int *restrict cut_cell, __global const REAL4 *restrict centroid,
                          __global const REAL4 *restrict boundary, __global const REAL *restrict normal,
                          MATRIX(blend), const REAL gain, __global const REAL *restrict entered,
                          __global REAL *restrict b) {
    const int c = get_global_id(0);
    if (c >= n) return;
    const int i = cut_cell[c];
    const REAL4 added = gain * row_times(c, MATRIX_OF(blend), entered);
    const REAL4 in = taken_out(c, i, added, h, fresnel_A, D, fitted, centroid, boundary, normal);
    vstore3((colours_at(i, b) + in).xyz, i, b);
}
