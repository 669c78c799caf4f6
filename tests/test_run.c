/* The camera loop with a source and a sink of its own: nothing allocates after the first frame, lost pictures are repeated, the light is followed, threads and kernels agree. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <unistd.h>
#include "oriel/cpu.h"
#include "runtime/run.h"
#include "tests/allocations.h"
#include "tests/synth_scene.h"

enum { W = 96, H = 64, FRAMES = 8, JUMP = 5 };

static orl_scene scene;
static uint8_t clip[FRAMES][W * H * 3], truth[FRAMES][W * H * 3];       /* recorded view; wide view */
static orl_camera cam, wide_cam;
static orl_pose pose;

static void render(orl_view *v, const orl_light *l, uint8_t *rgb)
{
    void *block = orl_widen_block(orl_view_light_need());
    orl_view_light *t = orl_view_light_make(v, l, block, orl_view_light_need());
    assert_non_null(t);
    orl_view_trace_sun(v, l, 0, v->h, ORL_CPU_REF, 1);
    orl_view_shade(v, t, ORL_CPU_REF, 0, v->h, rgb, (size_t)v->w * 3);
    free(block);
}

static int set_up(void **state)
{
    (void)state;
    const double eye[3] = { 6, -14, 26 }, target[3] = { 34, 34, 20 };
    orl_view view, wide;
    orl_light *light = malloc(sizeof *light);
    synth_scene_make(&scene, 8, 8, 6);
    cam = synth_camera(W, H, 45);
    wide_cam = synth_camera(W, H, 75);
    pose = synth_look(&scene, eye, target);
    void *a = orl_widen_block(orl_view_need(W, H)), *b = orl_widen_block(orl_view_need(W, H));
    assert_int_equal(orl_view_build(&scene, &cam, &pose, 2, 1, a, orl_view_need(W, H), &view), ORL_OK);
    assert_int_equal(orl_view_build(&scene, &wide_cam, &pose, 2, 1, b, orl_view_need(W, H), &wide), ORL_OK);
    for (int i = 0; i < FRAMES; i++) {
        float code[ORL_CODE];
        memcpy(code, scene.light.prior_mean, sizeof code);
        code[ORL_C_SUN_AZ] = 0.9f + 0.02f * (float)i;
        code[ORL_C_SUN_EL] = 0.6f;
        for (int k = 0; k < 3; k++) code[ORL_C_TONE + 4 * k] += i >= JUMP ? -0.25f : 0;
        orl_light_decode(&scene.light, code, light);
        render(&view, light, clip[i]);
        render(&wide, light, truth[i]);
    }
    free(a); free(b); free(light);
    return 0;
}

static int tear_down(void **state)
{
    (void)state;
    synth_scene_free(&scene);
    return 0;
}

/* ---- a source that loses some pictures, a sink that watches ---- */

typedef struct { orl_source base; int at; unsigned lost; } source;
static int next(orl_source *s, orl_frame *f)
{
    source *c = (source *)s;
    if (c->at == FRAMES) return 0;
    int i = c->at++;
    if (c->lost >> i & 1) {
        orl_fail(ORL_E_FORMAT, "picture %d: lost on purpose", i);
        return -1;
    }
    orl_frame_layout(&s->info, clip[i], f);
    return 1;
}
static void no_close(orl_source *s) { (void)s; }

typedef struct { orl_sink base; long first; uint8_t got[FRAMES][W * H * 3]; } sink;
static orl_err put(orl_sink *s, const uint8_t *rgb, size_t row)
{
    sink *k = (sink *)s;
    assert_int_equal(row, W * 3);
    assert_true(s->frame < FRAMES);
    if (!s->frame) k->first = allocations;
    memcpy(k->got[s->frame], rgb, sizeof *k->got);
    return ORL_OK;
}
static orl_err close_sink(orl_sink *s, char *line, size_t cap) { (void)s; (void)line; (void)cap; return ORL_OK; }

static const orl_source_ops SOURCE = { next, no_close };
static const orl_sink_ops SINK = { put, close_sink };
static sink out;

