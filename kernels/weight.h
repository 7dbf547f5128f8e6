/* weight.h -- weights of the prolongation as shares of a whole, which four divides: linear interpolation is exact. */
#define WHOLE 252
