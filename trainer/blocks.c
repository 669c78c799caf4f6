/* Encoder of blocks.h: least and greatest luma as first end points, then a least-squares fit of both, kept if it errs less; differences by the least step that spans them. */
#include "trainer/blocks.h"
#include <math.h>
#include <string.h>

static int luma_indices(const float y[16], int a, int b, uint8_t index[16], float *error)
{
    int used = 0;
    *error = 0;
    for (int i = 0; i < 16; i++) {
        int q = a == b ? 0 : (int)lrintf(15 * (y[i] - (float)a) / (float)(b - a));
        index[i] = (uint8_t)(q < 0 ? 0 : q > 15 ? 15 : q);
        float e = (float)a + (float)(b - a) * (float)index[i] / 15 - y[i];
        *error += e * e;
        used |= 1 << index[i];
    }
    return used;
}

static void encode_luma(const float y[16], uint8_t *out)
{
    float lo = y[0], hi = y[0], error;
    uint8_t best[16];
    for (int i = 1; i < 16; i++) { lo = fminf(lo, y[i]); hi = fmaxf(hi, y[i]); }
    int a = (int)lrintf(lo), b = (int)lrintf(hi);
    int used = luma_indices(y, a, b, best, &error);
    for (int round = 0; round < 2 && (used & (used - 1)); round++) {    /* at least two indices: the fit is determined */
        float uu = 0, uv = 0, vv = 0, uy = 0, vy = 0, e;
        uint8_t index[16];
        for (int i = 0; i < 16; i++) {
            float v = (float)best[i] / 15, u = 1 - v;
            uu += u * u; uv += u * v; vv += v * v; uy += u * y[i]; vy += v * y[i];
        }
        float det = uu * vv - uv * uv;
        int a1 = block_byte((int)lrintf((vv * uy - uv * vy) / det)), b1 = block_byte((int)lrintf((uu * vy - uv * uy) / det));
        int used1 = luma_indices(y, a1, b1, index, &e);
        if (!(e < error)) break;
        a = a1; b = b1; error = e; used = used1;
        memcpy(best, index, sizeof best);
    }
    out[0] = (uint8_t)a;
    out[1] = (uint8_t)b;
    for (int i = 0; i < 8; i++) out[2 + i] = (uint8_t)(best[2 * i] | best[2 * i + 1] << 4);
}

static void encode_difference(const float c[4], uint8_t *out)
{
    float lo = fminf(fminf(c[0], c[1]), fminf(c[2], c[3])), hi = fmaxf(fmaxf(c[0], c[1]), fmaxf(c[2], c[3]));
    int base = (int)lrintf(lo) + 128, step = 0, index = 0;
    base = block_byte(base);
    while (step < 15 && 7 * BLOCK_STEP[step] < hi - (float)(base - 128) - 0.5f) step++;
    for (int i = 0; i < 4 && step; i++) {
        int q = (int)lrintf((c[i] - (float)(base - 128)) / BLOCK_STEP[step]);
        index |= (q < 0 ? 0 : q > 7 ? 7 : q) << 3 * i;
    }
    out[0] = (uint8_t)base;
    out[1] = (uint8_t)(step | index << 4);
    out[2] = (uint8_t)(index >> 4);
}

void blocks_encode(const uint8_t *rgb, int w, int h, block *out)
{
    for (int by = 0; by < h; by += 4)
        for (int bx = 0; bx < w; bx += 4, out++) {
            float luma[16], cb[4] = { 0 }, cr[4] = { 0 };
            for (int i = 0; i < 16; i++) {
                int x = bx + i % 4 < w ? bx + i % 4 : w - 1, y = by + i / 4 < h ? by + i / 4 : h - 1, quarter = (i / 4 & 2) | (i % 4 >> 1);
                const uint8_t *p = rgb + 3 * ((size_t)y * (size_t)w + (size_t)x);
                luma[i] = 0.299f * p[0] + 0.587f * p[1] + 0.114f * p[2];
                cb[quarter] += 0.25f * (p[2] - luma[i]) / 1.772f;
                cr[quarter] += 0.25f * (p[0] - luma[i]) / 1.402f;
            }
            encode_luma(luma, out->b);
            encode_difference(cb, out->b + 10);
            encode_difference(cr, out->b + 13);
        }
}
