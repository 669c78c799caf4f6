/* Conversion to RGB for AVX2: convert.h's arithmetic, 32 pixels a step. Built into every x86-64 program, called where the CPU has it.
 *
 * A 32-bit lane holds a pair of pixels as two words, and their chroma A, B as two words of another vector: multiply-add with (k_y, 0) and (0, k_y) gives the two lumas, with (a, b) the
 * chroma's part. Words are taken four times, so that a result is the upper half of its lane: the pair's two halves come together by one shift and one blend.
 * Blue's chroma is taken eight times, its coefficients being Q13. */
#include <immintrin.h>
#include "runtime/kernels/convert.h"

#define INLINE static inline __attribute__((always_inline))

typedef struct { __m256i even, odd, c[3], add[3]; } constants;
typedef struct { __m256i c[3]; } colours;

INLINE __m256i load(const void *p) { return _mm256_loadu_si256((const __m256i *)p); }
INLINE __m256i two(const void *low, const void *high) { return _mm256_inserti128_si256(_mm256_castsi128_si256(_mm_loadu_si128((const __m128i *)low)), _mm_loadu_si128((const __m128i *)high), 1); }

INLINE constants prepare(const orl_yuv_tab *t)
{
    constants k = { .even = _mm256_set1_epi32(t->y), .odd = _mm256_set1_epi32((int)((uint32_t)t->y << 16)) };
    for (int c = 0; c < 3; c++) {
        k.c[c] = _mm256_set1_epi32((int)((uint32_t)t->c[c][1] << 16 | (uint16_t)t->c[c][0]));
        k.add[c] = _mm256_set1_epi32(4 * t->add[c]);
    }
    return k;
}

/* Words A, B of pairs, four and eight times. */
typedef struct { __m256i four, eight; } chroma;

INLINE chroma scaled(__m256i c) { return (chroma) { _mm256_slli_epi16(c, 2), _mm256_slli_epi16(c, 3) }; }

/* 16 pixels: y words in pairs, four times; ce and co of the pairs' even and odd pixels. Words out, not clamped. */
INLINE colours convert16(const constants *k, __m256i y, chroma ce, chroma co)
{
    colours o;
    __m256i e = _mm256_madd_epi16(y, k->even), d = _mm256_madd_epi16(y, k->odd);
    for (int c = 0; c < 3; c++) {
        __m256i se = _mm256_add_epi32(_mm256_madd_epi16(c == 2 ? ce.eight : ce.four, k->c[c]), k->add[c]), so = _mm256_add_epi32(_mm256_madd_epi16(c == 2 ? co.eight : co.four, k->c[c]), k->add[c]);
        o.c[c] = _mm256_blend_epi16(_mm256_srli_epi32(_mm256_add_epi32(e, se), 16), _mm256_add_epi32(d, so), 0xaa);
    }
    return o;
}

/* 32 pixels: a holds 0..7 and 16..23, b the others, which packing puts in order. A byte shuffle puts pixel i of 16 at 3 i mod 16, where all three channels' parts fit into each other. */
INLINE void store32(colours a, colours b, uint8_t *rgb)
{
    const __m256i to[3] = { _mm256_broadcastsi128_si256(_mm_setr_epi8(0, 11, 6, 1, 12, 7, 2, 13, 8, 3, 14, 9, 4, 15, 10, 5)), _mm256_broadcastsi128_si256(_mm_setr_epi8(5, 0, 11, 6, 1, 12, 7, 2, 13, 8, 3, 14, 9, 4, 15, 10)),
                            _mm256_broadcastsi128_si256(_mm_setr_epi8(10, 5, 0, 11, 6, 1, 12, 7, 2, 13, 8, 3, 14, 9, 4, 15)) };
    const __m256i m1 = _mm256_broadcastsi128_si256(_mm_setr_epi8(0, -1, 0, 0, -1, 0, 0, -1, 0, 0, -1, 0, 0, -1, 0, 0)), m2 = _mm256_broadcastsi128_si256(_mm_setr_epi8(0, 0, -1, 0, 0, -1, 0, 0, -1, 0, 0, -1, 0, 0, -1, 0));
    __m256i v[3], o[3];
    for (int c = 0; c < 3; c++) v[c] = _mm256_shuffle_epi8(_mm256_packus_epi16(a.c[c], b.c[c]), to[c]);
    for (int k = 0; k < 3; k++) o[k] = _mm256_blendv_epi8(_mm256_blendv_epi8(v[k], v[(k + 1) % 3], m1), v[(k + 2) % 3], m2);
    _mm256_storeu_si256((__m256i *)rgb, _mm256_permute2x128_si256(o[0], o[1], 0x20));
    _mm256_storeu_si256((__m256i *)(rgb + 32), _mm256_permute2x128_si256(o[2], o[0], 0x30));
    _mm256_storeu_si256((__m256i *)(rgb + 64), _mm256_permute2x128_si256(o[1], o[2], 0x31));
}

/* y: 32 bytes; uv: 16 pairs of bytes. */
INLINE void step(const constants *k, __m256i y, __m256i uv, uint8_t *rgb)
{
    const __m256i zero = _mm256_setzero_si256();
    chroma c0 = scaled(_mm256_unpacklo_epi8(uv, zero)), c1 = scaled(_mm256_unpackhi_epi8(uv, zero));
    store32(convert16(k, _mm256_slli_epi16(_mm256_unpacklo_epi8(y, zero), 2), c0, c0), convert16(k, _mm256_slli_epi16(_mm256_unpackhi_epi8(y, zero), 2), c1, c1), rgb);
}

