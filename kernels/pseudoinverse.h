/* pseudoinverse.h -- pseudo-inverses of symmetric 3x3 matrices, one a channel, by Jacobi rotations. */
typedef struct {
    REAL4 xx, yy, zz, xy, xz, yz;
} Symmetric;

/* Turn columns p and q of `a`, or its rows, by an angle's cosine and sine. */
void turn_columns(REAL4 a[3][3], const int p, const int q, const REAL4 c, const REAL4 s) {
    for (int k = 0; k < 3; k++) {
        const REAL4 x = a[k][p], y = a[k][q];
        a[k][p] = c * x - s * y;
        a[k][q] = s * x + c * y;
    }
}

void turn_rows(REAL4 a[3][3], const int p, const int q, const REAL4 c, const REAL4 s) {
    for (int k = 0; k < 3; k++) {
        const REAL4 x = a[p][k], y = a[q][k];
        a[p][k] = c * x - s * y;
        a[q][k] = s * x + c * y;
    }
}

/* Make a[p][q] zero. */
void rotate_pair(REAL4 a[3][3], REAL4 v[3][3], const int p, const int q) {
    const REAL4 apart = a[q][q] - a[p][p], twice = 2 * a[p][q];
    const REAL4 reach = fmax(fabs(apart) + sqrt(apart * apart + twice * twice), (REAL4)(1e-30));
    const REAL4 t = (apart >= 0 ? twice : -twice) / reach, c = 1 / sqrt(t * t + 1);
    turn_columns(a, p, q, c, t * c);
    turn_rows(a, p, q, c, t * c);
    turn_columns(v, p, q, c, t * c);
}

/* Eigenvalues under 1e-3 of the largest count as zero: directions that a thin sheet does not have. */
Symmetric pseudo_inverse(const Symmetric m) {
    REAL4 a[3][3] = {{m.xx, m.xy, m.xz}, {m.xy, m.yy, m.yz}, {m.xz, m.yz, m.zz}};
    REAL4 v[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    for (int sweep = 0; sweep < 6; sweep++) {
        rotate_pair(a, v, 0, 1);
        rotate_pair(a, v, 0, 2);
        rotate_pair(a, v, 1, 2);
    }
    const REAL4 cutoff = (REAL)1e-3 * fmax(a[0][0], fmax(a[1][1], a[2][2]));
    Symmetric r = {0, 0, 0, 0, 0, 0};
    for (int k = 0; k < 3; k++) {
        const REAL4 w = a[k][k] > cutoff ? 1 / a[k][k] : 0;
        r.xx += w * v[0][k] * v[0][k];
        r.yy += w * v[1][k] * v[1][k];
        r.zz += w * v[2][k] * v[2][k];
        r.xy += w * v[0][k] * v[1][k];
        r.xz += w * v[0][k] * v[2][k];
        r.yz += w * v[1][k] * v[2][k];
    }
    return r;
}
