/* slice.h -- what rays cross of cut cells, all lanes at once. Needs body.h and rays.h. */

/* Planes n . x = offset of the boundary, x from a cell's corner; where n is 0 `offset` is the share that is inside. */
typedef struct {
    Reals n[3], offset;
    Ints cut;
} Planes;

/* Planes of the cut cells that lanes which `hit` are in, and the cells' codes; n = offset = 0 on other lanes. */
Planes planes_at(const Body body, const Ints place, const Ints hit, Ints *code) {
    Planes planes;
    for (int a = 0; a < 3; a++) planes.n[a].all = (REALN)(0);
    planes.offset.all = (REALN)(0);
    planes.cut.all = (INTN)(-1);
    for (int l = 0; l < LANES; l++) {
        if (!hit.at[l]) continue;
        const int finest = finest_in(body.tree, body.tree.block[place.at[l] >> 9], place.at[l] & 511);
        const int cut = body.cut_index[finest];
        code->at[l] = 16 * finest;
        const REAL4 n = body.normal[cut], b = body.boundary[cut];
        const int two_sheets = dot(n, n) < (REAL)0.25 * b.w * b.w; /* which have no one plane */
        planes.n[0].at[l] = two_sheets ? 0 : n.x;
        planes.n[1].at[l] = two_sheets ? 0 : n.y;
        planes.n[2].at[l] = two_sheets ? 0 : n.z;
        planes.offset.at[l] = two_sheets ? body.centroid[cut].w : dot(n.xyz, b.xyz);
        planes.cut.at[l] = cut;
    }
    return planes;
}

/* Lengths inside the cut cells among those that rays cross between t and end. */
void cross_cut_cells(const Body body, const Rays *rays, const Ints place, const Ints kind, const Reals t,
                     const Reals end, Reals *length, Ints *code, Passage *met) {
    const Axis *axis = rays->axis;
    Ints hit;
    hit.all = (kind.all == 0) & convert_INTN(t.all < rays->distance.all);
    const Planes planes = planes_at(body, place, hit, code);
    REALN height = -planes.offset.all, rise = (REALN)(0), size2 = (REALN)(0);
    for (int a = 0; a < 3; a++) {
        const REALN n = planes.n[a].all;
        height += n * (axis[a].from.all - convert_REALN(axis[a].cell.all));
        rise += n * axis[a].to.all;
        size2 += n * n;
    }
    const REALN s0 = height + t.all * rise, s1 = height + end.all * rise, low = lesser(s0, s1);
    REALN share = lesser(greater(-low / greater(greater(s0, s1) - low, (REALN)(1e-30)), (REALN)(0)), (REALN)(1));
#ifdef OUTSIDE
    share = CHOOSE(share, (REALN)(0), rise > 0); /* a ray that starts under the skin comes out of it */
#endif
    share = CHOOSE(share, planes.offset.all, size2 == 0);
#ifdef OUTSIDE
    met->entry.all = CHOOSE(met->entry.all, planes.cut.all, hit.all);
#else
    met->entry.all = CHOOSE(met->entry.all, planes.cut.all, convert_INTN(share > 0));
#endif
    length->all += share * greater(end.all - t.all, (REALN)(0));
}
