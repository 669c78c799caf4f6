/* Re-lighting for AVX2: shade.h's arithmetic, 16 pixels a step. Built into every x86-64 program, called where the CPU has it. */
#include <immintrin.h>
#include <string.h>
#include "runtime/kernels/shade.h"

#define INLINE static inline __attribute__((always_inline))

INLINE __m256i load(const void *p) { return _mm256_loadu_si256((const __m256i *)p); }
INLINE __m256i bytes_q15(const uint8_t *p)
{
    __m256i v = _mm256_cvtepu8_epi16(_mm_loadu_si128((const __m128i *)p));
    return _mm256_add_epi16(_mm256_slli_epi16(v, 7), _mm256_srli_epi16(v, 1));
}

/* base + mul(delta, f) for 16 entries. lo and hi hold knot indices, f the fractions, all in the same lane order, which packs keeps. */
INLINE __m256i lut(const orl_lut *t, __m256i lo, __m256i hi, __m256i flo, __m256i fhi)
{
    __m256i a = _mm256_i32gather_epi32((const int *)t, lo, 4), b = _mm256_i32gather_epi32((const int *)t, hi, 4);
    __m256i base = _mm256_packs_epi32(_mm256_srai_epi32(_mm256_slli_epi32(a, 16), 16), _mm256_srai_epi32(_mm256_slli_epi32(b, 16), 16));
    __m256i delta = _mm256_packs_epi32(_mm256_srai_epi32(a, 16), _mm256_srai_epi32(b, 16));
    return _mm256_add_epi16(base, _mm256_mulhrs_epi16(delta, _mm256_packs_epi32(flo, fhi)));
}

/* In 16 bits: h is below 2^16; of a sun above that, the rest goes on top of what it is over h; t = (16 d)(2 20182) + 2^15 >> 16. */
void orl_vis_avx2(const uint8_t *h0, const uint8_t *h1, const orl_vis_tab *t, int n, uint8_t *vis)
{
    int sun = t->sun < 0 ? 0 : t->sun > 65535 ? 65535 : t->sun, more = t->sun - 65535 < 0 ? 0 : t->sun - 65535 > ORL_VIS_SPAN ? ORL_VIS_SPAN : t->sun - 65535;
    const __m256i w0 = _mm256_set1_epi16((short)(256 - t->f)), w1 = _mm256_set1_epi16((short)t->f), low = _mm256_set1_epi16((short)sun), high = _mm256_set1_epi16((short)more), span = _mm256_set1_epi16(ORL_VIS_SPAN);
    const __m256i scale = _mm256_set1_epi16((short)(2 * 20182)), one = _mm256_set1_epi16(32767), half = _mm256_set1_epi16(64), top = _mm256_set1_epi16(255);
    for (int i = 0; i < n; i += 16) {
        __m256i a = _mm256_cvtepu8_epi16(_mm_loadu_si128((const __m128i *)(h0 + i))), b = _mm256_cvtepu8_epi16(_mm_loadu_si128((const __m128i *)(h1 + i)));
        __m256i h = _mm256_add_epi16(_mm256_mullo_epi16(a, w0), _mm256_mullo_epi16(b, w1));
        __m256i d = _mm256_slli_epi16(_mm256_min_epu16(_mm256_adds_epu16(_mm256_subs_epu16(low, h), high), span), 4);
        __m256i x = _mm256_add_epi16(_mm256_mulhi_epu16(d, scale), _mm256_srli_epi16(_mm256_mullo_epi16(d, scale), 15));
        __m256i q = _mm256_mulhrs_epi16(x, x), v = _mm256_add_epi16(_mm256_add_epi16(q, half), _mm256_slli_epi16(_mm256_mulhrs_epi16(q, _mm256_sub_epi16(one, x)), 1));
        v = _mm256_min_epu16(_mm256_srli_epi16(v, 7), top);
        _mm_storeu_si128((__m128i *)(vis + i), _mm_packus_epi16(_mm256_castsi256_si128(v), _mm256_extracti128_si256(v, 1)));
    }
}

