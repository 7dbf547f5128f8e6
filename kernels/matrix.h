/* matrix.h -- sparse matrices by rows, and their products with colours. Needs real.h.
 *
 * A row has `width` entries, or as many as `start` says; of each its column, in 16 bits or in 32, and a number. Entries
 * are numbers times the row's unit; where there are no units, rows sum to one, and their numbers to PARTS.
 */
#define PARTS 65535

typedef struct {
    int width;
    __global const int *restrict start;
    __global const ushort *restrict narrow;
    __global const int *restrict wide;
    __global const ushort *restrict number;
    __global const REAL *restrict unit;
} Matrix;

#define PLACES(m) \
    const int m##_width, __global const int *restrict m##_start, __global const ushort *restrict m##_narrow, \
        __global const int *restrict m##_wide
#define MATRIX(m) PLACES(m), __global const ushort *restrict m##_number, __global const REAL *restrict m##_unit
#define MATRIX_OF(m) ((Matrix){m##_width, m##_start, m##_narrow, m##_wide, m##_number, m##_unit})
#define PLACES_OF(m) ((Matrix){m##_width, m##_start, m##_narrow, m##_wide, 0, 0})

int first_of_row(const int i, const Matrix m) { return m.start ? m.start[i] : i * m.width; }

int end_of_row(const int i, const Matrix m) { return m.start ? m.start[i + 1] : (i + 1) * m.width; }

int column_of(const int k, const Matrix m) { return m.narrow ? m.narrow[k] : m.wide[k]; }

REAL unit_of_row(const int i, __global const REAL *restrict unit) { return unit ? unit[i] : (REAL)1 / PARTS; }

/* One number as a vector: spread first, it converts at once. */
REAL4 spread(const ushort number) { return convert_REAL4((int4)(number)); }

/* A row times x. */
REAL4 row_times(const int i, const Matrix m, __global const REAL *restrict x) {
    const int first = first_of_row(i, m), end = end_of_row(i, m);
    REAL4 sum = (REAL4)(0);
    for (int k = first; k < end; k++) sum += spread(m.number[k]) * colours_at(column_of(k, m), x);
    return unit_of_row(i, m.unit) * sum;
}
