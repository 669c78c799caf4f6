/* 32 lanes of 16 bits for AVX-512 with VBMI and VNNI: what shade_simd.h asks for. Orders and saturations as shade.h has them. */
#ifndef RUNTIME_KERNELS_VEC_AVX512_H
#define RUNTIME_KERNELS_VEC_AVX512_H
#include <immintrin.h>
#include <string.h>
#include "runtime/kernels/shade.h"

#define INLINE static inline __attribute__((always_inline))
#include "runtime/kernels/half_sse.h"
#define LANES 32
typedef __m512i vec;

#define PX(f, i) f(i) f(i + 1) f(i + 2) f(i + 3) f(i + 4) f(i + 5) f(i + 6) f(i + 7)
#define PX32(f) PX(f, 0) PX(f, 8) PX(f, 16) PX(f, 24)

INLINE vec set1(int v) { return _mm512_set1_epi16((short)v); }
INLINE vec load(const int16_t *p) { return _mm512_loadu_si512(p); }
INLINE vec load_u8(const uint8_t *p) { return _mm512_cvtepu8_epi16(_mm256_loadu_si256((const __m256i *)p)); }
INLINE vec load_i8(const int8_t *p) { return _mm512_cvtepi8_epi16(_mm256_loadu_si256((const __m256i *)p)); }
INLINE vec load_part(const uint8_t *p)              /* times 256 */
{
#define HIGH(i) 0, (i),
    static const uint8_t from[64] __attribute__((aligned(64))) = { PX32(HIGH) };
#undef HIGH
    return _mm512_maskz_permutexvar_epi8(0xaaaaaaaaaaaaaaaa, _mm512_load_si512(from), _mm512_castsi256_si512(_mm256_loadu_si256((const __m256i *)p)));
}
INLINE vec load_high(const int8_t *p) { return load_part((const uint8_t *)p); }
INLINE vec lanes(void)
{
    static const uint8_t n[LANES] = { 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26, 27, 28, 29, 30, 31 };
    return load_u8(n);
}
INLINE void store(int16_t *p, vec v) { _mm512_storeu_si512(p, v); }

INLINE vec add(vec a, vec b) { return _mm512_add_epi16(a, b); }
INLINE vec sub(vec a, vec b) { return _mm512_sub_epi16(a, b); }
INLINE vec adds(vec a, vec b) { return _mm512_adds_epi16(a, b); }
INLINE vec addu(vec a, vec b) { return _mm512_adds_epu16(a, b); }
INLINE vec subu(vec a, vec b) { return _mm512_subs_epu16(a, b); }
INLINE vec mul(vec a, vec b) { return _mm512_mulhrs_epi16(a, b); }
INLINE vec part(vec v, vec b) { return _mm512_mulhi_epu16(v, b); }                       /* v by load_part, b not negative */
INLINE vec mullo(vec a, vec b) { return _mm512_mullo_epi16(a, b); }
INLINE vec min(vec a, vec b) { return _mm512_min_epi16(a, b); }
INLINE vec max(vec a, vec b) { return _mm512_max_epi16(a, b); }
INLINE vec minu(vec a, vec b) { return _mm512_min_epu16(a, b); }
INLINE vec and(vec a, vec b) { return _mm512_and_si512(a, b); }
#define shl(v, n) _mm512_slli_epi16(v, n)
#define shr(v, n) _mm512_srli_epi16(v, n)
INLINE vec shl_by(vec v, int n) { return _mm512_sll_epi16(v, _mm_cvtsi32_si128(n)); }
INLINE vec sar_by(vec v, int n) { return _mm512_sra_epi16(v, _mm_cvtsi32_si128(n)); }

INLINE vec where_greater(vec a, vec b, vec yes, vec no) { return _mm512_mask_mov_epi16(no, _mm512_cmpgt_epi16_mask(a, b), yes); }
INLINE int any(vec v) { return _mm512_test_epi16_mask(v, v) != 0; }
INLINE int all_255(vec v) { return _mm512_cmpneq_epi16_mask(v, set1(255)) == 0; }                      /* of bytes */
INLINE vec where_255(vec v, vec yes, vec no) { return _mm512_mask_mov_epi16(no, _mm512_cmpeq_epi16_mask(v, set1(255)), yes); }

/* Tables of 16 words, twice over: bit 4 of a place does not count. */
typedef __m512i table;
typedef __m512i picker;
INLINE table table_of(const int16_t t[16]) { return _mm512_broadcast_i64x4(_mm256_loadu_si256((const __m256i *)t)); }
INLINE picker picker_of(vec i) { return i; }
INLINE vec pick(table t, picker at) { return _mm512_permutexvar_epi16(at, t); }

