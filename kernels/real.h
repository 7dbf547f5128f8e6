/* real.h -- the precision of the build: REAL is float or double, REAL4 its vector of four channels. */
#if defined(cl_khr_fp64)
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
#endif
#define GLUE_(a, b) a##b
#define GLUE(a, b) GLUE_(a, b)
#define REAL2 GLUE(REAL, 2)
#define REAL3 GLUE(REAL, 3)
#define REAL4 GLUE(REAL, 4)
#define REAL8 GLUE(REAL, 8)
#define convert_REAL2 GLUE(convert_, REAL2)
#define convert_REAL3 GLUE(convert_, REAL3)
#define convert_REAL4 GLUE(convert_, REAL4)

/* Three numbers side by side, the colour channels; the spare one repeats the third. Where a work-item has vectors of
 * its own, one load of four is faster than three; device.py leaves room for the number beyond the last.
 */
REAL4 colours(__global const REAL *values) {
#if LANES == 1
    return vload3(0, values).xyzz;
#else
    return vload4(0, values).xyzz;
#endif
}

REAL4 colours_at(const int i, __global const REAL *values) { return colours(values + 3 * (size_t)i); }

/* Three numbers side by side as a vector in space. */
REAL4 vector_at(const int i, __global const REAL *values) {
#if LANES == 1
    return (REAL4)(vload3(i, values), 0);
#else
    return (REAL4)(vload4(0, values + 3 * (size_t)i).xyz, 0);
#endif
}

/* A float's first 16 bits, rounded to nearest: its range and eight bits of its precision, in half the memory. */
ushort4 shorten(const REAL4 value) {
    const uint4 bits = as_uint4(convert_float4(value));
    return convert_ushort4((bits + 0x7fff + ((bits >> 16) & 1)) >> 16);
}

REAL4 lengthen(const ushort4 value) { return convert_REAL4(as_float4(convert_uint4(value) << 16)); }

REAL4 lengthened_at(const int i, __global const ushort *values) { return lengthen(vload3(i, values).xyzz); }
