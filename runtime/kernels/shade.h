/* Re-lighting and blending kernels: formats, ranges, tables, variants. The equations are oriel/light.h's and oriel/blend.h's; here they stand in 16-bit integers, without a table that memory would have to be asked for.
 *
 * mul(a, b) is NEON's vqrdmulh on 16 bits (AVX2's mulhrs): (a b + 2^14) >> 15; it is never asked for -32768 times itself, the one case where the two differ. Sums wrap to 16 bits, +| saturates: tables that are made for a light leave no sum of real pixels beyond 16 bits, so only what a file invents can wrap.
 * part(v, b) of a byte v is v b >> 8, rounded down (NEON's vqdmulh of 128 v).
 * x >>r k is a rounding shift: (x + 2^(k-1)) >> k, k = 0: x.
 *
 *   lit(p, edge)  h = p[0] (256 - f) + p[1] f                                     Q8 of 1/255 quarter turn, 0 .. 65280
 *           but where p[0] and p[1] are more than `apart` from each other, 256 p[f >= 128]: not a slope, an edge, put halfway
 *           d = clamp(edge - h, 0, ORL_VIS_SPAN), t = 2 mul(8 d, 20182)           Q15, at most 32766
 *           a = mul(t, t), m = mul(a, 32767 - t), a +| m +| m                     smoothstep, Q15
 *   vis     lit(horizon, over), and where there are ceilings mul(that, lit(ceiling, under)), and where a sun was traced max(that +| 258 fix, 0)
 *   shadow  x = clamp((sum phi_k w_k >>r phi_shift) + phi_bias, 0, 32767)         Q11 of (argument + 8)
 *           s = shadow_0[i] + mul(t, shadow_1[i] + mul(t, shadow_2[i])), i = x >> 11, t = (x & 2047) << 4       sigmoid^(5/12), Q15
 *   shade   x, y, z = 256 normal                                                  Q15 of 127/128
 *           sun = mul(max(mul(x, d_0) + mul(y, d_1) + mul(z, d_2), 0), vis)
 *           sky_c = max(k_0 + mul(k_1, x) + mul(k_2, y) + .. mul(k_8, mul(z, z)), 0)        of 1, x, y, z, xy, yz, zx, xx - yy, zz (the same mul)
 *           E_c = max(mul(sun_c, sun) + part(open, sky_c) + (g_0c - mul(g_1c, z)), 2)    Q k, irradiance / pi
 *           P = power(E): log = floor(log2 E), t = (E << (15 - log)) - 2^16, mul(c_0 + mul(t, c_1 + mul(t, c_2 + mul(t, c_3))), factor[log - 1])       E^(5/12), Q15 of its greatest
 *           u = min(mul(part(albedo_c, mul(s, gain)), P), ORL_U_MAX >> gain_shift) << gain_shift   1.055 colour^(5/12), Q13
 *           w = 32 min(u, ORL_TOE), e = max(u - ORL_TOE_LINE, mul(mul(w, w), ORL_TOE_2 + mul(w, ORL_TOE_3)))   sRGB encoding, Q13, 0 .. 3.3
 *           y = node_a + mul(node_b - node_a, ramp)                               Q13, sky, nodes clamped to [-0.5, 3.49]
 *           p = cov = 255: e, else y + mul(e - y, 128 cov + (cov >> 1))           Q13
 *           rgb = clamp((tone_b_c + mul(tone_c0, p_0) + mul(tone_c1, p_1) + mul(tone_c2, p_2)) >> tone_shift, 0, 255)     in this order
 *   warp    V_i = (sum_j photo_ij row_j) >> 1, rgb = min((sum_i mul(V_i, column_i) + 64) >> 7, 255)       mean of the photo over a box; rows' shares Q8, columns' Q15
 *   mix     l_k = node_a + mul(node_b - node_a, ramp)                             correction of layer k, Q5 levels
 *           r = clamp(render + ((l_0 + mul(l_1 - l_0, 128 layer + (layer >> 1)) + 16) >> 5), 0, 255)
 *           m = photo weight + r (255 - weight) + 128, rgb = (m + (m >> 8)) >> 8  the quotient by 255, rounded: exact
 *
 * k is the largest of 4 .. 20 at which sun + sky + ground of no direction leaves 15 bits: a bright sun costs low bits of the shade, never saturates below 2000 x white.
 * vis and shadow are 0 in runs of ORL_KERNEL_STEP pixels that have no surface (cov = 0): of sky nothing is read but that.
 * All lengths but warp's are multiples of ORL_KERNEL_STEP; no kernel has a tail. Pointers need no alignment. Kernels write n items and nothing else. Of nodes, three more words than are asked for are read. */
