/* lanes.h -- LANES values side by side, as many as the device's vectors hold: 1 where work-items are the lanes. */
#if LANES == 1
#define REALN REAL
#define INTN int
#define convert_REALN GLUE(convert_, REAL)
#define convert_INTN convert_int
#define SOME(mask) ((mask) != 0)
#define CHOOSE(no, yes, mask) ((mask) ? (yes) : (no)) /* select wants masks as wide as doubles */
#else
#define REALN GLUE(REAL, LANES)
#define INTN GLUE(int, LANES)
#define convert_REALN GLUE(convert_, REALN)
#define convert_INTN GLUE(convert_, INTN)
#define SOME(mask) any(mask)
#define CHOOSE(no, yes, mask) select(no, yes, mask)
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
