/* bvh.h -- rays against triangles in a complete binary tree of boxes.
 *
 * Node 1 is the root, nodes 2i and 2i+1 are the children of i, nodes from `first_leaf` on are leaves that hold
 * `leaf_size` consecutive triangles each. A ray meets its hits in the order of (distance, triangle), each once:
 * walking on from one hit to the next can neither miss nor repeat any, whatever rounding does to distances.
 */
#pragma OPENCL FP_CONTRACT OFF /* an edge must look the same, negated, from both its triangles */

typedef struct {
    int first_leaf, leaf_size;
    __global const REAL *restrict box;
    __global const REAL *restrict triangle;
    __global const uchar *restrict opaque; /* which triangles are black and none of the solid's; 0: not asked for */
} Surface;

typedef struct { REAL3 origin, direction; int skip; } Ray; /* skip: the triangle the ray starts on, or -1 */

/* out: 1 where the ray leaves the solid, -1 where it enters, 0 where it meets nothing or a black body */
typedef struct { REAL t; int id, out; } Hit;

/* Distance at which the ray enters a box, or INFINITY. */
REAL enter(__global const REAL *restrict box, const REAL3 origin, const REAL3 inverse, const REAL after,
           const REAL reach) {
    const REAL3 a = (vload3(0, box) - origin) * inverse, b = (vload3(1, box) - origin) * inverse;
    const REAL3 low = fmin(a, b), high = fmax(a, b);
    const REAL t0 = fmax(fmax(low.x, low.y), fmax(low.z, after)), t1 = fmin(fmin(high.x, high.y), fmin(high.z, reach));
    return t0 <= t1 * (REAL)1.000001 ? t0 : INFINITY;
}

/* Meet one triangle (Pluecker edge tests, inclusive; the distance from its plane). */
void meet(const Surface s, const Ray ray, const Hit last, const int id, Hit *restrict best) {
    const REAL3 p = vload3(3 * id, s.triangle), q = vload3(3 * id + 1, s.triangle), r = vload3(3 * id + 2, s.triangle);
    const REAL3 a = p - ray.origin, b = q - ray.origin, c = r - ray.origin, d = ray.direction;
    const REAL u = dot(d, cross(c, b)), v = dot(d, cross(a, c)), w = dot(d, cross(b, a));
    if (!((u >= 0 && v >= 0 && w >= 0) || (u <= 0 && v <= 0 && w <= 0))) return;
    const REAL3 normal = cross(q - p, r - p);
    const REAL slope = dot(normal, d), x = dot(a, d), y = dot(b, d), z = dot(c, d);
    if (slope == 0) return;
    const REAL t = clamp(dot(normal, a) / slope, fmin(x, fmin(y, z)), fmax(x, fmax(y, z)));
    const int later = t > last.t || (t == last.t && id > last.id);
    if (later && id != ray.skip && (t < best->t || (t == best->t && id < best->id)))
        *best = (Hit){t, id, s.opaque && s.opaque[id] ? 0 : slope > 0 ? 1 : -1};
}

/* First hit after `last` and up to `reach`; its id is -1 where there is none. */
Hit next_hit(const Surface s, const Ray ray, const Hit last, const REAL reach) {
    Hit best = {reach, -1, 0};
    int stack[32], depth = 0, node = 1;
    REAL at[32];
    const REAL3 inverse = 1 / ray.direction;
    while (true) {
        if (node >= s.first_leaf) {
            for (int k = 0; k < s.leaf_size; k++) meet(s, ray, last, (node - s.first_leaf) * s.leaf_size + k, &best);
            node = 0;
        } else {
            const REAL t0 = enter(s.box + 12 * node, ray.origin, inverse, last.t, best.t);
            const REAL t1 = enter(s.box + 12 * node + 6, ray.origin, inverse, last.t, best.t);
            const int far = 2 * node + (t0 <= t1);
            if (fmax(t0, t1) < INFINITY) { at[depth] = fmax(t0, t1); stack[depth++] = far; }
            node = fmin(t0, t1) < INFINITY ? far ^ 1 : 0;
        }
        while (!node && depth) { depth--; if (at[depth] <= best.t) node = stack[depth]; }
        if (!node) return best;
    }
}

bool absorbed(const Hit hit) { return hit.id >= 0 && hit.out == 0; }

/* How many bodies hold the ray after it passed a hit. */
int crossed(const int count, const Hit hit) { return max(0, count - hit.out); }

/* Which piece of a triangle, cut into cut.y^2 of which cut.x is the first, a place on it lies in (subdivision.py). */
int piece(const Surface s, const int id, const REAL3 at, const int2 cut) {
    const REAL3 p = vload3(3 * id, s.triangle), x = at - p;
    const REAL3 b = vload3(3 * id + 1, s.triangle) - p, c = vload3(3 * id + 2, s.triangle) - p, normal = cross(b, c);
    const REAL scale = cut.y / dot(normal, normal), v = dot(cross(x, c), normal) * scale;
    const REAL w = dot(cross(b, x), normal) * scale;
    const int i = clamp((int)v, 0, cut.y - 1), j = clamp((int)w, 0, cut.y - 1 - i);
    return cut.x + i * (2 * cut.y - i) + 2 * j + (v - i + w - j > 1 && i + j + 1 < cut.y);
}

REAL3 face_normal(const Surface s, const int id) {
    const REAL3 p = vload3(3 * id, s.triangle);
    return normalize(cross(vload3(3 * id + 1, s.triangle) - p, vload3(3 * id + 2, s.triangle) - p));
}
