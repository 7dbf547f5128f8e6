/* pinning.h -- absorption of a coarse cell.
 *
 * A sliver that its boundary holds near zero must not hold its whole coarse cell there, as a plain sum would: that
 * moves the boundary inwards on every level. The coarse cell takes what its children take from a field of one after
 * two Jacobi relaxations, over that field's mean. Where the children take alike the sum is as good.
 */
#define ALIKE ((REAL)1.25) /* their mean over their least */

/* What one relaxation leaves of a field of one in cell i. */
REAL4 relaxed_once(const int i, __global const COND *restrict T, __global const REAL4 *restrict absorb) {
    COND all = 0;
    for (int f = 0; f < 6; f++) all += T[6 * i + f];
    return all / (all + absorb[i]);
}

/* What two leave, behind ghosts and junctions one; something even in a cell without open faces, to divide by. */
REAL4 relaxed_twice(const int i, const int n, __global const int *restrict nbr, __global const COND *restrict T,
                    __global const REAL4 *restrict absorb) {
    COND all = 0;
    REAL4 sum = (REAL4)(0);
    for (int f = 0; f < 6; f++) {
        const int j = nbr[6 * i + f];
        const COND t = T[6 * i + f];
        all += t;
        sum += j < n ? t * relaxed_once(j, T, absorb) : (REAL4)(t);
    }
    return fmax(sum / (all + absorb[i]), (REAL)1e-6);
}

REAL4 absorb_of_children(const int i, const int n_fine, __global const int *restrict child,
                         __global const int *restrict chain, __global const int *restrict nbr,
                         __global const COND *restrict T, __global const REAL4 *restrict absorb) {
    REAL4 least = (REAL4)(INFINITY), most = (REAL4)(0), sum = (REAL4)(0);
    int count = 0;
    for (int o = 0; o < 8; o++)
        for (int next = child[8 * i + o]; next != -1; count++) {
            const REAL4 own = absorb[take_child(&next, chain)];
            least = fmin(least, own);
            most = fmax(most, own);
            sum += own;
        }
    if (all(most == least)) return count * least; /* a leaf takes as much, to the last bit */
    if (!any(sum > ALIKE * count * least)) return sum;
    REAL4 taken = (REAL4)(0), field = (REAL4)(0);
    for (int o = 0; o < 8; o++)
        for (int next = child[8 * i + o]; next != -1;) {
            const int c = take_child(&next, chain);
            const REAL4 x = relaxed_twice(c, n_fine, nbr, T, absorb);
            taken += x * absorb[c];
            field += x;
        }
    return taken * count / field;
}
