/* Re-lighting for NEON: shade.h's arithmetic, 8 pixels a step. */
#include "runtime/kernels/lut_neon.h"

INLINE int16x8_t bytes_q15(const uint8_t *p)
{
    uint16x8_t v = vmovl_u8(vld1_u8(p));
    return vreinterpretq_s16_u16(vaddq_u16(vshlq_n_u16(v, 7), vshrq_n_u16(v, 1)));
}

/* In 16 bits: h is below 2^16; of a sun above that, the rest goes on top of what it is over h; t = (16 d)(2 20182) + 2^15 >> 16. */
void orl_vis_neon(const uint8_t *h0, const uint8_t *h1, const orl_vis_tab *t, int n, uint8_t *vis)
{
    int sun = t->sun < 0 ? 0 : t->sun > 65535 ? 65535 : t->sun, more = t->sun - 65535 < 0 ? 0 : t->sun - 65535 > ORL_VIS_SPAN ? ORL_VIS_SPAN : t->sun - 65535;
    const uint16x8_t low = vdupq_n_u16((uint16_t)sun), high = vdupq_n_u16((uint16_t)more), span = vdupq_n_u16(ORL_VIS_SPAN);
    for (int i = 0; i < n; i += 8) {
        uint16x8_t h = vmlaq_n_u16(vmulq_n_u16(vmovl_u8(vld1_u8(h0 + i)), (uint16_t)(256 - t->f)), vmovl_u8(vld1_u8(h1 + i)), (uint16_t)t->f);
        uint16x8_t d = vshlq_n_u16(vminq_u16(vqaddq_u16(vqsubq_u16(low, h), high), span), 4);
        uint16x4_t x0 = vrshrn_n_u32(vmull_n_u16(vget_low_u16(d), 2 * 20182), 16), x1 = vrshrn_n_u32(vmull_n_u16(vget_high_u16(d), 2 * 20182), 16);
        int16x8_t x = vreinterpretq_s16_u16(vcombine_u16(x0, x1)), q = vqrdmulhq_s16(x, x);
        uint16x8_t v = vreinterpretq_u16_s16(vqrdmulhq_s16(q, vsubq_s16(vdupq_n_s16(32767), x)));
        v = vaddq_u16(vaddq_u16(vreinterpretq_u16_s16(q), vdupq_n_u16(64)), vaddq_u16(v, v));
        vst1_u8(vis + i, vqmovn_u16(vshrq_n_u16(v, 7)));
    }
}

INLINE int32x4_t dot4(const int8_t *phi, int16x8_t w)
{
    int32x4_t m[4];
    for (int k = 0; k < 4; k++) {
        int16x8_t v = vmovl_s8(vld1_s8(phi + 8 * k));
        m[k] = vmlal_high_s16(vmull_s16(vget_low_s16(v), vget_low_s16(w)), v, w);
    }
    return vpaddq_s32(vpaddq_s32(m[0], m[1]), vpaddq_s32(m[2], m[3]));
}

void orl_shadow_neon(const int8_t *phi, const orl_shade_tab *t, int n, int16_t *s)
{
    int16x8_t w = vld1q_s16(t->phi_w);
    for (int i = 0; i < n; i += 8, phi += 64) sigmoid(t, dot4(phi, w), dot4(phi + 32, w), s + i);
}

/* Irradiance of 8 pixels, channels side by side, then planes. */
INLINE void irradiance(const uint16_t *normal, const orl_shade_tab *t, int16x8_t vis, int16x8_t open, int16x8_t e[3])
{
    int16_t a[8], b[8], rgb[8][4];
    vst1q_s16(a, vis);
    vst1q_s16(b, open);
    for (int i = 0; i < 8; i++) {
        const int16_t *pal = t->pal[normal[i]];
        int16x4_t m = vqadd_s16(vqrdmulh_s16(vld1_s16(pal), vdup_n_s16(a[i])), vqrdmulh_s16(vld1_s16(pal + 4), vdup_n_s16(b[i])));
        vst1_s16(rgb[i], vqadd_s16(m, vld1_s16(pal + 8)));
    }
    int16x8x4_t v = vld4q_s16(rgb[0]);
    for (int c = 0; c < 3; c++) e[c] = v.val[c];
}

INLINE uint32x4_t float_bits(uint32x4_t q, int32x4_t shift)
{
    q = vmaxq_u32(vminq_u32(vrshlq_u32(q, shift), vdupq_n_u32(0xffffff)), vdupq_n_u32(1));
    return vreinterpretq_u32_f32(vcvtq_f32_u32(q));                     /* exact: q < 2^24 */
}

