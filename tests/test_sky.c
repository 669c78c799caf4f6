/* Sky decoder: parametric skies, the fit, the default model, its file, panoramas. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <cmocka.h>
#include <math.h>
#include <stdio.h>
#include <unistd.h>
#include "oriel/image.h"
#include "oriel/scene.h"
#include "trainer/sky.h"

#define DATA "../shared/data/sky"

/* Smallest pivot of a Cholesky factorisation: positive if the matrix is positive definite. */
static double smallest_pivot(const orl_light_model *m)
{
    static double l[ORL_CODE][ORL_CODE];
    double least = 1e300;
    for (int i = 0; i < ORL_CODE; i++)
        for (int j = 0; j <= i; j++) {
            double s = m->prior_prec[i][j];
            assert_true(m->prior_prec[i][j] == m->prior_prec[j][i]);
            for (int k = 0; k < j; k++) s -= l[i][k] * l[j][k];
            if (i == j) { least = fmin(least, s); if (!(s > 0)) return s; }
            l[i][j] = i == j ? sqrt(s) : s / l[j][j];
        }
    return least;
}

static void check_model(const orl_light_model *m)
{
    const float *f = &m->env_mean[0][0];
    for (size_t i = 0; i < sizeof *m / sizeof *f; i++) assert_true(isfinite(f[i]));
    assert_true(smallest_pivot(m) > 0);
    assert_true(m->prior_prec[0][0] < 1e-3f);
    for (int c = 0; c < 3; c++) {
        assert_true(m->ground[c] == 0.25f);
        float zenith = m->sky_gen[0][c][0] + m->sky_gen[0][c][3], horizon = m->sky_gen[0][c][0];
        assert_true(zenith > 0.2f && horizon < 1 && zenith < horizon);
    }
    assert_true(m->sky_gen[0][2][3] > m->sky_gen[0][0][3]);                /* bluer above */
}

static void parametric_skies_are_plausible(void **state)
{
    (void)state;
    static orl_light_model grey;
    static orl_light l;
    static orl_sky s, t;
    double sum = 0, sq = 0, blue = 0, grey_blue = 0;
    enum { N = 600 };
    for (uint32_t i = 0; i < N; i++) {
        orl_sky_parametric(i, &s);
        orl_sky_parametric(i, &t);
        assert_memory_equal(&s, &t, sizeof s);
        assert_true(s.sun_el > 0.03f && s.sun_el < 1.32f);
        float code[ORL_CODE] = { 0 }, env[ORL_ENV][3], up[3];
        code[ORL_C_SUN_EL] = s.sun_el;
        memcpy(code + ORL_C_SUN_RGB, s.ln_sun, sizeof s.ln_sun);
        for (int w = 0; w < ORL_ENV; w++) for (int c = 0; c < 3; c++) { assert_true(isfinite(s.log_env[w][c]) && fabsf(s.log_env[w][c]) <= 12); env[w][c] = expf(s.log_env[w][c]); }
        orl_light_from_env(&grey, (const float (*)[3])env, code, &l);
        orl_light_esky(&l, (const float[3]){ 0, 0, 1 }, up);
        double e = 0;
        for (int c = 0; c < 3; c++) e += (up[c] + l.sun_rgb[c] * l.sun_dir[2]) / (3 * M_PI);
        sum += log(e);
        sq += log(e) * log(e);
        if (i % 15 == 11) blue += (s.log_env[0][2] - s.log_env[0][0]) / (N / 15);
        if (i % 15 == 0) grey_blue += (s.log_env[0][2] - s.log_env[0][0]) / (N / 15);
    }
    double mean = sum / N, dev = sqrt(sq / N - mean * mean);
    print_message("ln of display value of a white horizontal surface: %.3f +- %.3f; ln B / R overhead: clear %.2f, overcast %.2f\n", mean, dev, blue, grey_blue);
    assert_true(fabs(mean) < 0.1 && fabs(dev - 0.7) < 0.08);
    assert_true(blue > 0.5 && fabs(grey_blue) < 0.3);
}

