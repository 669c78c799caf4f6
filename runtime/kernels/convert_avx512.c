/* Conversion to RGB for AVX-512 (VBMI, VNNI): convert_avx2.c's scheme, 64 pixels a step, the sums in the multiply-adds and the three channels woven together by two byte permutations. */
#include <immintrin.h>
#include "runtime/kernels/convert.h"

#define INLINE static inline __attribute__((always_inline))

typedef struct { __m512i even, odd, c[3], add[3], weave[3]; } constants;
typedef struct { __m512i c[3]; } colours;

INLINE __m512i load(const void *p) { return _mm512_loadu_si512(p); }

/* Byte q of the 192 is channel q % 3 of pixel q / 3: index into R, from 64 on into G; B's is the same. */
#define W1(q) ((q) / 3 + ((q) % 3 == 1 ? 64 : 0))
#define W8(q) W1(q), W1(q + 1), W1(q + 2), W1(q + 3), W1(q + 4), W1(q + 5), W1(q + 6), W1(q + 7)
#define W64(q) W8(q), W8(q + 8), W8(q + 16), W8(q + 24), W8(q + 32), W8(q + 40), W8(q + 48), W8(q + 56)
static const uint8_t WEAVE[3][64] = { { W64(0) }, { W64(64) }, { W64(128) } };
static const uint64_t BLUE[3] = { 0x4924924924924924, 0x2492492492492492, 0x9249249249249249 };

INLINE constants prepare(const orl_yuv_tab *t)
{
    constants k = { .even = _mm512_set1_epi32(t->y), .odd = _mm512_set1_epi32((int)((uint32_t)t->y << 16)) };
    for (int c = 0; c < 3; c++) {
        k.c[c] = _mm512_set1_epi32((int)((uint32_t)t->c[c][1] << 16 | (uint16_t)t->c[c][0]));
        k.add[c] = _mm512_set1_epi32(4 * t->add[c]);
        k.weave[c] = load(WEAVE[c]);
    }
    return k;
}

INLINE colours convert32(const constants *k, __m512i y, __m512i ce, __m512i co)
{
    colours o;
    y = _mm512_slli_epi16(y, 2);
    for (int c = 0; c < 3; c++) {
        __m512i se = _mm512_dpwssd_epi32(k->add[c], _mm512_slli_epi16(ce, c == 2 ? 3 : 2), k->c[c]), so = _mm512_dpwssd_epi32(k->add[c], _mm512_slli_epi16(co, c == 2 ? 3 : 2), k->c[c]);
        o.c[c] = _mm512_mask_blend_epi16(0xaaaaaaaa, _mm512_srli_epi32(_mm512_dpwssd_epi32(se, y, k->even), 16), _mm512_dpwssd_epi32(so, y, k->odd));
    }
    return o;
}

/* a: pixels 0..7 of each 16, b the others. */
INLINE void store64(const constants *k, colours a, colours b, uint8_t *rgb)
{
    __m512i v[3];
    for (int c = 0; c < 3; c++) v[c] = _mm512_packus_epi16(a.c[c], b.c[c]);
    for (int j = 0; j < 3; j++)
        _mm512_storeu_si512(rgb + 64 * j, _mm512_mask_permutexvar_epi8(_mm512_permutex2var_epi8(v[0], k->weave[j], v[1]), BLUE[j], k->weave[j], v[2]));
}

/* Words U, V of pairs 0..3 of each 8, and the others: indices of their low bytes into U, from 64 on into V; high bytes are 0. */
#define C2(i) (i), 0, (i) + 64, 0
#define C8(i) C2(i), C2(i + 1), C2(i + 2), C2(i + 3)
static const uint8_t PAIR[2][64] = { { C8(0), C8(8), C8(16), C8(24) }, { C8(4), C8(12), C8(20), C8(28) } };

INLINE void step(const constants *k, __m512i y, __m512i c0, __m512i c1, uint8_t *rgb)
{
    const __m512i zero = _mm512_setzero_si512();
    store64(k, convert32(k, _mm512_unpacklo_epi8(y, zero), c0, c0), convert32(k, _mm512_unpackhi_epi8(y, zero), c1, c1), rgb);
}

void orl_convert_half_avx512(const uint8_t *const p[3], const orl_yuv_tab *t, int n, uint8_t *rgb)
{
    const constants k = prepare(t);
    const __m512i i0 = load(PAIR[0]), i1 = load(PAIR[1]);
    for (int i = 0; i < n; i += 64, rgb += 192) {
        __m512i u = _mm512_castsi256_si512(_mm256_loadu_si256((const __m256i *)(p[1] + i / 2))), v = _mm512_castsi256_si512(_mm256_loadu_si256((const __m256i *)(p[2] + i / 2)));
        step(&k, load(p[0] + i), _mm512_maskz_permutex2var_epi8(0x5555555555555555, u, i0, v), _mm512_maskz_permutex2var_epi8(0x5555555555555555, u, i1, v), rgb);
    }
}

