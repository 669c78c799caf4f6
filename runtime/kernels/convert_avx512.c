/* Conversion to RGB for AVX-512 (VBMI, VNNI): convert_avx2.c's scheme, 64 pixels a step. Word permutations collect the upper halves, byte permutations weave the channels. */
#include <immintrin.h>
#include "runtime/kernels/convert.h"

#define INLINE static inline __attribute__((always_inline))

typedef struct { __m512i even, odd, c[3], add[3], weave[3], merge; } constants;
typedef struct { __m512i c[3]; } colours;

INLINE __m512i load(const void *p) { return _mm512_loadu_si512(p); }

/* Byte q of the 192 is channel q % 3 of pixel q / 3. R and G of pixel x of a half's 32 stand in one vector at 16 (x / 8) + x % 8 and 8 behind, B of both halves likewise in another.
 * The first and the last 64 come from their half's and, from index 64 on, from blue's; those between from the two halves' (64: the second's), and from blue's where MIDDLE says so. */
#define PX(q) ((q) / 3 % 32 / 8 * 16 + (q) / 3 % 8)
#define W1(q) (PX(q) + ((q) % 3 == 0 ? 0 : (q) % 3 == 1 ? 8 : (q) < 96 ? 64 : 72))
#define M1(q) ((q) % 3 == 2 ? W1(q) - 64 : W1(q) + ((q) < 96 ? 0 : 64))
#define C8(f, q) f(q), f(q + 1), f(q + 2), f(q + 3), f(q + 4), f(q + 5), f(q + 6), f(q + 7)
#define C64(f, q) C8(f, q), C8(f, q + 8), C8(f, q + 16), C8(f, q + 24), C8(f, q + 32), C8(f, q + 40), C8(f, q + 48), C8(f, q + 56)
static const uint8_t WEAVE[3][64] = { { C64(W1, 0) }, { C64(M1, 64) }, { C64(W1, 128) } };
static const uint64_t MIDDLE = 0x2492492492492492;

/* Upper words of the even pixels' sums and, from index 32 on, of the odd ones'. */
#define H1(i) ((i) % 2 * 32 + (i) / 2 * 2 + 1)
static const uint16_t MERGE[32] = { C8(H1, 0), C8(H1, 8), C8(H1, 16), C8(H1, 24) };

INLINE constants prepare(const orl_yuv_tab *t)
{
    constants k = { .merge = load(MERGE), .even = _mm512_set1_epi32(t->y), .odd = _mm512_set1_epi32((int)((uint32_t)t->y << 16)) };
    for (int c = 0; c < 3; c++) {
        k.c[c] = _mm512_set1_epi32((int)((uint32_t)t->c[c][1] << 16 | (uint16_t)t->c[c][0]));
        k.add[c] = _mm512_set1_epi32(4 * t->add[c]);
        k.weave[c] = load(WEAVE[c]);
    }
    return k;
}

/* Chroma of the even and the odd pixels, or of both, four and eight times. */
typedef struct { __m512i four, eight; } chroma;

INLINE chroma scaled(__m512i c) { return (chroma) { _mm512_slli_epi16(c, 2), _mm512_slli_epi16(c, 3) }; }

/* y: four times. */
INLINE colours convert32(const constants *k, __m512i y, chroma ce, chroma co)
{
    colours o;
    __m512i e = _mm512_madd_epi16(y, k->even), d = _mm512_madd_epi16(y, k->odd);
    for (int c = 0; c < 3; c++) {
        __m512i se = _mm512_dpwssd_epi32(k->add[c], c == 2 ? ce.eight : ce.four, k->c[c]), so = _mm512_dpwssd_epi32(k->add[c], c == 2 ? co.eight : co.four, k->c[c]);
        o.c[c] = _mm512_permutex2var_epi16(_mm512_add_epi32(se, e), k->merge, _mm512_add_epi32(so, d));
    }
    return o;
}

/* a: pixels 0..31, b: 32..63. */
INLINE void store64(const constants *k, colours a, colours b, uint8_t *rgb)
{
    __m512i rg_a = _mm512_packus_epi16(a.c[0], a.c[1]), rg_b = _mm512_packus_epi16(b.c[0], b.c[1]), blue = _mm512_packus_epi16(a.c[2], b.c[2]);
    _mm512_storeu_si512(rgb, _mm512_permutex2var_epi8(rg_a, k->weave[0], blue));
    _mm512_storeu_si512(rgb + 64, _mm512_mask_permutexvar_epi8(_mm512_permutex2var_epi8(rg_a, k->weave[1], rg_b), MIDDLE, k->weave[1], blue));
    _mm512_storeu_si512(rgb + 128, _mm512_permutex2var_epi8(rg_b, k->weave[2], blue));
}

