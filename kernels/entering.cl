/* entering.cl -- power that a beam brings through the surface, in a fixed order: the same bits every time. */
#include "real.h"
#include "tile.h"
#include "beam.h"
#include "position.h"

/* Partial sums of A (omega . n)- F_B over the cut cells [in units of F_B times the area of a cell's side]. */
// cost entering: 704R+640 B, 1500 flop
__kernel void entering(const int n, const REAL4 light, __global const ushort *restrict position,
                       __global const int *restrict cut_cell, __global const REAL4 *restrict boundary,
                       __global const REAL *restrict normal, __global const REAL *restrict F_B,
                       __global REAL4 *restrict partial) {
    __local REAL4 part[GROUP];
    REAL4 sum = (REAL4)(0);
    for (int c = first_of_tile(); c < end_of_tile(n); c += GROUP) {
        const REAL4 towards = beam_at(light, corner_of(cut_cell[c], position) + boundary[c]).towards;
        sum += fmax(dot(towards.xyz, vector_at(c, normal).xyz), (REAL)0) * colours_at(c, F_B);
    }
    sum_of_group(sum, part, partial + get_group_id(0));
}
