/* fetch.h -- asks for what a later work-item reads. On CPUs one comes after the other, and on large grids each waits
 * for loads that follow no order. OpenCL's own prefetch would say the same, but PoCL leaves it out.
 */
#define AHEAD 16 /* work-items */

#if LANES > 1 && defined(__has_builtin)
#if __has_builtin(__builtin_prefetch)
#define FETCH(address) __builtin_prefetch((__private const void *)(uintptr_t)(address))
#endif
#endif
#ifndef FETCH
#define FETCH(address)
#endif
