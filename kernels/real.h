/* real.h -- the precision of the build: REAL is float or double, REAL4 its vector of four channels. */
#if defined(cl_khr_fp64)
#pragma OPENCL EXTENSION cl_khr_fp64 : enable
#endif
#define GLUE_(a, b) a##b
#define GLUE(a, b) GLUE_(a, b)
#define REAL2 GLUE(REAL, 2)
#define REAL4 GLUE(REAL, 4)
#define REAL8 GLUE(REAL, 8)
#define convert_REAL4 GLUE(convert_, REAL4)
