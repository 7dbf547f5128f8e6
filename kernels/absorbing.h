/* absorbing.h -- the volume that absorbs for a finest cell: its own, but along fitted links (layer.h). */
#include "conductance.h"
#include "layer.h"

/* In cells; sigma_a times it is what the cell takes of its fluence, or gets of an even source. */
REAL4 absorbing_volume(const int i, const int n, const REAL h, const REAL fresnel_A, MEDIUM D, MEDIUM sigma_a,
                       MEDIUM fitted, __global const int *restrict nbr, __global const int *restrict cut_index,
                       __global const REAL4 *restrict centroid, __global const REAL4 *restrict boundary,
                       __global const REAL *restrict normal, __global const REAL *restrict aperture,
                       __global const Place *restrict face_centroid) {
    const int c = cut_index[i];
    const REAL4 own = cell_centroid(c, centroid), D_i = AT(D, i), k2 = FITTED_AT(fitted, i);
    if (!any_fitted(k2)) return (REAL4)(own.w);
    REAL4 more = (REAL4)(0);
    for (int f = 0; f < 6; f++) {
        const int j = nbr[6 * i + f], up = f & 1, axis = f >> 1;
        if (j == i || j >= n) continue;
        const int other = cut_index[j];
        const REAL e2 = tilt_between(axis, c, other, boundary, normal);
        if (!(e2 > 0)) continue;
        const Face face = face_between(axis, up ? c : other, up ? other : c, centroid, aperture, face_centroid);
        const REAL4 x2 = link_width2(k2, FITTED_AT(fitted, j), face.delta, axis, c, other, boundary, normal);
        const REAL reach = up ? 1 - along_axis(own, axis) : along_axis(own, axis);
        more += face.area * e2 * (face.delta / 2 * sinh_over(x2 / 4) / cosh(sqrt(x2) / 2) - reach);
    }
    if (c >= 0 && has_normal(vector_at(c, normal), boundary[c])) {
        const REAL d = depth_below(centroid[c], boundary[c], unit_normal(vector_at(c, normal)), 0.1);
        more += boundary[c].w * d * (absorbing_depth(k2 * (d * d), d * h, D_i, fresnel_A) - 1);
    }
    const REAL4 share = k2 * D_i / fmax(AT(sigma_a, i) * (h * h), (REAL4)(1e-30));
    return fmax(own.w + share * more, (REAL4)((REAL)0.05 * own.w));
}
