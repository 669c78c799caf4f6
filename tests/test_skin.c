/* Base colour in textures: which texture answers, bilinear values against double, and what is fitted: a pattern finer than the grids from samples with outliers, borders that bricks share, the coarse colour where
 * nothing was seen, the same for any number of threads. */
#include "tests/scratch.h"
#include <math.h>
#include "oriel/scene.h"
#include "trainer/skin.h"

static void faces(void **state)
{
    (void)state;
    assert_int_equal(orl_skin_face(63, (int32_t[]){ 5, -7, 6 }), 3);
    assert_int_equal(orl_skin_face(63, (int32_t[]){ 5, 5, -5 }), 0);            /* the first of equals */
    assert_int_equal(orl_skin_face(1 << 0 | 1 << 4, (int32_t[]){ 5, -7, 6 }), 4);
    assert_int_equal(orl_skin_face(1 << 1 | 1 << 5, (int32_t[]){ 5, -7, 6 }), 1);   /* all look away: the least */
    for (int f = 0; f < 6; f++) assert_int_equal(orl_skin_face(1u << f, (int32_t[]){ 0, 0, 0 }), f);
    uint32_t e = 77u << 6 | 1 << 0 | 1 << 3 | 1 << 5;
    assert_int_equal(orl_skin_texture(e, 0), 77);
    assert_int_equal(orl_skin_texture(e, 3), 78);
    assert_int_equal(orl_skin_texture(e, 5), 79);
}

static void bilinear(void **state)
{
    (void)state;
    static uint8_t t[ORL_SKIN_TEXELS * 3];
    rng r = rng_make(11, 0, 0);
    for (size_t i = 0; i < sizeof t; i++) t[i] = (uint8_t)rng_below(&r, 256);
    for (int i = 0; i < 20000; i++) {
        int face = (int)rng_below(&r, 6), a = face >> 1;
        int32_t at[3];
        for (int k = 0; k < 3; k++) at[k] = i % 7 == k ? (i & 1 ? 8 << 12 : 0) : (int32_t)rng_below(&r, (8 << 12) + 2000) - 1000;
        uint32_t rgb[3];
        orl_skin_colour(t, face, at, rgb);
        double q[2];
        int first[2];
        for (int k = 0; k < 2; k++) {
            q[k] = fmin(fmax(at[(a + 1 + k) % 3] / 4096.0, 0), 8) * ORL_SKIN_PER_CELL;
            first[k] = (int)fmin(q[k], ORL_SKIN_SIDE - 2);
            q[k] -= first[k];
        }
        for (int c = 0; c < 3; c++) {
            double v = 0;
            for (int n = 0; n < 4; n++) {
                double b = t[3 * (first[0] + (n & 1) + ORL_SKIN_SIDE * (first[1] + (n >> 1))) + c] / 255.0;
                v += b * b * (n & 1 ? q[0] : 1 - q[0]) * (n & 2 ? q[1] : 1 - q[1]);
            }
            assert_true(rgb[c] <= 65535 && fabs(rgb[c] / 65535.0 - v) < 0.009);      /* places to 1/256 texel */
        }
    }
    memset(t, 255, sizeof t);
    uint32_t white[3];
    orl_skin_colour(t, 4, (int32_t[]){ 1234, 32768, 0 }, white);
    assert_true(white[0] == 65535 && white[1] == 65535 && white[2] == 65535);
}

enum { NB = 4, SIDE = ORL_SKIN_SIDE };
static const double TILT[3] = { -0.2, -0.15, 1 }, OFF = 9.3;       /* z = OFF + 0.2 x + 0.15 y, solid below */

static surface plane(void)
{
    surface s = { .nb = { NB, NB, NB }, .f = { .dims = { 8 * NB, 8 * NB, 8 * NB } } };
    s.bmap = malloc(NB * NB * NB * sizeof *s.bmap);
    s.sdf = malloc(NB * NB * NB * ORL_BRICK_VERTS * sizeof *s.sdf);
    for (int b = 0; b < NB * NB * NB; b++) {
        float *v = s.sdf + (size_t)s.nbricks * ORL_BRICK_VERTS, lo = 1e9f, hi = -1e9f;
        for (int i = 0; i < ORL_BRICK_VERTS; i++) {
            double x[3] = { b % NB * 8 + i % 9, b / NB % NB * 8 + i / 9 % 9, b / NB / NB * 8 + i / 81 };
            v[i] = (float)((x[2] - OFF + TILT[0] * x[0] + TILT[1] * x[1]) / sqrt(1 + 0.04 + 0.0225));
            lo = fminf(lo, v[i]);
            hi = fmaxf(hi, v[i]);
        }
        s.bmap[b] = lo < 0 && hi > 0 ? (int32_t)s.nbricks++ : -1;
    }
    return s;
}

static void coarse(const void *user, const float x[3], float rgb[3])
{
    (void)user;
    (void)x;
    rgb[0] = 0.3f;
    rgb[1] = 0.4f;
    rgb[2] = 0.5f;
}

/* Two texels a stripe. */
static float pattern(const float x[3]) { return 0.3f + 0.15f * sinf(3.14159265f * x[0] / 2) * cosf(3.14159265f * x[1] / 3); }