/* 8 pixels: sums of 8 products, in order. */
INLINE __m256i dot8(const int8_t *phi, __m256i w)
{
    __m256i m[4];
    for (int k = 0; k < 4; k++) m[k] = _mm256_madd_epi16(_mm256_cvtepi8_epi16(_mm_loadu_si128((const __m128i *)(phi + 16 * k))), w);
    __m256i h = _mm256_hadd_epi32(_mm256_hadd_epi32(m[0], m[1]), _mm256_hadd_epi32(m[2], m[3]));       /* 0 2 4 6 | 1 3 5 7 */
    return _mm256_permutevar8x32_epi32(h, _mm256_setr_epi32(0, 4, 1, 5, 2, 6, 3, 7));
}

void orl_shadow_avx2(const int8_t *phi, const orl_shade_tab *t, int n, int16_t *s)
{
    __m256i w = _mm256_broadcastsi128_si256(_mm_loadu_si128((const __m128i *)t->phi_w)), zero = _mm256_setzero_si256();
    __m256i round = _mm256_set1_epi32(t->phi_shift ? 1 << (t->phi_shift - 1) : 0), bias = _mm256_set1_epi32(t->phi_bias), top = _mm256_set1_epi32(32767), low = _mm256_set1_epi32(127);
    __m128i shift = _mm_cvtsi32_si128(t->phi_shift);
    for (int i = 0; i < n; i += 16, phi += 16 * ORL_SHADOW_DIM) {
        __m256i x[2];
        for (int k = 0; k < 2; k++) {
            x[k] = _mm256_add_epi32(_mm256_sra_epi32(_mm256_add_epi32(dot8(phi + 64 * k, w), round), shift), bias);
            x[k] = _mm256_min_epi32(_mm256_max_epi32(x[k], zero), top);
        }
        __m256i v = lut(t->sigmoid, _mm256_srli_epi32(x[0], 7), _mm256_srli_epi32(x[1], 7),
                        _mm256_slli_epi32(_mm256_and_si256(x[0], low), 8), _mm256_slli_epi32(_mm256_and_si256(x[1], low), 8));
        _mm256_storeu_si256((__m256i *)(s + i), _mm256_permute4x64_epi64(v, 0xd8));
    }
}

/* Irradiance of 16 pixels, one at a time with channels side by side, turned into planes. */
INLINE void irradiance(const uint16_t *normal, const orl_shade_tab *t, __m256i vis, __m256i open, __m256i e[3])
{
    int16_t a[16], b[16], rgb[16][4];
    _mm256_storeu_si256((__m256i *)a, vis);
    _mm256_storeu_si256((__m256i *)b, open);
    for (int i = 0; i < 16; i++) {
        const int16_t *pal = t->pal[normal[i]];
        __m128i w = _mm_unpacklo_epi64(_mm_set1_epi16(a[i]), _mm_set1_epi16(b[i])), m = _mm_mulhrs_epi16(_mm_loadu_si128((const __m128i *)pal), w);
        m = _mm_adds_epi16(_mm_adds_epi16(m, _mm_srli_si128(m, 8)), _mm_loadl_epi64((const __m128i *)(pal + 8)));
        _mm_storel_epi64((__m128i *)rgb[i], m);
    }
    /* 4 x 16 -> planes: byte shuffle groups the channels of two pixels, two rounds of unpacking collect them */
    __m256i g = _mm256_broadcastsi128_si256(_mm_setr_epi8(0, 1, 8, 9, 2, 3, 10, 11, 4, 5, 12, 13, 6, 7, 14, 15)), q[4];
    for (int k = 0; k < 4; k++) {                                       /* q[k]: pixels 2k, 2k+1 low lane, 2k+8, 2k+9 high lane: R R G G B B x x */
        __m256i v = _mm256_inserti128_si256(_mm256_castsi128_si256(_mm_loadu_si128((const __m128i *)rgb[2 * k])), _mm_loadu_si128((const __m128i *)rgb[2 * k + 8]), 1);
        q[k] = _mm256_shuffle_epi8(v, g);
    }
    __m256i a0 = _mm256_unpacklo_epi32(q[0], q[1]), a1 = _mm256_unpacklo_epi32(q[2], q[3]), b0 = _mm256_unpackhi_epi32(q[0], q[1]), b1 = _mm256_unpackhi_epi32(q[2], q[3]);
    e[0] = _mm256_unpacklo_epi64(a0, a1);
    e[1] = _mm256_unpackhi_epi64(a0, a1);
    e[2] = _mm256_unpacklo_epi64(b0, b1);
}

