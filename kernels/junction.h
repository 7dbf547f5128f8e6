/* junction.h -- a face of a coarse cell with several cells of its level beyond: parts of a block that is split.
 *
 * The neighbour's number is n_rows + junction. Each of its cells has a share of the face's transmissibility.
 */
typedef struct {
    int n_rows;
    __global const int *restrict start, *restrict cell;
    __global const COND *restrict share; /* 0: the level has no junctions */
} Junctions;

#define NO_JUNCTIONS ((Junctions){0, 0, 0, 0})

REAL4 value_beyond(const int j, const Junctions at, __global const REAL4 *x) {
    if (!at.share || j < at.n_rows) return x[j];
    REAL4 mean = (REAL4)(0);
    for (int k = at.start[j - at.n_rows]; k < at.start[j - at.n_rows + 1]; k++) mean += at.share[k] * x[at.cell[k]];
    return mean;
}
