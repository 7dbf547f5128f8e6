/* samples.h -- the 27 half-cell samples of signed distance of one cell, x fastest. */

/* Gather the 27 samples of a cell from the nodes that it and its upper neighbours own. */
void gather_samples(const int i, __global const int *restrict owners, __global const REAL *restrict distance,
                    REAL *restrict f) {
    for (int c = 0; c < 3; c++)
        for (int b = 0; b < 3; b++)
            for (int a = 0; a < 3; a++)
                f[(c * 3 + b) * 3 + a] = distance[owners[8 * i + (c >> 1) * 4 + (b >> 1) * 2 + (a >> 1)] * 8 +
                                                  (c & 1) * 4 + (b & 1) * 2 + (a & 1)];
}
