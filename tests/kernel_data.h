/* Inputs and tables for the re-lighting kernels, anywhere in the ranges that runtime/kernels/shade.h allows: random, all low, all high. Integers alone: the same on every machine. */
#ifndef TESTS_KERNEL_DATA_H
#define TESTS_KERNEL_DATA_H
#include <string.h>
#include "runtime/kernels/shade.h"

enum { KD_SIDE = 32, KD_N = KD_SIDE * KD_SIDE, KD_NODES = KD_N / 16 + 2 + ORL_NODES_MORE, KD_GUARD = 64 };
typedef enum { KD_RANDOM, KD_LOW, KD_HIGH, KD_MODES } kd_mode;

typedef struct {
    orl_shade_tab tab;
    orl_vis_tab vis_tab;
    int8_t normal[3][KD_N], fix[KD_N], phi[2][KD_N * ORL_PHI_GROUP];
    uint8_t albedo[3][KD_N], open[KD_N], cov[KD_N], horizon[2][KD_N], ceiling[2][KD_N];
    int16_t vis[KD_N], s[KD_N], sky[3][KD_NODES];
    int sky_log2, mix_log2, ceilings, traced, shadows, all;      /* what a view has */
    int16_t node[3][2][KD_NODES];
    uint8_t photo[3 * KD_N], render[3 * KD_N];              /* to the warp the photo is KD_SIDE pixels wide and high */
    orl_warp_at at[KD_N];
    int box[2];
    int16_t column[256 * ORL_WARP_PARTS * 16], row[256 * ORL_WARP_ROWS];
} kernel_data;

static inline uint32_t kd_next(uint64_t *r) { *r = *r * 6364136223846793005u + 1442695040888963407u; return (uint32_t)(*r >> 33); }
static inline int kd_in(uint64_t *r, kd_mode m, int lo, int hi)
{
    uint32_t v = kd_next(r);
    if (m == KD_RANDOM && v % 16 == 0) m = v / 16 % 2 ? KD_LOW : KD_HIGH;       /* extremes among the random ones too */
    return m == KD_LOW ? lo : m == KD_HIGH ? hi : lo + (int)(kd_next(r) % (uint32_t)(hi - lo + 1));
}

/* Shares of the pixels of a box, whole numbers that are not equal. */
static inline void kd_warp(kernel_data *d)
{
    for (int a = 0; a < 2; a++)
        for (int f = 0; f < 256; f++) {
            int n = (f + d->box[a] + 255) >> 8, parts = ((510 + d->box[0]) / 256 + ORL_WARP_PART - 1) / ORL_WARP_PART, rest = a ? 256 : 32767;
            for (int k = 0; k < n; k++) {
                int share = k == n - 1 ? rest : rest * (f + 32) / (300 * (n - k) / 2 + 32);
                rest -= share;
                if (a) d->row[f * ORL_WARP_ROWS + k] = (int16_t)share;
                else for (int c = 0; c < 3; c++) d->column[(f * parts + k / ORL_WARP_PART) * 16 + k % ORL_WARP_PART * 3 + c] = (int16_t)share;
            }
        }
}

