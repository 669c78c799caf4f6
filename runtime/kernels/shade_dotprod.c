/* Re-lighting for NEON with the dot product, which the shadow features take. */
#define WITH_DOTPROD
#include "runtime/kernels/vec_neon.h"
#define ISA dotprod
#include "runtime/kernels/shade_simd.h"
