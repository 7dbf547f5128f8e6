/* winding.cl -- generalised winding number of triangles about points; one work-item per point.
 *     w(q) = 1/(4 pi) sum over triangles of their solid angle seen from q
 * The nodes of a binary tree over the triangles are stored in preorder, so that what follows a node's subtree
 * is at skip[node] and no stack is needed. A node whose ball is far from q counts as a dipole and its first
 * moment (Barill et al. 2018, eq. 14); triangles near q are exact (Van Oosterom and Strackee 1983, eq. 8).
 * A node is 16 numbers: centre, squared distance from which it is far, sum of area vectors, first moment. */
#include "real.h"
#define REAL3 GLUE(REAL, 3)

/* Half the solid angle of a triangle, as the argument of a complex number with |re| + |im| = 1. */
REAL2 half_angle(const REAL3 a, const REAL3 b, const REAL3 c) {
    const REAL la = sqrt(dot(a, a)), lb = sqrt(dot(b, b)), lc = sqrt(dot(c, c));
    const REAL re = la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb;
    const REAL im = dot(a, cross(b, c));
    const REAL size = fabs(re) + fabs(im);
    return size > 0.0 ? (REAL2)(re, im) / size : (REAL2)(1, 0);
}

REAL far_field(const REAL3 d, const REAL d2, __global const REAL *restrict node) {
    const REAL r3 = rsqrt(d2) / d2;
    const REAL3 N = vload3(0, node + 4);
    const REAL3 M0 = vload3(0, node + 7), M1 = vload3(0, node + 10), M2 = vload3(0, node + 13);
    const REAL dMd = d.x * dot(M0, d) + d.y * dot(M1, d) + d.z * dot(M2, d);
    return r3 * (dot(N, d) + M0.x + M1.y + M2.z - 3.0 * dMd / d2);
}

// cost wind: 4R B, 20 flop  (read point, write w; besides, 16R+8 B and 50 flop a node, 9R B and 70 a triangle)
__kernel void wind(const int n, const int n_nodes, const int n_triangles, const int leaf_size,
                   __global const int *restrict skip, __global const int *restrict leaf,
                   __global const REAL *restrict nodes, __global const REAL *restrict triangles,
                   __global const REAL *restrict points, __global REAL *restrict w) {
    const int i = get_global_id(0);
    if (i < n) {
        const REAL3 q = vload3(i, points);
        REAL sum = 0.0, turns = 0.0;
        REAL2 z = (REAL2)(1, 0);  // the near triangles' half angles add up in its argument: one atan2 in all
        int k = 0;
        while (k < n_nodes) {
            __global const REAL *node = nodes + 16 * k;
            const REAL3 d = vload3(0, node) - q;
            const REAL d2 = dot(d, d);
            if (d2 > node[3]) {
                sum += far_field(d, d2, node);
                k = skip[k];
            } else if (leaf[k] < 0) {
                k++;
            } else {
                const int end = min(leaf[k] + leaf_size, n_triangles);
                for (int t = leaf[k]; t < end; t++) {
                    const REAL2 turn = half_angle(vload3(3 * t, triangles) - q, vload3(3 * t + 1, triangles) - q,
                                                  vload3(3 * t + 2, triangles) - q);
                    const REAL2 next = (REAL2)(z.x * turn.x - z.y * turn.y, z.x * turn.y + z.y * turn.x);
                    turns += turn.y > 0.0 && z.y >= 0.0 && next.y < 0.0 ? 1.0 : 0.0;
                    turns -= turn.y < 0.0 && z.y < 0.0 && next.y >= 0.0 ? 1.0 : 0.0;
                    z = next / (fabs(next.x) + fabs(next.y));
                }
                k = skip[k];
            }
        }
        w[i] = sum * (REAL)(0.25 * M_1_PI) + turns + atan2(z.y, z.x) * (REAL)(0.5 * M_1_PI);
    }
}
