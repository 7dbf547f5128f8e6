/* weight.h -- weights of the prolongation to a black cell: shares of a whole, towards the outward neighbours along x, y
 * and z, and for a fourth which octant of its parent the cell is, x fastest. The rest of the whole is the parent's;
 * four divides it: linear interpolation is exact.
 */
#define WHOLE 252