INLINE __m256i knot(__m256i v, __m256i *f)
{
    __m256i bits = _mm256_castps_si256(_mm256_cvtepi32_ps(v));          /* exact: v < 2^24 */
    *f = _mm256_and_si256(_mm256_srli_epi32(bits, 4), _mm256_set1_epi32(0x7fff));
    return _mm256_sub_epi32(_mm256_srli_epi32(bits, 19), _mm256_set1_epi32(127 << 4));
}

INLINE __m256i clamp_colour(__m256i v, __m256i round, __m128i shift)
{
    v = _mm256_srl_epi32(_mm256_add_epi32(v, round), shift);
    return _mm256_max_epi32(_mm256_min_epi32(v, _mm256_set1_epi32(0xffffff)), _mm256_set1_epi32(1));
}

INLINE __m256i encode(const uint16_t *albedo, __m256i e, const orl_shade_tab *t, __m256i round, __m128i shift)
{
    __m256i a = load(albedo), lo = _mm256_mullo_epi16(a, e), hi = _mm256_mulhi_epu16(a, e), f0, f1;
    __m256i k0 = knot(clamp_colour(_mm256_unpacklo_epi16(lo, hi), round, shift), &f0), k1 = knot(clamp_colour(_mm256_unpackhi_epi16(lo, hi), round, shift), &f1);
    return lut(t->encode, k0, k1, f0, f1);
}

INLINE __m128i tone(const __m256i p[3], const int16_t a[4], int32_t b)
{
    int32_t rg, bx = (uint16_t)a[2];
    memcpy(&rg, a, 4);
    __m256i wrg = _mm256_set1_epi32(rg), wb = _mm256_set1_epi32(bx), add = _mm256_set1_epi32(b), zero = _mm256_setzero_si256();
    __m256i lo = _mm256_add_epi32(_mm256_madd_epi16(_mm256_unpacklo_epi16(p[0], p[1]), wrg), _mm256_madd_epi16(_mm256_unpacklo_epi16(p[2], zero), wb));
    __m256i hi = _mm256_add_epi32(_mm256_madd_epi16(_mm256_unpackhi_epi16(p[0], p[1]), wrg), _mm256_madd_epi16(_mm256_unpackhi_epi16(p[2], zero), wb));
    __m256i v = _mm256_packs_epi32(_mm256_srai_epi32(_mm256_add_epi32(lo, add), 17), _mm256_srai_epi32(_mm256_add_epi32(hi, add), 17));
    return _mm_packus_epi16(_mm256_castsi256_si128(v), _mm256_extracti128_si256(v, 1));
}

