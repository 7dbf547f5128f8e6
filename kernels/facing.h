/* facing.h -- how faces of cells stand to a light. Needs beam.h. */

/* Unit vector to the light from the middle of face f of the cell at `corner`, `width` cells of the finest grid wide. */
REAL4 towards_light(const REAL4 light, const REAL4 corner, const REAL width, const int f) {
    const int axis = f >> 1, up = f & 1;
    REAL4 p = corner + width / 2;
    if (axis == 0) p.x = corner.x + up * width;
    if (axis == 1) p.y = corner.y + up * width;
    if (axis == 2) p.z = corner.z + up * width;
    return beam_at(light, p).towards;
}

/* omega . e_out for face f. */
REAL outward(const REAL4 towards, const int f) {
    const int axis = f >> 1;
    const REAL along = axis == 0 ? towards.x : axis == 1 ? towards.y : towards.z;
    return f & 1 ? -along : along;
}
