/* Re-lighting and blending kernels: formats, ranges, tables, variants. The equations are oriel/light.h's and oriel/blend.h's; here they stand in integers.
 *
 * mul(a, b) is NEON's vqrdmulh on 16 bits (AVX2's mulhrs): (a b + 2^14) >> 15, b >= 0 throughout, so that the one case where the two differ never occurs.
 * q15(v) of a byte v is (v << 7) + (v >> 1): 255 -> 32767. add is saturating. x >>r k is a rounding shift: (x + 2^(k-1)) >> k, k = 0: x.
 *
 *   vis     h = horizon[i0] (256 - f) + horizon[i1] f                               Q8 of 1/255 quarter turn, 0 .. 65280
 *           d = clamp(sun - h, 0, ORL_VIS_SPAN), t = (d 20182 + 2^10) >> 11          Q15
 *           a = mul(t, t), v = a + 2 mul(a, 32767 - t), vis = min((v + 64) >> 7, 255)
 *   shadow  x = clamp((sum phi_k w_k >>r phi_shift) + phi_bias, 0, 32767)             Q11 of (argument + 8)
 *           s = LUT sigmoid(x >> 7, (x & 127) << 8)                                  Q15
 *   shade   E = mul(add(add(mul(sun_n, q15(vis)), mul(sky_n, q15(open))), ground_n), s)   Q k, irradiance / pi; palette entry of the normal
 *           c = clamp(albedo E >>r colour_shift, 1, 2^24 - 1)                        linear colour Q20, < 16
 *           e = LUT encode(16 log + mantissa's top 4 bits, next 15 bits)             Q13, 0 .. 3.3; log = floor(log2 c)
 *           y = sky_a + mul(sky_b - sky_a, ramp)                                     Q13, nodes clamped to [-0.5, 3.49]
 *           p = y + mul(e - y, q15(cov))                                             Q13
 *           rgb = clamp((sum tone_ck p_k + tone_b_c) >> 17, 0, 255)                  tone Q12 x 255/256, tone_b Q17 of a grey level, 2^16 for rounding included
 *   LUT(i, f) = base_i + mul(delta_i, f)
 *   mix     l_k = a_k + (2 (b_k - a_k) share >> 16)                                  correction of layer k between two cells, Q5 levels; shares Q15; x >> k rounds down
 *           r = clamp(render + ((l_0 + (2 (l_1 - l_0) q15(layer) >> 16) + 16) >> 5), 0, 255)
 *           m = photo weight + r (255 - weight) + 128, rgb = (m + (m >> 8)) >> 8     the quotient by 255, rounded: exact
 *
 * k is the largest of 4 .. 20 at which sun + sky + ground of no palette entry leaves 15 bits: a bright sun costs low bits of the shade, never saturates below 2000 x white.
 * All lengths are multiples of ORL_KERNEL_STEP, mix's of ORL_MIX_STEP; no kernel has a tail. Pointers need no alignment. Kernels write n items and nothing else. */
#ifndef RUNTIME_KERNELS_SHADE_H
#define RUNTIME_KERNELS_SHADE_H
#include <stdint.h>
#include "oriel/cpu.h"
#include "oriel/light.h"

enum {
    ORL_KERNEL_STEP = 16, ORL_MIX_STEP = 8,
    ORL_PAL_SIDE = 64, ORL_PAL = ORL_PAL_SIDE * ORL_PAL_SIDE,   /* entry of (i, j): j * 64 + i, direction orl_oct_dir((i + 0.5) / 32 - 1, (j + 0.5) / 32 - 1) */
    ORL_VIS_SPAN = 3325,                                        /* ORL_SUN_SOFT in units of h */
    ORL_ENCODE_KNOTS = 24 * 16, ORL_SIGMOID_KNOTS = 256,
    ORL_PHI_W_MAX = 16255,                                      /* w = 128 hi + lo with both in int8 */
};

typedef struct { int16_t base, delta; } orl_lut;                /* value at a knot, difference to the next */

typedef struct {
    int i0, i1;                     /* azimuths 0..15 on both sides of the sun */
    int f;                          /* 0..256 */
    int32_t sun;                    /* upper edge of the soft sun, units of h */
} orl_vis_tab;

