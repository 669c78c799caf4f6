/* Re-lighting in plain C: the specification of shade.h that every other variant must meet bit for bit. */
#include <stdlib.h>
#include "runtime/kernels/shade.h"

static int mul(int a, int b) { return (a * b + 0x4000) >> 15; }
static int part(int v, int b) { return v * b >> 8; }
static int clamp(int v, int lo, int hi) { return v < lo ? lo : v > hi ? hi : v; }
static int plus(int a, int b) { return clamp(a + b, -32768, 32767); }
static int wrap(int v) { return (int16_t)(uint16_t)v; }
static int share(int v) { return 128 * v + (v >> 1); }             /* of 255, Q15 */

/* Whether the run of ORL_KERNEL_STEP pixels that pixel i is in has a surface. */
static int covered(const uint8_t *cov, int i)
{
    const uint8_t *run = cov + i / ORL_KERNEL_STEP * ORL_KERNEL_STEP;
    int any = 0;
    for (int k = 0; k < ORL_KERNEL_STEP; k++) any |= run[k];
    return any;
}

static int lit(const uint8_t *const p[2], int i, const orl_vis_tab *tab, int32_t edge)
{
    int f = abs(p[0][i] - p[1][i]) > tab->apart ? tab->f < 128 ? 0 : 256 : tab->f;
    int d = clamp(edge - (p[0][i] * (256 - f) + p[1][i] * f), 0, ORL_VIS_SPAN), t = 2 * mul(8 * d, 20182), a = mul(t, t), m = mul(a, 32767 - t);
    return plus(plus(a, m), m);
}

void orl_vis_ref(const orl_vis_in *in, const orl_vis_tab *t, int n, int16_t *vis)
{
    for (int i = 0; i < n; i++) {
        if (!covered(in->cov, i)) { vis[i] = 0; continue; }
        int v = lit(in->horizon, i, t, t->over);
        if (in->ceiling[0]) v = mul(v, lit(in->ceiling, i, t, t->under));
        if (in->fix) v = clamp(plus(v, 258 * in->fix[i]), 0, 32767);
        vis[i] = (int16_t)v;
    }
}

void orl_shadow_ref(const int8_t *const phi[2], const uint8_t *cov, const orl_shade_tab *t, int n, int16_t *s)
{
    int32_t round = t->phi_shift ? 1 << (t->phi_shift - 1) : 0;
    for (int i = 0; i < n; i++) {
        int32_t x = 0;
        if (!covered(cov, i)) { s[i] = 0; continue; }
        for (int k = 0; k < ORL_SHADOW_DIM; k++) x += phi[k / ORL_PHI_GROUP][ORL_PHI_GROUP * i + k % ORL_PHI_GROUP] * (128 * t->phi_hi[k] + t->phi_lo[k]);
        x = clamp(((x + round) >> t->phi_shift) + t->phi_bias, 0, 32767);
        int knot = x >> 11, f = (x & 2047) << 4;
        s[i] = (int16_t)wrap(t->shadow[0][knot] + mul(f, wrap(t->shadow[1][knot] + mul(f, t->shadow[2][knot]))));
    }
}

const int16_t orl_power_factor[16] = { 767, 1024, 1367, 1825, 2435, 3251, 4339, 5792, 7732, 10321, 13777, 18390, 24548, 32767 };     /* 32767 x 2^(-5 (14 - log2) / 12) */

int orl_power_ref(int e)
{
    int log = 31 - __builtin_clz((unsigned)e), f = (e << (15 - log)) - 0x10000;
    return mul(ORL_POW_0 + mul(f, ORL_POW_1 + mul(f, ORL_POW_2 + mul(f, ORL_POW_3))), orl_power_factor[log - 1]);
}

static int encode(int u)
{
    int w = 32 * (u < ORL_TOE ? u : ORL_TOE), toe = mul(mul(w, w), ORL_TOE_2 + mul(w, ORL_TOE_3)), line = u - ORL_TOE_LINE;
    return toe > line ? toe : line;
}

