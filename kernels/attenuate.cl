/* attenuate.cl -- reduced incident irradiance F along straight rays through the octree.
 *
 *     F(x) = F0 T exp(-tau),  tau the extinction along the part of the ray inside the object
 *
 * T is the Fresnel transmittance where the light first enters.
 */
#include "real.h"
#include "lanes.h"
#include "body.h"
#include "beam.h"
#include "position.h"
#include "march.h"
#include "irradiance.h"

/* What beams to LANES points, `count` of them asked for, meet on their way. */
Passage met_by_beams(const Body body, const REAL4 light, const REAL4 *p, const int count, Beam *beam) {
    Rays rays;
    for (int l = 0; l < LANES; l++) {
        beam[l] = beam_at(light, p[l]);
        set_ray(&rays, l, p[l], beam[l]);
        if (l >= count) rays.distance.at[l] = 0;
    }
    return march(body, rays);
}

/* F at the centroids of one level's cells that `order` lists, neighbours in space one after the other: what their rays
 * meet stays in a cache. One work-item for LANES cells. */
// cost beam_in_cells: 128R+384 B, 16000 flop  (16 lanes)
__kernel void beam_in_cells(const int n, const int depth, const REAL h, const REAL eta, const REAL4 light,
                            const REAL4 strength, BODY, __global const int *restrict order,
                            __global const ushort *restrict position, __global REAL4 *restrict F) {
    const int first = LANES * get_global_id(0), count = min(LANES, n - first);
    if (count <= 0) return;
    const Body body = BODY_ARGUMENTS;
    REAL4 p[LANES];
    for (int l = 0; l < LANES; l++) {
        const int i = order[first + min(l, count - 1)];
        const REAL4 corner = corner_of(i, position);
        p[l] = (corner + (REAL)0.5) * (REAL)(1 << depth);
        if (depth == 0 && cut_index[i] >= 0) p[l] = corner + centroid[cut_index[i]];
    }
    Beam beam[LANES];
    const Passage met = met_by_beams(body, light, p, count, beam);
    for (int l = 0; l < count; l++) {
        F[order[first + l]] =
            reduced_irradiance(body, h, eta, light, strength, beam[l], met.tau[l], met.entry.at[l]);
    }
}

/* F at the boundary of the cut cells, on its inner side. One work-item for LANES cells, in the order of planes. */
// cost beam_at_boundary: 176R+384 B, 16000 flop  (16 lanes)
__kernel void beam_at_boundary(const int n, const REAL h, const REAL eta, const REAL4 light, const REAL4 strength,
                               BODY, __global const ushort *restrict position, __global REAL *restrict F_B) {
    const int first = LANES * get_global_id(0), count = min(LANES, n - first);
    if (count <= 0) return;
    const Body body = BODY_ARGUMENTS;
    REAL4 p[LANES];
    for (int l = 0; l < LANES; l++) {
        const int i = plane_cell[first + min(l, count - 1)];
        p[l] = corner_of(i, position) + boundary[cut_index[i]];
    }
    Beam beam[LANES];
    const Passage met = met_by_beams(body, light, p, count, beam);
    for (int l = 0; l < count; l++) {
        const int c = cut_index[plane_cell[first + l]], entry = met.entry.at[l] < 0 ? c : met.entry.at[l];
        const REAL4 F = reduced_irradiance(body, h, eta, light, strength, beam[l], met.tau[l], entry);
        vstore3(F.xyz, c, F_B);
    }
}