void orl_convert_semi_avx512(const uint8_t *const p[3], const orl_yuv_tab *t, int n, uint8_t *rgb)
{
    const constants k = prepare(t);
    const __m512i zero = _mm512_setzero_si512();
    for (int i = 0; i < n; i += 64, rgb += 192) {
        __m512i c = load(p[1] + i);
        step(&k, load(p[0] + i), _mm512_unpacklo_epi8(c, zero), _mm512_unpackhi_epi8(c, zero), rgb);
    }
}

INLINE colours full32(const constants *k, __m512i y, __m512i u, __m512i v)
{
    return convert32(k, y, _mm512_mask_blend_epi16(0xaaaaaaaa, u, _mm512_slli_epi32(v, 16)), _mm512_mask_blend_epi16(0xaaaaaaaa, _mm512_srli_epi32(u, 16), v));
}

void orl_convert_full_avx512(const uint8_t *const p[3], const orl_yuv_tab *t, int n, uint8_t *rgb)
{
    const constants k = prepare(t);
    const __m512i zero = _mm512_setzero_si512();
    for (int i = 0; i < n; i += 64, rgb += 192) {
        __m512i y = load(p[0] + i), u = load(p[1] + i), v = load(p[2] + i);
        store64(&k, full32(&k, _mm512_unpacklo_epi8(y, zero), _mm512_unpacklo_epi8(u, zero), _mm512_unpacklo_epi8(v, zero)),
                full32(&k, _mm512_unpackhi_epi8(y, zero), _mm512_unpackhi_epi8(u, zero), _mm512_unpackhi_epi8(v, zero)), rgb);
    }
}

INLINE void packed(const uint8_t *p, const orl_yuv_tab *t, int n, uint8_t *rgb, int y_first)
{
    const constants k = prepare(t);
    const __m512i low = _mm512_set1_epi16(255);
    for (int i = 0; i < n; i += 64, rgb += 192) {
        __m512i x = load(p + 2 * i), y = load(p + 2 * i + 64), a = _mm512_shuffle_i64x2(x, y, 0x88), b = _mm512_shuffle_i64x2(x, y, 0xdd);
        __m512i a0 = _mm512_and_si512(a, low), a1 = _mm512_srli_epi16(a, 8), b0 = _mm512_and_si512(b, low), b1 = _mm512_srli_epi16(b, 8);
        if (y_first) store64(&k, convert32(&k, a0, a1, a1), convert32(&k, b0, b1, b1), rgb);
        else store64(&k, convert32(&k, a1, a0, a0), convert32(&k, b1, b0, b0), rgb);
    }
}

void orl_convert_yuyv_avx512(const uint8_t *const p[3], const orl_yuv_tab *t, int n, uint8_t *rgb) { packed(p[0], t, n, rgb, 1); }
void orl_convert_uyvy_avx512(const uint8_t *const p[3], const orl_yuv_tab *t, int n, uint8_t *rgb) { packed(p[0], t, n, rgb, 0); }

/* Byte q of the 192 comes from 2 (q / 3 * 3 + 1) - q, in the second vector of its pair from 64 on. */
#define S1(q, from) ((2 * ((q) / 3 * 3 + 1) - (q) - (from)) & 127)
#define S8(q, f) S1(q, f), S1(q + 1, f), S1(q + 2, f), S1(q + 3, f), S1(q + 4, f), S1(q + 5, f), S1(q + 6, f), S1(q + 7, f)
#define S64(q, f) S8(q, f), S8(q + 8, f), S8(q + 16, f), S8(q + 24, f), S8(q + 32, f), S8(q + 40, f), S8(q + 48, f), S8(q + 56, f)
static const uint8_t SWAP[3][64] = { { S64(0, 0) }, { S64(64, 0) }, { S64(128, 64) } };

void orl_convert_swap_avx512(const uint8_t *const p[3], const orl_yuv_tab *t, int n, uint8_t *rgb)
{
    (void)t;
    const __m512i s0 = load(SWAP[0]), s1 = load(SWAP[1]), s2 = load(SWAP[2]);
    const uint8_t *in = p[0];
    for (int i = 0; i < n; i += 64, in += 192, rgb += 192) {
        __m512i a = load(in), b = load(in + 64), c = load(in + 128);
        _mm512_storeu_si512(rgb, _mm512_permutex2var_epi8(a, s0, b));
        _mm512_storeu_si512(rgb + 64, _mm512_mask_permutexvar_epi8(_mm512_permutex2var_epi8(a, s1, b), (uint64_t)1 << 62, _mm512_setzero_si512(), c));
        _mm512_storeu_si512(rgb + 128, _mm512_permutex2var_epi8(b, s2, c));
    }
}
