/* The runtime at its extremes: lights at ten sigma, poses and lenses at the edge, views from one pixel to 16384 wide, huge and tiny worlds, frames that say nothing. Everything is defined and finite, every variant gives the
 * same bytes, and the fixed-point picture stays by the float model's: the table that is printed. Errors are in grey levels of 255, over pixels and channels. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>
#include <stdio.h>
#include "oriel/cpu.h"
#include "runtime/kernels/shade.h"
#include "oriel/widen.h"
#include "tests/synth_scene.h"

static orl_scene scene;
static float sigma[ORL_CODE];
static const double eye[3] = { 6, -14, 26 }, target[3] = { 34, 34, 20 };

static int set_up(void **state)
{
    (void)state;
    synth_scene_make(&scene, 8, 8, 6);
    for (int k = 0; k < ORL_CODE; k++) sigma[k] = scene.light.prior_prec[k][k] > 0 ? fminf(1 / sqrtf(scene.light.prior_prec[k][k]), 3) : 1;
    return 0;
}
static int tear_down(void **state) { (void)state; synth_scene_free(&scene); return 0; }

typedef struct { double mean, worst, bias; } errors;

/* Fixed against float on a view; every variant against the reference. */
static errors shade_all(orl_view *v, const orl_light *l)
{
    static const char *const variants[] = {
#define NAME(n) #n,
        ORL_KERNEL_VARIANTS(NAME)
#undef NAME
    };
    size_t n = (size_t)v->w * (size_t)v->h;
    uint8_t *rgb = malloc(3 * n), *other = malloc(3 * n);
    void *block = orl_widen_block(orl_view_light_need());
    orl_view_light *t = orl_view_light_make(v, l, block, orl_view_light_need());
    assert_non_null(t);
    orl_view_shade(v, t, ORL_CPU_REF, 0, v->h, rgb, 3 * (size_t)v->w);
    for (size_t k = 0; k < sizeof variants / sizeof *variants; k++) {
        unsigned cpu;
        if (orl_cpu_from_name(variants[k], &cpu)) continue;
        orl_view_shade(v, t, cpu, 0, v->h, other, 3 * (size_t)v->w);
        assert_memory_equal(rgb, other, 3 * n);
    }
    errors e = { 0 };
    size_t step = n > 20000 ? n / 20000 : 1, count = 0;
    for (size_t i = 0; i < n; i += step) {
        orl_sample s;
        float want[3];
        orl_view_sample(v, (int)(i % (size_t)v->w), (int)(i / (size_t)v->w), &s);
        orl_light_shade(l, &s, want);
        for (int c = 0; c < 3; c++, count++) {
            assert_true(isfinite(want[c]));
            double d = rgb[3 * i + (size_t)c] - 255.0 * fmin(fmax((double)want[c], 0), 1);
            e.mean += fabs(d);
            e.bias += d;
            e.worst = fmax(e.worst, fabs(d));
        }
    }
    e.mean /= (double)count;
    e.bias /= (double)count;
    free(rgb); free(other); free(block);
    return e;
}

static void row(const char *what, errors e, double mean, double worst)
{
    print_message("%-44s mean %6.3f  bias %6.3f  worst %6.2f\n", what, e.mean, e.bias, e.worst);
    if (!(e.mean <= mean && e.worst <= worst)) fail_msg("%s: mean %.3f, worst %.2f; at most %.2f and %.1f are wanted", what, e.mean, e.worst, mean, worst);
}

static void *build(const orl_camera *cam, const orl_pose *pose, int supersample, orl_view *v)
{
    size_t need = orl_view_need(cam->w, cam->h);
    void *block = orl_widen_block(need);
    assert_non_null(block);
    orl_err e = orl_view_build(&scene, cam, pose, supersample, 2, block, need, v);
    if (e) fail_msg("%s", orl_error_text());
    return block;
}

static void prior_light(orl_light *l, float el)
{
    float code[ORL_CODE];
    memcpy(code, scene.light.prior_mean, sizeof code);
    code[ORL_C_SUN_AZ] = 0.9f;
    code[ORL_C_SUN_EL] = el;
    orl_light_decode(&scene.light, code, l);
}