/* 32 bytes as words. */
INLINE __m512i words(const uint8_t *p) { return _mm512_cvtepu8_epi16(_mm256_loadu_si256((const __m256i *)p)); }

/* Words U, V of 16 pairs, from the low or the high half of 32 bytes each: indices of their low bytes into U, from 64 on into V; high bytes are 0. */
#define P1(i) ((i) / 2 % 2 * 64 + (i) / 4)
static const uint8_t PAIR[2][64] = { { C64(P1, 0) }, { C64(P1, 64) } };

INLINE void step(const constants *k, const uint8_t *y, __m512i c0, __m512i c1, uint8_t *rgb)
{
    chroma s0 = scaled(c0), s1 = scaled(c1);
    store64(k, convert32(k, _mm512_slli_epi16(words(y), 2), s0, s0), convert32(k, _mm512_slli_epi16(words(y + 32), 2), s1, s1), rgb);
}

void orl_convert_half_avx512(const uint8_t *const p[3], const orl_yuv_tab *t, int n, uint8_t *rgb)
{
    const constants k = prepare(t);
    const __m512i i0 = load(PAIR[0]), i1 = load(PAIR[1]);
    for (int i = 0; i < n; i += 64, rgb += 192) {
        __m512i u = _mm512_castsi256_si512(_mm256_loadu_si256((const __m256i *)(p[1] + i / 2))), v = _mm512_castsi256_si512(_mm256_loadu_si256((const __m256i *)(p[2] + i / 2)));
        step(&k, p[0] + i, _mm512_maskz_permutex2var_epi8(0x5555555555555555, u, i0, v), _mm512_maskz_permutex2var_epi8(0x5555555555555555, u, i1, v), rgb);
    }
}

void orl_convert_semi_avx512(const uint8_t *const p[3], const orl_yuv_tab *t, int n, uint8_t *rgb)
{
    const constants k = prepare(t);
    for (int i = 0; i < n; i += 64, rgb += 192) step(&k, p[0] + i, words(p[1] + i), words(p[1] + i + 32), rgb);
}

INLINE colours full32(const constants *k, __m512i y, __m512i u, __m512i v)
{
    return convert32(k, _mm512_slli_epi16(y, 2), scaled(_mm512_mask_blend_epi16(0xaaaaaaaa, u, _mm512_slli_epi32(v, 16))), scaled(_mm512_mask_blend_epi16(0xaaaaaaaa, _mm512_srli_epi32(u, 16), v)));
}

void orl_convert_full_avx512(const uint8_t *const p[3], const orl_yuv_tab *t, int n, uint8_t *rgb)
{
    const constants k = prepare(t);
    for (int i = 0; i < n; i += 64, rgb += 192)
        store64(&k, full32(&k, words(p[0] + i), words(p[1] + i), words(p[2] + i)), full32(&k, words(p[0] + i + 32), words(p[1] + i + 32), words(p[2] + i + 32)), rgb);
}

/* Multiply-add of bytes takes luma or chroma out of the words and scales it at once. */
INLINE void packed(const uint8_t *p, const orl_yuv_tab *t, int n, uint8_t *rgb, int y_first)
{
    const constants k = prepare(t);
    const __m512i y4 = _mm512_set1_epi16(y_first ? 4 : 4 << 8), c4 = _mm512_set1_epi16(y_first ? 4 << 8 : 4), c8 = _mm512_set1_epi16(y_first ? 8 << 8 : 8);
    for (int i = 0; i < n; i += 64, rgb += 192) {
        __m512i a = load(p + 2 * i), b = load(p + 2 * i + 64);
        chroma ca = { _mm512_maddubs_epi16(a, c4), _mm512_maddubs_epi16(a, c8) }, cb = { _mm512_maddubs_epi16(b, c4), _mm512_maddubs_epi16(b, c8) };
        store64(&k, convert32(&k, _mm512_maddubs_epi16(a, y4), ca, ca), convert32(&k, _mm512_maddubs_epi16(b, y4), cb, cb), rgb);
    }
}

void orl_convert_yuyv_avx512(const uint8_t *const p[3], const orl_yuv_tab *t, int n, uint8_t *rgb) { packed(p[0], t, n, rgb, 1); }
void orl_convert_uyvy_avx512(const uint8_t *const p[3], const orl_yuv_tab *t, int n, uint8_t *rgb) { packed(p[0], t, n, rgb, 0); }

/* Byte q of the 192 comes from 2 (q / 3 * 3 + 1) - q, in the second vector of its pair from 64 on. */
#define S1(q, from) ((2 * ((q) / 3 * 3 + 1) - (q) - (from)) & 127)
#define S0(q) S1(q, 0)
#define S2(q) S1(q, 64)
static const uint8_t SWAP[3][64] = { { C64(S0, 0) }, { C64(S0, 64) }, { C64(S2, 128) } };

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