/* Of 2 .. 32767: what a table holds for its log2, and what is below the leading bit, less 2^15. An odd lane is never 0, so a pair's leading zeros are its own: 15 - log, and 31 - log in even lanes. */
typedef __m512i power_table;
typedef struct { __m512i zeros; vec rest; } power;
INLINE power_table power_table_of(const int16_t t[16])
{
    int16_t by_zeros[32] = { 0 };
    for (int log = 1; log < 15; log++) by_zeros[15 - log] = by_zeros[31 - log] = t[log - 1];
    return load(by_zeros);
}
INLINE power power_of(vec v)
{
    __m512i zeros = _mm512_or_si512(_mm512_lzcnt_epi32(_mm512_and_si512(v, _mm512_set1_epi32(0xffff))), _mm512_slli_epi32(_mm512_lzcnt_epi32(v), 16));
    return (power){ zeros, _mm512_sllv_epi16(v, and(zeros, set1(15))) };
}
INLINE vec pick_power(power_table t, power p) { return _mm512_permutexvar_epi16(p.zeros, t); }

/* Nodes of LANES columns from x on: at most three. */
INLINE vec nodes(const int16_t *p, int x, int log2)
{
    vec four = _mm512_castsi128_si512(_mm_loadl_epi64((const __m128i *)(p + (x >> log2))));
    return _mm512_permutexvar_epi16(_mm512_srl_epi16(add(set1(x & ((1 << log2) - 1)), lanes()), _mm_cvtsi32_si128(log2)), four);
}

/* vpdpbusd takes unsigned bytes first: phi + 128, of which 128 times the sum of the weights is taken off. */
typedef struct { __m512i hi[2], lo[2], round, bias; __m128i shift; } phi_weights;
INLINE phi_weights phi_weights_of(const orl_shade_tab *t)
{
    phi_weights w = { .bias = _mm512_set1_epi32(t->phi_bias), .shift = _mm_cvtsi32_si128(t->phi_shift) };
    int32_t sum = 0;
    for (int g = 0; g < 2; g++) {
        int32_t four;
        memcpy(&four, t->phi_hi + 4 * g, 4);
        w.hi[g] = _mm512_set1_epi32(four);
        memcpy(&four, t->phi_lo + 4 * g, 4);
        w.lo[g] = _mm512_set1_epi32(four);
        for (int k = 4 * g; k < 4 * g + 4; k++) sum += 128 * t->phi_hi[k] + t->phi_lo[k];
    }
    w.round = _mm512_set1_epi32((t->phi_shift ? 1 << (t->phi_shift - 1) : 0) - 128 * sum);
    return w;
}
INLINE vec phi_sum(const int8_t *a, const int8_t *b, const phi_weights *w)
{
    const __m512i flip = _mm512_set1_epi8(-128);
    __m512i x[2];
    for (int k = 0; k < 2; k++) {
        __m512i pa = _mm512_xor_si512(_mm512_loadu_si512(a + 64 * k), flip), pb = _mm512_xor_si512(_mm512_loadu_si512(b + 64 * k), flip);
        __m512i hi = _mm512_dpbusd_epi32(_mm512_dpbusd_epi32(_mm512_setzero_si512(), pa, w->hi[0]), pb, w->hi[1]), lo = _mm512_dpbusd_epi32(_mm512_dpbusd_epi32(w->round, pa, w->lo[0]), pb, w->lo[1]);
        x[k] = _mm512_add_epi32(_mm512_sra_epi32(_mm512_add_epi32(_mm512_slli_epi32(hi, 7), lo), w->shift), w->bias);
    }
    return max(_mm512_permutexvar_epi64(_mm512_setr_epi64(0, 2, 4, 6, 1, 3, 5, 7), _mm512_packs_epi32(x[0], x[1])), set1(0));
}

/* 32 pixels' RGB, 96 bytes. */
INLINE void load_rgb(const uint8_t *p, vec c[3])
{
#define WORD(i) 3 * (i), 0,
    static const uint8_t from[64] __attribute__((aligned(64))) = { PX32(WORD) };
#undef WORD
    __m512i a = _mm512_loadu_si512(p), b = _mm512_castsi256_si512(_mm256_loadu_si256((const __m256i *)(p + 64))), at = _mm512_load_si512(from);
    for (int k = 0; k < 3; k++) c[k] = _mm512_maskz_permutex2var_epi8(0x5555555555555555, a, _mm512_add_epi8(at, _mm512_set1_epi8((char)k)), b);
}
INLINE void store_rgb(uint8_t *p, const vec c[3])
{
#define OF(i) ((i) / 8 * 16 + (i) % 8)      /* packing goes by lanes of 8 pixels: 8 R, 8 G; then 8 B, 8 B */
#define TRIPLE(i) OF(i), OF(i) + 8, OF(i) + 64,
    static const uint8_t to[96] __attribute__((aligned(64))) = { PX32(TRIPLE) };
#undef TRIPLE
#undef OF
    __m512i rg = _mm512_packus_epi16(c[0], c[1]), bb = _mm512_packus_epi16(c[2], c[2]);
    _mm512_storeu_si512(p, _mm512_permutex2var_epi8(rg, _mm512_load_si512(to), bb));
    _mm256_storeu_si256((__m256i *)(p + 64), _mm512_castsi512_si256(_mm512_permutex2var_epi8(rg, _mm512_castsi256_si512(_mm256_load_si256((const __m256i *)(to + 64))), bb)));
}
#undef PX
#undef PX32
#endif
