/* gradient.cl -- least-squares gradients of cut cells, per cell width.
 *
 * Rows: the neighbours within one cell, dx . g = phi_k - phi_i with weight sqrt(kappa_k) / max(|dx|^2, 0.05), and
 * one for the boundary condition,
 *     g . (D n / h + (x_B - x_i) / 2A) = -phi_i / 2A + 3 D q1 . n.
 */
#include "real.h"
#include "tree.h"
#include "face.h"
#include "conductance.h"

typedef struct {
    REAL xx, yy, zz, xy, xz, yz;
} Symmetric;

void rotate_pair(REAL a[3][3], REAL v[3][3], const int p, const int q) {
    if (a[p][q] == 0) return;
    const REAL theta = (a[q][q] - a[p][p]) / (2 * a[p][q]);
    const REAL t = (theta >= 0 ? 1 : -1) / (fabs(theta) + sqrt(theta * theta + 1));
    const REAL c = 1 / sqrt(t * t + 1), s = t * c;
    for (int k = 0; k < 3; k++) {
        const REAL x = a[k][p], y = a[k][q];
        a[k][p] = c * x - s * y;
        a[k][q] = s * x + c * y;
    }
    for (int k = 0; k < 3; k++) {
        const REAL x = a[p][k], y = a[q][k];
        a[p][k] = c * x - s * y;
        a[q][k] = s * x + c * y;
    }
    for (int k = 0; k < 3; k++) {
        const REAL x = v[k][p], y = v[k][q];
        v[k][p] = c * x - s * y;
        v[k][q] = s * x + c * y;
    }
}