static orl_err go(unsigned lost, int threads, unsigned cpu, int blend, orl_run_options o, orl_run_figures *f)
{
    source in = { { &SOURCE, { .w = W, .h = H, .pixels = ORL_PIX_RGB, .full_range = 1, .fps_num = 25, .fps_den = 1 }, 0 }, 0, lost };
    orl_widen_config c = { .scene = &scene, .photo = cam, .wide = wide_cam, .photo_pose = pose, .wide_pose = pose, .blend = blend, .threads = threads, .cpu = cpu };
    orl_widen w;
    static uint8_t photo[W * H * 3], wide[W * H * 3];
    void *block = orl_widen_block(orl_widen_need(&c));
    out.base = (orl_sink) { &SINK, W, H, 0 };
    assert_int_equal(orl_widen_init(&c, block, orl_widen_need(&c), &w), ORL_OK);
    int mute = open("/dev/null", O_WRONLY), err = dup(STDERR_FILENO);       /* lost pictures are named there */
    dup2(mute, STDERR_FILENO);
    orl_err e = orl_run_loop(&w, &in.base, &out.base, &o, photo, wide, f);
    dup2(err, STDERR_FILENO);
    close(mute);
    close(err);
    if (!e) assert_int_equal(COUNTING ? allocations : 0, COUNTING ? out.first : 0);
    free(block);
    return e;
}

static const orl_run_options EVERY = { .adapt_every = 1 };

static double mean_error(const uint8_t *a, const uint8_t *b)
{
    double sum = 0;
    for (int i = 0; i < W * H * 3; i++) sum += abs(a[i] - b[i]);
    return sum / (W * H * 3);
}

static void follows_the_light(void **state)
{
    (void)state;
    orl_run_figures f;
    for (int blend = 0; blend < 2; blend++) {
        assert_int_equal(go(0, 1, ORL_CPU_REF, blend, EVERY, &f), ORL_OK);
        assert_int_equal(f.frames, FRAMES);
        assert_int_equal(f.lost, 0);
        for (int i = 0; i < FRAMES; i++) {
            double e = mean_error(out.got[i], truth[i]);
            if (e > 2.5) print_message("frame %d: mean error %.2f levels\n", i, e);
            assert_true(e <= 2.5);
        }
    }
    assert_true(mean_error(truth[0], truth[FRAMES - 1]) > 8);      /* or the above says nothing */
}

static void allocates_nothing(void **state)
{
    (void)state;
    orl_run_figures f;
    if (!COUNTING) skip();
    long before = allocations;
    void *volatile p = malloc(1);
    free(p);
    assert_int_equal(allocations, before + 1);
    for (int threads = 1; threads <= 2; threads++) {
        assert_int_equal(go(0x28, threads, orl_cpu_detect(), 1, EVERY, &f), ORL_OK);
        assert_int_equal(allocations, out.first);
    }
}

static void repeats_lost_pictures(void **state)
{
    (void)state;
    orl_run_figures f;
    assert_int_equal(go(0x0d, 1, ORL_CPU_REF, 1, EVERY, &f), ORL_OK);     /* 0, 2, 3 lost: 0 has nothing to repeat */
    assert_int_equal(f.lost, 3);
    assert_int_equal(f.frames, FRAMES - 1);
    assert_memory_equal(out.got[0], out.got[1], sizeof *out.got);
    assert_memory_equal(out.got[0], out.got[2], sizeof *out.got);
    assert_memory_not_equal(out.got[2], out.got[3], sizeof *out.got);
    assert_int_equal(go(0xff, 1, ORL_CPU_REF, 1, EVERY, &f), ORL_E_FORMAT);
}

static void threads_and_kernels_agree(void **state)
{
    (void)state;
    static uint8_t first[FRAMES][W * H * 3];
    orl_run_figures f;
    for (int threads = 1; threads <= 3; threads++)
        for (int cpu = 0; cpu < 2; cpu++) {
            assert_int_equal(go(0x10, threads, cpu ? orl_cpu_detect() : ORL_CPU_REF, 1, EVERY, &f), ORL_OK);
            if (threads == 1 && !cpu) memcpy(first, out.got, sizeof first);
            assert_memory_equal(first, out.got, sizeof first);
        }
}

