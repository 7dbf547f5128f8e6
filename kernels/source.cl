/* source.cl -- what a beam deposits, as the divergence of its flux: the total is what enters minus what leaves,
 * times the albedo a, at any cell size.
 *
 *     B_f = A_f (a + 3 D g sigma_s) (omega . e) LM(F_i, F_j),   Q_i = -(sum_f B_f + A_B a (omega . n_B) F_B)
 *
 * The second term of a face is the flux 3 D q1 of the first moment q1 = g sigma_s F omega; at the boundary phi_B
 * holds it already. LM, the logarithmic mean, is the exact mean of an exponential between the two centroids.
 */
#include "real.h"
#include "face.h"
#include "beam.h"
#include "conductance.h"

REAL4 log_mean(const REAL4 u, const REAL4 v) {
    const REAL4 high = fmax(u, v), low = fmin(u, v), mean = (high + low) / 2;
    const REAL4 d = (high - low) / fmax(high + low, (REAL4)(1e-30));
    const REAL4 near = mean * (1 - d * d / 3 * (1 + d * d * (REAL)(4.0 / 15)));
    const REAL4 far = (high - low) / log(fmax(high, (REAL4)(1e-36)) / fmax(low, (REAL4)(1e-36)));
    return select(select(far, near, d < (REAL)0.05), (REAL4)(0), low <= 0);
}

REAL4 albedo(MEDIUM sigma_a, MEDIUM sigma_s, const int i) { return AT(sigma_s, i) / (AT(sigma_a, i) + AT(sigma_s, i)); }

/* What a face carries per irradiance and area: a + 3 D g sigma_s. */
REAL4 carried(const REAL g, MEDIUM D, MEDIUM sigma_a, MEDIUM sigma_s, const int i) {
    return albedo(sigma_a, sigma_s, i) + 3 * g * AT(D, i) * AT(sigma_s, i);
}

/* Unit vector to the light from the middle of face f of the cell at `corner`, `width` cells of the finest grid wide. */
REAL4 towards_light(const REAL4 light, const REAL4 corner, const REAL width, const int f) {
    const int axis = f >> 1, up = f & 1;
    REAL4 p = corner + width / 2;
    if (axis == 0) p.x = corner.x + up * width;
    if (axis == 1) p.y = corner.y + up * width;
    if (axis == 2) p.z = corner.z + up * width;
    p.w = 0;
    return beam_at(light, p).towards;
}

/* omega . e_out for face f. */
REAL outward(const REAL4 towards, const int f) {
    const int axis = f >> 1;
    const REAL along = axis == 0 ? towards.x : axis == 1 ? towards.y : towards.z;
    return f & 1 ? -along : along;
}

/* F of a cell carried by tau (cells) within a face: light that enters through the boundary of a cut cell falls with the
 * depth under it, and is nowhere more than what enters. Where it grazes, other cells let it in. */
REAL4 carried_along(const REAL4 F, const int cut, const REAL4 tau, const REAL4 towards, const REAL4 extinction,
                    __global const REAL4 *restrict normal, __global const REAL4 *restrict F_B) {
    if (cut < 0) return F;
    const REAL4 n = unit_normal(normal[cut]);
    const REAL mu = dot(towards.xyz, n.xyz);
    if (mu <= 0) return F;
    return fmin(F * exp(extinction * (dot(tau.xyz, n.xyz) / fmax(mu, (REAL)0.1))), fmax(F_B[cut], F));
}

