/* boundary.cl -- values at the boundary of the cut cells, and what leaves there.
 *
 *     phi_B = 2A (p + r_B) / (2A + d/D),   or as fitted,
 *
 * r_B the source's moment between the centroid and the surface.
 */
#include "real.h"
#include "conductance.h"
#include "layer.h"
#include "slope.h"
#include "matrix.h"

REAL4 fluence_at_boundary(const int c, const int i, const REAL h, const REAL fresnel_A, MEDIUM D, MEDIUM fitted,
                          __global const REAL4 *restrict centroid, __global const REAL4 *restrict boundary,
                          __global const REAL *restrict normal, __global const REAL *restrict slope,
                          const REAL4 value, const REAL4 moment) {
    const REAL4 nrm = unit_normal(vector_at(c, normal));
    const REAL d = depth_below(centroid[c], boundary[c], nrm, 0.05);
    const REAL4 p = value_below(c, value, d, nrm, centroid, boundary, slope);
    const REAL4 x2 = depth2(FITTED_AT(fitted, i), d, vector_at(c, normal), boundary[c]);
    const REAL4 swell = any_fitted(x2) ? cosh(sqrt(x2)) : (REAL4)(1);
    return 2 * fresnel_A * (p + swell * moment) / resistance(x2, d * h, AT(D, c), fresnel_A);
}

/* phi_B, which may take the place of the moment. */
// cost boundary_value: 31R+2M+4 B, 60 flop
__kernel void boundary_value(const int n, const REAL h, const REAL fresnel_A, MEDIUM D, MEDIUM fitted,
                             __global const int *restrict cut_cell, __global const REAL4 *restrict centroid,
                             __global const REAL4 *restrict boundary, __global const REAL *restrict normal,
                             __global const REAL *restrict slope, __global const REAL *moment,
                             __global const REAL4 *restrict x, __global REAL *phi_B) {
    const int c = get_global_id(0);
    if (c >= n) return;
    const int i = cut_cell[c];
    vstore3(fluence_at_boundary(c, i, h, fresnel_A, D, fitted, centroid, boundary, normal, slope, x[i],
                                colours_at(c, moment)).xyz, c, phi_B);
}

/* phi_B, where of the light that has entered patches `gain` times its blend at a cell takes part in the moment. One
 * work-item a cell: looping over a patch's cells takes five times as long. */
// cost value_with_entered: 49R+2M+28 B, 110 flop
__kernel void value_with_entered(const int n, const REAL h, const REAL fresnel_A, MEDIUM D, MEDIUM fitted,
                                 __global const int *restrict cut_cell, __global const REAL4 *restrict centroid,
                                 __global const REAL4 *restrict boundary, __global const REAL *restrict normal,
                                 __global const REAL *restrict slope, __global const REAL *restrict moment,
                                 __global const REAL4 *restrict x, MATRIX(blend), const REAL gain,
                                 __global const REAL *restrict entered, __global REAL *restrict phi_B) {
    const int c = get_global_id(0);
    if (c >= n) return;
    const int i = cut_cell[c];
    const REAL4 r_B = colours_at(c, moment) - gain * row_times(c, MATRIX_OF(blend), entered);
    vstore3(fluence_at_boundary(c, i, h, fresnel_A, D, fitted, centroid, boundary, normal, slope, x[i], r_B).xyz, c,
            phi_B);
}

/* Add J.n = phi_B / 2A of each patch to y, the mean over its cut cells by area. */
// cost leave_boundary: 19R+14 B, 30 flop
__kernel void leave_boundary(const int n, const REAL fresnel_A, PLACES(patches),
                             __global const REAL4 *restrict boundary, __global const REAL *restrict phi_B,
                             __global REAL *restrict y) {
    const int patch = get_global_id(0);
    if (patch >= n) return;
    const Matrix patches = PLACES_OF(patches);
    REAL4 sum = (REAL4)(0);
    REAL area = 0;
    for (int k = first_of_row(patch, patches); k < end_of_row(patch, patches); k++) {
        const int c = column_of(k, patches);
        sum += boundary[c].w * colours_at(c, phi_B);
        area += boundary[c].w;
    }
    const REAL4 flux = sum / (2 * fresnel_A * fmax(area, (REAL)1e-30));
    vstore3((colours_at(patch, y) + flux).xyz, patch, y);
}
