/* slope.h -- what the gradients of cut cells add to their values. */

/* The gradient along an axis; the spare channel repeats the third. */
REAL4 slope_along(const int c, const int axis, __global const REAL *restrict slope) {
    return colours_at(3 * c + axis, slope);
}

REAL4 along(const int c, const REAL4 d, __global const REAL *restrict slope) {
    return d.x * slope_along(c, 0, slope) + d.y * slope_along(c, 1, slope) + d.z * slope_along(c, 2, slope);
}

/* phi on the inner end of the normal through x_B. */
REAL4 value_below(const int c, const REAL4 value, const REAL d, const REAL4 n, __global const REAL4 *restrict centroid,
                  __global const REAL4 *restrict boundary, __global const REAL *restrict slope) {
    return value + along(c, boundary[c] - d * n - centroid[c], slope);
}
