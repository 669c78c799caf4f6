/* 16 lanes of 16 bits for AVX2: what shade_simd.h asks for. Orders and saturations as shade.h has them. */
#ifndef RUNTIME_KERNELS_VEC_AVX2_H
#define RUNTIME_KERNELS_VEC_AVX2_H
#include <immintrin.h>
#include "runtime/kernels/shade.h"

#define INLINE static inline __attribute__((always_inline))
#include "runtime/kernels/half_sse.h"
#define LANES 16
typedef __m256i vec;

INLINE vec set1(int v) { return _mm256_set1_epi16((short)v); }
INLINE vec lanes(void) { return _mm256_setr_epi16(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15); }
INLINE vec load(const int16_t *p) { return _mm256_loadu_si256((const __m256i *)p); }
INLINE vec load_u8(const uint8_t *p) { return _mm256_cvtepu8_epi16(_mm_loadu_si128((const __m128i *)p)); }
INLINE vec load_i8(const int8_t *p) { return _mm256_cvtepi8_epi16(_mm_loadu_si128((const __m128i *)p)); }
INLINE vec load_high(const int8_t *p) { return _mm256_slli_epi16(_mm256_cvtepu8_epi16(_mm_loadu_si128((const __m128i *)p)), 8); }       /* times 256 */
INLINE vec load_part(const uint8_t *p) { return _mm256_slli_epi16(_mm256_cvtepu8_epi16(_mm_loadu_si128((const __m128i *)p)), 8); }
INLINE void store(int16_t *p, vec v) { _mm256_storeu_si256((__m256i *)p, v); }

INLINE vec add(vec a, vec b) { return _mm256_add_epi16(a, b); }
INLINE vec sub(vec a, vec b) { return _mm256_sub_epi16(a, b); }
INLINE vec adds(vec a, vec b) { return _mm256_adds_epi16(a, b); }
INLINE vec addu(vec a, vec b) { return _mm256_adds_epu16(a, b); }
INLINE vec subu(vec a, vec b) { return _mm256_subs_epu16(a, b); }
INLINE vec mul(vec a, vec b) { return _mm256_mulhrs_epi16(a, b); }
INLINE vec part(vec v, vec b) { return _mm256_mulhi_epu16(v, b); }                       /* v by load_part, b not negative */
INLINE vec mullo(vec a, vec b) { return _mm256_mullo_epi16(a, b); }
INLINE vec min(vec a, vec b) { return _mm256_min_epi16(a, b); }
INLINE vec max(vec a, vec b) { return _mm256_max_epi16(a, b); }
INLINE vec minu(vec a, vec b) { return _mm256_min_epu16(a, b); }
INLINE vec and(vec a, vec b) { return _mm256_and_si256(a, b); }
#define shl(v, n) _mm256_slli_epi16(v, n)
#define shr(v, n) _mm256_srli_epi16(v, n)
INLINE vec shl_by(vec v, int n) { return _mm256_sll_epi16(v, _mm_cvtsi32_si128(n)); }
INLINE vec sar_by(vec v, int n) { return _mm256_sra_epi16(v, _mm_cvtsi32_si128(n)); }

INLINE vec where_greater(vec a, vec b, vec yes, vec no) { return _mm256_blendv_epi8(no, yes, _mm256_cmpgt_epi16(a, b)); }
INLINE int any(vec v) { return !_mm256_testz_si256(v, v); }
INLINE int all_255(vec v) { return _mm256_testc_si256(v, set1(255)); }                                 /* of bytes */
INLINE vec where_255(vec v, vec yes, vec no) { return _mm256_blendv_epi8(no, yes, _mm256_cmpeq_epi16(v, set1(255))); }

