/* mean.h -- exact means of an exponential between its values u and v at the two ends of a link. */
REAL4 log_mean(const REAL4 u, const REAL4 v) {
    const REAL4 high = fmax(u, v), low = fmin(u, v), mean = (high + low) / 2;
    const REAL4 d = (high - low) / fmax(high + low, (REAL4)(1e-30));
    const REAL4 near = mean * (1 - d * d / 3 * (1 + d * d * (REAL)(4.0 / 15)));
    const REAL4 far = (high - low) / log(fmax(high, (REAL4)(1e-36)) / fmax(low, (REAL4)(1e-36)));
    return select(select(far, near, d < (REAL)0.05), (REAL4)(0), low <= 0);
}

/* Weighted by cosh of the distance from the far end, x at the near one with value u: what gets there of a source along
 * a link on which light is absorbed (layer.h). */
REAL4 near_mean(const REAL4 u, const REAL4 v, const REAL4 x2) {
    if (!any_fitted(x2)) return log_mean(u, v);
    const REAL4 e = exp(sqrt(x2));
    return (log_mean(u * e, v) + log_mean(u / e, v)) / (2 * sinh_over(x2));
}
