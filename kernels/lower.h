/* lower.h -- the least of what many work-items find: numbers that are not negative are ordered as their bits. */
#ifdef DOUBLE
#pragma OPENCL EXTENSION cl_khr_int64_extended_atomics : enable
#define LOWER(place, value) atom_min((volatile __global ulong *)(place), as_ulong(value))
#else
#define LOWER(place, value) atomic_min((volatile __global uint *)(place), as_uint(value))
#endif