/* Tables of 16 words, low and high bytes apart. */
typedef struct { __m256i lo, hi; } table;
typedef struct { __m256i lo, hi; } picker;
INLINE table table_of(const int16_t t[16])
{
    __m128i a = _mm_loadu_si128((const __m128i *)t), b = _mm_loadu_si128((const __m128i *)(t + 8)), low = _mm_set1_epi16(255);
    return (table){ _mm256_broadcastsi128_si256(_mm_packus_epi16(_mm_and_si128(a, low), _mm_and_si128(b, low))),
                    _mm256_broadcastsi128_si256(_mm_packus_epi16(_mm_srli_epi16(a, 8), _mm_srli_epi16(b, 8))) };
}
INLINE picker picker_of(vec i) { return (picker){ _mm256_or_si256(i, set1(0x8000)), _mm256_or_si256(_mm256_slli_epi16(i, 8), set1(0x0080)) }; }
INLINE vec pick(table t, picker at) { return _mm256_or_si256(_mm256_shuffle_epi8(t.lo, at.lo), _mm256_shuffle_epi8(t.hi, at.hi)); }

/* Of 2 .. 32767: what a table holds for its log2, and what is below the leading bit, less 2^15, from the bits of floats. */
typedef table power_table;
typedef struct { __m256i log, rest; } power;
INLINE power_table power_table_of(const int16_t t[16]) { return table_of(t); }
INLINE power power_of(vec v)
{
    __m256i even = _mm256_castps_si256(_mm256_cvtepi32_ps(_mm256_and_si256(v, _mm256_set1_epi32(0xffff)))), odd = _mm256_castps_si256(_mm256_cvtepi32_ps(_mm256_srli_epi32(v, 16)));
    __m256i rest = _mm256_blend_epi16(_mm256_srli_epi32(even, 8), _mm256_slli_epi32(odd, 8), 0xaa), log = _mm256_blend_epi16(_mm256_srli_epi32(even, 23), _mm256_srli_epi32(odd, 7), 0xaa);
    return (power){ log, _mm256_or_si256(rest, set1(-32768)) };
}
INLINE vec pick_power(power_table t, power p)           /* 127 + log: 128 above a table's place */
{
    __m256i lo = _mm256_xor_si256(p.log, set1(-32640)), hi = _mm256_xor_si256(_mm256_slli_epi16(p.log, 8), set1(-32640));        /* 0x8080 */
    return _mm256_or_si256(_mm256_shuffle_epi8(t.lo, lo), _mm256_shuffle_epi8(t.hi, hi));
}

/* Nodes of LANES columns from x on: at most two, their border in the middle. */
INLINE vec nodes(const int16_t *p, int x, int log2)
{
    return _mm256_setr_m128i(_mm_set1_epi16(p[x >> log2]), _mm_set1_epi16(p[(x + 8) >> log2]));
}

typedef struct { __m256i w[2], round, bias; __m128i shift; } phi_weights;
INLINE phi_weights phi_weights_of(const orl_shade_tab *t)
{
    phi_weights w = { .round = _mm256_set1_epi32(t->phi_shift ? 1 << (t->phi_shift - 1) : 0), .bias = _mm256_set1_epi32(t->phi_bias), .shift = _mm_cvtsi32_si128(t->phi_shift) };
    for (int g = 0; g < 2; g++) {
        int16_t v[4];
        for (int k = 0; k < 4; k++) v[k] = (int16_t)(128 * t->phi_hi[4 * g + k] + t->phi_lo[4 * g + k]);
        w.w[g] = _mm256_setr_epi16(v[0], v[1], v[2], v[3], v[0], v[1], v[2], v[3], v[0], v[1], v[2], v[3], v[0], v[1], v[2], v[3]);
    }
    return w;
}
INLINE vec phi_sum(const int8_t *a, const int8_t *b, const phi_weights *w)
{
    __m256i m[4], x[2];
    for (int k = 0; k < 4; k++) m[k] = _mm256_add_epi32(_mm256_madd_epi16(load_i8(a + 16 * k), w->w[0]), _mm256_madd_epi16(load_i8(b + 16 * k), w->w[1]));
    for (int k = 0; k < 2; k++) x[k] = _mm256_add_epi32(_mm256_sra_epi32(_mm256_add_epi32(_mm256_hadd_epi32(m[2 * k], m[2 * k + 1]), w->round), w->shift), w->bias);        /* 0 1 4 5 | 2 3 6 7 */
    return max(_mm256_permutevar8x32_epi32(_mm256_packs_epi32(x[0], x[1]), _mm256_setr_epi32(0, 4, 1, 5, 2, 6, 3, 7)), set1(0));
}

