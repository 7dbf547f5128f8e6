/* junction.h -- a face of a coarse cell with several cells of its level beyond: parts of a block that is split.
 *
 * The neighbour's number is that of a row after cells and ghosts: the mean of the cells, each with its share of the
 * face's transmissibility. It must be up to date whenever its neighbour is looked at.
 */
REAL4 mean_beyond(const int q, __global const int *restrict start, __global const int *restrict cell,
                  __global const COND *restrict share, __global const REAL4 *x) {
    REAL4 mean = (REAL4)(0);
    for (int k = start[q]; k < start[q + 1]; k++) mean += share[k] * x[cell[k]];
    return mean;
}
