/* layer.h -- exponential fitting of the light that diffuses along the normal of a cut cell.
 *
 * Where cells are wide against the diffusion length 1/k, k^2 = sigma_a / D, phi under the surface is a sum of
 * exp(+-k s) of the depth s and of what the source adds. Between two points of a link across axis e, x = k |n_e| delta,
 * and between a centroid at depth d and the surface, x = k d, the equation in one dimension gives exactly
 *
 *     link:     flux T x / sinh(x) (phi_i - phi_j),  and each end absorbs sigma_a A n_e^2 delta tanh(x/2) / x of phi
 *     surface:  J.n = (phi + cosh(x) r_B) / (2A cosh(x) + d/D sinh(x)/x)
 *
 * k2 is (k h)^2 of a cell as far as it is fitted (`fitted_widths` in diffusion.py), 0 where k h is small.
 */
#include "face.h"

int any_fitted(const REAL4 x2) { return x2.x + x2.y + x2.z > 0; }

/* sinh(x) / x of x^2. */
REAL4 sinh_over(const REAL4 x2) {
    const REAL4 x = sqrt(x2);
    return select(sinh(x) / fmax(x, (REAL)1e-3), 1 + x2 / 6 * (1 + x2 / 20), x2 < (REAL)1e-2);
}

/* Whether a cut cell's boundary has one normal; two sheets have none. */
int has_normal(const REAL4 area_vector, const REAL4 boundary) { return length(area_vector) > (REAL)0.5 * boundary.w; }

REAL along_axis(const REAL4 v, const int axis) { return axis == 0 ? v.x : axis == 1 ? v.y : v.z; }

/* n_e^2 of a cut cell. */
REAL tilt(const int axis, const int c, __global const REAL4 *restrict boundary, __global const REAL *restrict normal) {
    const REAL4 n = vector_at(c, normal);
    const REAL e = along_axis(n, axis);
    return has_normal(n, boundary[c]) ? e * e / dot(n.xyz, n.xyz) : 0;
}

/* n_e^2 of a link between finest cells, of the one that is cut or the mean of both. */
REAL tilt_between(const int axis, const int c, const int other, __global const REAL4 *restrict boundary,
                  __global const REAL *restrict normal) {
    if (c < 0) return other < 0 ? 0 : tilt(axis, other, boundary, normal);
    const REAL own = tilt(axis, c, boundary, normal);
    return other < 0 ? own : (own + tilt(axis, other, boundary, normal)) / 2;
}

/* x^2 of a link of `delta` cells whose ends have (k h)^2 k2 and other_k2. */
REAL4 link_width2(const REAL4 k2, const REAL4 other_k2, const REAL delta, const int axis, const int c, const int other,
                  __global const REAL4 *restrict boundary, __global const REAL *restrict normal) {
    if (!any_fitted(k2 + other_k2)) return (REAL4)(0);
    return (k2 + other_k2) / 2 * (delta * delta * tilt_between(axis, c, other, boundary, normal));
}

/* x^2 of a centroid d cells under the surface. */
REAL4 depth2(const REAL4 k2, const REAL d, const REAL4 area_vector, const REAL4 boundary) {
    return has_normal(area_vector, boundary) ? k2 * (d * d) : (REAL4)(0);
}

/* Area over conductance from a centroid d [mm] under the surface to the outside. */
REAL4 resistance(const REAL4 x2, const REAL d, const REAL4 D, const REAL fresnel_A) {
    if (!any_fitted(x2)) return 2 * fresnel_A + d / D;
    return 2 * fresnel_A * cosh(sqrt(x2)) + d / D * sinh_over(x2);
}

/* Volume between the surface and the centroid that absorbs for the centroid, over area and d. */
REAL4 absorbing_depth(const REAL4 x2, const REAL d, const REAL4 D, const REAL fresnel_A) {
    const REAL4 rise = sinh_over(x2 / 4);
    return (2 * fresnel_A * sinh_over(x2) + d / D / 2 * rise * rise) / resistance(x2, d, D, fresnel_A);
}
