/* cut.h -- how the clearance of cells tells cut ones to rays: CUT and a number below 64 (planes.cl). */
#define CUT 64
#define IS_CUT(kind) (((kind) & 192) == CUT)
