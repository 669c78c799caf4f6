/* int8 networks for NEON: mlp.h's arithmetic. 16 weights of an output are multiplied by 16 inputs of a sample, two products a 16-bit sum (2 * 128 * 127 fits), those added in pairs to 32 bits. */
#include <arm_neon.h>
#include "runtime/kernels/mlp.h"

#define INLINE static inline __attribute__((always_inline))
enum { ROWS = 4 };

/* 16 inputs of a sample into 4 outputs: acc + ..., or acc = ... the first time. Written out, as gcc 12 moves accumulators to other registers and to the stack around the intrinsics;
 * four of a kind in a row, as a core that works in order waits for what it needs. */
INLINE void dot16(int32x4_t acc[4], const int8x16_t w[4], int8x16_t x, const int first)
{
#define EACH(op) op(4, 8) op(5, 9) op(6, 10) op(7, 11)
#define LOW(t, w) "smull %" #t ".8h, %" #w ".8b, %12.8b\n\t"
#define HIGH(t, w) "smlal2 %" #t ".8h, %" #w ".16b, %12.16b\n\t"
    int16x8_t t[4];
    if (first) __asm__(EACH(LOW) EACH(HIGH) "saddlp %0.4s, %4.8h\n\tsaddlp %1.4s, %5.8h\n\tsaddlp %2.4s, %6.8h\n\tsaddlp %3.4s, %7.8h"
                       : "=&w"(acc[0]), "=&w"(acc[1]), "=&w"(acc[2]), "=&w"(acc[3]), "=&w"(t[0]), "=&w"(t[1]), "=&w"(t[2]), "=&w"(t[3]) : "w"(w[0]), "w"(w[1]), "w"(w[2]), "w"(w[3]), "w"(x));
    else __asm__(EACH(LOW) EACH(HIGH) "sadalp %0.4s, %4.8h\n\tsadalp %1.4s, %5.8h\n\tsadalp %2.4s, %6.8h\n\tsadalp %3.4s, %7.8h"
                 : "+w"(acc[0]), "+w"(acc[1]), "+w"(acc[2]), "+w"(acc[3]), "=&w"(t[0]), "=&w"(t[1]), "=&w"(t[2]), "=&w"(t[3]) : "w"(w[0]), "w"(w[1]), "w"(w[2]), "w"(w[3]), "w"(x));
#undef EACH
#undef LOW
#undef HIGH
}

/* 16 inputs of ROWS samples into 4 outputs. */
INLINE void step(int32x4_t acc[ROWS][4], const int8_t *w, const int8_t *x, const int first)
{
    int8x16_t wv[4];
#pragma GCC unroll 4
    for (int c = 0; c < 4; c++) wv[c] = vld1q_s8(w + 16 * c);
#pragma GCC unroll 4
    for (int s = 0; s < ROWS; s++) dot16(acc[s], wv, vld1q_s8(x + 16 * s), first);
}

/* 4 outputs from column `o` on of ROWS samples, shifted. x: [in / 16][ROWS][16], as the tile lies between layers. */
INLINE void columns(const orl_mlp *m, int k, int o, const int8_t *x, int32x4_t t[ROWS])
{
    const int8_t *w = (const int8_t *)m->layer[k].w + o * m->layer[k].in, *end = w + 4 * m->layer[k].in;
    const int32x4_t bias = vld1q_s32(m->layer[k].bias + o), right = vnegq_s32(vld1q_s32(m->layer[k].shift + o));
    int32x4_t acc[ROWS][4];
    step(acc, w, x, 1);
    while ((w += 64) != end) step(acc, w, x += 16 * ROWS, 0);
#pragma GCC unroll 4
    for (int s = 0; s < ROWS; s++) {
        int32x4_t sum = vpaddq_s32(vpaddq_s32(acc[s][0], acc[s][1]), vpaddq_s32(acc[s][2], acc[s][3]));
        t[s] = vshlq_s32(vaddq_s32(sum, bias), right);
    }
}

/* 8 outputs of ROWS samples. */
INLINE void eight(const orl_mlp *m, int k, int o, const int8_t *x, int8_t *y, int y_stride, const int last)
{
    const int32_t *mul = m->layer[k].mul + o;
    int32x4_t t[ROWS];
    int16x4_t lo[ROWS];
    columns(m, k, o, x, t);
#pragma GCC unroll 4
    for (int s = 0; s < ROWS; s++) lo[s] = vqmovn_s32(t[s]);
    columns(m, k, o + 4, x, t);
    const int16x8_t mv = vcombine_s16(vmovn_s32(vld1q_s32(mul)), vmovn_s32(vld1q_s32(mul + 4)));
#pragma GCC unroll 4
    for (int s = 0; s < ROWS; s++) {
        int16x8_t u = vqrdmulhq_s16(vqmovn_high_s32(lo[s], t[s]), mv);
        vst1_s8(y + s * y_stride, last ? vqmovn_s16(u) : veor_s8(vreinterpret_s8_u8(vqmovun_s16(u)), vdup_n_s8(-128)));
    }
}

#define RUN run_neon
#include "runtime/kernels/mlp_arm.h"

static int64_t peak_neon(int rounds)
{
#define EACH(op) op(0, 16) op(1, 17) op(2, 18) op(3, 19) op(4, 20) op(5, 21) op(6, 22) op(7, 23)
#define LOW(acc, t) "smull v" #t ".8h, v31.8b, v31.8b\n\t"
#define HIGH(acc, t) "smlal2 v" #t ".8h, v31.16b, v31.16b\n\t"
#define ADD(acc, t) "sadalp v" #acc ".4s, v" #t ".8h\n\t"
    for (int i = 0; i < rounds; i++)
        __asm__ volatile(EACH(LOW) EACH(HIGH) EACH(ADD) : : : "v0", "v1", "v2", "v3", "v4", "v5", "v6", "v7", "v16", "v17", "v18", "v19", "v20", "v21", "v22", "v23");
#undef EACH
#undef LOW
#undef HIGH
#undef ADD
    return (int64_t)rounds * 8 * 16;
}

const orl_mlp_kernel orl_mlp_neon = { 4, 16, 1, 0, -128, run_neon, peak_neon };