static void default_model_is_sound(void **state)
{
    (void)state;
    static orl_light_model m, again;
    orl_light_model_default(&m);
    orl_light_model_default(&again);
    assert_memory_equal(&m, &again, sizeof m);
    check_model(&m);
    /* Unit variance over the skies it was made from; unseen ones are rebuilt far better than by the mean. */
    static orl_sky s;
    double var[ORL_ENV_DIM] = { 0 }, alone = 0, best = 0;
    for (uint32_t i = 0; i < 456; i++) {
        float z[ORL_ENV_DIM];
        orl_sky_parametric(i < 256 ? i : 10000 + i, &s);
        float r = orl_sky_project(&m, &s, z);
        if (i < 256) for (int k = 0; k < ORL_ENV_DIM; k++) var[k] += z[k] * z[k] / 256;
        else { best += r / 200; alone += orl_sky_project(&m, &s, NULL) / 200; }
    }
    for (int k = 0; k < ORL_ENV_DIM; k++) { print_message("var z%d %.2f\n", k, var[k]); assert_true(var[k] > 0.6 && var[k] < 1.6); }
    print_message("unseen parametric skies: mean alone %.3f, decoder %.3f (rms ln radiance)\n", alone, best);
    assert_true(best < 0.3 * alone);
}

static void fit_refuses_too_few(void **state)
{
    (void)state;
    static orl_sky s[16];
    static orl_light_model m;
    assert_int_equal(orl_sky_fit(s, 15, &m), ORL_E_RANGE);
    memset(s, 0, sizeof s);                                                 /* all alike: no variance at all */
    assert_int_equal(orl_sky_fit(s, 16, &m), ORL_OK);
    assert_true(smallest_pivot(&m) > 0);
    for (int k = 0; k < ORL_ENV_DIM; k++) assert_true(isfinite(m.env_basis[k][7][1]));
}

static void file_keeps_the_model(void **state)
{
    (void)state;
    char path[64];
    snprintf(path, sizeof path, "/tmp/oriel-sky-%ld.oriel", (long)getpid());
    static orl_scene scene;
    static orl_light_model m;
    orl_light_model_default(&scene.light);
    size_t bytes = 0;
    assert_int_equal(orl_scene_write(path, &scene, &bytes), ORL_OK);
    orl_err e = orl_sky_load(path, &m);
    unlink(path);
    assert_int_equal(e, ORL_OK);
    check_model(&m);
    float worst = 0;
    for (int w = 0; w < ORL_ENV; w++) for (int c = 0; c < 3; c++) worst = fmaxf(worst, fabsf(m.env_mean[w][c] - scene.light.env_mean[w][c]));
    assert_true(worst < 1e-3f);
    assert_memory_equal(m.prior_prec, scene.light.prior_prec, sizeof m.prior_prec);
    assert_int_equal(orl_sky_load("/nonexistent/sky.oriel", &m), ORL_E_IO);
}

/* Radiance RGBE, not compressed. */
static void write_hdr(const char *path, const orl_imagef *im)
{
    FILE *f = fopen(path, "wb");
    assert_non_null(f);
    fprintf(f, "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y %d +X %d\n", im->h, im->w);
    for (int i = 0; i < im->w * im->h; i++) {
        const float *p = im->px + 3 * i;
        int e;
        frexp(fmaxf(p[0], fmaxf(p[1], p[2])), &e);
        for (int c = 0; c < 3; c++) fputc((int)ldexp(p[c], 8 - e) & 255, f);
        fputc(p[0] > 0 ? e + 128 : 0, f);
    }
    assert_int_equal(fclose(f), 0);
}

