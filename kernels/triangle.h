/* triangle.h -- a triangle of the surface, and the boxes next to it. Needs real.h. */
typedef struct { REAL4 a, b, c; } Triangle;

Triangle triangle_at(const int t, __global const REAL *restrict triangle) {
    return (Triangle){(REAL4)(vload3(3 * t, triangle), 0), (REAL4)(vload3(3 * t + 1, triangle), 0),
                      (REAL4)(vload3(3 * t + 2, triangle), 0)};
}

REAL4 lowest(const Triangle t) { return fmin(t.a, fmin(t.b, t.c)); }

REAL4 highest(const Triangle t) { return fmax(t.a, fmax(t.b, t.c)); }

/* Normal, as long as twice the area. */
REAL4 double_area(const Triangle t) { return cross(t.b - t.a, t.c - t.a); }

/* Whether the plane of a triangle with this normal passes within the box at c of half-width r. */
int near_plane(const Triangle t, const REAL4 n, const REAL4 c, const REAL r) {
    return fabs(dot(n, c - t.a)) <= r * (fabs(n.x) + fabs(n.y) + fabs(n.z));
}
