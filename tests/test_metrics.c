/* Metrics: known values, a direct computation of SSIM, and what FLIP must obey. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <cmocka.h>
#include "oriel/metrics.h"

static uint32_t state;
static float noise(void)        /* [-0.5, 0.5) */
{
    state = state * 1664525u + 1013904223u;
    return (float)(state >> 8) / 16777216.0f - 0.5f;
}

static orl_imagef image(int w, int h)
{
    orl_imagef im;
    assert_int_equal(orl_imagef_alloc(&im, w, h, 3), ORL_OK);
    return im;
}

/* Smooth colours with an edge, within [0.2, 0.8], and noise of the amplitude given. */
static orl_imagef picture(int w, int h, float amplitude)
{
    orl_imagef im = image(w, h);
    for (int y = 0; y < h; y++)
        for (int x = 0; x < w; x++)
            for (int c = 0; c < 3; c++)
                im.px[(y * w + x) * 3 + c] = 0.5f + 0.2f * sinf(0.3f * (float)x + 0.2f * (float)(y * (c + 1))) + (x * 3 > w * 2 ? 0.1f : -0.1f) + amplitude * noise();
    return im;
}

static void blur(const orl_imagef *in, int r, orl_imagef *out)
{
    for (int y = 0; y < in->h; y++)
        for (int x = 0; x < in->w; x++)
            for (int c = 0; c < 3; c++) {
                float s = 0;
                for (int k = -r; k <= r; k++) {
                    int i = x + k < 0 ? 0 : x + k >= in->w ? in->w - 1 : x + k;
                    s += in->px[(y * in->w + i) * 3 + c];
                }
                out->px[(y * in->w + x) * 3 + c] = s / (float)(2 * r + 1);
            }
}

static double flip(const orl_imagef *a, const orl_imagef *b)
{
    double v = -1;
    assert_int_equal(orl_metrics_flip(a, b, 0, a->w, &v), ORL_OK);
    return v;
}

static void psnr_of_known_noise(void **s)
{
    (void)s;
    orl_imagef a = picture(200, 150, 0), b = image(200, 150);
    double db;
    for (int i = 0; i < 200 * 150 * 3; i++) b.px[i] = a.px[i] + (i & 1 ? 0.1f : -0.1f);
    assert_int_equal(orl_metrics_psnr(&a, &b, 0, 200, &db), ORL_OK);
    assert_true(fabs(db - 20) < 1e-3);
    for (int i = 0; i < 200 * 150 * 3; i++) b.px[i] = a.px[i] + 0.1f * noise();        /* variance of uniform noise: 0.01 / 12 */
    assert_int_equal(orl_metrics_psnr(&a, &b, 0, 200, &db), ORL_OK);
    assert_true(fabs(db + 10 * log10(0.01 / 12)) < 0.1);
    assert_int_equal(orl_metrics_psnr(&a, &a, 0, 200, &db), ORL_OK);
    assert_true(db == ORL_PSNR_MAX);
    orl_imagef_free(&a); orl_imagef_free(&b);
}

/* SSIM straight from its definition, one window at a time. */
static double ssim_direct(const orl_imagef *a, const orl_imagef *b)
{
    double sum = 0;
    int count = 0;
    for (int c = 0; c < 3; c++)
        for (int y = 5; y < a->h - 5; y++)
            for (int x = 5; x < a->w - 5; x++, count++) {
                double n = 0, ma = 0, mb = 0, va = 0, vb = 0, vab = 0;
                for (int pass = 0; pass < 3; pass++)
                    for (int j = -5; j <= 5; j++)
                        for (int i = -5; i <= 5; i++) {
                            double g = exp(-(i * i + j * j) / 4.5);
                            double p = a->px[((y + j) * a->w + x + i) * 3 + c], q = b->px[((y + j) * a->w + x + i) * 3 + c];
                            if (pass == 0) n += g;
                            if (pass == 1) { ma += g * p / n; mb += g * q / n; }
                            if (pass == 2) { va += g * (p - ma) * (p - ma) / n; vb += g * (q - mb) * (q - mb) / n; vab += g * (p - ma) * (q - mb) / n; }
                        }
                sum += (2 * ma * mb + 0.0001) * (2 * vab + 0.0009) / ((ma * ma + mb * mb + 0.0001) * (va + vb + 0.0009));
            }
    return sum / count;
}

