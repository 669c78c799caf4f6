/* CPU features and the mask that --cpu= sets. */
#ifndef ORIEL_CPU_H
#define ORIEL_CPU_H
#include "oriel/error.h"
enum { ORL_CPU_REF = 0, ORL_CPU_AVX2 = 1, ORL_CPU_NEON = 2, ORL_CPU_DOTPROD = 4, ORL_CPU_AVX512 = 8 };     /* AVX512: F, BW, CD, DQ, VL, VBMI and VNNI together */
unsigned orl_cpu_detect(void);
/* "auto", "ref", "avx2", "avx512", "neon", "dotprod": ORL_E_UNSUPPORTED if this machine or build has it not. */
orl_err orl_cpu_from_name(const char *name, unsigned *flags);
const char *orl_cpu_name(unsigned flags);
#endif
