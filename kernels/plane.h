/* plane.h -- boxes next to a triangle. Needs real.h. */

/* Whether the triangle's plane passes within the box at c of half-width r. */
int near_plane(const REAL4 a, const REAL4 n, const REAL4 c, const REAL r) {
    return fabs(dot(n, c - a)) <= r * (fabs(n.x) + fabs(n.y) + fabs(n.z));
}
