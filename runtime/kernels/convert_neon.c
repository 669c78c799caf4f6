/* Conversion to RGB for aarch64: convert.h's arithmetic, 16 pixels a step, even and odd ones apart until they are bytes.
 * The kernels copy their table: bytes that are written through rgb could otherwise be part of it, and it would be read again at every step. */
#include <arm_neon.h>
#include "runtime/kernels/convert.h"

#define INLINE static inline __attribute__((always_inline))

typedef struct { int32x4_t low, high; } sums;

INLINE int16x8_t wide(uint8x8_t v) { return vreinterpretq_s16_u16(vmovl_u8(v)); }

/* What chroma adds to channel c of 8 pixels or pairs. */
INLINE sums chroma(const orl_yuv_tab *t, int c, int16x8_t a, int16x8_t b)
{
    int32x4_t add = vdupq_n_s32(t->add[c]);
    if (c == 2) { a = vshlq_n_s16(a, 1); b = vshlq_n_s16(b, 1); }
    return (sums) { vmlal_n_s16(vmlal_n_s16(add, vget_low_s16(a), t->c[c][0]), vget_low_s16(b), t->c[c][1]), vmlal_high_n_s16(vmlal_high_n_s16(add, a, t->c[c][0]), b, t->c[c][1]) };
}

INLINE uint16x8_t colour(const orl_yuv_tab *t, int16x8_t y, sums s)
{
    return vqshrun_high_n_s32(vqshrun_n_s32(vmlal_n_s16(s.low, vget_low_s16(y), t->y), 14), vmlal_high_n_s16(s.high, y, t->y), 14);
}

/* y0, y1: the pixels of 8 pairs; a, b: their chroma. */
INLINE void pairs(const orl_yuv_tab *t, uint8x8_t y0, uint8x8_t y1, uint8x8_t a, uint8x8_t b, uint8_t *rgb)
{
    const uint8x16_t in_order = { 0, 8, 1, 9, 2, 10, 3, 11, 4, 12, 5, 13, 6, 14, 7, 15 };
    uint8x16x3_t o;
    for (int c = 0; c < 3; c++) {
        sums s = chroma(t, c, wide(a), wide(b));
        o.val[c] = vqtbl1q_u8(vqmovn_high_u16(vqmovn_u16(colour(t, wide(y0), s)), colour(t, wide(y1), s)), in_order);
    }
    vst3q_u8(rgb, o);
}

void orl_convert_half_neon(const uint8_t *const p[3], const orl_yuv_tab *t, int n, uint8_t *rgb)
{
    const orl_yuv_tab k = *t;
    for (int i = 0; i < n; i += 16, rgb += 48) {
        uint8x8x2_t y = vld2_u8(p[0] + i);
        pairs(&k, y.val[0], y.val[1], vld1_u8(p[1] + i / 2), vld1_u8(p[2] + i / 2), rgb);
    }
}

void orl_convert_semi_neon(const uint8_t *const p[3], const orl_yuv_tab *t, int n, uint8_t *rgb)
{
    const orl_yuv_tab k = *t;
    for (int i = 0; i < n; i += 16, rgb += 48) {
        uint8x8x2_t y = vld2_u8(p[0] + i), c = vld2_u8(p[1] + i);
        pairs(&k, y.val[0], y.val[1], c.val[0], c.val[1], rgb);
    }
}

void orl_convert_full_neon(const uint8_t *const p[3], const orl_yuv_tab *t, int n, uint8_t *rgb)
{
    const orl_yuv_tab k = *t;
    for (int i = 0; i < n; i += 8, rgb += 24) {
        int16x8_t y = wide(vld1_u8(p[0] + i)), u = wide(vld1_u8(p[1] + i)), v = wide(vld1_u8(p[2] + i));
        uint8x8x3_t o = { { vqmovn_u16(colour(&k, y, chroma(&k, 0, u, v))), vqmovn_u16(colour(&k, y, chroma(&k, 1, u, v))), vqmovn_u16(colour(&k, y, chroma(&k, 2, u, v))) } };
        vst3_u8(rgb, o);
    }
}

void orl_convert_yuyv_neon(const uint8_t *const p[3], const orl_yuv_tab *t, int n, uint8_t *rgb)
{
    const orl_yuv_tab k = *t;
    for (int i = 0; i < n; i += 16, rgb += 48) {
        uint8x8x4_t v = vld4_u8(p[0] + 2 * i);
        pairs(&k, v.val[0], v.val[2], v.val[1], v.val[3], rgb);
    }
}

void orl_convert_uyvy_neon(const uint8_t *const p[3], const orl_yuv_tab *t, int n, uint8_t *rgb)
{
    const orl_yuv_tab k = *t;
    for (int i = 0; i < n; i += 16, rgb += 48) {
        uint8x8x4_t v = vld4_u8(p[0] + 2 * i);
        pairs(&k, v.val[1], v.val[3], v.val[0], v.val[2], rgb);
    }
}

void orl_convert_swap_neon(const uint8_t *const p[3], const orl_yuv_tab *t, int n, uint8_t *rgb)
{
    (void)t;
    for (int i = 0; i < 3 * n; i += 48) {
        uint8x16x3_t v = vld3q_u8(p[0] + i);
        uint8x16x3_t o = { { v.val[2], v.val[1], v.val[0] } };
        vst3q_u8(rgb + i, o);
    }
}
