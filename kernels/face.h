/* face.h -- the face between two cells of the finest level; lengths in cells.
 *
 * Both sides of a face read the same record, the lower cell's, in the same order, so that what leaves one cell enters
 * the other to the last bit.
 */
#include "place.h"

typedef struct {
    REAL area, delta;       /* aperture; distance of the centroids along the axis */
    REAL4 tau_low, tau_high; /* tangential offset of the face's centroid from the two cells' */
} Face;

/* Centroid of a cell from its lower corner, and kappa. */
REAL4 cell_centroid(const int cut, __global const REAL4 *restrict centroid) {
    return cut < 0 ? (REAL4)(0.5, 0.5, 0.5, 1) : centroid[cut];
}

Face face_between(const int axis, const int cut_low, const int cut_high, __global const REAL4 *restrict centroid,
                  __global const REAL *restrict aperture, __global const Place *restrict face_centroid) {
    const REAL4 low = cell_centroid(cut_low, centroid), high = cell_centroid(cut_high, centroid);
    const int record = 3 * cut_low + axis, irregular = cut_low >= 0 && cut_high >= 0;
    const REAL2 c = irregular ? coordinates(face_centroid[record]) : (REAL2)(0.5);
    Face face;
    face.area = irregular ? aperture[record] : 1;
    const REAL4 x = axis == 0 ? (REAL4)(0, c.x, c.y, 0) : axis == 1 ? (REAL4)(c.x, 0, c.y, 0) : (REAL4)(c.x, c.y, 0, 0);
    const REAL4 along = axis == 0 ? (REAL4)(1, 0, 0, 0) : axis == 1 ? (REAL4)(0, 1, 0, 0) : (REAL4)(0, 0, 1, 0);
    const REAL4 across = (REAL4)(1, 1, 1, 0) - along;
    face.delta = fmax(1 + dot(high - low, along), (REAL)0.25);
    face.tau_low = (x - low) * across;
    face.tau_high = (x - high) * across;
    return face;
}

/* Distance [cells] of the centroid to the surface along its normal n, at least `least`. */
REAL depth_below(const REAL4 centroid, const REAL4 boundary, const REAL4 n, const REAL least) {
    return fmax(dot((boundary - centroid) * (REAL4)(1, 1, 1, 0), n), least);
}

REAL4 unit_normal(const REAL4 area_vector) {
    const REAL size = length(area_vector);
    return size > 0 ? area_vector / size : (REAL4)(0);
}
