/* int8 networks for NEON: mlp.h's arithmetic. 16 weights of an output are multiplied by 16 inputs of a sample, two products a 16-bit sum (2 * 128 * 127 fits), those added in pairs to 32 bits. */
#include <arm_neon.h>
#include "runtime/kernels/mlp.h"

#define INLINE static inline __attribute__((always_inline))
enum { ROWS = 4 };

INLINE int32x4_t dot16(int32x4_t acc, int8x16_t w, int8x16_t x)
{
    return vpadalq_s16(acc, vmlal_high_s8(vmull_s8(vget_low_s8(w), vget_low_s8(x)), w, x));
}

/* 4 outputs from column `o` on of ROWS samples, in int16. */
INLINE void columns(const orl_mlp *m, int k, int o, const int8_t *x, int16x4_t u[ROWS])
{
    const int in = m->layer[k].in;
    const int8_t *w = (const int8_t *)m->layer[k].w + o * in;
    const int32x4_t bias = vld1q_s32(m->layer[k].bias + o), right = vnegq_s32(vld1q_s32(m->layer[k].shift + o));
    const int16x4_t mul = vmovn_s32(vld1q_s32(m->layer[k].mul + o));
    int32x4_t acc[ROWS][4];
#pragma GCC unroll 16
    for (int i = 0; i < 4 * ROWS; i++) acc[i / 4][i % 4] = vdupq_n_s32(0);
    for (int g = 0; g < in; g += 16) {
        int8x16_t wv[4];
#pragma GCC unroll 4
        for (int c = 0; c < 4; c++) wv[c] = vld1q_s8(w + c * in + g);
#pragma GCC unroll 4
        for (int s = 0; s < ROWS; s++) {
            int8x16_t xv = vld1q_s8(x + s * in + g);
#pragma GCC unroll 4
            for (int c = 0; c < 4; c++) acc[s][c] = dot16(acc[s][c], wv[c], xv);
        }
    }
#pragma GCC unroll 4
    for (int s = 0; s < ROWS; s++) {
        int32x4_t sum = vpaddq_s32(vpaddq_s32(acc[s][0], acc[s][1]), vpaddq_s32(acc[s][2], acc[s][3]));
        u[s] = vqrdmulh_s16(vqmovn_s32(vshlq_s32(vaddq_s32(sum, bias), right)), mul);
    }
}

INLINE void layer(const orl_mlp *m, int k, const int8_t *x, int8_t *y, const int last)
{
    const int out = m->layer[k].out;
    for (int o = 0; o < out; o += 8) {
        int16x4_t lo[ROWS], hi[ROWS];
        columns(m, k, o, x, lo);
        columns(m, k, o + 4, x, hi);
#pragma GCC unroll 4
        for (int s = 0; s < ROWS; s++) {
            int16x8_t u = vcombine_s16(lo[s], hi[s]);
            vst1_s8(y + s * out + o, last ? vqmovn_s16(u) : veor_s8(vreinterpret_s8_u8(vqmovun_s16(u)), vdup_n_s8(-128)));
        }
    }
}

static void run_neon(const orl_mlp *m, const int8_t *x, int n, int8_t *y)
{
    const int end = m->layers - 1;
    int8_t a[2][ROWS * ORL_MLP_WIDTH];
    for (int s = 0; s < n; s += ROWS, x += ROWS * m->layer[0].in, y += ROWS * m->layer[end].out) {
        const int8_t *from = x;
        for (int k = 0; k < end; k++, from = a[~k & 1]) layer(m, k, from, a[k & 1], 0);
        layer(m, end, from, y, 1);
    }
}

static int64_t peak_neon(int rounds)
{
#define DOT(r, t) "smull v" #t ".8h, v31.8b, v31.8b\n\tsmlal2 v" #t ".8h, v31.16b, v31.16b\n\tsadalp v" #r ".4s, v" #t ".8h\n\t"
    for (int i = 0; i < rounds; i++)
        __asm__ volatile(DOT(0, 16) DOT(1, 17) DOT(2, 18) DOT(3, 19) DOT(4, 20) DOT(5, 21) DOT(6, 22) DOT(7, 23)
                         : : : "v0", "v1", "v2", "v3", "v4", "v5", "v6", "v7", "v16", "v17", "v18", "v19", "v20", "v21", "v22", "v23");
#undef DOT
    return (int64_t)rounds * 8 * 16;
}

const orl_mlp_kernel orl_mlp_neon = { 0, 1, 0, -128, run_neon, peak_neon };
