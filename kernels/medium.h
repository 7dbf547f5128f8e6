/* medium.h -- coefficients of one channel: everywhere the same, or trilinear between the nodes of a grid. */

typedef struct {
    REAL majorant;
    int4 nodes;  /* per axis */
    REAL4 origin, inverse_spacing;
    __global const REAL2 *restrict grid; /* sigma_a, sigma_s at nodes, x fastest; one value where homogeneous */
} Medium;

/* sigma_a and sigma_s at a place [1/mm]. */
REAL2 coefficients(const Medium m, const REAL3 at) {
#ifdef HETEROGENEOUS
    const REAL3 last = convert_REAL3(m.nodes.xyz - 1);
    const REAL3 x = clamp((at - m.origin.xyz) * m.inverse_spacing.xyz, (REAL3)0, last);
    const int3 i = min(convert_int3(x), m.nodes.xyz - 2);
    const REAL3 f = x - convert_REAL3(i);
    const int dy = m.nodes.x, dz = m.nodes.x * m.nodes.y;
    __global const REAL2 *v = m.grid + i.z * dz + i.y * dy + i.x;
    return mix(mix(mix(v[0], v[1], f.x), mix(v[dy], v[dy + 1], f.x), f.y),
               mix(mix(v[dz], v[dz + 1], f.x), mix(v[dz + dy], v[dz + dy + 1], f.x), f.y), f.z);
#else
    return m.grid[0];
#endif
}

/* Length of a flight that meets the majorant. */
REAL flight(const Medium m, const REAL u) { return -log(1 - u) / m.majorant; }
