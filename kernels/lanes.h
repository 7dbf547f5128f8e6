/* lanes.h -- LANES values side by side, as many as the device's vectors hold: 1 where work-items are the lanes. */
#if LANES == 1
#define REALN REAL
#define INTN int
#define convert_REALN GLUE(convert_, REAL)
#define convert_INTN convert_int
#define SOME(mask) ((mask) != 0)
#define CHOOSE(no, yes, mask) ((mask) ? (yes) : (no))
#else
#define REALN GLUE(REAL, LANES)
#define INTN GLUE(int, LANES)
#define convert_REALN GLUE(convert_, REALN)
#define convert_INTN GLUE(convert_, INTN)
#define SOME(mask) any(mask)
#define CHOOSE(no, yes, mask) select(no, yes, mask)
#endif
#if defined(DOUBLE) && LANES > 1
#define FOR_REALS(mask) GLUE(convert_long, LANES)(mask) /* select wants masks as wide as doubles */
#else
#define FOR_REALS(mask) (mask)
#endif

typedef union {
    REALN all;
    REAL at[LANES];
} Reals;

typedef union {
    INTN all;
    int at[LANES];
} Ints;

/* fmin and fmax without their care for NaN */
REALN lesser(const REALN a, const REALN b) { return CHOOSE(b, a, a < b); }
REALN greater(const REALN a, const REALN b) { return CHOOSE(b, a, a > b); }

/* What a table has at each of some places. */
static INTN gather(__global const int *restrict table, const INTN places) {
    Ints from, found;
    from.all = places;
#pragma unroll
    for (int l = 0; l < LANES; l++) found.at[l] = table[from.at[l]];
    return found.all;
}

static REALN gather_reals(__global const REAL *restrict table, const INTN places) {
    Ints from;
    Reals found;
    from.all = places;
#pragma unroll
    for (int l = 0; l < LANES; l++) found.at[l] = table[from.at[l]];
    return found.all;
}

/* The same of bytes, which no vector unit gathers one by one; their number is a multiple of four. */
static INTN gather_bytes(__global const uchar *restrict table, const INTN places) {
    return gather((__global const int *)table, places >> 2) >> 8 * (places & 3) & 255;
}

/* Four numbers side by side at each of some places: on wide vectors loaded whole and sorted, which takes less than four
 * gathers. */
static void gather_fours(__global const REAL4 *restrict table, const INTN places, REALN *found) {
#if LANES < 4
    for (int k = 0; k < 4; k++) found[k] = gather_reals((__global const REAL *)table, 4 * places + k);
#else
    typedef union {
        REALN all;
        REAL4 four[LANES / 4];
    } Fours;
    Fours sorted[4];
    Ints from;
    from.all = places;
#pragma unroll
    for (int l = 0; l < LANES; l += 4) {
        const REAL8 low = (REAL8)(table[from.at[l]], table[from.at[l + 1]]);
        const REAL8 high = (REAL8)(table[from.at[l + 2]], table[from.at[l + 3]]);
        sorted[0].four[l / 4] = (REAL4)(low.s04, high.s04);
        sorted[1].four[l / 4] = (REAL4)(low.s15, high.s15);
        sorted[2].four[l / 4] = (REAL4)(low.s26, high.s26);
        sorted[3].four[l / 4] = (REAL4)(low.s37, high.s37);
    }
#pragma unroll
    for (int k = 0; k < 4; k++) found[k] = sorted[k].all;
#endif
}
