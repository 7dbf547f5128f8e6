/* mean.h -- exact means of an exponential between its values u and v at the two ends of a link. */
#ifdef DOUBLE
typedef long4 Exponent;
#define EXPONENT(x) ((as_long4(x) >> 52) - 1023)
#define POWER_OF_TWO(k) as_double4(((k) + 1023) << 52)
#define DARK 1e-300 /* taken for less */
#define STEEPEST 1e300 /* of all ratios */
#else
typedef int4 Exponent;
#define EXPONENT(x) ((as_int4(x) >> 23) - 127)
#define POWER_OF_TWO(k) as_float4(((k) + 127) << 23)
#define DARK 1e-36
#define STEEPEST 1e38
#endif

/* atanh(s) / s of s^2 up to 0.0295, to 1e-10. */
REAL4 atanh_over(const REAL4 z) {
    const REAL c[6] = {1, 1.0 / 3, 1.0 / 5, 1.0 / 7, 1.0 / 9, 1.0 / 11};
    REAL4 sum = (REAL4)(c[5]);
    for (int k = 4; k >= 0; k--) sum = sum * z + c[k];
    return sum;
}

/* (u - v) / log(u / v), of which log(q) = k log 2 + 2 atanh(s) with the k that makes s least: without the builtin
 * logarithm, which CPUs call for one vector at a time. */
REAL4 log_mean(const REAL4 u, const REAL4 v) {
    const REAL4 low = fmax(fmin(u, v), (REAL4)(DARK)), high = fmax(fmax(u, v), (REAL4)(DARK));
    const Exponent k = EXPONENT(fmin(high / low, (REAL4)(STEEPEST)) * (REAL)1.41421356);
    const REAL4 near = low * POWER_OF_TWO(k), s = (high - near) / (high + near), over = atanh_over(s * s);
    const REAL4 far = (high - low) / (convert_REAL4(k) * (REAL)0.6931471805599453 + 2 * s * over);
    return select(select(far, (high + low) / (2 * over), k == 0), (REAL4)(0), fmin(u, v) <= 0);
}

/* Weighted by cosh of the distance from the far end, x at the near one with value u: what gets there of a source along
 * a link on which light is absorbed (layer.h). */
REAL4 near_mean(const REAL4 u, const REAL4 v, const REAL4 x2) {
    if (!any_fitted(x2)) return log_mean(u, v);
    const REAL4 e = exp(sqrt(x2));
    return (log_mean(u * e, v) + log_mean(u / e, v)) / (2 * sinh_over(x2));
}
