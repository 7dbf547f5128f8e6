/* gradient.cl -- least-squares gradients of cut cells, per cell width.
 *
 * Rows: the neighbours within one cell, dx . g = phi_k - phi_i with weight sqrt(kappa_k) / max(|dx|^2, 0.05), and
 * one for the boundary condition,
 *     g . (D n / h + (x_B - x_i) / 2A) = -phi_i / 2A + 3 D q1 . n.
 * The normal equations are summed up and solved each time: that takes less time than to read their inverse.
 */
#include "real.h"
#include "face.h"
#include "conductance.h"
#include "around.h"
#include "fetch.h"
#include "pseudoinverse.h"

#define REAL16 GLUE(REAL, 16)
#define STEP(k) (REAL)((k) % 3 - 1), (REAL)((k) / 3 % 3 - 1), (REAL)((k) / 9 - 1), 0
#define STEPS(k) (REAL16)(STEP(k), STEP((k) + 1), STEP((k) + 2), STEP((k) + 3))
__constant REAL16 steps[7] = {STEPS(0), STEPS(4), STEPS(8), STEPS(12), STEPS(16), STEPS(20),
                              (REAL16)(STEP(24), STEP(25), STEP(26), 0, 0, 0, 0)};

/* The normal equations, m g = right; each of a vector's four parts is a sum over other neighbours, (x, y, z, -) of m
 * and the channels of right. */
typedef struct {
    REAL16 mx, my, mz, right_x, right_y, right_z;
} Sums;

REAL16 four_times(const REAL4 v) { return (REAL16)(v, v, v, v); }

REAL4 fold(const REAL16 v) { return (v.s0123 + v.s4567) + (v.s89ab + v.scdef); }

/* Add four neighbours at distances d with values `rise` above the cell's own. */
void add_rows(Sums *s, const REAL16 d, const REAL16 rise, const REAL4 kappa) {
    const REAL16 x = d.s000044448888cccc, y = d.s111155559999dddd, z = d.s22226666aaaaeeee;
    const REAL4 size = fmax((x * x + y * y + z * z).s048c, (REAL4)(0.05));
    const REAL16 weight2 = (kappa / (size * size)).xxxxyyyyzzzzwwww;
    const REAL16 vx = weight2 * x, vy = weight2 * y, vz = weight2 * z;
    s->mx += vx * d;
    s->my += vy * d;
    s->mz += vz * d;
    s->right_x += vx * rise;
    s->right_y += vy * rise;
    s->right_z += vz * rise;
}

/* Where eigenvalues may be under 1e-3 of the largest (4 det < 1e-3 trace^3 where one is), they are sought. */
Symmetric inverse(const Symmetric m) {
    const REAL4 xx = m.yy * m.zz - m.yz * m.yz, yy = m.xx * m.zz - m.xz * m.xz, zz = m.xx * m.yy - m.xy * m.xy;
    const REAL4 xy = m.xz * m.yz - m.xy * m.zz, xz = m.xy * m.yz - m.xz * m.yy, yz = m.xy * m.xz - m.xx * m.yz;
    const REAL4 determinant = m.xx * xx + m.xy * xy + m.xz * xz, trace = m.xx + m.yy + m.zz, s = 1 / determinant;
    if (!all(4 * determinant > (REAL)1e-3 * trace * trace * trace)) return pseudo_inverse(m);
    return (Symmetric){s * xx, s * yy, s * zz, s * xy, s * xz, s * yz};
}

// cost gradient: 258R+1M+170 B, 1500 flop
__kernel void gradient(const int n, const REAL h, const REAL fresnel_A, MEDIUM D, const int n_red, const int n_cells,
                       __global const ushort *restrict around, __global const int *restrict far,
                       __global const int *restrict cut_cell, __global const int *restrict cut_index,
                       __global const REAL4 *restrict centroid, __global const REAL4 *restrict boundary,
                       __global const REAL *restrict normal, __global const REAL *restrict wall,
                       __global const REAL4 *restrict x, __global REAL *restrict slope) {
    const int c = get_global_id(0);
    if (c >= n) return;
    const int later = min(c + AHEAD, n - 1), its_cell = cut_cell[later];
#pragma unroll
    for (int row = 0; row < 9; row++) {
        const int middle = middle_of(row, later, its_cell, n_red, n_cells, around);
        FETCH(x + middle);
        FETCH(cut_index + middle);
    }
    const int i = cut_cell[c];
    int at[28];
    const int exist = cells_around(c, i, n_red, n_cells, around, far, at);
    const REAL4 own = centroid[c], value = x[i];
    const REAL16 full = four_times((REAL4)(0.5, 0.5, 0.5, 1));
    Sums s = {0, 0, 0, 0, 0, 0};
#pragma unroll
    for (int k = 0; k < 7; k++) {
        const int *j = at + 4 * k;
        const int4 cut = (int4)(cut_index[j[0]], cut_index[j[1]], cut_index[j[2]], cut_index[j[3]]), kept = max(cut, 0);
        const REAL16 cells = (REAL16)(centroid[kept.x], centroid[kept.y], centroid[kept.z], centroid[kept.w]);
        const REAL16 other = convert_REAL4(cut).xxxxyyyyzzzzwwww < 0 ? full : cells;
        const REAL4 there = convert_REAL4(((int4)(exist) >> (4 * k + (int4)(0, 1, 2, 3))) & 1);
        const REAL16 values = (REAL16)(x[j[0]], x[j[1]], x[j[2]], x[j[3]]);
        add_rows(&s, other - four_times(own) + steps[k], values - four_times(value), there * other.s37bf);
    }
    const REAL4 offset = (boundary[c] - own) * (REAL4)(1, 1, 1, 0), nrm = unit_normal(vector_at(c, normal));
    const REAL4 D_over_h = AT(D, c) / h, across = offset / (2 * fresnel_A);
    const REAL4 scale = fmin(boundary[c].w, (REAL)1) / (D_over_h + sqrt(dot(across, across)));
    const REAL4 held_by_wall = wall ? 2 * fresnel_A * colours_at(c, wall) : (REAL4)(0);
    const REAL4 value_there = -scale / (2 * fresnel_A) * (value - held_by_wall);
    const REAL4 row_x = scale * (D_over_h * nrm.x + across.x), row_y = scale * (D_over_h * nrm.y + across.y);
    const REAL4 row_z = scale * (D_over_h * nrm.z + across.z), mx = fold(s.mx), my = fold(s.my), mz = fold(s.mz);
    const REAL4 right_x = fold(s.right_x) + value_there * row_x, right_y = fold(s.right_y) + value_there * row_y;
    const REAL4 right_z = fold(s.right_z) + value_there * row_z;
    const Symmetric r = inverse((Symmetric){mx.x + row_x * row_x, my.y + row_y * row_y, mz.z + row_z * row_z,
                                            mx.y + row_x * row_y, mx.z + row_x * row_z, my.z + row_y * row_z});
    vstore3((r.xx * right_x + r.xy * right_y + r.xz * right_z).xyz, 3 * c, slope);
    vstore3((r.xy * right_x + r.yy * right_y + r.yz * right_z).xyz, 3 * c + 1, slope);
    vstore3((r.xz * right_x + r.yz * right_y + r.zz * right_z).xyz, 3 * c + 2, slope);
}
