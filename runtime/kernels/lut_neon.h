/* Table look-ups shared by the aarch64 kernels. */
#ifndef RUNTIME_KERNELS_LUT_NEON_H
#define RUNTIME_KERNELS_LUT_NEON_H
#include <arm_neon.h>
#include "runtime/kernels/shade.h"

#define INLINE static inline __attribute__((always_inline))

/* base + mul(delta, f) for 8 knots. */
INLINE int16x8_t lut(const orl_lut *t, uint16x8_t knot, int16x8_t f)
{
    uint16_t k[8];
    orl_lut got[8];
    vst1q_u16(k, knot);
    for (int i = 0; i < 8; i++) got[i] = t[k[i]];
    int16x8x2_t v = vld2q_s16(&got[0].base);
    return vaddq_s16(v.val[0], vqrdmulhq_s16(v.val[1], f));
}

/* Two times four sums of products -> s. */
INLINE void sigmoid(const orl_shade_tab *t, int32x4_t a, int32x4_t b, int16_t *s)
{
    int32x4_t shift = vdupq_n_s32(-t->phi_shift), bias = vdupq_n_s32(t->phi_bias), zero = vdupq_n_s32(0), top = vdupq_n_s32(32767);
    a = vminq_s32(vmaxq_s32(vaddq_s32(vrshlq_s32(a, shift), bias), zero), top);
    b = vminq_s32(vmaxq_s32(vaddq_s32(vrshlq_s32(b, shift), bias), zero), top);
    uint16x8_t x = vreinterpretq_u16_s16(vcombine_s16(vmovn_s32(a), vmovn_s32(b)));
    vst1q_s16(s, lut(t->sigmoid, vshrq_n_u16(x, 7), vreinterpretq_s16_u16(vshlq_n_u16(vandq_u16(x, vdupq_n_u16(127)), 8))));
}
#endif