#ifndef RUNTIME_KERNELS_SHADE_H
#define RUNTIME_KERNELS_SHADE_H
#include <stdint.h>
#include "oriel/cpu.h"
#include "oriel/light.h"

enum {
    ORL_KERNEL_STEP = 32, ORL_NODES_MORE = 3, ORL_AHEAD = 24,
    ORL_VIS_SPAN = 3325,                                        /* ORL_SUN_SOFT in units of h */
    ORL_SKY_TERMS = 9, ORL_SHADOW_KNOTS = 16,
    ORL_PHI_W_MAX = 16255,                                      /* w = 128 hi + lo with both in int8 */
    ORL_WARP_PART = 5, ORL_WARP_MOST = 64, ORL_WARP_ROWS = ORL_WARP_MOST + 1, ORL_WARP_PARTS = (ORL_WARP_MOST + ORL_WARP_PART) / ORL_WARP_PART,     /* boxes of up to 64 x 64 pixels */
    ORL_PHI_GROUP = 4,                                          /* features of a pixel that stand side by side: phi is [group][pixel][4] */
    ORL_POW_0 = 32762, ORL_POW_1 = 6890, ORL_POW_2 = -720, ORL_POW_3 = 608,     /* of (1 + t / 2)^(5/12), t in -1 .. 0: within 4e-4 of it */
    ORL_U_MAX = 27438, ORL_TOE = 737, ORL_TOE_LINE = 451, ORL_TOE_2 = 289, ORL_TOE_3 = 375,      /* the curve's lower end by u^2 and u^3: within 0.1 of a level */
};

typedef struct {
    int i0, i1;                     /* azimuths 0..15 on both sides of the sun */
    int f;                          /* 0..256 */
    int apart;                      /* 0..255; 255: always between both */
    int32_t over, under;            /* upper edge of the soft sun over horizons, and over ceilings seen from above; units of h */
} orl_vis_tab;

typedef struct {
    const uint8_t *horizon[2], *ceiling[2];     /* [n] of the azimuths i0 and i1; ceiling NULL: none */
    const int8_t *fix;                          /* [n] -127..127; NULL: none */
    const uint8_t *cov;
} orl_vis_in;

typedef struct {
    int16_t sun_dir[3], sun[3], sky[3][ORL_SKY_TERMS], ground[3][2];    /* direction Q15; the rest Q k, magnitudes at most 32767 */
    int16_t gain; int gain_shift;   /* 0 .. 3 */
    int16_t shadow[3][ORL_SHADOW_KNOTS];
    int8_t phi_hi[ORL_SHADOW_DIM], phi_lo[ORL_SHADOW_DIM];              /* w_k = 128 hi + lo */
    int32_t phi_shift, phi_bias;    /* 0 .. 15; Q11, magnitude below 2^20 */
    int16_t no_shadow;              /* s of a view without phi */
    int16_t tone[3][3], tone_b[3]; int tone_shift;                      /* 0 .. 4; tone_b carries the rounding */
} orl_shade_tab;

