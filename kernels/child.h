/* child.h -- the finer cells in an octant of a covered cell.
 *
 * An octant holds one cell, or none (-1); where a finer block is split it may hold several: -2 - k, where chain[2k] is
 * one of them and chain[2k + 1] what follows, a cell or another such number.
 */
int take_child(int *next, __global const int *restrict chain) {
    const int first = *next;
    *next = first >= 0 ? -1 : chain[2 * (-2 - first) + 1];
    return first >= 0 ? first : chain[2 * (-2 - first)];
}