/* A made-up panorama: even sky, a sun at a known place, a brighter patch a quarter turn to the right (clockwise) of it. */
static void panorama_geometry(void **state)
{
    (void)state;
    char path[3][64];                                                       /* three names: OpenImageIO remembers a file by its name */
    for (int i = 0; i < 3; i++) snprintf(path[i], sizeof path[i], "/tmp/oriel-pano-%ld-%d.hdr", (long)getpid(), i);
    enum { W = 256, H = 128, SX = 40, SY = 32 };
    orl_imagef im;
    assert_int_equal(orl_imagef_alloc(&im, W, H, 3), ORL_OK);
    for (int i = 0; i < W * H * 3; i++) im.px[i] = 0.5f;
    for (int y = 40; y < 50; y++) for (int x = SX + W / 4 - 4; x < SX + W / 4 + 4; x++) for (int c = 0; c < 3; c++) im.px[3 * (y * W + x) + c] = 1;
    for (int c = 0; c < 3; c++) im.px[3 * (SY * W + SX) + c] = 5000;
    write_hdr(path[0], &im);
    orl_imagef_free(&im);
    static orl_sky s, t;
    double azimuth;
    orl_err e = sky_from_panorama(path[0], &s, &azimuth);
    unlink(path[0]);
    assert_int_equal(e, ORL_OK);
    double el = M_PI / 2 - (SY + 0.5) * M_PI / H, area = 2 * M_PI / W * M_PI / H * cos(el);
    assert_true(fabs(s.sun_el - el) < 0.04);
    assert_true(fabs(azimuth - (0.5 - (SX + 0.5) / W) * 2 * M_PI) < 0.04);
    /* Sun against sky keeps its ratio: (5000 - 0.5) * area to 0.5. */
    double ratio = exp(s.ln_sun[1] - s.log_env[2 * ORL_ENV_COLS + 2][1]);
    assert_true(fabs(ratio / (4999.5 * area / 0.5) - 1) < 0.1);
    int brightest = 0;
    for (int w = 0; w < ORL_ENV; w++) if (s.log_env[w][0] > s.log_env[brightest][0]) brightest = w;
    assert_in_range(brightest % ORL_ENV_COLS, 7, 8);                        /* clockwise from the sun is negative azimuth: -90 degrees lies between columns 7 and 8 */
    assert_int_equal(brightest / ORL_ENV_COLS, 5);
    t = s;
    sky_mirror(&t);
    assert_true(t.log_env[brightest - brightest % 32 + 31 - brightest % 32][0] == s.log_env[brightest][0]);

    assert_int_equal(orl_imagef_alloc(&im, 100, 80, 3), ORL_OK);
    write_hdr(path[1], &im);
    orl_imagef_free(&im);
    e = sky_from_panorama(path[1], &s, NULL);
    unlink(path[1]);
    assert_int_equal(e, ORL_E_FORMAT);
    assert_int_equal(orl_imagef_alloc(&im, W, H, 3), ORL_OK);
    write_hdr(path[2], &im);
    orl_imagef_free(&im);
    e = sky_from_panorama(path[2], &s, NULL);
    unlink(path[2]);
    assert_int_equal(e, ORL_E_DEGENERATE);
}

static void panoramas_held_out(void **state)
{
    (void)state;
    if (access(DATA "/split.tsv", R_OK)) { print_message("no panoramas at " DATA "\n"); skip(); }
    static const char *const NAME[] = { "modern_buildings_2_1k.hdr", "pmndrs_sunrise.hdr", "noon_grass_1k.hdr", "venice_sunset_1k.hdr", "hilly_terrain_01_1k.hdr" };
    assert_int_equal(sky_split(DATA "/modern_buildings_2_1k.hdr"), SKY_TEST);
    assert_int_equal(sky_split(DATA "/noon_grass_1k.hdr"), SKY_BASILICA);
    assert_int_equal(sky_split(DATA "/dikhololo_night_1k.hdr"), SKY_TRAIN);
    assert_int_equal(sky_split("nowhere/else.hdr"), SKY_TRAIN);
    static orl_light_model m;
    static orl_sky s;
    orl_light_model_default(&m);                                            /* has seen no panorama at all */
    for (size_t i = 0; i < sizeof NAME / sizeof *NAME; i++) {
        char path[256];
        float z[ORL_ENV_DIM];
        snprintf(path, sizeof path, DATA "/%s", NAME[i]);
        assert_int_equal(sky_from_panorama(path, &s, NULL), ORL_OK);
        float alone = orl_sky_project(&m, &s, NULL), best = orl_sky_project(&m, &s, z);
        print_message("%s: mean alone %.3f, decoder %.3f\n", NAME[i], (double)alone, (double)best);
        assert_true(best < 0.8f * alone);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(parametric_skies_are_plausible), cmocka_unit_test(default_model_is_sound), cmocka_unit_test(fit_refuses_too_few),
        cmocka_unit_test(file_keeps_the_model), cmocka_unit_test(panorama_geometry), cmocka_unit_test(panoramas_held_out) };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