void orl_convert_half_avx2(const uint8_t *const p[3], const orl_yuv_tab *t, int n, uint8_t *rgb)
{
    const constants k = prepare(t);
    for (int i = 0; i < n; i += 32, rgb += 96) {
        __m128i u = _mm_loadu_si128((const __m128i *)(p[1] + i / 2)), v = _mm_loadu_si128((const __m128i *)(p[2] + i / 2));
        step(&k, load(p[0] + i), _mm256_setr_m128i(_mm_unpacklo_epi8(u, v), _mm_unpackhi_epi8(u, v)), rgb);
    }
}

void orl_convert_semi_avx2(const uint8_t *const p[3], const orl_yuv_tab *t, int n, uint8_t *rgb)
{
    const constants k = prepare(t);
    for (int i = 0; i < n; i += 32, rgb += 96) step(&k, load(p[0] + i), load(p[1] + i), rgb);
}

INLINE colours full16(const constants *k, __m256i y, __m256i u, __m256i v)
{
    return convert16(k, _mm256_slli_epi16(y, 2), scaled(_mm256_blend_epi16(u, _mm256_slli_epi32(v, 16), 0xaa)), scaled(_mm256_blend_epi16(_mm256_srli_epi32(u, 16), v, 0xaa)));
}

void orl_convert_full_avx2(const uint8_t *const p[3], const orl_yuv_tab *t, int n, uint8_t *rgb)
{
    const constants k = prepare(t);
    const __m256i zero = _mm256_setzero_si256();
    for (int i = 0; i < n; i += 32, rgb += 96) {
        __m256i y = load(p[0] + i), u = load(p[1] + i), v = load(p[2] + i);
        store32(full16(&k, _mm256_unpacklo_epi8(y, zero), _mm256_unpacklo_epi8(u, zero), _mm256_unpacklo_epi8(v, zero)),
                full16(&k, _mm256_unpackhi_epi8(y, zero), _mm256_unpackhi_epi8(u, zero), _mm256_unpackhi_epi8(v, zero)), rgb);
    }
}

/* Multiply-add of bytes takes luma or chroma out of the words and scales it at once. */
INLINE void packed(const uint8_t *p, const orl_yuv_tab *t, int n, uint8_t *rgb, int y_first)
{
    const constants k = prepare(t);
    const __m256i y4 = _mm256_set1_epi16(y_first ? 4 : 4 << 8), c4 = _mm256_set1_epi16(y_first ? 4 << 8 : 4), c8 = _mm256_set1_epi16(y_first ? 8 << 8 : 8);
    for (int i = 0; i < n; i += 32, rgb += 96) {
        __m256i a = two(p + 2 * i, p + 2 * i + 32), b = two(p + 2 * i + 16, p + 2 * i + 48);
        chroma ca = { _mm256_maddubs_epi16(a, c4), _mm256_maddubs_epi16(a, c8) }, cb = { _mm256_maddubs_epi16(b, c4), _mm256_maddubs_epi16(b, c8) };
        store32(convert16(&k, _mm256_maddubs_epi16(a, y4), ca, ca), convert16(&k, _mm256_maddubs_epi16(b, y4), cb, cb), rgb);
    }
}

void orl_convert_yuyv_avx2(const uint8_t *const p[3], const orl_yuv_tab *t, int n, uint8_t *rgb) { packed(p[0], t, n, rgb, 1); }
void orl_convert_uyvy_avx2(const uint8_t *const p[3], const orl_yuv_tab *t, int n, uint8_t *rgb) { packed(p[0], t, n, rgb, 0); }

/* A lane holds a third of 16 pixels; the pixels on the thirds' borders take a byte from the neighbour. */
void orl_convert_swap_avx2(const uint8_t *const p[3], const orl_yuv_tab *t, int n, uint8_t *rgb)
{
    (void)t;
#define X -1
#define SHUFFLE(v, ...) _mm256_shuffle_epi8(v, _mm256_broadcastsi128_si256(_mm_setr_epi8(__VA_ARGS__)))
    const uint8_t *in = p[0];
    for (int i = 0; i < n; i += 32, in += 96, rgb += 96) {
        __m256i a = two(in, in + 48), b = two(in + 16, in + 64), c = two(in + 32, in + 80);
        __m256i o0 = _mm256_or_si256(SHUFFLE(a, 2, 1, 0, 5, 4, 3, 8, 7, 6, 11, 10, 9, 14, 13, 12, X), SHUFFLE(b, X, X, X, X, X, X, X, X, X, X, X, X, X, X, X, 1));
        __m256i o1 = _mm256_or_si256(SHUFFLE(a, X, 15, X, X, X, X, X, X, X, X, X, X, X, X, X, X), SHUFFLE(c, X, X, X, X, X, X, X, X, X, X, X, X, X, X, 0, X));
        o1 = _mm256_or_si256(o1, SHUFFLE(b, 0, X, 4, 3, 2, 7, 6, 5, 10, 9, 8, 13, 12, 11, X, 15));
        __m256i o2 = _mm256_or_si256(SHUFFLE(b, 14, X, X, X, X, X, X, X, X, X, X, X, X, X, X, X), SHUFFLE(c, X, 3, 2, 1, 6, 5, 4, 9, 8, 7, 12, 11, 10, 15, 14, 13));
        _mm256_storeu_si256((__m256i *)rgb, _mm256_permute2x128_si256(o0, o1, 0x20));
        _mm256_storeu_si256((__m256i *)(rgb + 32), _mm256_permute2x128_si256(o2, o0, 0x30));
        _mm256_storeu_si256((__m256i *)(rgb + 64), _mm256_permute2x128_si256(o1, o2, 0x31));
    }
#undef SHUFFLE
#undef X
}