/* Each entry of the code, then all of them, three and ten standard deviations off either way. A sky at ten is a lamp, which nine terms of a normal tell only so well. */
static void test_lights(void **state)
{
    (void)state;
    orl_camera cam = synth_camera(120, 90, 75);
    orl_pose pose = synth_look(&scene, eye, target);
    orl_view v;
    orl_light *l = malloc(sizeof *l);
    void *block = build(&cam, &pose, 2, &v);
    static const struct { const char *name; int from, to; } PART[] = { { "sun's direction", 0, 2 }, { "sun's strength", 2, 5 }, { "sky's light", 5, 13 }, { "sky's look", 13, 17 }, { "shadow", 17, 25 }, { "tone", 25, 37 }, { "all at once", 0, 37 } };
    uint64_t r = 1;
    for (size_t p = 0; p < sizeof PART / sizeof *PART; p++) for (int sigmas = 3; sigmas <= 10; sigmas += 7) {
        errors most = { 0 };
        int n = p == 6 ? 30 : 2 * (PART[p].to - PART[p].from);
        for (int i = 0; i < n; i++) {
            float code[ORL_CODE];
            memcpy(code, scene.light.prior_mean, sizeof code);
            for (int k = PART[p].from; k < PART[p].to; k++) {
                r = r * 6364136223846793005u + 1442695040888963407u;
                if (p == 6) code[k] += (float)((int)(r >> 40) % 2001 - 1000) * 0.001f * (float)sigmas * sigma[k];
                else if (k == PART[p].from + i / 2) code[k] += (float)(i & 1 ? -sigmas : sigmas) * sigma[k];
            }
            orl_light_decode(&scene.light, code, l);
            orl_view_trace_sun(&v, l, 0, v.h, ORL_CPU_REF, 2);
            errors e = shade_all(&v, l);
            if (e.mean > most.mean) most.mean = e.mean, most.bias = e.bias;
            most.worst = fmax(most.worst, e.worst);
        }
        char what[80];
        int lamp = sigmas == 10 && (p == 2 || p == 6), beyond = sigmas == 10 && p == 6;        /* beyond: more than 2000 times white, where the kernels' range ends */
        snprintf(what, sizeof what, "light, %d sigma: %s (%d)", sigmas, PART[p].name, n);
        row(what, most, beyond ? 30 : lamp ? 6 : 1, beyond ? 255 : lamp ? 120 : 12);
    }
    free(block); free(l);
}

