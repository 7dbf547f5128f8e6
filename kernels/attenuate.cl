/* attenuate.cl -- reduced incident irradiance F along straight rays through the octree.
 *
 *     F(x) = F0 T exp(-tau),  tau the extinction along the part of the ray inside the object
 *
 * T is the Fresnel transmittance where the light first enters.
 */
#include "real.h"
#include "tree.h"
#include "beam.h"
#include "ray.h"

/* F at the centroids of the leaves of one level; zero on covered cells. */
// cost beam_in_cells: 8R+20 B, 1000 flop
__kernel void beam_in_cells(const int n, const int depth, const REAL h, const REAL eta, const REAL4 light,
                            const REAL4 strength, const int4 dims, __global const int *restrict block,
                            __global const int *restrict brick, __global const int *restrict position,
                            __global const uchar *restrict is_leaf, __global const int *restrict cut_index,
                            __global const REAL4 *restrict boundary, __global const REAL4 *restrict normal,
                            __global const REAL4 *restrict centroid, EXTINCTION, __global REAL4 *restrict F) {
    const int i = get_global_id(0);
    if (i >= n) return;
    if (!is_leaf[i]) {
        F[i] = (REAL4)(0);
        return;
    }
    const REAL4 corner = convert_REAL4(vload4(i, position));
    REAL4 p = (corner + (REAL)0.5) * (REAL)(1 << depth);
    if (depth == 0 && cut_index[i] >= 0) p = corner + centroid[cut_index[i]];
    p.w = 0;
    F[i] = reduced_irradiance(p, h, eta, light, strength, dims, block, brick, cut_index, boundary, normal, centroid,
                              EXTINCTION_ARGUMENTS, -1);
}

/* F at the boundary of the cut cells, on its inner side. */
// cost beam_at_boundary: 12R+20 B, 1000 flop
__kernel void beam_at_boundary(const int n, const REAL h, const REAL eta, const REAL4 light, const REAL4 strength,
                               const int4 dims, __global const int *restrict block, __global const int *restrict brick,
                               __global const int *restrict position, __global const int *restrict cut_cell,
                               __global const int *restrict cut_index, __global const REAL4 *restrict boundary,
                               __global const REAL4 *restrict normal, __global const REAL4 *restrict centroid,
                               EXTINCTION, __global REAL4 *restrict F_B) {
    const int c = get_global_id(0);
    if (c >= n) return;
    REAL4 p = convert_REAL4(vload4(cut_cell[c], position)) + boundary[c];
    p.w = 0;
    F_B[c] = reduced_irradiance(p, h, eta, light, strength, dims, block, brick, cut_index, boundary, normal, centroid,
                                EXTINCTION_ARGUMENTS, c);
}
