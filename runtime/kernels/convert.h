/* Conversion kernels: a row of a camera's picture to RGB of 8 bits. Formats are oriel/source.h's; chroma is repeated over the pixels that it stands for.
 *
 *   c = clamp((k_y Y + a_c A + b_c B + add_c) >> 14, 0, 255)     c: R, G, B; Y, A, B bytes as stored, A the chroma that comes first in memory; x >> k rounds down
 *
 * k_y, a, b are Q14, but blue's a and b Q13 and taken twice (U to B exceeds 2 in limited range). add_c holds black, the 128 of chroma and 2^13 for rounding to nearest.
 * The sum is exact in 32 bits (below 2^24); results are within 0.51 of the real matrix's, so at most 1 level from its rounded value: tests/test_convert.c goes through all 2^24 triples.
 * In 16 bits (each product rounded by mul of shade.h to Q6) 0.8 % of limited range's values would be a level off; the exact form also keeps what Y4M replays have given all along.
 *
 * Lengths are multiples of ORL_CONVERT_STEP, no kernel has a tail: orl_frame_to_rgb() takes the rest of a row through a padded copy. Pointers need no alignment.
 * A kernel reads the n pixels of its rows and writes 3 n bytes, nothing else; rows in and out do not overlap. */
#ifndef RUNTIME_KERNELS_CONVERT_H
#define RUNTIME_KERNELS_CONVERT_H
#include <stdint.h>
#include "oriel/cpu.h"
#include "oriel/source.h"

enum { ORL_CONVERT_STEP = 64 };

typedef struct {
    int16_t y;                      /* k_y */
    int16_t c[3][2];                /* a, b of R, G, B */
    int32_t add[3];                 /* Q14 */
} orl_yuv_tab;

/* Of a picture's matrix and range. MONO takes no chroma; NV21 and its like have V first. */
void orl_yuv_table(const orl_source_info *info, orl_yuv_tab *t);

/* p: the row of each plane, as in orl_frame. MONO is read as 420 with the chroma of weight 0: p[1] and p[2] may be the Y row. t: unused by RGB and BGR. */
typedef void (*orl_convert_fn)(const uint8_t *const p[3], const orl_yuv_tab *t, int n, uint8_t *rgb);
typedef struct { orl_convert_fn row[ORL_PIX_COUNT]; } orl_convert_kernels;

/* C first, then what the flags allow. Flags of another architecture are ignored. */
void orl_convert_kernels_init(orl_convert_kernels *k, unsigned cpu);

/* One list for tests and benchmark: name as in --cpu=. */
#define ORL_CONVERT_VARIANTS(X) X("ref") X("avx2") X("avx512") X("neon")

/* Instruction sets; private to the dispatch. half: planar 4:2:0 and 4:2:2; full: planar 4:4:4; semi: NV12 and NV21; swap: BGR. */
#define ORL_CONVERT_SET(isa) \
    void orl_convert_half_##isa(const uint8_t *const p[3], const orl_yuv_tab *t, int n, uint8_t *rgb); \
    void orl_convert_full_##isa(const uint8_t *const p[3], const orl_yuv_tab *t, int n, uint8_t *rgb); \
    void orl_convert_semi_##isa(const uint8_t *const p[3], const orl_yuv_tab *t, int n, uint8_t *rgb); \
    void orl_convert_yuyv_##isa(const uint8_t *const p[3], const orl_yuv_tab *t, int n, uint8_t *rgb); \
    void orl_convert_uyvy_##isa(const uint8_t *const p[3], const orl_yuv_tab *t, int n, uint8_t *rgb); \
    void orl_convert_swap_##isa(const uint8_t *const p[3], const orl_yuv_tab *t, int n, uint8_t *rgb);
ORL_CONVERT_SET(ref)
ORL_CONVERT_SET(avx2)
ORL_CONVERT_SET(avx512)
ORL_CONVERT_SET(neon)
void orl_convert_copy_ref(const uint8_t *const p[3], const orl_yuv_tab *t, int n, uint8_t *rgb);
#endif
