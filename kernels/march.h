/* march.h -- straight rays through a body towards a light, as many at once as there are lanes.
 *
 * Rays leap as far as all cells are empty, or full of one medium, by the cells' `clearance` (clearance.cl); where the
 * medium varies, leaf by leaf. Needs real.h, lanes.h, body.h and beam.h.
 */
#define OPAQUE 104 /* optical depth: single precision holds nothing below exp(-104) */
#include "rays.h"
#include "slice.h"

/* Bound the cells that are like those the rays are in: `near` of their blocks, their kinds, and codes of the leaves
 * where these bound them. */
static void look_around(const Body body, Axis *axis, const Ints place, Ints *near, Ints *kind, Ints *code) {
    near->all = gather(body.near, place.all >> 9);
    const INTN alike = near->all >> 31; /* a block of one kind */
    kind->all = gather_bytes(body.clearance, 512 * max(near->all, 0) + (place.all & 511));
    kind->all = CHOOSE(kind->all, -1 - near->all, alike);
    const INTN around = CHOOSE((kind->all & 127) - 1, (INTN)(0), IS_CUT(kind->all));
    const INTN whole = alike & 7; /* bits of coordinates within a block */
#pragma unroll
    for (int a = 0; a < 3; a++) {
        axis[a].low = (axis[a].cell.all & ~whole) - around;
        axis[a].high = (axis[a].cell.all | whole) + around;
    }
#ifdef HETEROGENEOUS
    const INTN full = kind->all > 127;
    code->all = CHOOSE((INTN)(0), codes_at(body, CHOOSE((INTN)(0), place.all, full)), full);
    const INTN depth = code->all & 15;
    for (int a = 0; a < 3; a++) {
        const INTN low = (axis[a].cell.all >> depth) << depth;
        axis[a].low = CHOOSE(axis[a].low, low, full);
        axis[a].high = CHOOSE(axis[a].high, low + ((INTN)(1) << depth) - 1, full);
    }
#endif
}

/* Add lengths inside to the optical depths. */
static void attenuate(const Body body, const Reals length, const Ints code, Passage *met) {
    met->solid.all += length.all;
#ifdef HETEROGENEOUS
    const INTN place = 3 * (gather(body.depth_start, code.all & 15) + (code.all >> 4));
#pragma unroll
    for (int k = 0; k < 3; k++) met->depth[k].all += gather_reals(body.extinction, place + k) * length.all;
#endif
}

/* Which rays need not go on, for their optical depth exceeds what matters. */
static INTN opaque(const Body body, const Passage *met) {
#ifdef HETEROGENEOUS
    const REALN least = lesser(met->depth[0].all, lesser(met->depth[1].all, met->depth[2].all));
    return convert_INTN(least > OPAQUE);
#else
    const REAL least = fmin(body.extinction.x, fmin(body.extinction.y, body.extinction.z));
    return convert_INTN(met->solid.all * least > OPAQUE);
#endif
}

Passage march(const Body body, Rays rays) {
    Axis *axis = rays.axis;
    start(&rays, body.tree.dims);
    Passage met;
    met.entry.all = (INTN)(-1);
    met.solid.all = (REALN)(0);
#ifdef HETEROGENEOUS
    for (int k = 0; k < 3; k++) met.depth[k].all = (REALN)(0);
#endif
    REALN t = (REALN)(0);
    INTN on = convert_INTN(t < rays.distance.all);
    while (SOME(on)) {
        Ints place, near, kind, code;
        Reals length;
        place.all = place_of(body.tree.dims, axis[0].cell.all, axis[1].cell.all, axis[2].cell.all);
        look_around(body, axis, place, &near, &kind, &code);
        const REALN least = way_out(axis), end = lesser(rays.distance.all, greater(t, least));
        length.all = greater(end - t, (REALN)(0)) * convert_REALN(kind.all >> 7);
#ifndef OUTSIDE
        on &= ~opaque(body, &met); /* after the step before: this one's need not be waited for */
#endif
        const INTN hit = on & IS_CUT(kind.all);
        if (SOME(hit)) {
            const Planes planes = planes_at(body, near.all, place.all, kind.all, hit);
            cross_cut_cells(axis, planes, hit, t, end, &length, &met);
#ifdef HETEROGENEOUS
            code.all = CHOOSE(code.all, 16 * gather(body.plane_cell, planes.number), hit);
#endif
        }
        attenuate(body, length, code, &met);
#ifdef OUTSIDE
        on &= ~opaque(body, &met);
#endif
        t = CHOOSE(rays.distance.all, end, FOR_REALS(on));
        on = convert_INTN(t < rays.distance.all);
#pragma unroll
        for (int a = 0; a < 3; a++) {
            const INTN beyond = CHOOSE(axis[a].low - 1, axis[a].high + 1, convert_INTN(axis[a].inverse > 0));
            const INTN at = convert_INTN(axis[a].from.all + t * axis[a].to.all);
            const INTN leaves = convert_INTN(axis[a].leave <= least);
            const INTN next = CHOOSE(clamp(at, axis[a].low, axis[a].high), beyond, leaves);
            axis[a].cell.all = CHOOSE(axis[a].cell.all, next, on);
        }
    }
    for (int l = 0; l < LANES; l++)
        if (met.entry.at[l] >= 0) met.entry.at[l] = body.cut_index[body.plane_cell[met.entry.at[l]]];
    for (int l = 0; l < LANES; l++) {
#ifdef HETEROGENEOUS
        met.tau[l] = (REAL4)(met.depth[0].at[l], met.depth[1].at[l], met.depth[2].at[l], met.depth[2].at[l]);
#else
        met.tau[l] = body.extinction * met.solid.at[l];
#endif
    }
    return met;
}