static void test_poses_and_lenses(void **state)
{
    (void)state;
    orl_light *l = malloc(sizeof *l);
    prior_light(l, 0.6f);
    static const struct { const char *name; double eye[3], at[3]; int w, h, model; double fov, k1, mean, worst; } CASE[] = {
        { "inside the wall", { 32, 32, 20 }, { 40, 36, 22 }, 96, 64, 1, 60, 0, 0, 0 },
        { "sky alone", { 6, -14, 26 }, { 6, -13, 60 }, 96, 64, 1, 40, 0, 0, 0 },
        { "grazing the ground", { -30, -30, 10.4 }, { 32, 32, 10.31 }, 96, 64, 1, 50, 0, 0, 0 },
        { "under the ground", { 6, -14, -20 }, { 34, 34, 20 }, 96, 64, 1, 60, 0, 0, 0 },
        { "a million cells away", { 1e6, 1e6, 1e6 }, { 32, 32, 18 }, 96, 64, 1, 60, 0, 0, 0 },
        { "tele, 0.05 degrees", { 6, -14, 26 }, { 34, 34, 20 }, 96, 64, 1, 0.05, 0, 0, 0 },
        { "wide, 150 degrees: 16 pixels span 50 of sky", { 6, -14, 26 }, { 34, 34, 20 }, 96, 64, 1, 150, 0, 2, 25 },
        { "wide, 175 degrees: 16 pixels span 70 of sky", { 6, -14, 26 }, { 34, 34, 20 }, 96, 64, 1, 175, 0, 4, 110 },
        { "fish-eye: k1 -0.45, which folds in the corners", { 6, -14, 26 }, { 34, 34, 20 }, 96, 64, 2, 110, -0.45, 2, 60 },
        { "pincushion: k1 2", { 6, -14, 26 }, { 34, 34, 20 }, 96, 64, 2, 90, 2, 0, 0 },
        { "one pixel", { 6, -14, 26 }, { 34, 34, 20 }, 1, 1, 1, 30, 0, 0, 0 },
        { "16384 x 1", { 6, -14, 26 }, { 34, 34, 20 }, 16384, 1, 1, 120, 0, 0, 0 },
        { "1 x 16384", { 6, -14, 26 }, { 34, 34, 20 }, 1, 16384, 1, 0.01, 0, 0, 0 },
        { "16384 x 48", { 6, -14, 26 }, { 34, 34, 20 }, 16384, 48, 1, 150, 0, 0, 0 },
    };
    for (size_t i = 0; i < sizeof CASE / sizeof *CASE; i++) {
        orl_camera cam = synth_camera(CASE[i].w, CASE[i].h, CASE[i].fov);
        cam.model = CASE[i].model == 2 ? ORL_CAM_SIMPLE_RADIAL : ORL_CAM_PINHOLE;
        cam.k1 = CASE[i].k1;
        orl_pose pose = synth_look(&scene, CASE[i].eye, CASE[i].at);
        orl_view v;
        void *block = build(&cam, &pose, CASE[i].w * CASE[i].h > 100000 ? 1 : 2, &v);
        orl_view_trace_sun(&v, l, 0, v.h, ORL_CPU_REF, 2);
        row(CASE[i].name, shade_all(&v, l), CASE[i].mean > 0 ? CASE[i].mean : 0.6, CASE[i].mean > 0 ? CASE[i].worst : 4);
        free(block);
    }
    free(l);
}

/* The same picture whatever a world unit is. */
static void test_worlds(void **state)
{
    (void)state;
    orl_light *l = malloc(sizeof *l);
    orl_camera cam = synth_camera(96, 64, 60);
    orl_pose pose = synth_look(&scene, eye, target);
    orl_view v, w;
    void *a = build(&cam, &pose, 2, &v), *b;
    double was[12];
    float cell = scene.cell_world;
    memcpy(was, scene.world_to_grid, sizeof was);
    prior_light(l, 0.5f);
    for (int e = -6; e <= 6; e += 3) {
        double unit = pow(10, e);
        orl_pose moved = pose;
        for (int i = 0; i < 12; i++) scene.world_to_grid[i] = i % 4 == 3 ? was[i] : was[i] / unit;
        for (int k = 0; k < 3; k++) moved.t[k] *= unit;
        scene.cell_world = (float)(cell * unit);
        b = build(&cam, &moved, 2, &w);
        int differ = 0;
        for (int i = 0; i < v.stride * v.h; i++) differ += abs(v.depth[i] - w.depth[i]) > 1 || v.cov[i] != w.cov[i];
        char what[60];
        snprintf(what, sizeof what, "a world of units 1e%d", e);
        row(what, shade_all(&w, l), 0.6, 4);
        if (differ > v.w * v.h / 200) fail_msg("%s: %d pixels differ", what, differ);
        free(b);
    }
    memcpy(scene.world_to_grid, was, sizeof was);
    scene.cell_world = cell;
    free(a); free(l);
}

