/* Re-lighting for NEON. */
#include "runtime/kernels/vec_neon.h"
#define ISA neon
#include "runtime/kernels/shade_simd.h"
