/* conductance.h -- homogeneous media scale the equation by 1/D, so that transmissibilities are one number for all
 * channels; heterogeneous ones keep one for each.
 *
 *     homogeneous:    T = area / distance,            absorb = (sigma_a V + C_B) / D
 *     heterogeneous:  T = area / (d_i/D_i + d_j/D_j), absorb =  sigma_a V + C_B
 */
#ifdef HETEROGENEOUS
#define COND REAL4
#define MEDIUM __global const REAL *restrict
#define AT(value, i) colours_at(i, value)
#define MEAN(t) (((t).x + (t).y + (t).z) / 3)
#define SCALE(value, D) (value)
#else
#define COND REAL
#define MEDIUM const REAL4
#define AT(value, i) value
#define MEAN(t) (t)
#define SCALE(value, D) ((value) / (D))
#endif

/* (k h)^2 as far as it is fitted (layer.h): of a heterogeneous medium only where it is somewhere. */
#if defined(HETEROGENEOUS) && !defined(FITTED)
#define FITTED_AT(fitted, i) ((REAL4)(0))
#else
#define FITTED_AT(fitted, i) AT(fitted, i)
#endif
