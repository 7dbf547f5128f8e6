/* seen.cl -- which cut cell a ray from the surface meets first, outside the object. */
#define OUTSIDE
#include "real.h"
#include "lanes.h"
#include "body.h"
#include "beam.h"
#include "march.h"

/* Of n rays, the cut cell met, or -1; the extinction is so large that rays end there. One work-item for LANES rays. */
// cost first_met: 96R+64 B, 8000 flop  (16 lanes)
__kernel void first_met(const int n, BODY, __global const REAL *restrict origin,
                        __global const REAL *restrict direction, __global int *restrict met) {
    const int first = LANES * get_global_id(0), count = min(LANES, n - first);
    if (count <= 0) return;
    const Body body = BODY_ARGUMENTS;
    Rays rays;
    for (int l = 0; l < LANES; l++) {
        const int i = first + min(l, count - 1);
        const Beam beam = {(REAL4)(vload3(i, direction), 0), (REAL)1e30};
        set_ray(&rays, l, (REAL4)(vload3(i, origin), 0), beam);
    }
    const Passage passage = march(body, rays);
    for (int l = 0; l < count; l++) met[first + l] = passage.solid.at[l] > 0 ? passage.entry.at[l] : -1;
}