void orl_shade_avx2(const orl_shade_in *in, const orl_shade_tab *t, int n, uint8_t *rgb)
{
    __m256i round = _mm256_set1_epi32(t->colour_shift ? 1 << (t->colour_shift - 1) : 0);
    __m128i shift = _mm_cvtsi32_si128(t->colour_shift);
    __m256i lane = _mm256_setr_epi16(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
    int mask = (1 << in->sky_log2) - 1;
    for (int i = 0; i < n; i += 16, rgb += 48) {
        const int16_t *sky = in->sky[(in->x + i) >> in->sky_log2];
        __m256i ramp = _mm256_sll_epi16(_mm256_add_epi16(_mm256_set1_epi16((short)((in->x + i) & mask)), lane), _mm_cvtsi32_si128(15 - in->sky_log2)), p[3];
        for (int c = 0; c < 3; c++)
            p[c] = _mm256_add_epi16(_mm256_set1_epi16(sky[c]), _mm256_mulhrs_epi16(_mm256_set1_epi16((short)(sky[4 + c] - sky[c])), ramp));
        __m128i cov8 = _mm_loadu_si128((const __m128i *)(in->cov + i));
        if (!_mm_testz_si128(cov8, cov8)) {
            __m256i cov = bytes_q15(in->cov + i), s = load(in->s + i), e[3];
            irradiance(in->normal + i, t, bytes_q15(in->vis + i), bytes_q15(in->open + i), e);
            for (int c = 0; c < 3; c++)
                p[c] = _mm256_add_epi16(p[c], _mm256_mulhrs_epi16(_mm256_sub_epi16(encode(in->albedo[c] + i, _mm256_mulhrs_epi16(e[c], s), t, round, shift), p[c]), cov));
        }
        __m128i r = tone(p, t->tone[0], t->tone_b[0]), g = tone(p, t->tone[1], t->tone_b[1]), b = tone(p, t->tone[2], t->tone_b[2]);
#define X -1
#define MIX(r0, g0, b0) _mm_or_si128(_mm_or_si128(_mm_shuffle_epi8(r, r0), _mm_shuffle_epi8(g, g0)), _mm_shuffle_epi8(b, b0))
        _mm_storeu_si128((__m128i *)rgb, MIX(_mm_setr_epi8(0, X, X, 1, X, X, 2, X, X, 3, X, X, 4, X, X, 5), _mm_setr_epi8(X, 0, X, X, 1, X, X, 2, X, X, 3, X, X, 4, X, X),
                                             _mm_setr_epi8(X, X, 0, X, X, 1, X, X, 2, X, X, 3, X, X, 4, X)));
        _mm_storeu_si128((__m128i *)(rgb + 16), MIX(_mm_setr_epi8(X, X, 6, X, X, 7, X, X, 8, X, X, 9, X, X, 10, X), _mm_setr_epi8(5, X, X, 6, X, X, 7, X, X, 8, X, X, 9, X, X, 10),
                                                    _mm_setr_epi8(X, 5, X, X, 6, X, X, 7, X, X, 8, X, X, 9, X, X)));
        _mm_storeu_si128((__m128i *)(rgb + 32), MIX(_mm_setr_epi8(X, 11, X, X, 12, X, X, 13, X, X, 14, X, X, 15, X, X), _mm_setr_epi8(X, X, 11, X, X, 12, X, X, 13, X, X, 14, X, X, 15, X),
                                                    _mm_setr_epi8(10, X, X, 11, X, X, 12, X, X, 13, X, X, 14, X, X, 15)));
#undef MIX
#undef X
    }
}

/* What two vectors hold of one. */
INLINE __m128i channel(__m128i first, __m128i last, __m128i from_first, __m128i from_last) { return _mm_or_si128(_mm_shuffle_epi8(first, from_first), _mm_shuffle_epi8(last, from_last)); }

/* 8 pixels' RGB, 24 bytes and no more, as channels of 16 bits. */
typedef struct { __m128i c[3]; } planes8;
INLINE planes8 split(const uint8_t *p)
{
#define X -1
    __m128i a = _mm_loadu_si128((const __m128i *)p), b = _mm_loadu_si128((const __m128i *)(p + 8));
    return (planes8){ { channel(a, b, _mm_setr_epi8(0, X, 3, X, 6, X, 9, X, 12, X, 15, X, X, X, X, X), _mm_setr_epi8(X, X, X, X, X, X, X, X, X, X, X, X, 10, X, 13, X)),
                        channel(a, b, _mm_setr_epi8(1, X, 4, X, 7, X, 10, X, 13, X, X, X, X, X, X, X), _mm_setr_epi8(X, X, X, X, X, X, X, X, X, X, 8, X, 11, X, 14, X)),
                        channel(a, b, _mm_setr_epi8(2, X, 5, X, 8, X, 11, X, 14, X, X, X, X, X, X, X), _mm_setr_epi8(X, X, X, X, X, X, X, X, X, X, 9, X, 12, X, 15, X)) } };
}

void orl_mix_avx2(const orl_mix_in *in, int n, uint8_t *rgb)
{
    const __m128i sixteen = _mm_set1_epi16(16), top = _mm_set1_epi16(255), half = _mm_set1_epi16(128);
    for (int i = 0; i < n; i += ORL_MIX_STEP, rgb += 24) {
        const int16_t (*a)[2] = in->cell[in->cell_of[i / ORL_MIX_STEP]], (*b)[2] = a + 3;
        __m128i layer = _mm_cvtepu8_epi16(_mm_loadl_epi64((const __m128i *)(in->layer + i))), w = _mm_cvtepu8_epi16(_mm_loadl_epi64((const __m128i *)(in->weight + i))), rest = _mm_sub_epi16(top, w), out[3];
        __m256i share = _mm256_broadcastsi128_si256(_mm_loadu_si128((const __m128i *)(in->share + i)));
        layer = _mm_add_epi16(_mm_slli_epi16(layer, 7), _mm_srli_epi16(layer, 1));
        planes8 was = split(rgb), photo = split(in->photo + 3 * i);
        for (int c = 0; c < 3; c++) {
            __m256i from = _mm256_setr_m128i(_mm_set1_epi16(a[c][0]), _mm_set1_epi16(a[c][1])), to = _mm256_setr_m128i(_mm_set1_epi16(b[c][0]), _mm_set1_epi16(b[c][1]));
            __m256i line = _mm256_add_epi16(from, _mm256_mulhi_epi16(_mm256_slli_epi16(_mm256_sub_epi16(to, from), 1), share));
            __m128i sky = _mm256_castsi256_si128(line), d = _mm_sub_epi16(_mm256_extracti128_si256(line, 1), sky);
            __m128i add = _mm_add_epi16(sky, _mm_mulhi_epi16(_mm_slli_epi16(d, 1), layer));
            __m128i r = _mm_add_epi16(was.c[c], _mm_srai_epi16(_mm_add_epi16(add, sixteen), 5));
            r = _mm_max_epi16(_mm_min_epi16(r, top), _mm_setzero_si128());
            __m128i m = _mm_add_epi16(_mm_add_epi16(_mm_mullo_epi16(photo.c[c], w), _mm_mullo_epi16(r, rest)), half);
            out[c] = _mm_srli_epi16(_mm_add_epi16(m, _mm_srli_epi16(m, 8)), 8);
        }
        __m128i rg = _mm_packus_epi16(out[0], out[1]), bb = _mm_packus_epi16(out[2], out[2]);          /* R 0..7, G 8..15; B 0..7 */
        _mm_storeu_si128((__m128i *)rgb, channel(rg, bb, _mm_setr_epi8(0, 8, X, 1, 9, X, 2, 10, X, 3, 11, X, 4, 12, X, 5), _mm_setr_epi8(X, X, 0, X, X, 1, X, X, 2, X, X, 3, X, X, 4, X)));
        _mm_storel_epi64((__m128i *)(rgb + 16), channel(rg, bb, _mm_setr_epi8(13, X, 6, 14, X, 7, 15, X, X, X, X, X, X, X, X, X), _mm_setr_epi8(X, 5, X, X, 6, X, X, 7, X, X, X, X, X, X, X, X)));
#undef X
    }
}
