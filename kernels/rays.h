/* rays.h -- as many straight rays at once as there are lanes: where they are, and what they have met. Needs real.h,
 * lanes.h and beam.h.
 */
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

/* What rays met: optical depth (of a medium that varies it adds up colour by colour), cut cell where the light enters
 * the object last (-1: none), length inside. Where rays run OUTSIDE the object, the last cut cell on their way. */
typedef struct {
    REAL4 tau[LANES];
#ifdef HETEROGENEOUS
    Reals depth[3];
#endif
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
static REALN way_out(Axis *axis) {
#pragma unroll
    for (int a = 0; a < 3; a++) {
        const INTN up = convert_INTN(axis[a].inverse > 0);
        axis[a].leave = (convert_REALN(CHOOSE(axis[a].low, axis[a].high + 1, up)) - axis[a].from.all) * axis[a].inverse;
    }
    return lesser(axis[0].leave, lesser(axis[1].leave, axis[2].leave));
}

/* Rays at their start; they end where the grid's outermost cells begin, which are empty. */
static void start(Rays *rays, const int4 dims) {
    const int size[3] = {dims.x, dims.y, dims.z};
#pragma unroll
    for (int a = 0; a < 3; a++) {
        Axis *axis = rays->axis + a;
        const REALN to = axis->to.all;
        axis->inverse = 1 / CHOOSE(to, (REALN)(1e-20), fabs(to) < (REALN)(1e-20)); /* none goes 1e20 cells */
        axis->cell.all = convert_INTN(axis->from.all);
        axis->low = (INTN)(1);
        axis->high = (INTN)(size[a] - 2);
    }
    rays->distance.all = lesser(rays->distance.all, way_out(rays->axis));
}