/* 16 pixels' RGB: what three vectors of bytes hold of each channel, and back. */
#define X -1
INLINE __m128i gather3(__m128i a, __m128i b, __m128i c, __m128i from_a, __m128i from_b, __m128i from_c)
{
    return _mm_or_si128(_mm_or_si128(_mm_shuffle_epi8(a, from_a), _mm_shuffle_epi8(b, from_b)), _mm_shuffle_epi8(c, from_c));
}
INLINE void load_rgb(const uint8_t *p, vec c[3])
{
    __m128i v0 = _mm_loadu_si128((const __m128i *)p), v1 = _mm_loadu_si128((const __m128i *)(p + 16)), v2 = _mm_loadu_si128((const __m128i *)(p + 32));
    c[0] = _mm256_cvtepu8_epi16(gather3(v0, v1, v2, _mm_setr_epi8(0, 3, 6, 9, 12, 15, X, X, X, X, X, X, X, X, X, X), _mm_setr_epi8(X, X, X, X, X, X, 2, 5, 8, 11, 14, X, X, X, X, X), _mm_setr_epi8(X, X, X, X, X, X, X, X, X, X, X, 1, 4, 7, 10, 13)));
    c[1] = _mm256_cvtepu8_epi16(gather3(v0, v1, v2, _mm_setr_epi8(1, 4, 7, 10, 13, X, X, X, X, X, X, X, X, X, X, X), _mm_setr_epi8(X, X, X, X, X, 0, 3, 6, 9, 12, 15, X, X, X, X, X), _mm_setr_epi8(X, X, X, X, X, X, X, X, X, X, X, 2, 5, 8, 11, 14)));
    c[2] = _mm256_cvtepu8_epi16(gather3(v0, v1, v2, _mm_setr_epi8(2, 5, 8, 11, 14, X, X, X, X, X, X, X, X, X, X, X), _mm_setr_epi8(X, X, X, X, X, 1, 4, 7, 10, 13, X, X, X, X, X, X), _mm_setr_epi8(X, X, X, X, X, X, X, X, X, X, 0, 3, 6, 9, 12, 15)));
}
INLINE __m128i bytes(vec v) { return _mm_packus_epi16(_mm256_castsi256_si128(v), _mm256_extracti128_si256(v, 1)); }
INLINE void store_rgb(uint8_t *p, const vec c[3])
{
    __m128i r = bytes(c[0]), g = bytes(c[1]), b = bytes(c[2]);
    _mm_storeu_si128((__m128i *)p, gather3(r, g, b, _mm_setr_epi8(0, X, X, 1, X, X, 2, X, X, 3, X, X, 4, X, X, 5), _mm_setr_epi8(X, 0, X, X, 1, X, X, 2, X, X, 3, X, X, 4, X, X), _mm_setr_epi8(X, X, 0, X, X, 1, X, X, 2, X, X, 3, X, X, 4, X)));
    _mm_storeu_si128((__m128i *)(p + 16), gather3(r, g, b, _mm_setr_epi8(X, X, 6, X, X, 7, X, X, 8, X, X, 9, X, X, 10, X), _mm_setr_epi8(5, X, X, 6, X, X, 7, X, X, 8, X, X, 9, X, X, 10), _mm_setr_epi8(X, 5, X, X, 6, X, X, 7, X, X, 8, X, X, 9, X, X)));
    _mm_storeu_si128((__m128i *)(p + 32), gather3(r, g, b, _mm_setr_epi8(X, 11, X, X, 12, X, X, 13, X, X, 14, X, X, 15, X, X), _mm_setr_epi8(X, X, 11, X, X, 12, X, X, 13, X, X, 14, X, X, 15, X), _mm_setr_epi8(10, X, X, 11, X, X, 12, X, X, 13, X, X, 14, X, X, 15)));
}
#undef X
#endif
