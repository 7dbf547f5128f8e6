/* subsurface.h -- a beam between the boundary of a cut cell and its centroid. Needs layer.h and mean.h. */

/* F of a cell carried by tau (cells) within a face: light that enters through the boundary of a cut cell falls with the
 * depth under it, and is nowhere more than what enters. Where it grazes, other cells let it in. */
REAL4 carried_along(const REAL4 F, const REAL4 tau, const REAL4 towards, const REAL4 n, const REAL4 entering,
                    const REAL4 extinction) {
    const REAL mu = dot(towards.xyz, n.xyz);
    if (mu <= 0) return F;
    return fmin(F * exp(extinction * (dot(tau.xyz, n.xyz) / fmax(mu, (REAL)0.1))), fmax(entering, F));
}

/* What neither the centroid gets of a beam between the surface (irradiance u) and itself (v), nor r_B. */
REAL4 lost_below(const REAL4 u, const REAL4 v, const REAL4 x2, const REAL d, const REAL4 D, const REAL4 a,
                 const REAL4 own, const REAL fresnel_A) {
    const REAL4 x = sqrt(x2), e = exp(x), rising = log_mean(u, v * e), falling = log_mean(u, v / e);
    const REAL4 to_surface = d / D * (a * sinh_over(x2) * u - own / 2 * (e * falling + rising / e));
    const REAL4 to_centroid = 2 * fresnel_A * (a * u + own * x / 2 * (rising - falling)) +
                              own * (d / D / 2) * (rising + falling);
    return a * u - (to_surface / cosh(x) + to_centroid) / resistance(x2, d, D, fresnel_A);
}
