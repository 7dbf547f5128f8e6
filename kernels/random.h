/* random.h -- counter-based random numbers: Philox4x32-10 (Salmon et al. 2011), the same on every device. */

typedef struct { uint4 counter; uint2 key; } Random;

/* Four uniform numbers in [0, 1); the stream is fixed by key and counter.xyz, the place in it by counter.w. */
REAL4 uniform4(Random *restrict r) {
    uint4 c = r->counter;
    uint2 k = r->key;
    for (int round = 0; round < 10; round++) {
        const uint low = 0xD2511F53u * c.x, high = mul_hi(0xD2511F53u, c.x);
        const uint low2 = 0xCD9E8D57u * c.z, high2 = mul_hi(0xCD9E8D57u, c.z);
        c = (uint4)(high2 ^ c.y ^ k.x, low2, high ^ c.w ^ k.y, low);
        k += (uint2)(0x9E3779B9u, 0xBB67AE85u);
    }
    r->counter.w++;
    const uint4 high24 = c >> 8;
    return (REAL4)(high24.x, high24.y, high24.z, high24.w) * (REAL)5.9604644775390625e-8;
}

/* Unit vector at cosine `mu` and azimuth 2 pi u from the unit vector `axis` (frame of Duff et al. 2017). */
REAL3 around(const REAL3 axis, const REAL mu, const REAL u) {
    const REAL s = copysign((REAL)1, axis.z), a = -1 / (s + axis.z), b = axis.x * axis.y * a;
    const REAL3 x = (REAL3)(1 + s * axis.x * axis.x * a, s * b, -s * axis.x);
    const REAL3 y = (REAL3)(b, s + axis.y * axis.y * a, -axis.y);
    REAL cosine;
    const REAL sine = sincos(2 * M_PI_F * u, &cosine), r = sqrt(fmax((REAL)0, 1 - mu * mu));
    return normalize(r * cosine * x + r * sine * y + mu * axis);
}

/* First entry of a cumulative distribution that exceeds u. */
int pick(const int n, __global const REAL *restrict cumulative, const REAL u) {
    int low = 0, high = n - 1;
    while (low < high) {
        const int middle = (low + high) / 2;
        if (cumulative[middle] > u) high = middle; else low = middle + 1;
    }
    return low;
}
