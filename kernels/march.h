/* march.h -- straight rays through a body towards a light, as many at once as there are lanes.
 *
 * Rays leap as far as all cells are empty, or full of one medium, by the cells' `clearance` (clearance.cl); where the
 * medium varies, leaf by leaf. Needs real.h, lanes.h, body.h and beam.h.
 */
#define OPAQUE 104 /* optical depth: single precision holds nothing below exp(-104) */
#include "rays.h"
#include "slice.h"

/* Bound the cells that are like those the rays are in; codes of the leaves where these bound them. */
void look_around(const Body body, Axis *axis, const Ints place, Ints *kind, Ints *code) {
    Ints whole; /* bits of a cell's coordinates that its block's other cells differ in, where these are all alike */
    for (int l = 0; l < LANES; l++) {
        const int near = body.near[place.at[l] >> 9];
        kind->at[l] = near < 0 ? -1 - near : body.clearance[512 * near + (place.at[l] & 511)];
        whole.at[l] = near < 0 ? 7 : 0;
    }
    const INTN around = max(kind->all & 127, 1) - 1;
    for (int a = 0; a < 3; a++) {
        axis[a].low = (axis[a].cell.all & ~whole.all) - around;
        axis[a].high = (axis[a].cell.all | whole.all) + around;
    }
#ifdef HETEROGENEOUS
    for (int l = 0; l < LANES; l++) code->at[l] = kind->at[l] > 127 ? code_at(body, place.at[l]) : 0;
    const INTN depth = code->all & 15, full = kind->all > 127;
    for (int a = 0; a < 3; a++) {
        const INTN low = (axis[a].cell.all >> depth) << depth;
        axis[a].low = CHOOSE(axis[a].low, low, full);
        axis[a].high = CHOOSE(axis[a].high, low + ((INTN)(1) << depth) - 1, full);
    }
#endif
}

/* Add a length inside to the optical depths; where these exceed what matters, the ray need not go on. */
void attenuate(const Body body, const Reals length, const Ints code, const REALN distance, Reals *t, Passage *met) {
    met->solid.all += length.all;
#ifdef HETEROGENEOUS
    for (int l = 0; l < LANES; l++) {
        if (!(length.at[l] > 0)) continue;
        const int c = code.at[l];
        met->tau[l] += body.extinction[body.depth_start[c & 15] + (c >> 4)] * length.at[l];
        if (all(met->tau[l] > OPAQUE)) t->at[l] = INFINITY;
    }
#else
    const REAL least = fmin(body.extinction.x, fmin(body.extinction.y, body.extinction.z));
    t->all = CHOOSE(t->all, distance, met->solid.all * least > OPAQUE);
#endif
}

Passage march(const Body body, Rays rays) {
    Axis *axis = rays.axis;
    start(&rays, body.tree.dims);
    Passage met;
    met.entry.all = (INTN)(-1);
    met.solid.all = (REALN)(0);
    for (int l = 0; l < LANES; l++) met.tau[l] = (REAL4)(0);
    Reals t;
    t.all = (REALN)(0);
    while (SOME(convert_INTN(t.all < rays.distance.all))) {
        Ints place, kind, code;
        Reals end, length;
        place.all = place_of(body.tree.dims, axis[0].cell.all, axis[1].cell.all, axis[2].cell.all);
        look_around(body, axis, place, &kind, &code);
        const REALN least = way_out(axis);
        end.all = lesser(rays.distance.all, greater(t.all, least));
        length.all = greater(end.all - t.all, (REALN)(0)) * convert_REALN(kind.all >> 7);
        if (SOME(kind.all == 0)) cross_cut_cells(body, &rays, place, kind, t, end, &length, &code, &met);
        t = end;
        attenuate(body, length, code, rays.distance.all, &t, &met);
        const INTN on = convert_INTN(t.all < rays.distance.all);
        for (int a = 0; a < 3; a++) {
            const INTN beyond = CHOOSE(axis[a].low - 1, axis[a].high + 1, convert_INTN(axis[a].inverse > 0));
            const INTN at = convert_INTN(axis[a].from.all + t.all * axis[a].to.all);
            const INTN leaves = convert_INTN(axis[a].leave <= least);
            const INTN next = CHOOSE(clamp(at, axis[a].low, axis[a].high), beyond, leaves);
            axis[a].cell.all = CHOOSE(axis[a].cell.all, next, on);
        }
    }
#ifndef HETEROGENEOUS
    for (int l = 0; l < LANES; l++) met.tau[l] = body.extinction * met.solid.at[l];
#endif
    return met;
}
