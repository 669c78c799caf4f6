/* Images in memory: allocation, area-averaged resize, conversion (include/oriel/image.h). */
#include "oriel/image.h"
#include <math.h>
#include <stdlib.h>
#include <string.h>

static orl_err check(int w, int h, int c)
{
    if (w < 1 || h < 1 || w > ORL_IMAGE_MAX_SIDE || h > ORL_IMAGE_MAX_SIDE || c < 1 || c > ORL_IMAGEF_MAX_CHANNELS) return orl_fail(ORL_E_RANGE, "image size %d x %d x %d", w, h, c);
    return ORL_OK;
}

orl_err orl_image_alloc(orl_image *out, int w, int h, int c)
{
    orl_err e = check(w, h, c);
    if (e) return e;
    uint8_t *p = calloc((size_t)w * (size_t)h, (size_t)c);
    if (!p) return orl_fail(ORL_E_MEMORY, "image of %d x %d x %d: no memory", w, h, c);
    *out = (orl_image){ w, h, c, p };
    return ORL_OK;
}

orl_err orl_imagef_alloc(orl_imagef *out, int w, int h, int c)
{
    orl_err e = check(w, h, c);
    if (e) return e;
    float *p = calloc((size_t)w * (size_t)h, (size_t)c * sizeof *p);
    if (!p) return orl_fail(ORL_E_MEMORY, "image of %d x %d x %d: no memory", w, h, c);
    *out = (orl_imagef){ w, h, c, p };
    return ORL_OK;
}

void orl_image_free(orl_image *im) { free(im->px); memset(im, 0, sizeof *im); }
void orl_imagef_free(orl_imagef *im) { free(im->px); memset(im, 0, sizeof *im); }

/* Box filter along one axis: output i covers [i, i + 1) * in / out of the input. stride counts floats between neighbours along the axis. */
static void box_line(const float *in, int n, size_t step, float *out, int m, size_t ostep, int c)
{
    double ratio = (double)n / m;
    for (int i = 0; i < m; i++) {
        double a = i * ratio, b = (i + 1) * ratio;
        int i0 = (int)a, i1 = (int)ceil(b);
        if (i1 > n) i1 = n;
        for (int k = 0; k < c; k++) {
            double s = 0;
            for (int j = i0; j < i1; j++) {
                double lo = j > a ? j : a, hi = j + 1 < b ? j + 1 : b;
                s += (hi - lo) * in[(size_t)j * step + (size_t)k];
            }
            out[(size_t)i * ostep + (size_t)k] = (float)(s / ratio);
        }
    }
}

orl_err orl_imagef_resize_area(const orl_imagef *in, int w, int h, orl_imagef *out)
{
    orl_imagef mid = { 0 }, o = { 0 };
    orl_err e = orl_imagef_alloc(&mid, w, in->h, in->c);
    if (!e) e = orl_imagef_alloc(&o, w, h, in->c);
    if (e) { orl_imagef_free(&mid); return e; }
    size_t c = (size_t)in->c;
    for (int y = 0; y < in->h; y++) box_line(in->px + (size_t)y * (size_t)in->w * c, in->w, c, mid.px + (size_t)y * (size_t)w * c, w, c, in->c);
    for (int x = 0; x < w; x++) box_line(mid.px + (size_t)x * c, in->h, (size_t)w * c, o.px + (size_t)x * c, h, (size_t)w * c, in->c);
    orl_imagef_free(&mid);
    *out = o;
    return ORL_OK;
}

orl_err orl_image_resize_area(const orl_image *in, int w, int h, orl_image *out)
{
    orl_imagef f = { 0 }, g = { 0 };
    orl_err e = orl_image_to_float(in, &f);
    if (!e) e = orl_imagef_resize_area(&f, w, h, &g);
    if (!e) e = orl_image_from_float(&g, out);
    orl_imagef_free(&f);
    orl_imagef_free(&g);
    return e;
}

void orl_size_long_side(int w, int h, int long_side, int *ow, int *oh)
{
    int side = w > h ? w : h;
    if (long_side <= 0 || side <= long_side) { *ow = w; *oh = h; return; }
    *ow = (int)(((int64_t)w * long_side * 2 + side) / (2 * (int64_t)side));
    *oh = (int)(((int64_t)h * long_side * 2 + side) / (2 * (int64_t)side));
    if (*ow < 1) *ow = 1;
    if (*oh < 1) *oh = 1;
}

orl_err orl_image_to_float(const orl_image *in, orl_imagef *out)
{
    orl_imagef o;
    orl_err e = orl_imagef_alloc(&o, in->w, in->h, in->c);
    if (e) return e;
    size_t n = (size_t)in->w * (size_t)in->h * (size_t)in->c;
    for (size_t i = 0; i < n; i++) o.px[i] = in->px[i] / 255.0f;
    *out = o;
    return ORL_OK;
}

orl_err orl_image_from_float(const orl_imagef *in, orl_image *out)
{
    orl_image o;
    orl_err e = orl_image_alloc(&o, in->w, in->h, in->c);
    if (e) return e;
    size_t n = (size_t)in->w * (size_t)in->h * (size_t)in->c;
    for (size_t i = 0; i < n; i++) {
        float v = in->px[i];
        o.px[i] = (uint8_t)(!(v > 0) ? 0 : v >= 1 ? 255 : (int)(v * 255.0f + 0.5f));
    }
    *out = o;
    return ORL_OK;
}
