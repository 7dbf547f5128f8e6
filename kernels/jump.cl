/* jump.cl -- transmissibilities of links along which D jumps (jumps.py). */
#include "real.h"

// cost cross_jumps: 24R+8 B, 8 flop
__kernel void cross_jumps(const int n, __global const int *restrict face, __global const REAL4 *restrict share,
                          __global REAL4 *restrict T) {
    const int m = get_global_id(0);
    if (m >= n) return;
    T[face[2 * m]] *= share[m];
    T[face[2 * m + 1]] *= share[m];
}