typedef struct {
    int16_t pal[ORL_PAL][12];       /* sun R G B 0, sky R G B 0, ground R G B 0; Q k, >= 0 */
    orl_lut encode[ORL_ENCODE_KNOTS], sigmoid[ORL_SIGMOID_KNOTS];
    int16_t phi_w[ORL_SHADOW_DIM];
    int8_t phi_hi[2 * ORL_SHADOW_DIM], phi_lo[2 * ORL_SHADOW_DIM];      /* phi_w split, twice over (two pixels a vector) */
    int32_t phi_shift, phi_bias;    /* 0 .. 15; Q11 */
    int32_t colour_shift;           /* k - 4: 0 .. 16 */
    int16_t tone[3][4];             /* a row's absolute sum at most 32767; [3] is 0 */
    int32_t tone_b[3];              /* absolute value at most 2^30 - 2^17 */
} orl_shade_tab;

typedef struct {
    const uint16_t *normal, *albedo[3];
    const uint8_t *open, *cov, *vis;
    const int16_t *s;               /* from the shadow kernel */
    const int16_t (*sky)[4];        /* nodes of this row from the image's left edge, R G B 0 */
    int sky_log2;                   /* pixels between nodes: 4 .. 15 */
    int x;                          /* column of the first pixel, a multiple of ORL_KERNEL_STEP */
} orl_shade_in;

typedef struct {
    const int16_t (*cell)[3][2];    /* [cells + 1] of this row: corrections of sky and surface, Q5 levels, magnitudes at most 8160 */
    const uint8_t *cell_of;         /* of each ORL_MIX_STEP pixels: the cell a, b comes next */
    const int16_t *share;           /* [n] of b, Q15, 0..32767 */
    const uint8_t *layer, *weight;  /* [n] 0 sky .. 255 surface; of the photo */
    const uint8_t *photo;           /* [n][3] */
} orl_mix_in;

typedef struct {
    void (*vis)(const uint8_t *h0, const uint8_t *h1, const orl_vis_tab *t, int n, uint8_t *vis);      /* [n] of the azimuths i0 and i1 */
    void (*shadow)(const int8_t *phi, const orl_shade_tab *t, int n, int16_t *s);               /* phi [n][8] */
    void (*shade)(const orl_shade_in *in, const orl_shade_tab *t, int n, uint8_t *rgb);         /* rgb [n][3] */
    void (*mix)(const orl_mix_in *in, int n, uint8_t *rgb);                                     /* rgb [n][3]: the render, then the blend */
} orl_kernels;

/* C first, then what the flags allow. Flags of another architecture are ignored. */
void orl_kernels_init(orl_kernels *k, unsigned cpu);

/* One list for tests and benchmark: name as in --cpu=. */
#define ORL_KERNEL_VARIANTS(X) X("ref") X("avx2") X("avx512") X("neon") X("dotprod")

/* Instruction sets; private to the dispatch. */
void orl_vis_ref(const uint8_t *h0, const uint8_t *h1, const orl_vis_tab *t, int n, uint8_t *vis);
void orl_shadow_ref(const int8_t *phi, const orl_shade_tab *t, int n, int16_t *s);
void orl_shade_ref(const orl_shade_in *in, const orl_shade_tab *t, int n, uint8_t *rgb);
void orl_mix_ref(const orl_mix_in *in, int n, uint8_t *rgb);
void orl_vis_avx2(const uint8_t *h0, const uint8_t *h1, const orl_vis_tab *t, int n, uint8_t *vis);
void orl_vis_neon(const uint8_t *h0, const uint8_t *h1, const orl_vis_tab *t, int n, uint8_t *vis);
void orl_mix_avx2(const orl_mix_in *in, int n, uint8_t *rgb);
void orl_mix_neon(const orl_mix_in *in, int n, uint8_t *rgb);
void orl_shadow_avx2(const int8_t *phi, const orl_shade_tab *t, int n, int16_t *s);
void orl_shade_avx2(const orl_shade_in *in, const orl_shade_tab *t, int n, uint8_t *rgb);
void orl_shadow_neon(const int8_t *phi, const orl_shade_tab *t, int n, int16_t *s);
void orl_shade_neon(const orl_shade_in *in, const orl_shade_tab *t, int n, uint8_t *rgb);
void orl_shadow_dotprod(const int8_t *phi, const orl_shade_tab *t, int n, int16_t *s);
#endif
