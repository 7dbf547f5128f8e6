/* tetrahedron.h -- the part of a Kuhn tetrahedron of half a cell where f < 0, and the surface f = 0 in it.
 *
 * Each cuts a half cell into six alike. What is left of one is up to three tetrahedra, whose shares of its volume are
 * products of the places t where f = 0 along its edges, from the end inside.
 */
typedef struct {
    REAL volume, area;
    REAL4 first, area_vector, area_first;
} Moments;

/* The corners inside, then the others: two bits a place, the first lowest. */
__constant uchar inside_first[16] = {228, 228, 225, 228, 210, 216, 201, 228,
                                     147, 156, 141, 180, 78, 120, 57, 228};

/* Add a share of the whole's volume, a tetrahedron whose corners have this sum. */
void add_share(Moments *m, const REAL share, const REAL4 corners) {
    m->volume += share * ((REAL)1 / 48);
    m->first += share * ((REAL)1 / (4 * 48)) * corners;
}

void add_surface(Moments *m, const REAL4 a, const REAL4 b, const REAL4 c, const REAL4 outward) {
    const REAL4 either = cross(b - a, c - a) / 2, v = copysign((REAL)1, dot(either, outward)) * either;
    const REAL area = sqrt(dot(v, v));
    m->area += area;
    m->area_vector += v;
    m->area_first += area * ((REAL)1 / 3) * (a + b + c);
}

/* `inside` has a bit for each corner where f < 0. */
__attribute__((always_inline)) void clip_tetrahedron(Moments *m, const REAL4 *v, const REAL *f, const int inside) {
    if (inside == 0) return;
    if (inside == 15) {
        add_share(m, 1, v[0] + v[1] + v[2] + v[3]);
        return;
    }
    const int order = inside_first[inside], i = order & 3, j = (order >> 2) & 3, k = (order >> 4) & 3, l = order >> 6;
    const REAL4 p = v[i], q = v[j], r = v[k], s = v[l];
    const int n = popcount(inside);
    if (n == 1) {
        const REAL4 t = f[i] / (f[i] - (REAL4)(f[j], f[k], f[l], f[l]));
        const REAL4 pq = p + t.x * (q - p), pr = p + t.y * (r - p), ps = p + t.z * (s - p);
        add_share(m, t.x * t.y * t.z, p + pq + pr + ps);
        add_surface(m, pq, pr, ps, q - p);
    } else if (n == 2) {
        const REAL4 from = (REAL4)(f[i], f[i], f[j], f[j]), t = from / (from - (REAL4)(f[k], f[l], f[k], f[l]));
        const REAL4 pr = p + t.x * (r - p), ps = p + t.y * (s - p), qr = q + t.z * (r - q), qs = q + t.w * (s - q);
        add_share(m, t.x * t.y * (1 - t.w), p + pr + ps + qs);
        add_share(m, t.x * (1 - t.z) * t.w, p + pr + qr + qs);
        add_share(m, t.z * t.w, p + q + qr + qs);
        add_surface(m, pr, ps, qs, r - p);
        add_surface(m, pr, qs, qr, r - p);
    } else {
        const REAL4 from = (REAL4)(f[i], f[j], f[k], f[k]), t = from / (from - f[l]);
        const REAL4 ps = p + t.x * (s - p), qs = q + t.y * (s - q), rs = r + t.z * (s - r);
        add_share(m, t.x, p + q + r + ps);
        add_share(m, (1 - t.x) * t.y, q + r + ps + qs);
        add_share(m, (1 - t.x) * (1 - t.y) * t.z, r + ps + qs + rs);
        add_surface(m, ps, qs, rs, s - p);
    }
}
