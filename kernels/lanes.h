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