typedef struct {
    const int8_t *normal[3];        /* 127ths */
    const uint8_t *albedo[3];       /* base colour^(5/12), 255ths */
    const uint8_t *open, *cov;
    const int16_t *vis, *s;         /* from their kernels; s NULL: the table's no_shadow */
    const int16_t *sky[3];          /* nodes of this row from the image's left edge */
    int sky_log2;                   /* pixels between nodes: 4 .. 15 */
    int x;                          /* column of the first pixel, a multiple of ORL_KERNEL_STEP */
    int all;                        /* 1: surface and sky of every pixel, also where the one counts nothing; the same pixels, later */
    struct { const uint8_t *at; int step; } ahead[ORL_AHEAD];       /* [aheads] bytes that will be wanted soon: kernels may fetch at + step i into the cache as they come to pixel i; more streams than a CPU foresees */
    int aheads;
} orl_shade_in;

typedef struct {
    const int16_t *node[3][2];      /* of this row, by channel: corrections of sky and surface, Q5 levels, magnitudes at most 8160; the first stands half a cell before the left edge */
    int log2;                       /* pixels of a cell: 4 .. 14 */
    int x;                          /* as above */
    const uint8_t *layer, *weight;  /* [n] 0 sky .. 255 surface; of the photo */
    const uint8_t *photo;           /* [n][3] */
} orl_mix_in;

typedef struct { uint32_t from; uint8_t u, v; uint16_t unused; } orl_warp_at;      /* where a box's first pixel stands in the photo, bytes; the corner's fractions of it, Q8 */

typedef struct {
    const uint8_t *photo;           /* rows of `stride` bytes, `bytes` in all */
    size_t stride, bytes;
    const orl_warp_at *at;          /* [n]; boxes are inside the photo */
    int rows, parts, narrow;        /* of a box; ORL_WARP_PART columns a part; 1: two rows and two columns at most */
    const int16_t *column;          /* [256][parts][16] by the corner's fraction: shares of the columns from its pixel on, three times over (R, G, B), the 16th 0; a box's sum to 32767, and are 0 beyond it */
    const int16_t *row;             /* [256][ORL_WARP_ROWS] likewise, to 256 */
} orl_warp_in;

typedef struct {
    void (*vis)(const orl_vis_in *in, const orl_vis_tab *t, int n, int16_t *vis);
    void (*shadow)(const int8_t *const phi[2], const uint8_t *cov, const orl_shade_tab *t, int n, int16_t *s);      /* phi [2] groups of [n][4] */
    void (*shade)(const orl_shade_in *in, const orl_shade_tab *t, int n, uint8_t *rgb);         /* rgb [n][3] */
    void (*warp)(const orl_warp_in *in, int n, uint8_t *rgb);                                   /* rgb [n][3]; n any */
    void (*mix)(const orl_mix_in *in, int n, uint8_t *rgb);                                     /* rgb [n][3]: the render, then the blend */
} orl_kernels;

/* C first, then what the flags allow. Flags of another architecture are ignored. */
void orl_kernels_init(orl_kernels *k, unsigned cpu);

/* E^(5/12) as above, E 2 .. 32767; [log2 - 1] of its factors. */
int orl_power_ref(int e);
extern const int16_t orl_power_factor[16];

/* One list for dispatch, tests and benchmark: name as in --cpu=. */
#define ORL_KERNEL_VARIANTS(X) X(ref) X(avx2) X(avx512) X(neon) X(dotprod)

/* Instruction sets; private to the dispatch. */
#define ORL_KERNEL_PROTOTYPES(isa) \
    void orl_vis_##isa(const orl_vis_in *in, const orl_vis_tab *t, int n, int16_t *vis); \
    void orl_shadow_##isa(const int8_t *const phi[2], const uint8_t *cov, const orl_shade_tab *t, int n, int16_t *s); \
    void orl_shade_##isa(const orl_shade_in *in, const orl_shade_tab *t, int n, uint8_t *rgb); \
    void orl_warp_##isa(const orl_warp_in *in, int n, uint8_t *rgb); \
    void orl_mix_##isa(const orl_mix_in *in, int n, uint8_t *rgb);
ORL_KERNEL_VARIANTS(ORL_KERNEL_PROTOTYPES)
#endif