/* Q on the finest level. */
// cost deposit_finest: 90R+21M+60 B, 300 flop
__kernel void deposit_finest(const int n, const REAL h, const REAL g, const REAL4 light, MEDIUM D, MEDIUM sigma_a,
                             MEDIUM sigma_s, MEDIUM D_coarse, MEDIUM sigma_a_coarse, MEDIUM sigma_s_coarse,
                             __global const int *restrict position,
                             __global const int *restrict nbr, __global const int *restrict parent,
                             __global const int *restrict cut_index, __global const REAL4 *restrict centroid,
                             __global const REAL4 *restrict boundary, __global const REAL4 *restrict normal,
                             __global const REAL *restrict aperture, __global const REAL2 *restrict face_centroid,
                             __global const REAL4 *restrict F_B, __global const REAL4 *restrict F,
                             __global REAL4 *restrict Q) {
    const int i = get_global_id(0);
    if (i >= n) return;
    const REAL4 corner = convert_REAL4(vload4(i, position)), own = carried(g, D, sigma_a, sigma_s, i);
    const int cut = cut_index[i];
    REAL4 sum = (REAL4)(0);
    for (int f = 0; f < 6; f++) {
        const int j = nbr[6 * i + f], up = f & 1;
        if (j == i) continue;
        const REAL4 towards = towards_light(light, corner, 1, f);
        REAL area = 1;
        REAL4 other = (REAL4)(0), F_i = F[i], F_j = F[j];
        if (j < n) {
            const int c = cut_index[j];
            const Face face = face_between(f >> 1, up ? cut : c, up ? c : cut, centroid, aperture, face_centroid);
            area = face.area;
            F_i = carried_along(F_i, cut, up ? face.tau_low : face.tau_high, towards,
                                h * (AT(sigma_a, i) + AT(sigma_s, i)), normal, F_B);
            F_j = carried_along(F_j, c, up ? face.tau_high : face.tau_low, towards,
                                h * (AT(sigma_a, j) + AT(sigma_s, j)), normal, F_B);
            other = carried(g, D, sigma_a, sigma_s, j);
        } else {
            other = carried(g, D_coarse, sigma_a_coarse, sigma_s_coarse, parent[j]);
        }
        sum -= area * outward(towards, f) * (own + other) / 2 * log_mean(F_i, F_j);
    }
    if (cut >= 0) {
        REAL4 p = corner + boundary[cut];
        p.w = 0;
        sum += dot(beam_at(light, p).towards.xyz, normal[cut].xyz) * albedo(sigma_a, sigma_s, i) * F_B[cut];
    }
    Q[i] += h * h * sum;
}

/* Q on the leaves of a coarser level, but for the faces to finer cells. */
// cost deposit_coarse: 70R+21M+60 B, 200 flop
__kernel void deposit_coarse(const int n, const REAL h, const REAL g, const int depth, const REAL4 light, MEDIUM D,
                             MEDIUM sigma_a, MEDIUM sigma_s, MEDIUM D_coarse, MEDIUM sigma_a_coarse,
                             MEDIUM sigma_s_coarse,
                             __global const int *restrict position, __global const int *restrict nbr,
                             __global const int *restrict parent, __global const uchar *restrict is_leaf,
                             __global const REAL4 *restrict F, __global REAL4 *restrict Q) {
    const int i = get_global_id(0);
    if (i >= n || !is_leaf[i]) return;
    const REAL width = 1 << depth;
    const REAL4 corner = width * convert_REAL4(vload4(i, position)), own = carried(g, D, sigma_a, sigma_s, i);
    REAL4 sum = (REAL4)(0);
    for (int f = 0; f < 6; f++) {
        const int j = nbr[6 * i + f];
        if (j == i || (j < n && !is_leaf[j])) continue;
        const REAL4 other = j < n ? carried(g, D, sigma_a, sigma_s, j)
                                  : carried(g, D_coarse, sigma_a_coarse, sigma_s_coarse, parent[j]);
        sum -= outward(towards_light(light, corner, width, f), f) * (own + other) / 2 * log_mean(F[i], F[j]);
    }
    Q[i] += h * h * sum;
}