static inline void kd_fill(kernel_data *d, uint64_t seed, kd_mode m)
{
    uint64_t r = seed;
    orl_shade_tab *t = &d->tab;
    memset(d, 0, sizeof *d);
    for (int c = 0; c < 3; c++) {
        t->sun_dir[c] = (int16_t)kd_in(&r, m, -32767, 32767);
        t->sun[c] = (int16_t)kd_in(&r, m, 0, 32767);
        for (int k = 0; k < ORL_SKY_TERMS; k++) t->sky[c][k] = (int16_t)kd_in(&r, m, -32767, 32767);
        for (int k = 0; k < 2; k++) t->ground[c][k] = (int16_t)kd_in(&r, m, 0, 32767);
        for (int k = 0; k < 3; k++) t->tone[c][k] = (int16_t)kd_in(&r, m, -32767, 32767);
        t->tone_b[c] = (int16_t)kd_in(&r, m, -32767, 32767);
    }
    t->gain = (int16_t)kd_in(&r, m, 2000, 32767);
    t->gain_shift = kd_in(&r, m, 0, 3);
    t->tone_shift = kd_in(&r, m, 1, 4);
    for (int i = 0; i < ORL_SHADOW_KNOTS; i++) {
        t->shadow[0][i] = (int16_t)kd_in(&r, m, 0, 28000);
        t->shadow[1][i] = (int16_t)kd_in(&r, m, 0, 3600);
        t->shadow[2][i] = (int16_t)kd_in(&r, m, -800, 800);
    }
    for (int k = 0; k < ORL_SHADOW_DIM; k++) {
        int w = kd_in(&r, m, -ORL_PHI_W_MAX, ORL_PHI_W_MAX), hi = (w + 64) >> 7;
        t->phi_hi[k] = (int8_t)hi;
        t->phi_lo[k] = (int8_t)(w - 128 * hi);
    }
    t->phi_shift = kd_in(&r, m, 0, 15);
    t->phi_bias = kd_in(&r, m, 0, 40000);
    t->no_shadow = (int16_t)kd_in(&r, m, 0, 32767);
    d->vis_tab.i0 = kd_in(&r, m, 0, 15);
    d->vis_tab.i1 = (d->vis_tab.i0 + 1) & 15;
    d->vis_tab.f = kd_in(&r, m, 0, 256);
    d->vis_tab.apart = kd_in(&r, m, 0, 255);
    d->vis_tab.over = kd_in(&r, m, -200000, 200000) >> (m == KD_RANDOM ? 1 : 0);
    d->vis_tab.under = kd_in(&r, m, -200000, 200000) >> (m == KD_RANDOM ? 1 : 0);
    d->ceilings = kd_in(&r, m, 0, 1);
    d->traced = kd_in(&r, m, 0, 1);
    d->shadows = kd_in(&r, m, 0, 1);
    for (int i = 0; i < KD_N; i++) {
        for (int c = 0; c < 3; c++) {
            d->normal[c][i] = (int8_t)kd_in(&r, m, -127, 127);
            d->albedo[c][i] = (uint8_t)kd_in(&r, m, 0, 255);
        }
        d->open[i] = (uint8_t)kd_in(&r, m, 0, 255);
        d->cov[i] = (uint8_t)(m != KD_RANDOM ? kd_in(&r, m, 0, 255) : (i / 96) % 4 == 2 ? 0 : (i / 96) % 4 == 3 ? 255 : kd_in(&r, m, 0, 255));      /* runs of pure sky and pure surface: kernels have ways of their own for them */
        d->fix[i] = (int8_t)kd_in(&r, m, -127, 127);
        d->vis[i] = (int16_t)kd_in(&r, m, 0, 32767);
        d->s[i] = (int16_t)kd_in(&r, m, 0, 32767);
        for (int k = 0; k < 2; k++) {
            d->horizon[k][i] = (uint8_t)kd_in(&r, m, 0, 255);
            d->ceiling[k][i] = (uint8_t)kd_in(&r, m, 0, 255);
        }
        for (int k = 0; k < ORL_SHADOW_DIM; k++) d->phi[k / ORL_PHI_GROUP][ORL_PHI_GROUP * i + k % ORL_PHI_GROUP] = (int8_t)kd_in(&r, m, -128, 127);
    }
    d->sky_log2 = kd_in(&r, m, 4, 10);
    d->mix_log2 = kd_in(&r, m, 4, 10);
    for (int c = 0; c < 3; c++)
        for (int i = 0; i < KD_NODES; i++) {
            d->sky[c][i] = (int16_t)(m == KD_RANDOM ? kd_in(&r, m, -4096, 28590) : (i + c) & 1 ? -4096 : 28590);
            for (int k = 0; k < 2; k++) d->node[c][k][i] = (int16_t)(m == KD_RANDOM ? kd_in(&r, m, -8160, 8160) : (i + c + k) & 1 ? -8160 : 8160);
        }
    for (int i = 0; i < 3 * KD_N; i++) {
        d->photo[i] = (uint8_t)kd_in(&r, m, 0, 255);
        d->render[i] = (uint8_t)kd_in(&r, m, 0, 255);
    }
    for (int a = 0; a < 2; a++) d->box[a] = seed % 3 ? kd_in(&r, m, 256, seed % 3 == 1 ? 1024 : 2900) : 256;
    for (int i = 0; i < KD_N; i++) {
        int u = kd_in(&r, m, 0, KD_SIDE * 256 - d->box[0]), v = kd_in(&r, m, 0, KD_SIDE * 256 - d->box[1]);
        d->at[i] = (orl_warp_at){ (uint32_t)(3 * (KD_SIDE * (v >> 8) + (u >> 8))), (uint8_t)u, (uint8_t)v, 0 };
    }
    d->all = kd_in(&r, m, 0, 1);
    kd_warp(d);
}

static inline orl_warp_in kd_warp_struct(const kernel_data *d, int x)
{
    int most = (510 + d->box[0]) / 256, rows = (510 + d->box[1]) / 256;
    return (orl_warp_in){ d->photo, 3 * KD_SIDE, sizeof d->photo, d->at + x, rows, (most + ORL_WARP_PART - 1) / ORL_WARP_PART, most <= 2 && rows <= 2, d->column, d->row };
}
static inline orl_vis_in kd_vis_struct(const kernel_data *d, int x)
{
    orl_vis_in in = { { d->horizon[0] + x, d->horizon[1] + x }, { NULL, NULL }, d->traced ? d->fix + x : NULL, d->cov + x };
    if (d->ceilings) in.ceiling[0] = d->ceiling[0] + x, in.ceiling[1] = d->ceiling[1] + x;
    return in;
}
static inline orl_shade_in kd_in_struct(const kernel_data *d, int x)
{
    orl_shade_in in = { .open = d->open + x, .cov = d->cov + x, .vis = d->vis + x, .s = d->shadows ? d->s + x : NULL, .sky_log2 = d->sky_log2, .x = x, .all = d->all };
    for (int c = 0; c < 3; c++) {
        in.normal[c] = d->normal[c] + x;
        in.albedo[c] = d->albedo[c] + x;
        in.sky[c] = d->sky[c];
    }
    return in;
}
static inline orl_mix_in kd_mix_struct(const kernel_data *d, int x)        /* layers and shares of the photo: openness and coverage will do */
{
    orl_mix_in in = { .log2 = d->mix_log2, .x = x, .layer = d->open + x, .weight = d->cov + x, .photo = d->photo + 3 * x };
    for (int c = 0; c < 3; c++) for (int k = 0; k < 2; k++) in.node[c][k] = d->node[c][k];
    return in;
}
#endif
