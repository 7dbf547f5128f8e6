/* cutcell.cl -- moments of a cut cell: volume, apertures, boundary area, centroids; unit cell coordinates.
 *
 * The 27 samples of signed distance split the cell into 8 subcells of 6 Kuhn tetrahedra each. Clipping them all
 * gives one closed polyhedron, so that the apertures and the boundary close: sum_f alpha_f n_f + alpha_B n_B = 0.
 * The diagonals of neighbouring cells coincide, so both see the same face.
 */
#include "real.h"
#include "samples.h"
#include "place.h"
#include "tetrahedron.h"
#include "opening.h"

#define CORNERS 0x361b /* of a subcell among the samples from its lowest corner on, a bit each */

/* From the samples of cut cell i:
 *   centroid  (x_C, kappa)       boundary  (x_B, alpha_B)        normal  (alpha_B n_B as a vector)
 *   aperture  alpha_f for +x +y +z                                face_centroid  two tangential coordinates each
 */
// cost moments: 42R+44 B, 6000 flop
__kernel void moments(const int n, __global const int *restrict owners, __global const REAL *restrict distance,
                      __global REAL4 *restrict centroid, __global REAL4 *restrict boundary,
                      __global REAL *restrict normal, __global REAL *restrict aperture,
                      __global Place *restrict face_centroid) {
    const int i = get_global_id(0);
    if (i >= n) return;
    REAL f[27];
    gather_samples(i, owners, distance, f);
    int below = 0; /* a bit for each sample */
    for (int k = 0; k < 27; k++) below |= (f[k] < 0) << k;
    Moments m = {0, 0, (REAL4)(0), (REAL4)(0), (REAL4)(0)};
    for (int sub = 0; sub < 8; sub++) {
        const int x = sub & 1, y = (sub >> 1) & 1, z = sub >> 2, o = (z * 3 + y) * 3 + x, near = below >> o;
        const REAL4 low = (REAL4)(x, y, z, 0) / 2;
        if (!(near & CORNERS)) continue;
        if ((near & CORNERS) == CORNERS) {
            m.volume += (REAL)0.125;
            m.first += (REAL)0.125 * (low + (REAL4)(0.25, 0.25, 0.25, 0));
            continue;
        }
        const REAL4 e[3] = {(REAL4)(0.5, 0, 0, 0), (REAL4)(0, 0.5, 0, 0), (REAL4)(0, 0, 0.5, 0)};
        const int step[3] = {1, 3, 9};
        for (int p = 0; p < 6; p++) {
            const int first = p >> 1, second = (first + 1 + (p & 1)) % 3, a = step[first], b = a + step[second];
            const REAL4 v[4] = {low, low + e[first], low + e[first] + e[second], low + (REAL4)(0.5, 0.5, 0.5, 0)};
            const REAL g[4] = {f[o], f[o + a], f[o + b], f[o + 13]};
            clip_tetrahedron(&m, v, g,
                             (near & 1) | ((near >> a) & 1) << 1 | ((near >> b) & 1) << 2 | ((near >> 13) & 1) << 3);
        }
    }
    m.first /= m.volume;
    m.first.w = m.volume;
    m.area_first = m.area > 0 ? m.area_first / m.area : m.first;
    m.area_first.w = m.area;
    centroid[i] = m.first;
    boundary[i] = m.area_first;
    vstore3(m.area_vector.xyz, i, normal);
    for (int axis = 0; axis < 3; axis++) {
        REAL alpha;
        REAL2 where;
        face_moments(f, below, axis, &alpha, &where);
        aperture[3 * i + axis] = alpha;
        face_centroid[3 * i + axis] = place_at(where);
    }
}
