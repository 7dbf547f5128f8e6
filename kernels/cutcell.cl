/* cutcell.cl -- moments of a cut cell: volume, apertures, boundary area, centroids; unit cell coordinates.
 *
 * The 27 samples of signed distance split the cell into 8 subcells of 6 Kuhn tetrahedra each. Clipping them all
 * gives one closed polyhedron, so that the apertures and the boundary close: sum_f alpha_f n_f + alpha_B n_B = 0.
 * The diagonals of neighbouring cells coincide, so both see the same face.
 */
#include "real.h"
#include "samples.h"

typedef struct {
    REAL volume, area;
    REAL4 first, area_vector, area_first;
} Moments;

REAL4 cut_point(const REAL4 a, const REAL4 b, const REAL fa, const REAL fb) { return a + (b - a) * (fa / (fa - fb)); }

void add_tetrahedron(Moments *m, const REAL4 a, const REAL4 b, const REAL4 c, const REAL4 d) {
    const REAL v = fabs(dot(b - a, cross(c - a, d - a))) / 6;
    m->volume += v;
    m->first += v * (a + b + c + d) / 4;
}

void add_surface(Moments *m, const REAL4 a, const REAL4 b, const REAL4 c, const REAL4 outward) {
    REAL4 v = cross(b - a, c - a) / 2;
    if (dot(v, outward) < 0) v = -v;
    const REAL area = length(v);
    m->area += area;
    m->area_vector += v;
    m->area_first += area * (a + b + c) / 3;
}

/* Add the part of a tetrahedron where f < 0, and the surface f = 0 in it. */
void clip_tetrahedron(Moments *m, const REAL4 *v, const REAL *f) {
    int in[4], out[4], n = 0, k = 0;
    for (int i = 0; i < 4; i++) {
        if (f[i] < 0) in[n++] = i;
        else out[k++] = i;
    }
    if (n == 0) return;
    const REAL4 p = v[in[0]];
    if (n == 4) {
        add_tetrahedron(m, v[0], v[1], v[2], v[3]);
    } else if (n == 1) {
        const REAL4 a = cut_point(p, v[out[0]], f[in[0]], f[out[0]]), b = cut_point(p, v[out[1]], f[in[0]], f[out[1]]),
                    c = cut_point(p, v[out[2]], f[in[0]], f[out[2]]);
        add_tetrahedron(m, p, a, b, c);
        add_surface(m, a, b, c, v[out[0]] - p);
    } else if (n == 2) {
        const REAL4 q = v[in[1]];
        const REAL4 pr = cut_point(p, v[out[0]], f[in[0]], f[out[0]]), ps = cut_point(p, v[out[1]], f[in[0]], f[out[1]]),
                    qr = cut_point(q, v[out[0]], f[in[1]], f[out[0]]), qs = cut_point(q, v[out[1]], f[in[1]], f[out[1]]);
        add_tetrahedron(m, p, pr, ps, qs);
        add_tetrahedron(m, p, pr, qr, qs);
        add_tetrahedron(m, p, q, qr, qs);
        add_surface(m, pr, ps, qs, v[out[0]] - p);
        add_surface(m, pr, qs, qr, v[out[0]] - p);
    } else {
        const REAL4 q = v[in[1]], r = v[in[2]], s = v[out[0]];
        const REAL4 ps = cut_point(p, s, f[in[0]], f[out[0]]), qs = cut_point(q, s, f[in[1]], f[out[0]]),
                    rs = cut_point(r, s, f[in[2]], f[out[0]]);
        add_tetrahedron(m, p, q, r, ps);
        add_tetrahedron(m, q, r, ps, qs);
        add_tetrahedron(m, r, ps, qs, rs);
        add_surface(m, ps, qs, rs, s - p);
    }
}

/* Add area and first moment of the part of a triangle where f < 0; (x, y, area) as in moments of the plane. */
void clip_triangle(REAL *area, REAL2 *first, const REAL2 *v, const REAL *f) {
    for (int turn = 0; turn < 3; turn++) {
        const int i = turn, j = (turn + 1) % 3, k = (turn + 2) % 3;
        const int n_in = (f[i] < 0) + (f[j] < 0) + (f[k] < 0);
        if (n_in == 0) return;
        REAL2 corner[4] = {v[0], v[1], v[2], v[2]};
        if (n_in == 1) {
            if (!(f[i] < 0)) continue;
            corner[0] = v[i];
            corner[1] = v[i] + (v[j] - v[i]) * (f[i] / (f[i] - f[j]));
            corner[2] = corner[3] = v[i] + (v[k] - v[i]) * (f[i] / (f[i] - f[k]));
        } else if (n_in == 2) {
            if (f[i] < 0) continue;
            corner[0] = v[j];
            corner[1] = v[k];
            corner[2] = v[k] + (v[i] - v[k]) * (f[k] / (f[k] - f[i]));
            corner[3] = v[j] + (v[i] - v[j]) * (f[j] / (f[j] - f[i]));
        }
        for (int half_ = 0; half_ < 2; half_++) {
            const REAL2 a = corner[0], b = corner[1 + half_], c = corner[2 + half_];
            const REAL s = fabs((b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x)) / 2;
            *area += s;
            *first += s * (a + b + c) / 3;
        }
        return;
    }
}