/* Pseudo-inverse of a symmetric matrix; eigenvalues under 1e-3 of the largest count as zero (thin sheets). */
Symmetric pseudo_inverse(const Symmetric m) {
    REAL a[3][3] = {{m.xx, m.xy, m.xz}, {m.xy, m.yy, m.yz}, {m.xz, m.yz, m.zz}};
    REAL v[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    for (int sweep = 0; sweep < 6; sweep++) {
        rotate_pair(a, v, 0, 1);
        rotate_pair(a, v, 0, 2);
        rotate_pair(a, v, 1, 2);
    }
    const REAL cutoff = (REAL)1e-3 * fmax(a[0][0], fmax(a[1][1], a[2][2]));
    Symmetric r = {0, 0, 0, 0, 0, 0};
    for (int k = 0; k < 3; k++) {
        if (!(a[k][k] > cutoff)) continue;
        const REAL w = 1 / a[k][k];
        r.xx += w * v[0][k] * v[0][k];
        r.yy += w * v[1][k] * v[1][k];
        r.zz += w * v[2][k] * v[2][k];
        r.xy += w * v[0][k] * v[1][k];
        r.xz += w * v[0][k] * v[2][k];
        r.yz += w * v[1][k] * v[2][k];
    }
    return r;
}

/* Squared weight of a neighbour at dx with volume fraction kappa. */
REAL row_weight2(const REAL4 dx, const REAL kappa) {
    const REAL size = fmax(dot(dx, dx), (REAL)0.05);
    return kappa / (size * size);
}

/* The boundary condition's row for diffusion length D/h: direction (x, y, z) and right-hand side per phi_i. */
REAL4 boundary_row(const REAL4 offset, const REAL4 n, const REAL alpha_B, const REAL D_over_h, const REAL fresnel_A) {
    const REAL scale = fmin(alpha_B, (REAL)1) / (D_over_h + length(offset) / (2 * fresnel_A));
    REAL4 row = scale * (D_over_h * n + offset / (2 * fresnel_A));
    row.w = -scale / (2 * fresnel_A);
    return row;
}

REAL component(const REAL4 v, const int c) { return c == 0 ? v.x : c == 1 ? v.y : c == 2 ? v.z : v.w; }

// cost gradient_inverse: 144R+1M+210 B, 2500 flop
__kernel void gradient_inverse(const int n, const REAL h, const REAL fresnel_A, const int4 dims, MEDIUM D,
                               __global const int *restrict block, __global const int *restrict brick,
                               __global const ushort *restrict position, __global const int *restrict cut_cell,
                               __global const int *restrict cut_index, __global const REAL4 *restrict centroid,
                               __global const REAL4 *restrict boundary, __global const REAL4 *restrict normal,
                               __global REAL *restrict inverse, __global int *restrict around) {
    const int c = get_global_id(0);
    if (c >= n) return;
    const int i = cut_cell[c];
    const int3 p = convert_int3(vload3(i, position));
    const REAL4 own = centroid[c] * (REAL4)(1, 1, 1, 0);
    Symmetric m = {0, 0, 0, 0, 0, 0};
    for (int dz = -1; dz <= 1; dz++)
        for (int dy = -1; dy <= 1; dy++)
            for (int dx = -1; dx <= 1; dx++) {
                const int code = leaf_code(dims, block, brick, p.x + dx, p.y + dy, p.z + dz);
                const int known = code >= 0 && !(code & 15) && !(dx == 0 && dy == 0 && dz == 0);
                around[27 * c + 9 * dz + 3 * dy + dx + 13] = known ? code >> 4 : i;
                if (!known) continue;
                const REAL4 other = cell_centroid(cut_index[code >> 4], centroid);
                const REAL4 d = (other + (REAL4)(dx, dy, dz, 0) - own) * (REAL4)(1, 1, 1, 0);
                const REAL w = row_weight2(d, other.w);
                m.xx += w * d.x * d.x;
                m.yy += w * d.y * d.y;
                m.zz += w * d.z * d.z;
                m.xy += w * d.x * d.y;
                m.xz += w * d.x * d.z;
                m.yz += w * d.y * d.z;
            }
    const REAL4 offset = (boundary[c] - centroid[c]) * (REAL4)(1, 1, 1, 0), nrm = unit_normal(normal[c]);
    for (int channel = 0; channel < 3; channel++) {
        const REAL4 row = boundary_row(offset, nrm, boundary[c].w, component(AT(D, i), channel) / h, fresnel_A);
        Symmetric full = m;
        full.xx += row.x * row.x;
        full.yy += row.y * row.y;
        full.zz += row.z * row.z;
        full.xy += row.x * row.y;
        full.xz += row.x * row.z;
        full.yz += row.y * row.z;
        const Symmetric r = pseudo_inverse(full);
        const REAL out[6] = {r.xx, r.yy, r.zz, r.xy, r.xz, r.yz};
        for (int k = 0; k < 6; k++) inverse[18 * (size_t)c + 3 * k + channel] = out[k];
    }
}

// cost gradient: 294R+1M+220 B, 700 flop
__kernel void gradient(const int n, const REAL h, const REAL fresnel_A, MEDIUM D, __global const int *restrict around,
                       __global const int *restrict cut_cell, __global const int *restrict cut_index,
                       __global const REAL4 *restrict centroid, __global const REAL4 *restrict boundary,
                       __global const REAL4 *restrict normal, __global const REAL *restrict inverse,
                       __global const REAL4 *restrict wall, __global const REAL4 *restrict x,
                       __global REAL4 *restrict slope) {
    const int c = get_global_id(0);
    if (c >= n) return;
    const int i = cut_cell[c];
    const REAL4 own = centroid[c], value = x[i];
    REAL4 sx = (REAL4)(0), sy = (REAL4)(0), sz = (REAL4)(0);
    __global const int *restrict row = around + 27 * c;
    for (int dz = -1; dz <= 1; dz++)
        for (int dy = -1; dy <= 1; dy++)
            for (int dx = -1; dx <= 1; dx++) {
                const int j = *row++, cut = cut_index[j];
                const REAL4 kept = centroid[max(cut, 0)];
                const REAL4 other = cut < 0 ? (REAL4)(0.5, 0.5, 0.5, 1) : kept;
                const REAL4 d = (other + (REAL4)(dx, dy, dz, 0) - own) * (REAL4)(1, 1, 1, 0);
                const REAL4 rise = row_weight2(d, other.w) * (x[j] - value);
                sx += d.x * rise;
                sy += d.y * rise;
                sz += d.z * rise;
            }
    const REAL4 offset = (boundary[c] - own) * (REAL4)(1, 1, 1, 0), nrm = unit_normal(normal[c]);
    const REAL4 D_over_h = AT(D, i) / h, across = offset / (2 * fresnel_A);
    const REAL4 scale = fmin(boundary[c].w, (REAL)1) / (D_over_h + length(across));
    const REAL4 right = -scale * scale / (2 * fresnel_A) * (value - 2 * fresnel_A * wall[c]);
    sx += right * (D_over_h * nrm.x + across.x);
    sy += right * (D_over_h * nrm.y + across.y);
    sz += right * (D_over_h * nrm.z + across.z);
    REAL4 r[6];
    for (int k = 0; k < 6; k++) r[k] = vload3(6 * (size_t)c + k, inverse).xyzz; /* the spare channel repeats the third */
    slope[3 * c] = r[0] * sx + r[3] * sy + r[4] * sz;
    slope[3 * c + 1] = r[3] * sx + r[1] * sy + r[5] * sz;
    slope[3 * c + 2] = r[4] * sx + r[5] * sy + r[2] * sz;
}
