/* ray.h -- straight rays through a body towards a light, as many at once as there are lanes.
 *
 * Rays leap as far as all cells are empty, or full of one medium, by the cells' `clearance` (clearance.cl); where the
 * medium varies, leaf by leaf. Needs real.h, lanes.h, body.h and beam.h.
 */
#define OPAQUE 104 /* optical depth: single precision holds nothing below exp(-104) */

/* One coordinate of the rays: where they start, their direction; the cells that they cross next, and up to where. */
typedef struct {
    Reals from, to;
    REALN inverse, leave;
    Ints cell;
    INTN low, high;
} Axis;

typedef struct {
    Axis axis[3];
    Reals distance; /* to go at most */
} Rays;

/* What rays met: optical depth, cut cell where the light enters the object last (-1: none), length inside. Where rays
 * run OUTSIDE the object, the last cut cell on their way. */
typedef struct {
    REAL4 tau[LANES];
    Ints entry;
    Reals solid;
} Passage;

void set_ray(Rays *rays, const int lane, const REAL4 p, const Beam beam) {
    const REAL from[3] = {p.x, p.y, p.z}, to[3] = {beam.towards.x, beam.towards.y, beam.towards.z};
    for (int a = 0; a < 3; a++) {
        rays->axis[a].from.at[lane] = from[a];
        rays->axis[a].to.at[lane] = to[a];
    }
    rays->distance.at[lane] = beam.distance;
}

/* How far along the rays they leave the cells from low to high. */
REALN way_out(Axis *axis) {
    for (int a = 0; a < 3; a++) {
        const INTN up = convert_INTN(axis[a].inverse > 0);
        axis[a].leave = (convert_REALN(select(axis[a].low, axis[a].high + 1, up)) - axis[a].from.all) * axis[a].inverse;
    }
    return lesser(axis[0].leave, lesser(axis[1].leave, axis[2].leave));
}

/* Rays at their start; they end where the grid's outermost cells begin, which are empty. */
void start(Rays *rays, const int4 dims) {
    const int size[3] = {dims.x, dims.y, dims.z};
    for (int a = 0; a < 3; a++) {
        Axis *axis = rays->axis + a;
        const REALN to = axis->to.all;
        axis->inverse = 1 / select(to, (REALN)(1e-20), fabs(to) < (REALN)(1e-20)); /* none goes 1e20 cells */
        axis->cell.all = convert_INTN(axis->from.all);
        axis->low = (INTN)(1);
        axis->high = (INTN)(size[a] - 2);
    }
    rays->distance.all = lesser(rays->distance.all, way_out(rays->axis));
}

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
        axis[a].low = select(axis[a].low, low, full);
        axis[a].high = select(axis[a].high, low + ((INTN)(1) << depth) - 1, full);
    }
#endif
}

/* Lengths inside the cut cells among those that rays cross between t and end. */
void cross_cut_cells(const Body body, const Rays *rays, const Ints place, const Ints kind, const Reals t,
                     const Reals end, Reals *length, Ints *code, Passage *met) {
    const Axis *axis = rays->axis;
    for (int l = 0; l < LANES; l++) {
        if (kind.at[l] || !(t.at[l] < rays->distance.at[l])) continue;
        const int finest = finest_in(body.tree, body.tree.block[place.at[l] >> 9], place.at[l] & 511);
        const int cut = body.cut_index[finest];
        code->at[l] = 16 * finest;
        const REAL4 p = (REAL4)(axis[0].from.at[l] - axis[0].cell.at[l], axis[1].from.at[l] - axis[1].cell.at[l],
                                axis[2].from.at[l] - axis[2].cell.at[l], 0);
        const REAL4 to = (REAL4)(axis[0].to.at[l], axis[1].to.at[l], axis[2].to.at[l], 0);
        const REAL share = share_inside(body, cut, p, to, t.at[l], end.at[l]);
#ifdef OUTSIDE
        met->entry.at[l] = cut;
#else
        met->entry.at[l] = share > 0 ? cut : met->entry.at[l];
#endif
        length->at[l] = share * (end.at[l] - t.at[l]);
    }
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
    t->all = select(t->all, distance, met->solid.all * least > OPAQUE);
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
            const INTN beyond = select(axis[a].low - 1, axis[a].high + 1, convert_INTN(axis[a].inverse > 0));
            const INTN at = convert_INTN(axis[a].from.all + t.all * axis[a].to.all);
            const INTN next = select(clamp(at, axis[a].low, axis[a].high), beyond, convert_INTN(axis[a].leave <= least));
            axis[a].cell.all = select(axis[a].cell.all, next, on);
        }
    }
#ifndef HETEROGENEOUS
    for (int l = 0; l < LANES; l++) met.tau[l] = body.extinction * met.solid.at[l];
#endif
    return met;
}
