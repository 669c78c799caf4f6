/* Inputs and tables for the re-lighting kernels, anywhere in the ranges that runtime/kernels/shade.h allows: random, all low, all high. Integers alone: the same on every machine. */
#ifndef TESTS_KERNEL_DATA_H
#define TESTS_KERNEL_DATA_H
#include <string.h>
#include "runtime/kernels/shade.h"

enum { KD_CELLS = 40, KD_N = 1024, KD_NODES = KD_N / 16 + 2, KD_GUARD = 64 };
typedef enum { KD_RANDOM, KD_LOW, KD_HIGH, KD_MODES } kd_mode;

typedef struct {
    orl_shade_tab tab;
    orl_vis_tab vis_tab;
    uint16_t normal[KD_N], albedo[3][KD_N];
    uint8_t open[KD_N], cov[KD_N], vis[KD_N], horizon[2][KD_N];
    int8_t phi[KD_N * 8];
    int16_t s[KD_N], sky[KD_NODES][4];
    int sky_log2;
    int16_t cell[KD_CELLS + 1][3][2], share[KD_N];
    uint8_t cell_of[KD_N / ORL_MIX_STEP], photo[3 * KD_N], render[3 * KD_N];
} kernel_data;

static inline uint32_t kd_next(uint64_t *r) { *r = *r * 6364136223846793005u + 1442695040888963407u; return (uint32_t)(*r >> 33); }
static inline int kd_in(uint64_t *r, kd_mode m, int lo, int hi)
{
    uint32_t v = kd_next(r);
    if (m == KD_RANDOM && v % 16 == 0) m = v / 16 % 2 ? KD_LOW : KD_HIGH;       /* extremes among the random ones too */
    return m == KD_LOW ? lo : m == KD_HIGH ? hi : lo + (int)(kd_next(r) % (uint32_t)(hi - lo + 1));
}

static inline void kd_fill(kernel_data *d, uint64_t seed, kd_mode m)
{
    uint64_t r = seed;
    memset(d, 0, sizeof *d);
    for (int i = 0; i < ORL_PAL; i++) for (int k = 0; k < 12; k++) d->tab.pal[i][k] = (int16_t)(k % 4 == 3 ? 0 : kd_in(&r, m, 0, 32767));
    for (int i = 0; i < ORL_ENCODE_KNOTS; i++) d->tab.encode[i] = (orl_lut){ (int16_t)kd_in(&r, m, 0, 26000), (int16_t)kd_in(&r, m, 0, 900) };
    for (int i = 0; i < ORL_SIGMOID_KNOTS; i++) d->tab.sigmoid[i] = (orl_lut){ (int16_t)kd_in(&r, m, 0, 32000), (int16_t)kd_in(&r, m, 0, 767) };
    for (int k = 0; k < 8; k++) {
        int w = kd_in(&r, m, -ORL_PHI_W_MAX, ORL_PHI_W_MAX), hi = (w + 64) >> 7;
        d->tab.phi_w[k] = (int16_t)w;
        d->tab.phi_hi[k] = d->tab.phi_hi[k + 8] = (int8_t)hi;
        d->tab.phi_lo[k] = d->tab.phi_lo[k + 8] = (int8_t)(w - 128 * hi);
    }
    d->tab.phi_shift = kd_in(&r, m, 0, 15);
    d->tab.phi_bias = 22528;
    d->tab.colour_shift = kd_in(&r, m, 0, 16);
    for (int c = 0; c < 3; c++) {
        for (int k = 0; k < 3; k++) d->tab.tone[c][k] = (int16_t)kd_in(&r, m, -10922, 10922);
        d->tab.tone_b[c] = kd_in(&r, m, -(1 << 30) + (1 << 17), (1 << 30) - (1 << 17)) >> (m == KD_RANDOM ? 4 : 0);
    }
    d->vis_tab.i0 = kd_in(&r, m, 0, 15);
    d->vis_tab.i1 = (d->vis_tab.i0 + 1) & 15;
    d->vis_tab.f = kd_in(&r, m, 0, 256);
    d->vis_tab.sun = kd_in(&r, m, -200000, 200000) >> (m == KD_RANDOM ? 1 : 0);
    for (int i = 0; i < KD_N; i++) {
        d->normal[i] = (uint16_t)kd_in(&r, m, 0, ORL_PAL - 1);
        for (int c = 0; c < 3; c++) d->albedo[c][i] = (uint16_t)kd_in(&r, m, 0, 65535);
        d->open[i] = (uint8_t)kd_in(&r, m, 0, 255);
        d->cov[i] = (uint8_t)(m == KD_RANDOM && (i / 48) % 3 == 2 ? 0 : kd_in(&r, m, 0, 255));      /* runs of pure sky: kernels skip them */
        d->vis[i] = (uint8_t)kd_in(&r, m, 0, 255);
        d->s[i] = (int16_t)kd_in(&r, m, 0, 32767);
        for (int k = 0; k < 2; k++) d->horizon[k][i] = (uint8_t)kd_in(&r, m, 0, 255);
        for (int k = 0; k < 8; k++) d->phi[8 * i + k] = (int8_t)kd_in(&r, m, -128, 127);
    }
    for (int i = 0; i < KD_NODES; i++) for (int c = 0; c < 3; c++) d->sky[i][c] = (int16_t)(m == KD_RANDOM ? kd_in(&r, m, -4096, 28590) : (i + c) & 1 ? -4096 : 28590);
    d->sky_log2 = kd_in(&r, m, 4, 10);
    for (int i = 0; i <= KD_CELLS; i++) for (int c = 0; c < 3; c++) for (int k = 0; k < 2; k++) d->cell[i][c][k] = (int16_t)(m == KD_RANDOM ? kd_in(&r, m, -8160, 8160) : (i + c + k) & 1 ? -8160 : 8160);
    for (int i = 0; i < KD_N; i++) d->share[i] = (int16_t)kd_in(&r, m, 0, 32767);
    for (int i = 0; i < KD_N / ORL_MIX_STEP; i++) d->cell_of[i] = (uint8_t)kd_in(&r, m, 0, KD_CELLS - 1);
    for (int i = 0; i < 3 * KD_N; i++) {
        d->photo[i] = (uint8_t)kd_in(&r, m, 0, 255);
        d->render[i] = (uint8_t)kd_in(&r, m, 0, 255);
    }
}

static inline orl_shade_in kd_in_struct(const kernel_data *d, int x)
{
    return (orl_shade_in){ d->normal + x, { d->albedo[0] + x, d->albedo[1] + x, d->albedo[2] + x }, d->open + x, d->cov + x, d->vis + x, d->s + x, (const int16_t (*)[4])d->sky, d->sky_log2, x };
}
static inline orl_mix_in kd_mix_struct(const kernel_data *d, int x)        /* layers and shares of the photo: openness and coverage will do */
{
    return (orl_mix_in){ (const int16_t (*)[3][2])d->cell, d->cell_of + x / ORL_MIX_STEP, d->share + x, d->open + x, d->cov + x, d->photo + 3 * x };
}
#endif