/* A light that stands costs nothing after a while, noise and passers-by do not wake it, a change of exposure does; the picture is nearly that of --no-skip. */
static void light_that_stands(void **state)
{
    (void)state;
    static uint8_t photo[W * H * 3], got[2][W * H * 3];
    enum { LONG = 30, ASLEEP = 20 };
    uint32_t noise = 7;
    for (int no_skip = 0; no_skip < 2; no_skip++) {
        orl_widen_config c = { .scene = &scene, .photo = cam, .wide = wide_cam, .photo_pose = pose, .wide_pose = pose, .no_skip = no_skip, .threads = 1, .cpu = ORL_CPU_REF };
        orl_widen w;
        void *block = orl_widen_block(orl_widen_need(&c));
        assert_int_equal(orl_widen_init(&c, block, orl_widen_need(&c), &w), ORL_OK);
        for (int i = 0; i < LONG; i++) {
            memcpy(photo, clip[0], sizeof photo);
            for (int k = 0; k < W * H * 3; k++) {
                noise = noise * 1664525u + 1013904223u;
                int v = photo[k] + (int)(noise >> 30) - 1;
                photo[k] = (uint8_t)(v < 0 ? 0 : v > 255 ? 255 : v);
            }
            for (int y = H / 2; i > ASLEEP && y < H; y++) memset(photo + (y * W + i) * 3, 20, 3 * 4);      /* somebody walks by */
            assert_int_equal(orl_widen_adapt(&w, photo), ORL_OK);
            assert_true(no_skip || i < ASLEEP ? w.starts > 0 || i > 15 : w.starts == 0);
        }
        assert_int_equal(orl_widen_render(&w, photo, got[no_skip]), ORL_OK);
        assert_int_equal(orl_widen_adapt(&w, clip[JUMP]), ORL_OK);
        assert_true(w.starts > 0);
        assert_int_equal(orl_widen_render(&w, clip[JUMP], photo), ORL_OK);
        assert_true(mean_error(photo, truth[JUMP]) < 2.5);
        free(block);
    }
    print_message("with and without: %.2f levels apart\n", mean_error(got[0], got[1]));
    assert_true(mean_error(got[0], got[1]) < 1 && mean_error(got[0], truth[0]) < 2.5);
}

static void options(void **state)
{
    (void)state;
    orl_run_figures f;
    assert_int_equal(go(0, 1, ORL_CPU_REF, 0, (orl_run_options) { .frames = 3, .adapt_every = 2 }, &f), ORL_OK);
    assert_int_equal(f.frames, 3);
    assert_memory_equal(out.got[0], out.got[1], sizeof *out.got);          /* no adaptation, no blend: the same light again */
    assert_memory_not_equal(out.got[1], out.got[2], sizeof *out.got);
}

/* Light found while the wide view is marched is the light found after it, and so is the picture; threads or not. */
static void start_is_init_and_adapt(void **state)
{
    (void)state;
    static uint8_t wide[2][W * H * 3];
    for (int threads = 1; threads <= 3; threads++) {
        orl_widen_config c = { .scene = &scene, .photo = cam, .wide = wide_cam, .photo_pose = pose, .wide_pose = pose, .blend = 1, .threads = threads, .cpu = orl_cpu_detect() };
        orl_widen a, b;
        void *room[2] = { orl_widen_block(orl_widen_need(&c)), orl_widen_block(orl_widen_need(&c)) };
        assert_int_equal(orl_widen_init(&c, room[0], orl_widen_need(&c), &a), ORL_OK);
        assert_int_equal(orl_widen_adapt(&a, clip[0]), ORL_OK);
        assert_int_equal(orl_widen_start(&c, clip[0], room[1], orl_widen_need(&c), &b), ORL_OK);
        assert_memory_equal(a.fit.code, b.fit.code, sizeof a.fit.code);
        assert_int_equal(orl_widen_render(&a, clip[0], wide[0]), ORL_OK);
        assert_int_equal(orl_widen_render(&b, clip[0], wide[1]), ORL_OK);
        assert_memory_equal(wide[0], wide[1], sizeof wide[0]);
        for (int k = 0; k < 2; k++) free(room[k]);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(start_is_init_and_adapt), cmocka_unit_test(follows_the_light), cmocka_unit_test(allocates_nothing), cmocka_unit_test(repeats_lost_pictures), cmocka_unit_test(threads_and_kernels_agree), cmocka_unit_test(light_that_stands), cmocka_unit_test(options),
    };
    return cmocka_run_group_tests(tests, set_up, tear_down);
}
