/* opening.h -- the open part of a cell's upper face, where f < 0. */

/* Add area and first moment of a triangle. */
void add_triangle(REAL *area, REAL2 *first, const REAL2 a, const REAL2 b, const REAL2 c) {
    const REAL s = fabs((b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x)) / 2;
    *area += s;
    *first += s * (a + b + c) / 3;
}

/* The same of its part where f < 0; `inside` has a bit for each corner that is. */
__attribute__((always_inline)) void clip_triangle(REAL *area, REAL2 *first, const REAL2 *v, const REAL *f,
                                                  const int inside) {
    if (inside == 0) return;
    const int n = popcount(inside);
    if (n == 3) {
        add_triangle(area, first, v[0], v[1], v[2]);
        return;
    }
    const int unlike = n == 1 ? inside : 7 - inside, i = unlike >> 1, j = (i + 1) % 3, k = (i + 2) % 3;
    if (n == 1) {
        add_triangle(area, first, v[i], v[i] + (v[j] - v[i]) * (f[i] / (f[i] - f[j])),
                     v[i] + (v[k] - v[i]) * (f[i] / (f[i] - f[k])));
    } else {
        const REAL2 ki = v[k] + (v[i] - v[k]) * (f[k] / (f[k] - f[i]));
        add_triangle(area, first, v[j], v[k], ki);
        add_triangle(area, first, v[j], ki, v[j] + (v[i] - v[j]) * (f[j] / (f[j] - f[i])));
    }
}

/* Aperture and its centroid (two tangential coordinates) of the upper face across `axis`, of a cell's 27 samples;
 * `below` has a bit for each under zero. */
void face_moments(const REAL *f, const int below, const int axis, REAL *aperture, REAL2 *centroid) {
    const int u = axis == 0 ? 3 : 1, w = axis == 2 ? 3 : 9, base = axis == 0 ? 2 : axis == 1 ? 6 : 18;
    const int nine = axis == 0 ? 0x1249249 : axis == 1 ? 0x1c0e07 : 0x1ff, inside = (below >> base) & nine;
    *aperture = inside == nine;
    *centroid = (REAL2)(0.5);
    if (inside == 0 || inside == nine) return;
    REAL area = 0;
    REAL2 first = (REAL2)(0);
    for (int b = 0; b < 2; b++)
        for (int a = 0; a < 2; a++)
            for (int upper = 0; upper < 2; upper++) {
                const int o = a * u + b * w, mid = o + (upper ? w : u), ab = o + u + w;
                const REAL2 low = (REAL2)(a, b) / 2, high = low + (REAL)0.5;
                const REAL2 v[3] = {low, upper ? (REAL2)(low.x, high.y) : (REAL2)(high.x, low.y), high};
                const REAL g[3] = {f[base + o], f[base + mid], f[base + ab]};
                clip_triangle(&area, &first, v, g,
                              ((inside >> o) & 1) | ((inside >> mid) & 1) << 1 | ((inside >> ab) & 1) << 2);
            }
    *aperture = area;
    if (area > 0) *centroid = first / area;
}
