/* rows.h -- T and absorb as the solve takes them: of three channels where the medium is heterogeneous; by row where it
 * is homogeneous and many cells of a level share theirs, each cell knowing its row. The first `last` rows of absorb are
 * those of T, the last is for all other rows of T.
 */
#define TWO_POINT \
    __global const int *restrict rows, const int last, __global const REAL *restrict T, \
        __global const SINK *restrict absorb

#ifdef HETEROGENEOUS
#define ROW_OF(i, rows) (i)
#define T_AT(T, face) colours_at(face, T)
#define SINK REAL
#define SINK_AT(absorb, row) colours_at(row, absorb)
#else
#define ROW_OF(i, rows) rows[i]
#define T_AT(T, face) T[face]
#define SINK REAL4
#define SINK_AT(absorb, row) absorb[row]
#endif
