/* 8 words for the warp of x86-64: what shade_simd.h asks for beside a vec_*.h. */
#ifndef RUNTIME_KERNELS_HALF_SSE_H
#define RUNTIME_KERNELS_HALF_SSE_H
#include <immintrin.h>
#include <string.h>

typedef __m128i half;
INLINE half half_set1(int v) { return _mm_set1_epi16((short)v); }
INLINE half half_load(const int16_t *p) { return _mm_loadu_si128((const __m128i *)p); }
INLINE half half_pixels(const uint8_t *p) { return _mm_cvtepu8_epi16(_mm_loadl_epi64((const __m128i *)p)); }
INLINE half half_add(half a, half b) { return _mm_add_epi16(a, b); }
INLINE half half_mul(half a, half b) { return _mm_mulhrs_epi16(a, b); }
INLINE half half_mullo(half a, half b) { return _mm_mullo_epi16(a, b); }
#define half_shr(v, n) _mm_srli_epi16(v, n)
#define half_down(v, n) _mm_srli_si128(v, 2 * (n))
#define half_up(v, n) _mm_slli_si128(v, 2 * (n))

/* Two of them. */
typedef __m256i pair;
INLINE pair pair_set1(int v) { return _mm256_set1_epi16((short)v); }
INLINE pair pair_load(const int16_t *p) { return _mm256_loadu_si256((const __m256i *)p); }
INLINE pair pair_pixels(const uint8_t *p) { return _mm256_cvtepu8_epi16(_mm_loadu_si128((const __m128i *)p)); }
INLINE pair pair_add(pair a, pair b) { return _mm256_add_epi16(a, b); }
INLINE pair pair_mul(pair a, pair b) { return _mm256_mulhrs_epi16(a, b); }
INLINE pair pair_mullo(pair a, pair b) { return _mm256_mullo_epi16(a, b); }
#define pair_shr(v, n) _mm256_srli_epi16(v, n)
INLINE half pair_low(pair v) { return _mm256_castsi256_si128(v); }
INLINE half pair_high(pair v) { return _mm256_extracti128_si256(v, 1); }

INLINE void half_store_rgb(uint8_t *p, half v, int last)           /* v >> 7; but for the last, a byte more */
{
    v = _mm_srli_epi16(v, 7);
    uint32_t rgb = (uint32_t)_mm_cvtsi128_si32(_mm_packus_epi16(v, v));
    if (last) memcpy(p, &rgb, 3);
    else memcpy(p, &rgb, 4);
}
#endif
