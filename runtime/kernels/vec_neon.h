/* 8 lanes of 16 bits for aarch64 NEON: what shade_simd.h asks for. Orders and saturations as shade.h has them. With WITH_DOTPROD the features' sums take sdot. */
#ifndef RUNTIME_KERNELS_VEC_NEON_H
#define RUNTIME_KERNELS_VEC_NEON_H
#include <arm_neon.h>
#include <string.h>
#include "runtime/kernels/shade.h"

#define INLINE static inline __attribute__((always_inline))
#define LANES 8
typedef int16x8_t vec;
#define U(v) vreinterpretq_u16_s16(v)
#define S(v) vreinterpretq_s16_u16(v)

INLINE vec set1(int v) { return vdupq_n_s16((int16_t)v); }
INLINE vec lanes(void)
{
    static const int16_t n[LANES] = { 0, 1, 2, 3, 4, 5, 6, 7 };
    return vld1q_s16(n);
}
INLINE vec load(const int16_t *p) { return vld1q_s16(p); }
INLINE vec load_u8(const uint8_t *p) { return S(vmovl_u8(vld1_u8(p))); }
INLINE vec load_i8(const int8_t *p) { return vmovl_s8(vld1_s8(p)); }
INLINE vec load_high(const int8_t *p) { return vshll_n_s8(vld1_s8(p), 8); }             /* times 256 */
INLINE vec load_part(const uint8_t *p) { return S(vshll_n_u8(vld1_u8(p), 7)); }
INLINE void store(int16_t *p, vec v) { vst1q_s16(p, v); }

INLINE vec add(vec a, vec b) { return vaddq_s16(a, b); }
INLINE vec sub(vec a, vec b) { return vsubq_s16(a, b); }
INLINE vec adds(vec a, vec b) { return vqaddq_s16(a, b); }
INLINE vec addu(vec a, vec b) { return S(vqaddq_u16(U(a), U(b))); }
INLINE vec subu(vec a, vec b) { return S(vqsubq_u16(U(a), U(b))); }
INLINE vec mul(vec a, vec b) { return vqrdmulhq_s16(a, b); }
INLINE vec part(vec v, vec b) { return vqdmulhq_s16(v, b); }                            /* v by load_part, b not negative */
INLINE vec mullo(vec a, vec b) { return vmulq_s16(a, b); }
INLINE vec min(vec a, vec b) { return vminq_s16(a, b); }
INLINE vec max(vec a, vec b) { return vmaxq_s16(a, b); }
INLINE vec minu(vec a, vec b) { return S(vminq_u16(U(a), U(b))); }
INLINE vec and(vec a, vec b) { return vandq_s16(a, b); }
#define shl(v, n) vshlq_n_s16(v, n)
#define shr(v, n) S(vshrq_n_u16(U(v), n))
INLINE vec shl_by(vec v, int n) { return vshlq_s16(v, set1(n)); }
INLINE vec sar_by(vec v, int n) { return vshlq_s16(v, set1(-n)); }

INLINE vec where_greater(vec a, vec b, vec yes, vec no) { return vbslq_s16(vcgtq_s16(a, b), yes, no); }
INLINE int any(vec v) { return vmaxvq_s16(v) != 0; }                                    /* of bytes, as the next two */
INLINE int all_255(vec v) { return vminvq_s16(v) == 255; }
INLINE vec where_255(vec v, vec yes, vec no) { return vbslq_s16(vceqq_s16(v, set1(255)), yes, no); }

/* Tables of 16 words, by byte: word i is bytes 2 i and 2 i + 1. */
typedef uint8x16x2_t table;
typedef uint8x16_t picker;
INLINE table table_of(const int16_t t[16]) { return (table){ { vld1q_u8((const uint8_t *)t), vld1q_u8((const uint8_t *)(t + 8)) } }; }
INLINE picker picker_of(vec i) { return vreinterpretq_u8_s16(vmlaq_n_s16(set1(0x0100), i, 0x0202)); }
INLINE vec pick(table t, picker at) { return vreinterpretq_s16_u8(vqtbl2q_u8(t, at)); }

/* Of 2 .. 32767: what a table holds for its log2, and what is below the leading bit, less 2^15. */
typedef table power_table;
typedef struct { vec zeros, rest; } power;
INLINE power_table power_table_of(const int16_t t[16])
{
    int16_t by_zeros[16] = { 0 };
    for (int log = 1; log < 15; log++) by_zeros[15 - log] = t[log - 1];
    return table_of(by_zeros);
}
INLINE power power_of(vec v)
{
    vec zeros = vclzq_s16(v);                                                           /* 15 - log */
    return (power){ zeros, vshlq_s16(v, zeros) };
}
INLINE vec pick_power(power_table t, power p) { return pick(t, picker_of(p.zeros)); }

/* The node of LANES columns from x on. */
INLINE vec nodes(const int16_t *p, int x, int log2) { return vld1q_dup_s16(p + (x >> log2)); }

