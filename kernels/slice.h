/* slice.h -- what rays cross of cut cells, all lanes at once. Needs body.h and rays.h. */

/* Planes of the boundary (planes.cl), and their numbers. */
typedef struct {
    REALN n[4]; /* and the offset */
    INTN number;
} Planes;

/* Planes of the cut cells that lanes which `hit` are in. */
static Planes planes_at(const Body body, const INTN near, const INTN place, const INTN kind, const INTN hit) {
    const INTN layer = CHOOSE((INTN)(0), 8 * near + (place >> 6 & 7), hit);
    Planes planes;
    planes.number = CHOOSE((INTN)(0), gather(body.first_plane, layer) + kind - CUT, hit);
    gather_fours(body.plane, planes.number, planes.n);
    return planes;
}

/* Lengths inside the cut cells among those that rays cross between t and end. */
static void cross_cut_cells(const Axis *axis, const Planes planes, const INTN hit, const REALN t, const REALN end,
                            Reals *length, Passage *met) {
    REALN height = -planes.n[3], rise = (REALN)(0), size2 = (REALN)(0);
#pragma unroll
    for (int a = 0; a < 3; a++) {
        const REALN n = planes.n[a];
        height += n * (axis[a].from.all - convert_REALN(axis[a].cell.all));
        rise += n * axis[a].to.all;
        size2 += n * n;
    }
    const REALN s0 = height + t * rise, s1 = height + end * rise, low = lesser(s0, s1);
    REALN share = lesser(greater(-low / greater(greater(s0, s1) - low, (REALN)(1e-30)), (REALN)(0)), (REALN)(1));
#ifdef OUTSIDE
    share = CHOOSE(share, (REALN)(0), rise > 0); /* a ray that starts under the skin comes out of it */
#endif
    share = CHOOSE((REALN)(0), CHOOSE(share, planes.n[3], size2 == 0), FOR_REALS(hit));
#ifdef OUTSIDE
    met->entry.all = CHOOSE(met->entry.all, planes.number, hit);
#else
    met->entry.all = CHOOSE(met->entry.all, planes.number, convert_INTN(share > 0));
#endif
    length->all += share * greater(end - t, (REALN)(0));
}
