/* Small int8 networks: dense layers with a bias, ReLU between them, all layers of a tile of samples in one go. Formats, ranges, packing, variants.
 *
 * x >>r k is a rounding shift: (x + 2^(k-1)) >> k, k = 0: x. mul(a, b) is NEON's vqrdmulh on 16 bits (AVX2's mulhrs): (a b + 2^14) >> 15, b >= 0. sat16 saturates as vqmovn does.
 *
 *   acc = bias_o + sum_i w_oi x_i           int32
 *   u   = mul(sat16(acc >>r shift_o), mul_o)     int16; mul_o 2^-(15 + shift_o) is the layer's scale: input times weight over output
 *   h   = clamp(u, 0, 255)                  hidden layers: unsigned, ReLU and the whole of 8 bits
 *   y   = clamp(u, -128, 127)               last layer
 *
 * Inputs are int8 -128..127, weights -127..127 (so that two products fit into 16 bits with a sign), |bias| <= 2^30, shift 0..24, mul 0..32767, widths multiples of 16 up to 64: a sum of products is below 2^21,
 * one moved by 128 below 2^22, rounding adds 2^23 at most, and no partial sum in any order leaves 31 bits. A multiplier of 16 bits is enough: with mul as orl_mlp_scale chooses it, 2048 .. 4095 wherever
 * something is shifted out, a result within 0..255 is off acc scale by no more than 0.5 + mul / 2^16 + 255 / (2 mul) < 0.6, and sat16 bites where |u| > 2046 alone, which is clamped anyway.
 *
 * A network is packed once, for one variant: weights in the order that its dot product takes them, biases moved by what its operands are moved (vpdpbusd takes x + 128, sdot h - 128) and by the shift's rounding.
 * Samples are rows: x [n][in], y [n][out]; n a multiple of ORL_MLP_STEP. Pointers need no alignment, x and y do not overlap. Kernels write n rows and nothing else. */
#ifndef RUNTIME_KERNELS_MLP_H
#define RUNTIME_KERNELS_MLP_H
#include <stddef.h>
#include <stdint.h>
#include "oriel/cpu.h"

enum { ORL_MLP_STEP = 16, ORL_MLP_WIDTH = 64, ORL_MLP_LAYERS = 8, ORL_MLP_BIAS = 1 << 30, ORL_MLP_SHIFT = 24 };

typedef struct {
    int in, out;                /* multiples of 16, 16 .. ORL_MLP_WIDTH; a layer's in is the out of the one before */
    const int8_t *w;            /* [out][in] */
    const int32_t *bias;        /* [out] */
    const int16_t *mul;         /* [out] */
    const uint8_t *shift;       /* [out] */
} orl_mlp_layer;

typedef struct orl_mlp orl_mlp;

/* What a variant wants of packing. */
typedef struct {
    int block, group, bytes;    /* weights [out / block][in / group][block][group], each of so many bytes; block: no more than out */
    int first, hidden;          /* its operands are x + first, h + hidden */
    void (*run)(const orl_mlp *m, const int8_t *x, int n, int8_t *y);
    int64_t (*peak)(int rounds);    /* the bare dot product on registers: multiply-adds done, for the clock around it to tell this machine's peak. NULL: none */
} orl_mlp_kernel;

struct orl_mlp {
    const orl_mlp_kernel *kernel;
    int layers;
    struct { int in, out; const void *w; const int32_t *bias, *shift, *mul; } layer[ORL_MLP_LAYERS];      /* [out] each; 64-byte aligned */
};

/* The best that the flags allow. Flags of another architecture are ignored. */
const orl_mlp_kernel *orl_mlp_kernel_of(unsigned cpu);
/* Bytes of a packed network of these layers for any variant; widths and count alone are read. 0 if they are out of range. */
size_t orl_mlp_need(const orl_mlp_layer *l, int layers);
/* Packs into the caller's block, 64-byte aligned, of orl_mlp_need bytes; the layers may go afterwards. ORL_E_RANGE naming the layer and what in it is out of range; ORL_E_MEMORY. */
orl_err orl_mlp_pack(const orl_mlp_layer *l, int layers, unsigned cpu, void *block, size_t size, const orl_mlp **out);
static inline void orl_mlp_run(const orl_mlp *m, const int8_t *x, int n, int8_t *y) { m->kernel->run(m, x, n, y); }
/* mul and shift of a scale in [0, 1): shift 0 from 1/16 up, mul 2048 .. 4095 from 2^-28 up, below that what is left. */
void orl_mlp_scale(double scale, int16_t *mul, uint8_t *shift);

/* Instruction sets; private to the dispatch. */
extern const orl_mlp_kernel orl_mlp_ref, orl_mlp_avx2, orl_mlp_avx512, orl_mlp_neon, orl_mlp_dotprod;
#endif
