/* Re-lighting in plain C: the specification of shade.h that every other variant must meet bit for bit. */
#include "runtime/kernels/shade.h"

static int mul(int a, int b) { return (a * b + 0x4000) >> 15; }
static int q15(int v) { return (v << 7) + (v >> 1); }
static int add(int a, int b) { int s = a + b; return s > 32767 ? 32767 : s; }          /* operands are never negative */
static int lut(const orl_lut *t, int f) { return t->base + mul(t->delta, f); }

void orl_vis_ref(const uint8_t *restrict h0, const uint8_t *restrict h1, const orl_vis_tab *t, int n, uint8_t *restrict vis)
{
    const int f = t->f, sun = t->sun;
    for (int i = 0; i < n; i++) {
        int d = sun - (h0[i] * (256 - f) + h1[i] * f);
        d = d < 0 ? 0 : d > ORL_VIS_SPAN ? ORL_VIS_SPAN : d;
        int x = (d * 20182 + 1024) >> 11, a = mul(x, x), v = (a + 2 * mul(a, 32767 - x) + 64) >> 7;
        vis[i] = (uint8_t)(v > 255 ? 255 : v);
    }
}

void orl_shadow_ref(const int8_t *phi, const orl_shade_tab *t, int n, int16_t *s)
{
    int32_t round = t->phi_shift ? 1 << (t->phi_shift - 1) : 0;
    for (int i = 0; i < n; i++, phi += ORL_SHADOW_DIM) {
        int32_t x = 0;
        for (int k = 0; k < ORL_SHADOW_DIM; k++) x += phi[k] * t->phi_w[k];
        x = ((x + round) >> t->phi_shift) + t->phi_bias;
        x = x < 0 ? 0 : x > 32767 ? 32767 : x;
        s[i] = (int16_t)lut(&t->sigmoid[x >> 7], (x & 127) << 8);
    }
}

void orl_shade_ref(const orl_shade_in *in, const orl_shade_tab *t, int n, uint8_t *rgb)
{
    uint32_t round = t->colour_shift ? 1u << (t->colour_shift - 1) : 0;
    for (int i = 0; i < n; i++, rgb += 3) {
        const int16_t *pal = t->pal[in->normal[i]];
        int vis = q15(in->vis[i]), open = q15(in->open[i]), cov = q15(in->cov[i]), p[3];
        const int16_t *sky = in->sky[(in->x + i) >> in->sky_log2];
        int ramp = ((in->x + i) & ((1 << in->sky_log2) - 1)) << (15 - in->sky_log2);
        for (int c = 0; c < 3; c++) {
            int y = sky[c] + mul(sky[4 + c] - sky[c], ramp);
            if (!cov) { p[c] = y; continue; }
            int E = mul(add(add(mul(pal[c], vis), mul(pal[4 + c], open)), pal[8 + c]), in->s[i]);
            uint32_t q = ((uint32_t)in->albedo[c][i] * (uint32_t)E + round) >> t->colour_shift;
            q = q < 1 ? 1 : q > 0xffffff ? 0xffffff : q;
            int log = 31 - __builtin_clz(q);
            uint32_t m = q << (23 - log) & 0x7fffff;
            p[c] = y + mul(lut(&t->encode[16 * log + (int)(m >> 19)], (int)(m >> 4 & 0x7fff)) - y, cov);
        }
        for (int c = 0; c < 3; c++) {
            int v = (t->tone[c][0] * p[0] + t->tone[c][1] * p[1] + t->tone[c][2] * p[2] + t->tone_b[c]) >> 17;
            rgb[c] = (uint8_t)(v < 0 ? 0 : v > 255 ? 255 : v);
        }
    }
}

void orl_mix_ref(const orl_mix_in *in, int n, uint8_t *rgb)
{
    for (int i = 0; i < n; i++, rgb += 3) {
        const int16_t (*a)[2] = in->cell[in->cell_of[i / ORL_MIX_STEP]], (*b)[2] = a + 3;
        for (int c = 0; c < 3; c++) {
            int sky = a[c][0] + ((2 * (b[c][0] - a[c][0]) * in->share[i]) >> 16), add = a[c][1] + ((2 * (b[c][1] - a[c][1]) * in->share[i]) >> 16) - sky;
            int r = rgb[c] + ((sky + ((2 * add * q15(in->layer[i])) >> 16) + 16) >> 5);
            r = r < 0 ? 0 : r > 255 ? 255 : r;
            int m = in->photo[3 * i + c] * in->weight[i] + r * (255 - in->weight[i]) + 128;
            rgb[c] = (uint8_t)((m + (m >> 8)) >> 8);
        }
    }
}
