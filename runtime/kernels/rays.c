/* Dispatch of rays: C first, overridden by what the CPU flags allow. */
#include "oriel/cpu.h"
#include "runtime/kernels/rays.h"

void orl_rays_march(const orl_scene *s, int n, int refine, unsigned cpu, orl_rays *r)
{
    void (*march)(const orl_scene *, int, int, orl_rays *) = orl_rays_march_ref;
    if (s->nbricks > ORL_RAY_BRICKS) cpu = ORL_CPU_REF;
#if defined(__x86_64__)
    if (cpu & ORL_CPU_AVX2) march = orl_rays_march_avx2;
    if (cpu & ORL_CPU_AVX512) march = orl_rays_march_avx512;
#elif defined(__aarch64__)
    if (cpu & ORL_CPU_NEON) march = orl_rays_march_neon;
#else
    (void)cpu;
#endif
    march(s, n, refine, r);
}
