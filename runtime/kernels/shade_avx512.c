/* Re-lighting for AVX-512 with VBMI and VNNI. Built into every x86-64 program, called where the CPU has them. */
#include "runtime/kernels/vec_avx512.h"
#define ISA avx512
#include "runtime/kernels/shade_simd.h"
