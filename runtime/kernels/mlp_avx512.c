/* int8 networks for AVX-512 with VNNI: mlp.h's arithmetic. An accumulator holds 16 outputs of a sample; 4 weights of each are multiplied by 4 broadcast inputs. */
#include <immintrin.h>
#include <string.h>
#include "runtime/kernels/mlp.h"

#define INLINE static inline __attribute__((always_inline))

/* _mm512_dpbusd_epi32, around which gcc 12 moves every accumulator to another register and back. */
INLINE __m512i dot(__m512i acc, __m512i x, __m512i w)
{
    __asm__("vpdpbusd %2, %1, %0" : "+v"(acc) : "v"(x), "v"(w));
    return acc;
}

/* Four accumulators to 64 bytes in their order. The packs work within 128 bits, which leaves a matrix of dwords to transpose. */
INLINE __m512i narrow(const __m512i *acc, const __m512i shift[4], __m512i mul01, __m512i mul23, int last)
{
    const __m512i transpose = _mm512_setr_epi32(0, 4, 8, 12, 1, 5, 9, 13, 2, 6, 10, 14, 3, 7, 11, 15);
    __m512i a = _mm512_packs_epi32(_mm512_srav_epi32(acc[0], shift[0]), _mm512_srav_epi32(acc[1], shift[1]));
    __m512i b = _mm512_packs_epi32(_mm512_srav_epi32(acc[2], shift[2]), _mm512_srav_epi32(acc[3], shift[3]));
    a = _mm512_mulhrs_epi16(a, mul01);
    b = _mm512_mulhrs_epi16(b, mul23);
    return _mm512_permutexvar_epi32(transpose, last ? _mm512_packs_epi16(a, b) : _mm512_packus_epi16(a, b));
}

/* A layer of 16 `vectors` outputs on 16 samples, some at a time: accumulators enough to hide a latency, and a multiple of 4. Loops that have to unroll count to constants: clang leaves others. */
INLINE void layer(const orl_mlp *m, int k, const uint8_t *x, uint8_t *y, const int vectors, const int last)
{
    const int samples = vectors == 1 ? 16 : vectors == 2 ? 8 : 4, in = m->layer[k].in;
    const int32_t *bias = m->layer[k].bias, *shift = m->layer[k].shift, *mul = m->layer[k].mul;
    for (int from = 0; from < ORL_MLP_STEP; from += samples, x += samples * in) {
        const int8_t *w = m->layer[k].w;
        __m512i acc[16];
#pragma GCC unroll 16
        for (int i = 0; i < 16; i++) acc[i] = _mm512_load_si512(bias + 16 * (i % vectors));
        for (int g = 0; g < in; g += 4, w += 64 * vectors) {
            __m512i wv[4];
#pragma GCC unroll 4
            for (int v = 0; v < 4; v++) if (v < vectors) wv[v] = _mm512_load_si512(w + 64 * v);
#pragma GCC unroll 16
            for (int i = 0; i < 16; i++) {
                if (i >= samples) continue;
                int32_t four;
                memcpy(&four, x + i * in + g, 4);
                __m512i xv = _mm512_set1_epi32(four);
#pragma GCC unroll 4
                for (int v = 0; v < 4; v++) if (v < vectors) acc[i * vectors + v] = dot(acc[i * vectors + v], xv, wv[v]);
            }
        }
#pragma GCC unroll 4
        for (int q = 0; q < 4; q++) {
            if (4 * q >= samples * vectors) continue;
            __m512i sv[4], mv[4];
#pragma GCC unroll 4
            for (int i = 0; i < 4; i++) {
                sv[i] = _mm512_load_si512(shift + 16 * ((4 * q + i) % vectors));
                mv[i] = _mm512_load_si512(mul + 16 * ((4 * q + i) % vectors));
            }
            _mm512_storeu_si512(y, narrow(acc + 4 * q, sv, _mm512_packs_epi32(mv[0], mv[1]), _mm512_packs_epi32(mv[2], mv[3]), last));
            y += 64;
        }
    }
}

INLINE void any(const orl_mlp *m, int k, const uint8_t *x, uint8_t *y, const int last)
{
    switch (m->layer[k].out / 16) {
    case 1: layer(m, k, x, y, 1, last); break;
    case 2: layer(m, k, x, y, 2, last); break;
    case 3: layer(m, k, x, y, 3, last); break;
    default: layer(m, k, x, y, 4, last);
    }
}

static void run_avx512(const orl_mlp *m, const int8_t *x, int n, int8_t *y)
{
    const int in = m->layer[0].in, end = m->layers - 1, out = m->layer[end].out;
    uint8_t a[2][ORL_MLP_STEP * ORL_MLP_WIDTH] __attribute__((aligned(64)));
    for (int s = 0; s < n; s += ORL_MLP_STEP, x += ORL_MLP_STEP * in, y += ORL_MLP_STEP * out) {
        for (int i = 0; i < ORL_MLP_STEP * in; i += 64) _mm512_store_si512(a[0] + i, _mm512_xor_si512(_mm512_loadu_si512(x + i), _mm512_set1_epi8(-128)));       /* x + 128 */
        for (int k = 0; k < end; k++) any(m, k, a[k & 1], a[~k & 1], 0);
        any(m, end, a[end & 1], (uint8_t *)y, 1);
    }
}

static int64_t peak_avx512(int rounds)
{
#define DOT(r) "vpdpbusd %%zmm31, %%zmm31, %%zmm" #r "\n\t"
    for (int i = 0; i < rounds; i++)
        __asm__ volatile(DOT(0) DOT(1) DOT(2) DOT(3) DOT(4) DOT(5) DOT(6) DOT(7) DOT(8) DOT(9) DOT(10) DOT(11) DOT(12) DOT(13) DOT(14) DOT(15)
                         : : : "xmm0", "xmm1", "xmm2", "xmm3", "xmm4", "xmm5", "xmm6", "xmm7", "xmm8", "xmm9", "xmm10", "xmm11", "xmm12", "xmm13", "xmm14", "xmm15");
#undef DOT
    return (int64_t)rounds * 16 * 64;
}

const orl_mlp_kernel orl_mlp_avx512 = { 64, 4, 1, 128, 0, run_avx512, peak_avx512 };