#ifdef WITH_DOTPROD
typedef struct { int8x16_t hi[2], lo[2]; int32x4_t shift, bias; } phi_weights;
INLINE phi_weights phi_weights_of(const orl_shade_tab *t)
{
    phi_weights w = { .shift = vdupq_n_s32(-t->phi_shift), .bias = vdupq_n_s32(t->phi_bias) };
    for (int g = 0; g < 2; g++) {
        w.hi[g] = vreinterpretq_s8_s32(vld1q_dup_s32((const int32_t *)(t->phi_hi + 4 * g)));
        w.lo[g] = vreinterpretq_s8_s32(vld1q_dup_s32((const int32_t *)(t->phi_lo + 4 * g)));
    }
    return w;
}
INLINE int32x4_t phi_four(const int8_t *a, const int8_t *b, const phi_weights *w)
{
    int8x16_t pa = vld1q_s8(a), pb = vld1q_s8(b);
    int32x4_t zero = vdupq_n_s32(0), hi = vdotq_s32(vdotq_s32(zero, pa, w->hi[0]), pb, w->hi[1]);
    return vdotq_s32(vdotq_s32(vshlq_n_s32(hi, 7), pa, w->lo[0]), pb, w->lo[1]);
}
#else
typedef struct { int16x4_t w[2]; int32x4_t shift, bias; } phi_weights;
INLINE phi_weights phi_weights_of(const orl_shade_tab *t)
{
    phi_weights w = { .shift = vdupq_n_s32(-t->phi_shift), .bias = vdupq_n_s32(t->phi_bias) };
    for (int g = 0; g < 2; g++) {
        int16_t v[4];
        for (int k = 0; k < 4; k++) v[k] = (int16_t)(128 * t->phi_hi[4 * g + k] + t->phi_lo[4 * g + k]);
        w.w[g] = vld1_s16(v);
    }
    return w;
}
INLINE int32x4_t phi_four(const int8_t *a, const int8_t *b, const phi_weights *w)
{
    int32x4_t m[4];
    for (int k = 0; k < 2; k++) {
        vec pa = load_i8(a + 8 * k), pb = load_i8(b + 8 * k);
        m[2 * k] = vmlal_s16(vmull_s16(vget_low_s16(pa), w->w[0]), vget_low_s16(pb), w->w[1]);
        m[2 * k + 1] = vmlal_s16(vmull_s16(vget_high_s16(pa), w->w[0]), vget_high_s16(pb), w->w[1]);
    }
    return vpaddq_s32(vpaddq_s32(m[0], m[1]), vpaddq_s32(m[2], m[3]));
}
#endif
INLINE vec phi_sum(const int8_t *a, const int8_t *b, const phi_weights *w)
{
    int32x4_t x0 = vaddq_s32(vrshlq_s32(phi_four(a, b, w), w->shift), w->bias), x1 = vaddq_s32(vrshlq_s32(phi_four(a + 16, b + 16, w), w->shift), w->bias);
    return max(vcombine_s16(vqmovn_s32(x0), vqmovn_s32(x1)), set1(0));
}

/* A vector is half of what the warp takes. */
typedef vec half;
#define half_set1 set1
#define half_load load
#define half_add add
#define half_mul mul
#define half_mullo mullo
#define half_shr shr
#define half_pixels load_u8
#define half_down(v, n) vextq_s16(v, vdupq_n_s16(0), n)
#define half_up(v, n) vextq_s16(vdupq_n_s16(0), v, 8 - (n))

typedef int16x8x2_t pair;
INLINE pair pair_set1(int v) { return (pair){ { set1(v), set1(v) } }; }
INLINE pair pair_load(const int16_t *p) { return (pair){ { load(p), load(p + 8) } }; }
INLINE pair pair_pixels(const uint8_t *p) { return (pair){ { load_u8(p), load_u8(p + 8) } }; }
INLINE pair pair_add(pair a, pair b) { return (pair){ { add(a.val[0], b.val[0]), add(a.val[1], b.val[1]) } }; }
INLINE pair pair_mul(pair a, pair b) { return (pair){ { mul(a.val[0], b.val[0]), mul(a.val[1], b.val[1]) } }; }
INLINE pair pair_mullo(pair a, pair b) { return (pair){ { mullo(a.val[0], b.val[0]), mullo(a.val[1], b.val[1]) } }; }
#define pair_shr(v, n) ((pair){ { shr((v).val[0], n), shr((v).val[1], n) } })
INLINE half pair_low(pair v) { return v.val[0]; }
INLINE half pair_high(pair v) { return v.val[1]; }

INLINE void half_store_rgb(uint8_t *p, half v, int last)           /* v >> 7; but for the last, a byte more */
{
    uint32_t rgb = vget_lane_u32(vreinterpret_u32_u8(vqshrn_n_u16(U(v), 7)), 0);
    if (last) memcpy(p, &rgb, 3);
    else memcpy(p, &rgb, 4);
}

INLINE void load_rgb(const uint8_t *p, vec c[3])
{
    uint8x8x3_t v = vld3_u8(p);
    for (int k = 0; k < 3; k++) c[k] = S(vmovl_u8(v.val[k]));
}
INLINE void store_rgb(uint8_t *p, const vec c[3]) { vst3_u8(p, (uint8x8x3_t){ { vqmovun_s16(c[0]), vqmovun_s16(c[1]), vqmovun_s16(c[2]) } }); }
#endif
