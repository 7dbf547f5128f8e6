/* mean.h -- exact means of an exponential between its values u and v at the two ends of a link. */

/* d / atanh(d) of d^2 up to 0.16, to 1e-9. */
REAL4 over_atanh(const REAL4 z) {
    const REAL c[9] = {1, -1.0 / 3, -4.0 / 45, -44.0 / 945, -428.0 / 14175, -10196.0 / 467775, -1.6787551856e-2,
                       -1.3502765051e-2, -1.1203745638e-2};
    REAL4 sum = (REAL4)(c[8]);
    for (int k = 7; k >= 0; k--) sum = sum * z + c[k];
    return sum;
}

REAL4 log_mean(const REAL4 u, const REAL4 v) {
    const REAL4 high = fmax(u, v), low = fmin(u, v);
    const REAL4 d = (high - low) / fmax(high + low, (REAL4)(1e-30)), near = (high + low) / 2 * over_atanh(d * d);
    if (all(d < (REAL)0.4)) return near;
    const REAL4 far = (high - low) / log(fmax(high, (REAL4)(1e-36)) / fmax(low, (REAL4)(1e-36)));
    return select(select(far, near, d < (REAL)0.4), (REAL4)(0), low <= 0);
}

/* Weighted by cosh of the distance from the far end, x at the near one with value u: what gets there of a source along
 * a link on which light is absorbed (layer.h). */
REAL4 near_mean(const REAL4 u, const REAL4 v, const REAL4 x2) {
    if (!any_fitted(x2)) return log_mean(u, v);
    const REAL4 e = exp(sqrt(x2));
    return (log_mean(u * e, v) + log_mean(u / e, v)) / (2 * sinh_over(x2));
}
