/* rows.h -- coefficients that many cells of a level share where the medium is homogeneous: T and absorb are kept by
 * row, and cells know theirs. The first `last` rows of absorb are those of T, the last is for all other rows of T.
 */
#ifdef HETEROGENEOUS
#define ROW_OF(i, rows) (i)
#else
#define ROW_OF(i, rows) rows[i]
#endif
