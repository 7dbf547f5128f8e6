/* ray.h -- straight rays through the octree towards a light.
 *
 * Rays go leaf by leaf, or across 4x4x4 cells at once where those are all empty, or all full of one medium: `uniform`
 * has two bytes a brick, with a bit set for each of its eight parts that is full, or empty. Cut cells count up to the plane of their boundary; cavities and gaps hold no leaves and
 * attenuate nothing. Lengths in cells, the extinction is per cell width. Needs real.h, tree.h and beam.h.
 */
#ifdef HETEROGENEOUS
#define EXTINCTION \
    __global const uchar *restrict uniform, __global const REAL4 *restrict extinction, \
        __global const int *restrict depth_start
#define EXTINCTION_ARGUMENTS uniform, extinction, depth_start
#define ONE_MEDIUM 0
#define EXTINCTION_OF(code) extinction[depth_start[(code) & 15] + ((code) >> 4)]
#else
#define EXTINCTION __global const uchar *restrict uniform, const REAL4 extinction
#define EXTINCTION_ARGUMENTS uniform, extinction
#define ONE_MEDIUM 1
#define EXTINCTION_OF(code) extinction
#endif

/* Share of the ray between s0 and s1 (heights over the boundary's plane at its ends) that is inside. */
REAL inside_share(const REAL s0, const REAL s1) {
    if (s0 < 0) return s1 < 0 ? 1 : s0 / (s0 - s1);
    return s1 < 0 ? s1 / (s1 - s0) : 0;
}

/* Optical depth from p to the light, the cut cell where its light enters the object last (-1: none), and the length
 * inside the object. */
REAL4 optical_depth(const REAL4 p, const Beam beam, const int4 dims, __global const int *restrict block,
                    __global const int *restrict brick, __global const int *restrict cut_index,
                    __global const REAL4 *restrict boundary, __global const REAL4 *restrict normal,
                    __global const REAL4 *restrict centroid, EXTINCTION, int *entry, REAL *solid) {
    const REAL4 dir = beam.towards;
    const REAL huge = 1e30;
    const REAL4 inverse = (REAL4)(dir.x != 0 ? 1 / dir.x : huge, dir.y != 0 ? 1 / dir.y : huge,
                                  dir.z != 0 ? 1 / dir.z : huge, huge);
    int4 c = convert_int4(floor(p));
    REAL4 tau = (REAL4)(0);
    REAL t = 0;
    *entry = -1;
    *solid = 0;
    while (t < beam.distance && c.x >= 0 && c.y >= 0 && c.z >= 0 && c.x < dims.x && c.y < dims.y && c.z < dims.z) {
        const int b = block[((c.z >> 3) * (dims.y >> 3) + (c.y >> 3)) * (dims.x >> 3) + (c.x >> 3)];
        int code = b == -1 ? -1 : -2 - b, depth = b == -1 ? 3 : code & 15;
        if (b >= 0) {
            const int part = 1 << (((c.z >> 2) & 1) * 4 + ((c.y >> 2) & 1) * 2 + ((c.x >> 2) & 1));
            const int full = ONE_MEDIUM ? uniform[2 * b] : 0;
            if (full & part) {
                code = 0;
                depth = full == 255 ? 3 : 2;
            } else if (uniform[2 * b + 1] & part) {
                code = -1;
                depth = 2;
            } else {
                code = brick[b * 512 + ((c.z & 7) * 8 + (c.y & 7)) * 8 + (c.x & 7)];
                depth = code < 0 ? 0 : code & 15;
            }
        }
        const int4 low = (c >> depth) << depth, high = low + (1 << depth);
        const REAL tx = (dir.x > 0 ? high.x - p.x : low.x - p.x) * inverse.x,
                   ty = (dir.y > 0 ? high.y - p.y : low.y - p.y) * inverse.y,
                   tz = (dir.z > 0 ? high.z - p.z : low.z - p.z) * inverse.z;
        const REAL ux = dir.x != 0 ? tx : huge, uy = dir.y != 0 ? ty : huge, uz = dir.z != 0 ? tz : huge;
        const REAL leave = fmax(t, fmin(ux, fmin(uy, uz))), end = fmin(leave, beam.distance);
        if (code >= 0) {
            REAL share = 1;
            const int cut = depth == 0 ? cut_index[code >> 4] : -1;
            if (cut >= 0) {
                const REAL4 n = normal[cut], at = p - convert_REAL4(c) - boundary[cut];
                if (length(n) < (REAL)0.5 * boundary[cut].w) {
                    share = centroid[cut].w; /* two sheets in one cell have no one plane */
                } else {
                    const REAL height = dot(at.xyz, n.xyz), rise = dot(dir.xyz, n.xyz);
                    share = inside_share(height + t * rise, height + end * rise);
                }
                if (share > 0) *entry = cut;
            }
            tau += EXTINCTION_OF(code) * (share * (end - t));
            *solid += share * (end - t);
        }
        t = leave;
        const int4 next = clamp(convert_int4(floor(p + t * dir)), low, high - 1);
        c = next;
        if (ux <= uy && ux <= uz) c.x = dir.x > 0 ? high.x : low.x - 1;
        else if (uy <= uz) c.y = dir.y > 0 ? high.y : low.y - 1;
        else c.z = dir.z > 0 ? high.z : low.z - 1;
    }
    return tau;
}

/* Unpolarised Fresnel transmittance for light that enters at cosine mu from outside. */
REAL transmittance(const REAL mu, const REAL eta) {
    const REAL inner2 = 1 - (1 - mu * mu) / (eta * eta);
    if (inner2 <= 0) return 0;
    const REAL inner = sqrt(inner2);
    const REAL s = (mu - eta * inner) / (mu + eta * inner), q = (eta * mu - inner) / (eta * mu + inner);
    return 1 - (s * s + q * q) / 2;
}

REAL4 reduced_irradiance(const REAL4 p, const REAL h, const REAL eta, const REAL4 light, const REAL4 strength,
                         const int4 dims, __global const int *restrict block, __global const int *restrict brick,
                         __global const int *restrict cut_index, __global const REAL4 *restrict boundary,
                         __global const REAL4 *restrict normal, __global const REAL4 *restrict centroid, EXTINCTION,
                         int entry) {
    const Beam beam = beam_at(light, p);
    int last;
    REAL solid;
    const REAL4 tau = optical_depth(p, beam, dims, block, brick, cut_index, boundary, normal, centroid,
                                    EXTINCTION_ARGUMENTS, &last, &solid);
    REAL4 F = beam_strength(strength, light, beam, h) * exp(-tau);
    if (last >= 0) entry = last;
    if (eta != 1 && entry >= 0) {
        const REAL4 n = normal[entry];
        const REAL size = length(n);
        const REAL mu = size > 0 ? fabs(dot(n.xyz, beam.towards.xyz)) / size : 1;
        F *= transmittance(fmin(mu, (REAL)1), eta);
    }
    return F;
}
