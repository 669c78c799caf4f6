/* Shadow features by sdot, for aarch64 CPUs that have it: w = 128 hi + lo, so two sdots replace widening and eight 16-bit products. Arithmetic: shade.h. */
#include "runtime/kernels/lut_neon.h"

static int32x4_t dot4(const int8_t *phi, int8x16_t hi, int8x16_t lo)
{
    int32x4_t zero = vdupq_n_s32(0);
    int8x16_t a = vld1q_s8(phi), b = vld1q_s8(phi + 16);
    int32x4_t h = vpaddq_s32(vdotq_s32(zero, a, hi), vdotq_s32(zero, b, hi)), l = vpaddq_s32(vdotq_s32(zero, a, lo), vdotq_s32(zero, b, lo));
    return vaddq_s32(vshlq_n_s32(h, 7), l);
}

void orl_shadow_dotprod(const int8_t *phi, const orl_shade_tab *t, int n, int16_t *s)
{
    int8x16_t hi = vld1q_s8(t->phi_hi), lo = vld1q_s8(t->phi_lo);
    for (int i = 0; i < n; i += 8, phi += 64) sigmoid(t, dot4(phi, hi, lo), dot4(phi + 32, hi, lo), s + i);
}
