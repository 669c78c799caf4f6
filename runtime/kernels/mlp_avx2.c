/* int8 networks for AVX2: mlp.h's arithmetic on 16-bit operands, the products of two inputs summed by vpmaddwd (vpmaddubsw would saturate). An accumulator holds 8 outputs of a sample. */
#include <immintrin.h>
#include <string.h>
#include "runtime/kernels/mlp.h"

#define INLINE static inline __attribute__((always_inline))
enum { ROWS = 4 };

/* 16 outputs of a sample, in their order but for the middle two quarters. */
INLINE __m256i narrow(__m256i lo, __m256i hi, const int32_t *shift, __m256i mul)
{
    lo = _mm256_srav_epi32(lo, _mm256_load_si256((const __m256i *)shift));
    hi = _mm256_srav_epi32(hi, _mm256_load_si256((const __m256i *)(shift + 8)));
    return _mm256_mulhrs_epi16(_mm256_packs_epi32(lo, hi), mul);
}

/* 16 outputs from column `o` on of ROWS samples. */
INLINE void columns(const orl_mlp *m, int k, int o, const int16_t *x, int16_t *h, int8_t *y, const int last)
{
    const int in = m->layer[k].in, out = m->layer[k].out;
    const int16_t *w = (const int16_t *)m->layer[k].w + o * in;
    const __m256i *bias = (const __m256i *)(m->layer[k].bias + o), *mul = (const __m256i *)(m->layer[k].mul + o);
    __m256i acc[ROWS][2], mv = _mm256_packs_epi32(_mm256_load_si256(mul), _mm256_load_si256(mul + 1));
#pragma GCC unroll 4
    for (int s = 0; s < ROWS; s++) { acc[s][0] = _mm256_load_si256(bias); acc[s][1] = _mm256_load_si256(bias + 1); }
    for (int g = 0; g < in; g += 2, w += 32) {
        __m256i w0 = _mm256_load_si256((const __m256i *)w), w1 = _mm256_load_si256((const __m256i *)(w + 16));
#pragma GCC unroll 4
        for (int s = 0; s < ROWS; s++) {
            int32_t two;
            memcpy(&two, x + s * in + g, 4);
            __m256i xv = _mm256_set1_epi32(two);
            acc[s][0] = _mm256_add_epi32(acc[s][0], _mm256_madd_epi16(xv, w0));
            acc[s][1] = _mm256_add_epi32(acc[s][1], _mm256_madd_epi16(xv, w1));
        }
    }
#pragma GCC unroll 4
    for (int s = 0; s < ROWS; s++) {
        __m256i u = narrow(acc[s][0], acc[s][1], m->layer[k].shift + o, mv);
        if (last) {
            u = _mm256_permute4x64_epi64(u, 0xd8);
            _mm_storeu_si128((__m128i *)(y + s * out + o), _mm_packs_epi16(_mm256_castsi256_si128(u), _mm256_extracti128_si256(u, 1)));
        } else {
            u = _mm256_min_epi16(_mm256_max_epi16(u, _mm256_setzero_si256()), _mm256_set1_epi16(255));
            _mm256_store_si256((__m256i *)(h + s * out + o), _mm256_permute4x64_epi64(u, 0xd8));
        }
    }
}

static void run_avx2(const orl_mlp *m, const int8_t *x, int n, int8_t *y)
{
    const int in = m->layer[0].in, end = m->layers - 1, out = m->layer[end].out;
    int16_t a[2][ORL_MLP_STEP * ORL_MLP_WIDTH] __attribute__((aligned(64)));
    for (int s = 0; s < n; s += ORL_MLP_STEP, x += ORL_MLP_STEP * in, y += ORL_MLP_STEP * out) {
        for (int i = 0; i < ORL_MLP_STEP * in; i += 16) _mm256_store_si256((__m256i *)(a[0] + i), _mm256_cvtepi8_epi16(_mm_loadu_si128((const __m128i *)(x + i))));
        for (int k = 0; k < end; k++) {
            for (int o = 0; o < m->layer[k].out; o += 16)
                for (int r = 0; r < ORL_MLP_STEP; r += ROWS) columns(m, k, o, a[k & 1] + r * m->layer[k].in, a[~k & 1] + r * m->layer[k].out, NULL, 0);
        }
        for (int o = 0; o < out; o += 16)
            for (int r = 0; r < ORL_MLP_STEP; r += ROWS) columns(m, end, o, a[end & 1] + r * m->layer[end].in, NULL, y + r * out, 1);
    }
}

static int64_t peak_avx2(int rounds)
{
#define DOT(r) "vpmaddwd %%ymm15, %%ymm15, %%ymm14\n\tvpaddd %%ymm14, %%ymm" #r ", %%ymm" #r "\n\t"
    for (int i = 0; i < rounds; i++)
        __asm__ volatile(DOT(0) DOT(1) DOT(2) DOT(3) DOT(4) DOT(5) DOT(6) DOT(7) : : : "xmm0", "xmm1", "xmm2", "xmm3", "xmm4", "xmm5", "xmm6", "xmm7", "xmm14");
#undef DOT
    return (int64_t)rounds * 8 * 16;
}

const orl_mlp_kernel orl_mlp_avx2 = { 16, 2, 2, 0, 0, run_avx2, peak_avx2 };
