/* source.cl -- what a beam deposits, as the divergence of its flux: the total is what enters minus what leaves,
 * times the albedo a, at any cell size.
 *
 *     B_f = A_f (a_i + 3 D g sigma_s) (omega . e) LM(F_i, F_j),   Q_i = -(sum_f B_f + A_B a_i (omega . n_B) F_B)
 *
 * a_i is the cell's own: a beam scatters nothing where it passes from one albedo to another. The second term of a face
 * is the flux 3 D q1 of the first moment q1 = g sigma_s F omega; at the boundary phi_B holds it already. LM, the
 * logarithmic mean, is the exact mean of an exponential between the two centroids; where a link is fitted (layer.h)
 * each end has its own, and what neither gets is absorbed on the way (lost).
 */
#include "real.h"
#include "face.h"
#include "beam.h"
#include "facing.h"
#include "position.h"
#include "conductance.h"
#include "layer.h"
#include "mean.h"
#include "carried.h"
#include "subsurface.h"

/* Q on the finest level. */
// cost deposit_finest: 86R+28M+50 B, 300 flop
__kernel void deposit_finest(const int n, const REAL h, const REAL g, const REAL fresnel_A, const REAL4 light, MEDIUM D,
                             MEDIUM sigma_a, MEDIUM sigma_s, MEDIUM D_coarse, MEDIUM sigma_s_coarse, MEDIUM fitted,
                             __global const ushort *restrict position, __global const int *restrict nbr,
                             __global const int *restrict parent, __global const int *restrict cut_index,
                             __global const REAL4 *restrict centroid, __global const REAL4 *restrict boundary,
                             __global const REAL *restrict normal, __global const REAL *restrict aperture,
                             __global const Place *restrict face_centroid, __global const REAL *restrict F_B,
                             __global const REAL4 *restrict F, __global REAL *restrict Q,
                             __global REAL *restrict lost) {
    const int i = get_global_id(0);
    if (i >= n) return;
    const REAL4 corner = corner_of(i, position), a = albedo(sigma_a, sigma_s, i);
    const REAL4 own = first_moment(g, D, sigma_s, i), k2 = FITTED_AT(fitted, i);
    const int cut = cut_index[i], kept = max(cut, 0);
    const REAL4 area_vector = vector_at(kept, normal), nrm = unit_normal(area_vector), surface = colours_at(kept, F_B);
    const REAL4 extinction = h * (AT(sigma_a, i) + AT(sigma_s, i));
    REAL4 sum = (REAL4)(0), on_the_way = (REAL4)(0);
#if LANES > 1 /* four times the code, which a GPU's instruction cache does not hold */
#pragma unroll
#endif
    for (int f = 0; f < 6; f++) {
        const int j = nbr[6 * i + f], up = f & 1;
        if (j == i) continue;
        const REAL4 towards = towards_light(light, corner, 1, f);
        REAL area = 1;
        REAL4 F_i = F[i], F_j = F[j], x2 = (REAL4)(0);
        const REAL4 other =
            j < n ? first_moment(g, D, sigma_s, j) : first_moment(g, D_coarse, sigma_s_coarse, parent[j]);
        const int c = j < n ? cut_index[j] : -1;
        if (j < n && (cut >= 0 || c >= 0)) {
            const Face face = face_between(f >> 1, up ? cut : c, up ? c : cut, centroid, aperture, face_centroid);
            area = face.area;
            x2 = link_width2(k2, FITTED_AT(fitted, j), face.delta, f >> 1, cut, c, boundary, normal);
            if (cut >= 0)
                F_i = carried_along(F_i, up ? face.tau_low : face.tau_high, towards, nrm, surface, extinction);
            if (c >= 0)
                F_j = carried_along(F_j, up ? face.tau_high : face.tau_low, towards, unit_normal(vector_at(c, normal)),
                                    colours_at(c, F_B), h * (AT(sigma_a, j) + AT(sigma_s, j)));
        }
        const REAL4 flux = area * outward(towards, f) * (a + (own + other) / 2), mean = near_mean(F_i, F_j, x2);
        sum -= flux * mean;
        if (cut >= 0 && any_fitted(x2)) on_the_way += flux * (mean - near_mean(F_j, F_i, x2)) / (c < 0 ? 1 : 2);
    }
    if (cut >= 0) {
        const REAL inward = dot(beam_at(light, corner + boundary[cut]).towards.xyz, area_vector.xyz);
        const REAL d = depth_below(centroid[cut], boundary[cut], nrm, 0.05);
        const REAL4 x2 = depth2(k2, d, area_vector, boundary[cut]);
        sum += inward * a * surface;
        if (any_fitted(x2)) {
            const REAL4 at_surface = inward * lost_below(surface, F[i], x2, d * h, AT(D, i), a, a + own, fresnel_A);
            sum -= at_surface;
            vstore3((colours_at(cut, lost) + h * h * (on_the_way + at_surface)).xyz, cut, lost);
        }
    }
    vstore3((colours_at(i, Q) + h * h * sum).xyz, i, Q);
}

