/* Re-lighting for AVX2. Built into every x86-64 program, called where the CPU has it. */
#include "runtime/kernels/vec_avx2.h"
#define ISA avx2
#include "runtime/kernels/shade_simd.h"
