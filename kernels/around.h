/* around.h -- the 27 finest cells around a cut cell, in 40 bytes.
 *
 * Cells are sorted by colour, then z, y, x: in a row along x the two beside the middle are of one colour and, where
 * both exist, one follows the other. So each of the 9 rows has two numbers, where its sides begin and where its middle
 * is, counted from the cell itself if of its colour, else from the cell as far behind the first of the other colour;
 * and 27 bits tell which cells there are. Numbers have 16 bits and an offset of NEAR; what they lack on the widest
 * grids is in `far`, which else is null.
 */
#define NEAR 32768
#define ENTRIES 20 /* of 16 bits a cut cell: sides and middles of the rows, x fastest, and two for the bits */

/* Where the numbers of the other colour count from; in any case a cell. */
int opposite(const int i, const int n_red, const int n) { return i < n_red ? min(i + n_red, n - 1) : i - n_red; }

/* The cells around cell i, x fastest, and the cell itself for a 28th; any where there is none. Returns which exist. */
__attribute__((always_inline)) int cells_around(const int c, const int i, const int n_red, const int n,
                                                __global const ushort *restrict around,
                                                __global const short *restrict far, int at[28]) {
    __global const ushort *restrict entry = around + ENTRIES * (size_t)c;
    const int other = opposite(i, n_red, n), exist = entry[18] | entry[19] << 16;
#pragma unroll
    for (int row = 0; row < 9; row++) {
        const int like = (row % 3 + row / 3) & 1 ? other : i, unlike = (row % 3 + row / 3) & 1 ? i : other;
        at[3 * row] = unlike + entry[2 * row] - NEAR;
        at[3 * row + 1] = like + entry[2 * row + 1] - NEAR;
        if (far) {
            at[3 * row] += far[18 * (size_t)c + 2 * row] << 16;
            at[3 * row + 1] += far[18 * (size_t)c + 2 * row + 1] << 16;
        }
        at[3 * row + 2] = at[3 * row] + ((exist >> 3 * row) & (exist >> (3 * row + 2)) & 1);
    }
    at[27] = i;
    return exist;
}
