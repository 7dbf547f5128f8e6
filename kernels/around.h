/* around.h -- the 27 finest cells around a cut cell, in 30 bytes.
 *
 * Cells are sorted by colour, then z, y, x: in a row along x the two beside the middle are of one colour and, where
 * both exist, one follows the other. So each of the 9 rows has two numbers, where its middle is and where its sides
 * begin, counted from the cell itself if of its colour, else from the cell as far behind the first of the other colour.
 * How these two differ changes little from row to row: but for the sign it is how many more cells of the other colour
 * lie before. So `near` has 16 bits for the middle of each row but the cell's own (first in the order of rows, x
 * fastest), then as many for that difference, the skew, then 8 for what each row's own difference has beside it, then
 * 27 bits that tell which cells there are. Numbers have an offset of half their range; what they lack on the widest
 * grids is in `far`, sides and middles of all rows, which else is null.
 */
#define NEAR 32768
#define CLOSE 128
#define ENTRIES 15 /* of 16 bits a cut cell */
#define SKEW 8
#define BITS 13

/* Where the numbers of the other colour count from; in any case a cell. */
int opposite(const int i, const int n_red, const int n) { return i < n_red ? min(i + n_red, n - 1) : i - n_red; }

/* Whether a row's middle is of the other colour. */
int is_odd(const int row) { return (row % 3 + row / 3) & 1; }

/* Where the number of a row's own difference is, among those of 8 bits. */
int close_at(const int row) { return 2 * (SKEW + 1) + row - (row > 4); }

/* The middle of a row around cell i, but for what is in `far`. */
int middle_of(const int row, const int c, const int i, const int n_red, const int n,
              __global const ushort *restrict around) {
    if (row == 4) return i;
    return (is_odd(row) ? opposite(i, n_red, n) : i) - NEAR + around[ENTRIES * (size_t)c + row - (row > 4)];
}

/* The cells around cell i, x fastest, and the cell itself for a 28th; any where there is none. Returns which exist. */
__attribute__((always_inline)) int cells_around(const int c, const int i, const int n_red, const int n,
                                                __global const ushort *restrict around,
                                                __global const int *restrict far, int at[28]) {
    __global const ushort *restrict entry = around + ENTRIES * (size_t)c;
    __global const uchar *restrict close = (__global const uchar *)entry;
    const int other = opposite(i, n_red, n), exist = entry[BITS] | entry[BITS + 1] << 16;
    const int across = other - i + entry[SKEW] - NEAR;
#pragma unroll
    for (int row = 0; row < 9; row++) {
        const int middle = middle_of(row, c, i, n_red, n, around);
        const int sides = middle + (is_odd(row) ? -across : across);
        at[3 * row] = row == 4 ? sides : sides - CLOSE + close[close_at(row)];
        at[3 * row + 1] = middle;
        if (far) {
            at[3 * row] += far[18 * (size_t)c + 2 * row];
            at[3 * row + 1] += far[18 * (size_t)c + 2 * row + 1];
        }
        at[3 * row + 2] = at[3 * row] + ((exist >> 3 * row) & (exist >> (3 * row + 2)) & 1);
    }
    at[27] = i;
    return exist;
}