/* Q on the leaves of a coarser level, but for the faces to finer cells. */
// cost deposit_coarse: 68R+15M+50 B, 200 flop
__kernel void deposit_coarse(const int n, const REAL h, const REAL g, const int depth, const REAL4 light, MEDIUM D,
                             MEDIUM sigma_a, MEDIUM sigma_s, MEDIUM D_coarse, MEDIUM sigma_s_coarse,
                             __global const ushort *restrict position, __global const int *restrict nbr,
                             __global const int *restrict parent, __global const uchar *restrict is_leaf,
                             __global const REAL4 *restrict F, __global REAL *restrict Q) {
    const int i = get_global_id(0);
    if (i >= n || !is_leaf[i]) return;
    const REAL width = 1 << depth;
    const REAL4 corner = width * corner_of(i, position), a = albedo(sigma_a, sigma_s, i);
    const REAL4 own = first_moment(g, D, sigma_s, i);
    REAL4 sum = (REAL4)(0);
    for (int f = 0; f < 6; f++) {
        const int j = nbr[6 * i + f];
        if (j == i || (j < n && !is_leaf[j])) continue;
        const REAL4 both = own + (j < n ? first_moment(g, D, sigma_s, j)
                                        : first_moment(g, D_coarse, sigma_s_coarse, parent[j]));
        sum -= outward(towards_light(light, corner, width, f), f) * (a + both / 2) * log_mean(F[i], F[j]);
    }
    vstore3((colours_at(i, Q) + h * h * sum).xyz, i, Q);
}

/* The faces to finer cells: what leaves those enters here. */
// cost deposit_interface: 68R+11M+50 B, 200 flop
__kernel void deposit_interface(const int n, const int n_fine, const REAL h_fine, const REAL g, const int depth_fine,
                                const REAL4 light, MEDIUM D, MEDIUM sigma_a, MEDIUM sigma_s, MEDIUM D_fine,
                                MEDIUM sigma_s_fine, __global const int *restrict interface,
                                __global const int *restrict interface_start, __global const int *restrict ghost_face,
                                __global const ushort *restrict position_fine, __global const REAL4 *restrict F_fine,
                                __global REAL *restrict Q) {
    const int m = get_global_id(0);
    if (m >= n) return;
    const REAL width = 1 << depth_fine;
    const REAL4 a = albedo(sigma_a, sigma_s, interface[m]), own = first_moment(g, D, sigma_s, interface[m]);
    REAL4 sum = (REAL4)(0);
    for (int k = interface_start[m]; k < interface_start[m + 1]; k++) {
        const int i = ghost_face[k] / 6, f = ghost_face[k] % 6;
        const REAL4 corner = width * corner_of(i, position_fine);
        const REAL4 mean = log_mean(F_fine[i], F_fine[n_fine + k]), other = first_moment(g, D_fine, sigma_s_fine, i);
        sum += outward(towards_light(light, corner, width, f), f) * (a + (own + other) / 2) * mean;
    }
    vstore3((colours_at(interface[m], Q) + h_fine * h_fine * sum).xyz, interface[m], Q);
}