static void fitted(void **state)
{
    (void)state;
    enum { N = 300000 };
    surface surf = plane();
    skin s[2];
    skin_sample *q = malloc(N * sizeof *q);
    uint32_t *begin = calloc(surf.nbricks + 1, sizeof *begin);
    for (uint32_t i = 0, n = 0; i < surf.nbricks; i++) {       /* samples brick by brick, none where x > 24 */
        rng r = rng_make(5, i, 0);
        for (int k = 0; k < N / NB / NB; k++) {
            float x[3] = { 24 * rng_f(&r), 32 * rng_f(&r), 0 }, rgb[3], slope[3] = { 1, 1, 1 };
            int b[3];
            x[2] = (float)(OFF - TILT[0] * x[0] - TILT[1] * x[1]);
            if (surface_brick(&surf, x, b) != (int32_t)i || n == N) continue;
            rgb[0] = rng_below(&r, 10) ? pattern(x) : 1;        /* one in ten is somebody's coat */
            rgb[1] = rgb[2] = pattern(x);
            skin_say(&q[n++], b, x, (float[]){ -0.8f, -0.6f, 4 }, rgb, slope, 1);
        }
        begin[i + 1] = n;
    }
    for (int t = 0; t < 2; t++) {
        assert_int_equal(skin_init(&s[t], &surf, t + 1), ORL_OK);
        assert_int_equal(skin_fit(&s[t], &surf, q, begin, coarse, NULL, t + 1), ORL_OK);
    }
    assert_int_equal(s[0].n, surf.nbricks);                     /* all of it looks up */
    for (uint32_t i = 0; i < surf.nbricks; i++) assert_int_equal(orl_skin_mask(s[0].index[i]), 1 << 4);
    assert_memory_equal(s[0].texel, s[1].texel, (size_t)s[0].n * ORL_SKIN_TEXELS * sizeof *s[0].texel);
    double err = 0, stain = 0;
    int n = 0;
    rng r = rng_make(6, 0, 0);
    for (int k = 0; k < 5000; k++) {
        float x[3] = { 32 * rng_f(&r), 31 * rng_f(&r), 0 }, rgb[3], want[3];
        int b[3];
        x[2] = (float)(OFF - TILT[0] * x[0] - TILT[1] * x[1]);
        int32_t m = surface_brick(&surf, x, b);
        if (m < 0) continue;
        skin_colour(&s[0], (uint32_t)m, b, x, (float[]){ -0.8f, -0.6f, 4 }, rgb);
        coarse(NULL, x, want);
        if (x[0] > 25) for (int c = 0; c < 3; c++) assert_true(fabsf(rgb[c] - want[c]) < 1e-5f);
        if (x[0] > 22 || x[1] < 1) continue;
        err += fabs(rgb[2] - pattern(x));
        stain += rgb[0] - pattern(x);
        n++;
    }
    print_message("%d places, off by %.4f, outliers' pull %.4f\n", n, err / n, stain / n);
    assert_true(n > 2000 && err / n < 0.01 && fabs(stain / n) < 0.02);
    for (size_t i = 0; i < NB * NB * NB; i++) {                 /* neighbours along x */
        if (i % NB == NB - 1 || surf.bmap[i] < 0 || surf.bmap[i + 1] < 0) continue;
        float (*a)[3] = s[0].texel + (size_t)surf.bmap[i] * ORL_SKIN_TEXELS, (*b)[3] = s[0].texel + (size_t)surf.bmap[i + 1] * ORL_SKIN_TEXELS;
        for (int v = 0; v < SIDE; v++) {
            float x[3] = { (float)(i % NB * 8 + 8), (float)(i / NB % NB * 8) + (float)v / ORL_SKIN_PER_CELL, 0 };
            x[2] = (float)(OFF - TILT[0] * x[0] - TILT[1] * x[1]) - (float)(i / NB / NB * 8);
            if (x[2] < 0 || x[2] > 8) continue;                 /* the surface leaves the layer there */
            for (int c = 0; c < 3; c++) assert_true(fabsf(a[v * SIDE + SIDE - 1][c] - b[v * SIDE][c]) < 1e-3f);
        }
    }
    for (int t = 0; t < 2; t++) skin_free(&s[t]);
    free(q);
    free(begin);
    surface_free(&surf);
}

static void what_says_nothing(void **state)
{
    (void)state;
    const float x[3] = { 3, 4, 5 }, grad[3] = { 0, 0, 1 }, grey[3] = { 0.5f, 0.5f, 0.5f }, one[3] = { 1, 1, 1 }, bad[] = { NAN, INFINITY, -1, 40 };
    const int b[3] = { 0 };
    skin_sample q;
    skin_say(&q, b, x, grad, grey, one, 0.5f);
    assert_true(q.weight == 128 && q.rgb[0] == 16384 && q.slope[1] == 2048 && q.at[2] == 5 << 12 && q.grad[2] == 127);
    for (int i = 0; i < 4; i++) {
        skin_say(&q, b, x, grad, (float[]){ 0.5f, bad[i], 0.5f }, one, 1);
        assert_int_equal(q.weight, 0);
        skin_say(&q, b, x, grad, grey, (float[]){ 1, 1, bad[i] }, 1);
        assert_int_equal(q.weight, 0);
    }
    skin_say(&q, b, x, (float[]){ 0, NAN, 0 }, grey, one, 1);
    assert_int_equal(q.weight, 0);
    skin_say(&q, b, x, grad, grey, one, NAN);
    assert_int_equal(q.weight, 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = { cmocka_unit_test(faces), cmocka_unit_test(bilinear), cmocka_unit_test(fitted), cmocka_unit_test(what_says_nothing) };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
