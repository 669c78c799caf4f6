/* int8 networks for NEON with dot product: mlp.h's arithmetic. An accumulator holds 4 outputs of a sample; 4 weights of each are multiplied by 4 inputs, a lane of the sample's vector. */
#include <arm_neon.h>
#include "runtime/kernels/mlp.h"

#define INLINE static inline __attribute__((always_inline))
enum { ROWS = 8 };

/* vdotq_laneq_s32, around which gcc 12 moves accumulators to other registers and to the stack. */
#define DOT(acc, w, x, lane) __asm__("sdot %0.4s, %1.16b, %2.4b[" #lane "]" : "+w"(acc) : "w"(w), "w"(x))

/* 8 outputs from column `o` on of ROWS samples. x: [in / 16][ROWS][16], as the tile lies between layers. */
INLINE void eight(const orl_mlp *m, int k, int o, const int8_t *x, int8_t *y, int y_stride, const int last)
{
    const int32_t *bias = m->layer[k].bias + o, *shift = m->layer[k].shift + o, *mul = m->layer[k].mul + o;
    const int8_t *w = (const int8_t *)m->layer[k].w + o * m->layer[k].in, *end = w + 8 * m->layer[k].in;
    int32x4_t acc[ROWS][2];
#pragma GCC unroll 8
    for (int s = 0; s < ROWS; s++) { acc[s][0] = vld1q_s32(bias); acc[s][1] = vld1q_s32(bias + 4); }
    do {
        int8x16_t xv[ROWS];
#pragma GCC unroll 8
        for (int s = 0; s < ROWS; s++) xv[s] = vld1q_s8(x + 16 * s);
#define STEP(lane) do { \
            int8x16_t w0 = vld1q_s8(w + 32 * lane), w1 = vld1q_s8(w + 32 * lane + 16); \
            _Pragma("GCC unroll 8") \
            for (int s = 0; s < ROWS; s++) { DOT(acc[s][0], w0, xv[s], lane); DOT(acc[s][1], w1, xv[s], lane); } \
        } while (0)
        STEP(0); STEP(1); STEP(2); STEP(3);
#undef STEP
        w += 128;
        x += 16 * ROWS;
    } while (w != end);
    const int32x4_t right0 = vnegq_s32(vld1q_s32(shift)), right1 = vnegq_s32(vld1q_s32(shift + 4));
    const int16x8_t mv = vcombine_s16(vmovn_s32(vld1q_s32(mul)), vmovn_s32(vld1q_s32(mul + 4)));
#pragma GCC unroll 8
    for (int s = 0; s < ROWS; s++) {
        int16x8_t u = vqrdmulhq_s16(vqmovn_high_s32(vqmovn_s32(vshlq_s32(acc[s][0], right0)), vshlq_s32(acc[s][1], right1)), mv);
        vst1_s8(y + s * y_stride, last ? vqmovn_s16(u) : veor_s8(vreinterpret_s8_u8(vqmovun_s16(u)), vdup_n_s8(-128)));
    }
}

#define RUN run_dotprod
#include "runtime/kernels/mlp_arm.h"

static int64_t peak_dotprod(int rounds)
{
#define ONE(r) "sdot v" #r ".4s, v31.16b, v31.16b\n\t"
    for (int i = 0; i < rounds; i++)
        __asm__ volatile(ONE(0) ONE(1) ONE(2) ONE(3) ONE(4) ONE(5) ONE(6) ONE(7) ONE(16) ONE(17) ONE(18) ONE(19) ONE(20) ONE(21) ONE(22) ONE(23)
                         : : : "v0", "v1", "v2", "v3", "v4", "v5", "v6", "v7", "v16", "v17", "v18", "v19", "v20", "v21", "v22", "v23");
#undef ONE
    return (int64_t)rounds * 16 * 16;
}

const orl_mlp_kernel orl_mlp_dotprod = { 8, 4, 1, 0, -128, run_dotprod, peak_dotprod };
