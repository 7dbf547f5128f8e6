/* junction.h -- a face of a coarse cell with several cells of its level beyond: parts of a block that is split.
 *
 * The neighbour's number is n_rows + junction. Each of its cells has a share of the face's transmissibility.
 */
REAL4 value_beyond(const int j, const int n_rows, __global const int *restrict start, __global const int *restrict cell,
                   __global const COND *restrict share, __global const REAL4 *x) {
    if (j < n_rows) return x[j];
    REAL4 mean = (REAL4)(0);
    for (int k = start[j - n_rows]; k < start[j - n_rows + 1]; k++) mean += share[k] * x[cell[k]];
    return mean;
}