INLINE int16x8_t encode(const uint16_t *albedo, int16x8_t e, const orl_shade_tab *t, int32x4_t shift)
{
    uint16x8_t a = vld1q_u16(albedo), u = vreinterpretq_u16_s16(e);
    uint32x4_t lo = float_bits(vmull_u16(vget_low_u16(a), vget_low_u16(u)), shift), hi = float_bits(vmull_high_u16(a, u), shift);
    uint16x8_t knot = vsubq_u16(vcombine_u16(vshrn_n_u32(vshrq_n_u32(lo, 4), 15), vshrn_n_u32(vshrq_n_u32(hi, 4), 15)), vdupq_n_u16(127 << 4));
    uint16x8_t f = vandq_u16(vcombine_u16(vshrn_n_u32(lo, 4), vshrn_n_u32(hi, 4)), vdupq_n_u16(0x7fff));
    return lut(t->encode, knot, vreinterpretq_s16_u16(f));
}

INLINE uint8x8_t tone(const int16x8_t p[3], const int16_t a[4], int32_t b)
{
    int32x4_t lo = vdupq_n_s32(b), hi = lo;
    for (int k = 0; k < 3; k++) {
        lo = vmlal_n_s16(lo, vget_low_s16(p[k]), a[k]);
        hi = vmlal_high_n_s16(hi, p[k], a[k]);
    }
    return vqmovun_s16(vcombine_s16(vqmovn_s32(vshrq_n_s32(lo, 17)), vqmovn_s32(vshrq_n_s32(hi, 17))));
}

void orl_shade_neon(const orl_shade_in *in, const orl_shade_tab *t, int n, uint8_t *rgb)
{
    static const int16_t lanes[8] = { 0, 1, 2, 3, 4, 5, 6, 7 };
    int32x4_t shift = vdupq_n_s32(-t->colour_shift);
    int16x8_t lane = vld1q_s16(lanes), up = vdupq_n_s16((int16_t)(15 - in->sky_log2));
    int mask = (1 << in->sky_log2) - 1;
    for (int i = 0; i < n; i += 8, rgb += 24) {
        const int16_t *sky = in->sky[(in->x + i) >> in->sky_log2];
        int16x8_t ramp = vshlq_s16(vaddq_s16(vdupq_n_s16((int16_t)((in->x + i) & mask)), lane), up), p[3];
        for (int c = 0; c < 3; c++) p[c] = vaddq_s16(vdupq_n_s16(sky[c]), vqrdmulhq_s16(vdupq_n_s16((int16_t)(sky[4 + c] - sky[c])), ramp));
        if (vmaxv_u8(vld1_u8(in->cov + i))) {
            int16x8_t cov = bytes_q15(in->cov + i), s = vld1q_s16(in->s + i), e[3];
            irradiance(in->normal + i, t, bytes_q15(in->vis + i), bytes_q15(in->open + i), e);
            for (int c = 0; c < 3; c++) p[c] = vaddq_s16(p[c], vqrdmulhq_s16(vsubq_s16(encode(in->albedo[c] + i, vqrdmulhq_s16(e[c], s), t, shift), p[c]), cov));
        }
        uint8x8x3_t out = { { tone(p, t->tone[0], t->tone_b[0]), tone(p, t->tone[1], t->tone_b[1]), tone(p, t->tone[2], t->tone_b[2]) } };
        vst3_u8(rgb, out);
    }
}

void orl_mix_neon(const orl_mix_in *in, int n, uint8_t *rgb)
{
    for (int i = 0; i < n; i += ORL_MIX_STEP, rgb += 24) {
        const int16_t (*a)[2] = in->cell[in->cell_of[i / ORL_MIX_STEP]], (*b)[2] = a + 3;
        int16x8_t share = vld1q_s16(in->share + i), layer = bytes_q15(in->layer + i);
        uint8x8_t w = vld1_u8(in->weight + i), rest = vmvn_u8(w);
        uint8x8x3_t was = vld3_u8(rgb), photo = vld3_u8(in->photo + 3 * i);
        for (int c = 0; c < 3; c++) {               /* vqdmulh: 2 x y >> 16 */
            int16x8_t sky = vaddq_s16(vdupq_n_s16(a[c][0]), vqdmulhq_s16(vdupq_n_s16((int16_t)(b[c][0] - a[c][0])), share));
            int16x8_t stone = vaddq_s16(vdupq_n_s16(a[c][1]), vqdmulhq_s16(vdupq_n_s16((int16_t)(b[c][1] - a[c][1])), share));
            int16x8_t add = vaddq_s16(sky, vqdmulhq_s16(vsubq_s16(stone, sky), layer));
            uint8x8_t r = vqmovun_s16(vaddq_s16(vreinterpretq_s16_u16(vmovl_u8(was.val[c])), vshrq_n_s16(vaddq_s16(add, vdupq_n_s16(16)), 5)));
            uint16x8_t m = vaddq_u16(vmlal_u8(vmull_u8(photo.val[c], w), r, rest), vdupq_n_u16(128));
            was.val[c] = vshrn_n_u16(vaddq_u16(m, vshrq_n_u16(m, 8)), 8);
        }
        vst3_u8(rgb, was);
    }
}