/* Aperture and its centroid (two tangential coordinates) of the upper face across `axis`. */
void face_moments(const REAL *f, const int axis, REAL *aperture, REAL2 *centroid) {
    const int u = axis == 0 ? 3 : 1, w = axis == 2 ? 3 : 9, base = axis == 0 ? 2 : axis == 1 ? 6 : 18;
    REAL area = 0;
    REAL2 first = (REAL2)(0);
    for (int b = 0; b < 2; b++)
        for (int a = 0; a < 2; a++)
            for (int upper = 0; upper < 2; upper++) {
                const int o = base + a * u + b * w, ab = o + u + w, mid = upper ? o + w : o + u;
                const REAL2 low = (REAL2)(a, b) / 2, high = low + (REAL)0.5;
                const REAL2 v[3] = {low, upper ? (REAL2)(low.x, high.y) : (REAL2)(high.x, low.y), high};
                const REAL g[3] = {f[o], f[mid], f[ab]};
                clip_triangle(&area, &first, v, g);
            }
    *aperture = area;
    *centroid = area > 0 ? first / area : (REAL2)(0.5);
}

/* From the samples of cut cell i:
 *   centroid  (x_C, kappa)       boundary  (x_B, alpha_B)        normal  (alpha_B n_B as a vector, 0)
 *   aperture  alpha_f for +x +y +z                                face_centroid  two tangential coordinates each
 */
// cost moments: 48R+32 B, 6000 flop
__kernel void moments(const int n, __global const int *restrict owners, __global const REAL *restrict distance,
                      __global REAL4 *restrict centroid, __global REAL4 *restrict boundary,
                      __global REAL4 *restrict normal, __global REAL *restrict aperture,
                      __global REAL2 *restrict face_centroid) {
    const int i = get_global_id(0);
    if (i >= n) return;
    REAL f[27];
    gather_samples(i, owners, distance, f);
    Moments m = {0, 0, (REAL4)(0), (REAL4)(0), (REAL4)(0)};
    for (int sub = 0; sub < 8; sub++) {
        const int x = sub & 1, y = (sub >> 1) & 1, z = sub >> 2, o = (z * 3 + y) * 3 + x;
        const int step[3] = {1, 3, 9};
        const REAL4 low = (REAL4)(x, y, z, 0) / 2;
        int n_inside = 0;
        for (int k = 0; k < 8; k++) n_inside += f[o + (k & 1) + 3 * ((k >> 1) & 1) + 9 * (k >> 2)] < 0;
        if (n_inside == 0) continue;
        if (n_inside == 8) {
            m.volume += (REAL)0.125;
            m.first += (REAL)0.125 * (low + (REAL4)(0.25, 0.25, 0.25, 0));
            continue;
        }
        for (int p = 0; p < 6; p++) {
            const int first = p >> 1, second = (first + 1 + (p & 1)) % 3;
            REAL4 e[3] = {(REAL4)(0.5, 0, 0, 0), (REAL4)(0, 0.5, 0, 0), (REAL4)(0, 0, 0.5, 0)};
            const REAL4 v[4] = {low, low + e[first], low + e[first] + e[second], low + (REAL4)(0.5, 0.5, 0.5, 0)};
            const REAL g[4] = {f[o], f[o + step[first]], f[o + step[first] + step[second]], f[o + 13]};
            clip_tetrahedron(&m, v, g);
        }
    }
    m.first /= m.volume;
    m.first.w = m.volume;
    m.area_first = m.area > 0 ? m.area_first / m.area : m.first;
    m.area_first.w = m.area;
    centroid[i] = m.first;
    boundary[i] = m.area_first;
    normal[i] = m.area_vector;
    for (int axis = 0; axis < 3; axis++) {
        REAL alpha;
        REAL2 where;
        face_moments(f, axis, &alpha, &where);
        aperture[3 * i + axis] = alpha;
        face_centroid[3 * i + axis] = where;
    }
}
