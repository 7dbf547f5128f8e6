/* fused.cl -- a whole V-cycle on the levels of few cells, by one work-group: a launch would cost more than its cells.
 *
 * Steps follow one another with a barrier in between; within a step no item needs another's. A step is its kind, its
 * level, its first cell (or ghost, covered cell, leaf with finer neighbours) and how many there are (fused.py).
 */
#include "real.h"
#include "conductance.h"
#include "rows.h"
#include "cycle.h"

enum {
    CLEAR, FROM_ZERO, RELAX, OVER_RELAX, FILL_JUNCTIONS, REFLUX, LEAVE_RESIDUAL, RESTRICT, COPY_GHOSTS, PROLONG, SOLVE
};

/* Where a level's rows start in e and r, and its arrays in `words`, in words of four bytes. */
typedef struct {
    int n, first_junction, e, r, last, nbr, parent, covered, child, chain, ghost_face, interface, interface_start,
        junction_start, junction_cell, rows, T, absorb, share, weight, inverse;
} FusedLevel;

#define INTS(at) (words + (at))
#define REALS(at) ((__global const REAL *)(words + (at)))
#define OPERATOR(level) \
    INTS(level.rows), level.last, REALS(level.T), (__global const SINK *)(words + level.absorb)
#define EACH(i) int i = now.z + get_local_id(0); i < now.z + now.w; i += get_local_size(0)

// cost fused_v_cycle: 252R+39C+182 B, 440 flop
__kernel void fused_v_cycle(const int n_steps, const REAL over, __global const int4 *restrict step,
                            __global const FusedLevel *restrict level, __global const int *restrict words,
                            __global REAL *r, __global REAL4 *e) {
    for (int s = 0; s < n_steps; s++) {
        const int4 now = step[s];
        const FusedLevel fine = level[now.y], coarse = level[max(now.y - 1, 0)];
        __global REAL4 *x = e + fine.e, *x_coarse = e + coarse.e;
        __global REAL *b = r + 3 * fine.r, *b_coarse = r + 3 * coarse.r;
        switch (now.x) {
        case CLEAR: /* ghosts, and rows that no cell has */
            for (EACH(i)) x[i] = (REAL4)(0);
            break;
        case FROM_ZERO:
            for (EACH(i)) x[i] = relaxed_from_zero(i, over, OPERATOR(fine), b);
            break;
        case RELAX:
        case OVER_RELAX:
            for (EACH(i)) x[i] = relaxed(i, now.x == RELAX ? 1 : over, INTS(fine.nbr), OPERATOR(fine), b, x);
            break;
        case FILL_JUNCTIONS:
            for (EACH(q))
                x[fine.first_junction + q] = mean_beyond(q, INTS(fine.junction_start), INTS(fine.junction_cell),
                                                 (__global const COND *)(words + fine.share), x);
            break;
        case REFLUX:
            for (EACH(m))
                vstore3(refluxed(m, fine.n, INTS(coarse.interface), INTS(coarse.interface_start),
                                 INTS(fine.ghost_face), INTS(fine.rows), REALS(fine.T), x, b_coarse).xyz,
                        INTS(coarse.interface)[m], b_coarse);
            break;
        case LEAVE_RESIDUAL:
            for (EACH(i)) x[i] = residual_at(i, INTS(fine.nbr), OPERATOR(fine), b, x);
            break;
        case RESTRICT:
            for (EACH(c))
                vstore3(sum_of_red(c, INTS(coarse.child), INTS(coarse.chain), x).xyz, INTS(coarse.covered)[c],
                        b_coarse);
            break;
        case COPY_GHOSTS:
            for (EACH(k)) x[fine.n + k] = x_coarse[INTS(fine.parent)[fine.n + k]];
            break;
        case PROLONG:
            for (EACH(i))
                x[i] = prolonged(i, ((__global const uchar4 *)(words + fine.weight))[i - now.z], INTS(fine.nbr),
                                 INTS(fine.parent), x_coarse, x);
            break;
        case SOLVE:
            for (EACH(i)) x[i] = solved_directly(i, fine.n, (__global const REAL4 *)(words + fine.inverse), b);
            break;
        }
        barrier(CLK_GLOBAL_MEM_FENCE);
    }
}
