/* CPU features that kernels ask for. The only place beside the dispatch that looks at the architecture. */
#include "oriel/cpu.h"
#include <string.h>
#if defined(__aarch64__)
#include <asm/hwcap.h>
#include <sys/auxv.h>
#endif

unsigned orl_cpu_detect(void)
{
#if defined(__x86_64__)
    int avx512 = __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512cd") && __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl") && __builtin_cpu_supports("avx512vbmi") && __builtin_cpu_supports("avx512vnni");
    return __builtin_cpu_supports("avx2") ? ORL_CPU_AVX2 | (avx512 ? ORL_CPU_AVX512 : 0) : ORL_CPU_REF;
#elif defined(__aarch64__)
    return ORL_CPU_NEON | (getauxval(AT_HWCAP) & HWCAP_ASIMDDP ? ORL_CPU_DOTPROD : 0);
#else
    return ORL_CPU_REF;
#endif
}

static const struct { const char *name; unsigned flags; } names[] = {
    { "dotprod", ORL_CPU_NEON | ORL_CPU_DOTPROD }, { "neon", ORL_CPU_NEON }, { "avx512", ORL_CPU_AVX2 | ORL_CPU_AVX512 }, { "avx2", ORL_CPU_AVX2 }, { "ref", ORL_CPU_REF },     /* best first */
};

orl_err orl_cpu_from_name(const char *name, unsigned *flags)
{
    if (!strcmp(name, "auto")) { *flags = orl_cpu_detect(); return ORL_OK; }
    for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
        if (strcmp(name, names[i].name)) continue;
        if (names[i].flags & ~orl_cpu_detect()) return orl_fail(ORL_E_UNSUPPORTED, "--cpu=%s: this machine does not have it", name);
        *flags = names[i].flags;
        return ORL_OK;
    }
    return orl_fail(ORL_E_UNSUPPORTED, "--cpu=%s: not one of auto, ref, avx2, avx512, neon, dotprod", name);
}

const char *orl_cpu_name(unsigned flags)
{
    for (size_t i = 0; i < sizeof names / sizeof *names; i++) if ((flags & names[i].flags) == names[i].flags) return names[i].name;
    return "ref";
}