static void surface(const orl_shade_in *in, const orl_shade_tab *t, int i, int e[3])
{
    int x = 256 * in->normal[0][i], y = 256 * in->normal[1][i], z = 256 * in->normal[2][i], s = in->s ? in->s[i] : t->no_shadow;
    int sun = wrap(mul(x, t->sun_dir[0]) + mul(y, t->sun_dir[1]) + mul(z, t->sun_dir[2]));
    const int term[ORL_SKY_TERMS - 1] = { x, y, z, mul(x, y), mul(y, z), mul(z, x), wrap(mul(x, x) - mul(y, y)), mul(z, z) };
    sun = mul(sun > 0 ? sun : 0, in->vis[i]);
    s = mul(s, t->gain);
    for (int c = 0; c < 3; c++) {
        int sky = t->sky[c][0];
        for (int k = 1; k < ORL_SKY_TERMS; k++) sky += mul(t->sky[c][k], term[k - 1]);
        sky = wrap(sky);
        int E = wrap(mul(t->sun[c], sun) + part(in->open[i], sky > 0 ? sky : 0) + t->ground[c][0] - mul(t->ground[c][1], z));
        int u = mul(part(in->albedo[c][i], s), orl_power_ref(E > 2 ? E : 2)), most = ORL_U_MAX >> t->gain_shift;
        e[c] = encode((u < most ? u : most) << t->gain_shift);
    }
}

void orl_shade_ref(const orl_shade_in *in, const orl_shade_tab *t, int n, uint8_t *rgb)
{
    for (int i = 0; i < n; i++, rgb += 3) {
        int at = in->x + i, cov = in->cov[i], ramp = (at & ((1 << in->sky_log2) - 1)) << (15 - in->sky_log2), p[3], e[3];
        if (cov) surface(in, t, i, e);
        for (int c = 0; c < 3; c++) {
            const int16_t *node = in->sky[c] + (at >> in->sky_log2);
            int y = node[0] + mul(node[1] - node[0], ramp);
            p[c] = !cov ? y : cov == 255 ? e[c] : y + mul(e[c] - y, share(cov));
        }
        for (int c = 0; c < 3; c++) rgb[c] = (uint8_t)clamp(wrap(t->tone_b[c] + mul(t->tone[c][0], p[0]) + mul(t->tone[c][1], p[1]) + mul(t->tone[c][2], p[2])) >> t->tone_shift, 0, 255);
    }
}

void orl_warp_ref(const orl_warp_in *in, int n, uint8_t *rgb)
{
    for (int i = 0; i < n; i++, rgb += 3) {
        const orl_warp_at at = in->at[i];
        const int16_t *column = in->column + at.u * in->parts * 16, *row = in->row + at.v * ORL_WARP_ROWS;
        const uint8_t *p = in->photo + at.from;
        int sum[3] = { 64, 64, 64 };
        for (int k = 0; k < (in->narrow ? 2 : in->parts * ORL_WARP_PART); k++) {
            const int16_t share = column[k / ORL_WARP_PART * 16 + k % ORL_WARP_PART * 3];
            for (int c = 0; share && c < 3; c++) {          /* no share: maybe beyond the photo */
                int V = 0;
                for (int j = 0; j < in->rows && row[j]; j++) V += p[(size_t)j * in->stride + (size_t)(3 * k + c)] * row[j];
                sum[c] += mul(V >> 1, share);
            }
        }
        for (int c = 0; c < 3; c++) rgb[c] = (uint8_t)clamp(sum[c] >> 7, 0, 255);
    }
}

void orl_mix_ref(const orl_mix_in *in, int n, uint8_t *rgb)
{
    int cell = 1 << in->log2;
    for (int i = 0; i < n; i++, rgb += 3) {
        int at = in->x + i + cell / 2, ramp = (2 * (at & (cell - 1)) + 1) << (14 - in->log2), w = in->weight[i];
        for (int c = 0; c < 3; c++) {
            int l[2];
            for (int k = 0; k < 2; k++) {
                const int16_t *node = in->node[c][k] + (at >> in->log2);
                l[k] = node[0] + mul(node[1] - node[0], ramp);
            }
            int r = clamp(rgb[c] + ((l[0] + mul(l[1] - l[0], share(in->layer[i])) + 16) >> 5), 0, 255), m = in->photo[3 * i + c] * w + r * (255 - w) + 128;
            rgb[c] = (uint8_t)((m + (m >> 8)) >> 8);
        }
    }
}
