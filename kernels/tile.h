/* tile.h -- sums over a field by work-groups, each of a tile of consecutive cells. Needs real.h. */
#define GROUP 64
#define CELLS_PER_ITEM 64

int first_of_tile(void) { return get_group_id(0) * GROUP * CELLS_PER_ITEM + get_local_id(0); }

int end_of_tile(const int n) { return min(n, (int)(get_group_id(0) + 1) * GROUP * CELLS_PER_ITEM); }

/* Sum of a work-group's values, in the order of its items. */
void sum_of_group(const REAL4 value, __local REAL4 *restrict part, __global REAL4 *restrict out) {
    barrier(CLK_LOCAL_MEM_FENCE);
    part[get_local_id(0)] = value;
    barrier(CLK_LOCAL_MEM_FENCE);
    if (get_local_id(0) > 0) return;
    REAL4 sum = (REAL4)(0);
    for (int k = 0; k < GROUP; k++) sum += part[k];
    *out = sum;
}
