/* int8 networks for NEON with dot product: mlp.h's arithmetic. An accumulator holds 4 outputs of a sample; 4 weights of each are multiplied by 4 inputs, a lane of the sample's vector. */
#include <arm_neon.h>
#include "runtime/kernels/mlp.h"

#define INLINE static inline __attribute__((always_inline))
enum { ROWS = 8 };

/* 8 outputs from column `o` on of ROWS samples. */
INLINE void columns(const orl_mlp *m, int k, int o, const int8_t *x, int8_t *y, const int last)
{
    const int in = m->layer[k].in, out = m->layer[k].out;
    const int8_t *w = (const int8_t *)m->layer[k].w + 4 * o;
    const int32_t *bias = m->layer[k].bias + o, *shift = m->layer[k].shift + o, *mul = m->layer[k].mul + o;
    int32x4_t acc[ROWS][2], right0 = vnegq_s32(vld1q_s32(shift)), right1 = vnegq_s32(vld1q_s32(shift + 4));
    int16x8_t mv = vcombine_s16(vmovn_s32(vld1q_s32(mul)), vmovn_s32(vld1q_s32(mul + 4)));
#pragma GCC unroll 8
    for (int s = 0; s < ROWS; s++) { acc[s][0] = vld1q_s32(bias); acc[s][1] = vld1q_s32(bias + 4); }
    for (int g = 0; g < in; g += 16) {
        int8x16_t xv[ROWS];
#pragma GCC unroll 8
        for (int s = 0; s < ROWS; s++) xv[s] = vld1q_s8(x + s * in + g);
#define STEP(lane) do { \
            int8x16_t w0 = vld1q_s8(w), w1 = vld1q_s8(w + 16); \
            w += 4 * out; \
            _Pragma("GCC unroll 8") \
            for (int s = 0; s < ROWS; s++) { acc[s][0] = vdotq_laneq_s32(acc[s][0], w0, xv[s], lane); acc[s][1] = vdotq_laneq_s32(acc[s][1], w1, xv[s], lane); } \
        } while (0)
        STEP(0); STEP(1); STEP(2); STEP(3);
#undef STEP
    }
#pragma GCC unroll 8
    for (int s = 0; s < ROWS; s++) {
        int16x8_t u = vqrdmulhq_s16(vqmovn_high_s32(vqmovn_s32(vshlq_s32(acc[s][0], right0)), vshlq_s32(acc[s][1], right1)), mv);
        vst1_s8(y + s * out + o, last ? vqmovn_s16(u) : veor_s8(vreinterpret_s8_u8(vqmovun_s16(u)), vdup_n_s8(-128)));
    }
}

static void run_dotprod(const orl_mlp *m, const int8_t *x, int n, int8_t *y)
{
    const int end = m->layers - 1;
    int8_t a[2][ROWS * ORL_MLP_WIDTH];
    for (int s = 0; s < n; s += ROWS, x += ROWS * m->layer[0].in, y += ROWS * m->layer[end].out) {
        const int8_t *from = x;
        for (int k = 0; k < end; k++, from = a[~k & 1])
            for (int o = 0; o < m->layer[k].out; o += 8) columns(m, k, o, from, a[k & 1], 0);
        for (int o = 0; o < m->layer[end].out; o += 8) columns(m, end, o, from, y, 1);
    }
}

static int64_t peak_dotprod(int rounds)
{
#define DOT(r) "sdot v" #r ".4s, v31.16b, v31.16b\n\t"
    for (int i = 0; i < rounds; i++)
        __asm__ volatile(DOT(0) DOT(1) DOT(2) DOT(3) DOT(4) DOT(5) DOT(6) DOT(7) DOT(16) DOT(17) DOT(18) DOT(19) DOT(20) DOT(21) DOT(22) DOT(23)
                         : : : "v0", "v1", "v2", "v3", "v4", "v5", "v6", "v7", "v16", "v17", "v18", "v19", "v20", "v21", "v22", "v23");
#undef DOT
    return (int64_t)rounds * 16 * 16;
}

const orl_mlp_kernel orl_mlp_dotprod = { 4, 1, 0, -128, run_dotprod, peak_dotprod };