/* The faces to finer cells: what leaves those enters here. */
// cost deposit_interface: 70R+15M+60 B, 200 flop
__kernel void deposit_interface(const int n, const int n_fine, const REAL h_fine, const REAL g, const int depth_fine,
                                const REAL4 light, MEDIUM D, MEDIUM sigma_a, MEDIUM sigma_s, MEDIUM D_fine,
                                MEDIUM sigma_a_fine, MEDIUM sigma_s_fine, __global const int *restrict interface,
                                __global const int *restrict interface_start, __global const int *restrict ghost_face,
                                __global const int *restrict position_fine, __global const REAL4 *restrict F_fine,
                                __global REAL4 *restrict Q) {
    const int m = get_global_id(0);
    if (m >= n) return;
    const REAL width = 1 << depth_fine;
    REAL4 sum = (REAL4)(0);
    for (int k = interface_start[m]; k < interface_start[m + 1]; k++) {
        const int i = ghost_face[k] / 6, f = ghost_face[k] % 6;
        const REAL4 corner = width * convert_REAL4(vload4(i, position_fine));
        const REAL4 a = (carried(g, D_fine, sigma_a_fine, sigma_s_fine, i) +
                         carried(g, D, sigma_a, sigma_s, interface[m])) / 2;
        sum += outward(towards_light(light, corner, width, f), f) * a * log_mean(F_fine[i], F_fine[n_fine + k]);
    }
    Q[interface[m]] += h_fine * h_fine * sum;
}

/* First moment of the source between centroid and surface,
 *     r_B = (d/D) (-omega . n) (a (F_B - LM(F_B, F_i)) - 3 D g sigma_s LM(F_B, F_i)),
 * and the part 3 D q1 . n that the boundary condition needs (wall). */
// cost moment: 30R+3M+8 B, 60 flop
__kernel void moment(const int n, const REAL h, const REAL g, const REAL4 light, MEDIUM D, MEDIUM sigma_a, MEDIUM sigma_s,
                     __global const int *restrict position, __global const int *restrict cut_cell,
                     __global const REAL4 *restrict centroid, __global const REAL4 *restrict boundary,
                     __global const REAL4 *restrict normal, __global const REAL4 *restrict F_B,
                     __global const REAL4 *restrict F, __global REAL4 *restrict r_B, __global REAL4 *restrict wall) {
    const int c = get_global_id(0);
    if (c >= n) return;
    const int i = cut_cell[c];
    const REAL4 nrm = unit_normal(normal[c]);
    REAL4 p = convert_REAL4(vload4(i, position)) + boundary[c];
    p.w = 0;
    const REAL d = h * depth_below(centroid[c], boundary[c], nrm, 0.05);
    const REAL4 mean = log_mean(F_B[c], F[i]);
    const REAL inward = dot(beam_at(light, p).towards.xyz, nrm.xyz);
    const REAL4 first = -inward * 3 * g * AT(D, i) * AT(sigma_s, i) * mean;
    r_B[c] += d / AT(D, i) * (inward * albedo(sigma_a, sigma_s, i) * (F_B[c] - mean) + first);
    wall[c] += first;
}

/* Right-hand side in the operator's scale, b = Q, less C_B r_B at the boundary. */
// cost right_hand_side: 8R+1M B, 4 flop
__kernel void right_hand_side(const int n, MEDIUM D, __global const REAL4 *restrict Q, __global REAL4 *restrict b) {
    const int i = get_global_id(0);
    if (i < n) b[i] = SCALE(Q[i], AT(D, i));
}

// cost subtract_moment: 28R+1M+4 B, 20 flop
__kernel void subtract_moment(const int n, const REAL h, const REAL fresnel_A, MEDIUM D,
                              __global const int *restrict cut_cell, __global const REAL4 *restrict centroid,
                              __global const REAL4 *restrict boundary, __global const REAL4 *restrict normal,
                              __global const REAL4 *restrict r_B, __global REAL4 *restrict b) {
    const int c = get_global_id(0);
    if (c >= n) return;
    const int i = cut_cell[c];
    const REAL d = h * depth_below(centroid[c], boundary[c], unit_normal(normal[c]), 0.05);
    b[i] -= SCALE(boundary[c].w * h * h * r_B[c] / (2 * fresnel_A + d / AT(D, i)), AT(D, i));
}