/* Frames that say nothing, or lies: a status, finite codes, a picture; and after them a good frame finds its light again. */
static void test_frames(void **state)
{
    (void)state;
    enum { W = 96, H = 64 };
    static uint8_t photo[W * H * 3], wide[W * H * 3], good[W * H * 3];
    orl_camera cam = synth_camera(W, H, 45), big = synth_camera(W, H, 75);
    orl_pose pose = synth_look(&scene, eye, target);
    orl_widen_config c = { .scene = &scene, .photo = cam, .wide = big, .photo_pose = pose, .wide_pose = pose, .blend = 1, .threads = 2, .cpu = orl_cpu_detect() };
    orl_light *l = malloc(sizeof *l);
    orl_view v;
    void *block = build(&cam, &pose, 2, &v), *tables = orl_widen_block(orl_view_light_need()), *room = orl_widen_block(orl_widen_need(&c));
    prior_light(l, 0.7f);
    orl_view_trace_sun(&v, l, 0, H, ORL_CPU_REF, 1);
    orl_view_shade(&v, orl_view_light_make(&v, l, tables, orl_view_light_need()), ORL_CPU_REF, 0, H, good, 3 * W);
    static const char *const KIND[] = { "black", "white", "red", "grey", "noise", "checks", "half black", "negative", "one bright pixel" };
    enum { KINDS = sizeof KIND / sizeof *KIND };
    for (int first = 0; first < 2; first++)             /* a bad frame first, or after a good one */
        for (int k = 0; k < KINDS; k++) {
            orl_widen w;
            uint32_t r = 12345;
            assert_int_equal(orl_widen_init(&c, room, orl_widen_need(&c), &w), ORL_OK);
            if (!first) assert_int_equal(orl_widen_adapt(&w, good), ORL_OK);
            for (int i = 0; i < W * H * 3; i++) {
                r = r * 1664525 + 1013904223;
                int x = i / 3 % W, y = i / 3 / W;
                photo[i] = (uint8_t)(k == 0 ? 0 : k == 1 ? 255 : k == 2 ? (i % 3 ? 0 : 255) : k == 3 ? 128 : k == 4 ? (int)(r >> 24) : k == 5 ? ((x ^ y) & 1) * 255 : k == 6 ? (x < W / 2 ? 0 : good[i]) : k == 7 ? 255 - good[i] : i / 3 == 1000 ? 255 : 0);
            }
            for (int n = 0; n < 3; n++) {
                assert_int_equal(orl_widen_adapt(&w, photo), ORL_OK);
                assert_true(w.fit.status == ORL_ADAPT_CONVERGED || w.fit.status == ORL_ADAPT_ITERATIONS || w.fit.status == ORL_ADAPT_DEGENERATE);
                if (k < 2 && w.fit.status != ORL_ADAPT_DEGENERATE) fail_msg("%s: status %d", KIND[k], (int)w.fit.status);
                for (int q = 0; q < ORL_CODE; q++) if (!isfinite(w.fit.code[q]) || !isfinite(w.fit.std[q])) fail_msg("%s: code %d is %g +- %g", KIND[k], q, (double)w.fit.code[q], (double)w.fit.std[q]);
                assert_true(isfinite(w.fit.cost) && isfinite(w.fit.rms) && w.fit.inliers >= 0 && w.fit.inliers <= 1);
                memset(wide, 1, sizeof wide);
                assert_int_equal(orl_widen_render(&w, photo, wide), ORL_OK);
            }
            if (k == 0 || k == 1) for (int q = 0; q < 3; q++) assert_int_equal(wide[3 * (H / 2 * W + W / 2) + q], k ? 255 : 0);        /* the photo itself, whatever it is */
            double err = 0;
            for (int n = 0; n < 12; n++) assert_int_equal(orl_widen_adapt(&w, good), ORL_OK);
            for (int i = 0; i < w.nsamples; i++) {
                float rgb[3];
                orl_light_shade(w.light, &w.samples[i], rgb);
                for (int q = 0; q < 3; q++) err += fabs((double)(rgb[q] - w.samples[i].rgb[q])) * 255 / (3 * w.nsamples);
            }
            print_message("%-18s %-6s then a good one: off by %.2f levels\n", KIND[k], first ? "first," : "later,", err);
            if (!(err < 1)) fail_msg("%s: a good frame after it is off by %.2f levels", KIND[k], err);
        }
    free(block); free(tables); free(room); free(l);
}

int main(void)
{
    const struct CMUnitTest tests[] = { cmocka_unit_test(test_lights), cmocka_unit_test(test_poses_and_lenses), cmocka_unit_test(test_worlds), cmocka_unit_test(test_frames) };
    return cmocka_run_group_tests(tests, set_up, tear_down);
}
