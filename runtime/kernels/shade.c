/* Dispatch: C first, overridden by what the CPU flags allow. */
#include "runtime/kernels/shade.h"
#include "runtime/numbers.h"

#define SET(isa) (orl_kernels){ orl_vis_##isa, orl_shadow_##isa, orl_shade_##isa, orl_warp_##isa, orl_mix_##isa }

void orl_kernels_init(orl_kernels *k, unsigned cpu)
{
    *k = SET(ref);
#if defined(__x86_64__)
    if (cpu & ORL_CPU_AVX2) *k = SET(avx2);
    if (cpu & ORL_CPU_AVX512) *k = SET(avx512);
#elif defined(__aarch64__)
    if (cpu & ORL_CPU_NEON) *k = SET(neon);
    if (cpu & ORL_CPU_DOTPROD) *k = SET(dotprod);
#else
    (void)cpu;
#endif
}