static void ssim_as_defined(void **s)
{
    (void)s;
    orl_imagef a = picture(23, 17, 0.1f), b = picture(23, 17, 0.4f);
    double v;
    assert_int_equal(orl_metrics_ssim(&a, &b, 0, 23, &v), ORL_OK);
    assert_true(v < 0.95 && fabs(v - ssim_direct(&a, &b)) < 1e-5);
    assert_int_equal(orl_metrics_ssim(&a, &a, 0, 23, &v), ORL_OK);
    assert_true(fabs(v - 1) < 1e-6);
    assert_int_equal(orl_metrics_ssim(&a, &b, 13, 23, &v), ORL_E_RANGE);       /* ten columns hold no window */
    orl_imagef_free(&a); orl_imagef_free(&b);
}

static void flip_obeys(void **s)
{
    (void)s;
    orl_imagef a = picture(96, 64, 0), b = image(96, 64), c = picture(96, 64, 0.2f), d = picture(96, 64, 0.6f);
    assert_true(flip(&a, &a) == 0);
    double mild = flip(&a, &c), strong = flip(&a, &d);
    assert_true(0 < mild && mild < strong && strong < 1);
    assert_true(fabs(flip(&c, &a) - mild) < 1e-12);
    double last = 0;
    for (int r = 1; r <= 6; r += 2) {
        blur(&a, r, &b);
        double v = flip(&a, &b);
        assert_true(v > last && v < 1);
        last = v;
    }
    /* Flat black against flat white: no features, lightness 100 apart, 100^0.7 = 25.12 of at most 41.28, compressed above the knee. */
    for (int i = 0; i < 96 * 64 * 3; i++) { a.px[i] = 0; b.px[i] = 1; }
    assert_true(fabs(flip(&a, &b) - 0.9674) < 1e-3);
    orl_imagef_free(&a); orl_imagef_free(&b); orl_imagef_free(&c); orl_imagef_free(&d);
}

/* Scores of a range equal scores of the picture cut there; what lies outside, even NaN, has no part. */
static void range_is_a_cut(void **s)
{
    (void)s;
    orl_imagef a = picture(60, 40, 0.1f), b = picture(60, 40, 0.3f), ca = image(37, 40), cb = image(37, 40);
    for (int y = 0; y < 40; y++)
        for (int x = 0; x < 60; x++)
            for (int c = 0; c < 3; c++) {
                int at = (y * 60 + x) * 3 + c;
                if (x < 23) { b.px[at] = NAN; continue; }
                ca.px[(y * 37 + x - 23) * 3 + c] = a.px[at];
                cb.px[(y * 37 + x - 23) * 3 + c] = b.px[at];
            }
    orl_score p, q;
    assert_int_equal(orl_metrics_score(&a, &b, 23, 60, &p), ORL_OK);
    assert_int_equal(orl_metrics_score(&ca, &cb, 0, 37, &q), ORL_OK);
    assert_true(p.psnr == q.psnr && p.ssim == q.ssim && p.flip == q.flip);
    assert_int_equal(orl_metrics_score(&a, &cb, 0, 37, &q), ORL_E_RANGE);
    assert_int_equal(orl_metrics_score(&a, &b, 30, 61, &q), ORL_E_RANGE);
    assert_int_equal(orl_metrics_score(&a, &b, 30, 30, &q), ORL_E_RANGE);
    orl_imagef_free(&a); orl_imagef_free(&b); orl_imagef_free(&ca); orl_imagef_free(&cb);
}

int main(int argc, char **argv)
{
    state = argc > 1 ? (uint32_t)strtoul(argv[1], NULL, 0) : 20220610u;
    printf("seed %u\n", state);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(psnr_of_known_noise), cmocka_unit_test(ssim_as_defined), cmocka_unit_test(flip_obeys), cmocka_unit_test(range_is_a_cut),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
