/* Dispatch: C first, overridden by what the CPU flags allow. */
#include "runtime/kernels/shade.h"

void orl_kernels_init(orl_kernels *k, unsigned cpu)
{
    *k = (orl_kernels){ orl_vis_ref, orl_shadow_ref, orl_shade_ref, orl_mix_ref };
#if defined(__x86_64__)
    if (cpu & ORL_CPU_AVX2) *k = (orl_kernels){ orl_vis_avx2, orl_shadow_avx2, orl_shade_avx2, orl_mix_avx2 };
#elif defined(__aarch64__)
    if (cpu & ORL_CPU_NEON) *k = (orl_kernels){ orl_vis_neon, orl_shadow_neon, orl_shade_neon, orl_mix_neon };
    if (cpu & ORL_CPU_DOTPROD) k->shadow = orl_shadow_dotprod;
#else
    (void)cpu;
#endif
}
