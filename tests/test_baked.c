/* Baked views: what is written comes back, a baked sun agrees with a traced one, a roof hides high suns and lets low ones in, threads agree, and hostile files are named. */
#include "tests/scratch.h"
#include <math.h>
#include "oriel/cpu.h"
#include "runtime/baked.h"
#include "oriel/widen.h"
#include "tests/synth_scene.h"

enum { W = 96, H = 64 };
static orl_scene scene;
static orl_camera cam;
static orl_pose pose;
static orl_view view[ORL_VIEWS];
static uint8_t *ceiling[ORL_VIEWS];
static void *block[ORL_VIEWS];
static orl_light light;

static int set_up(void **state)
{
    if (scratch_make(state)) return -1;
    synth_scene_make(&scene, 8, 8, 6);
    cam = synth_camera(2 * W, 2 * H, 45);
    pose = synth_look(&scene, (double[]){ 6, -14, 26 }, (double[]){ 34, 34, 20 });
    for (int k = 0; k < ORL_VIEWS; k++) {
        orl_camera c = k ? synth_camera(W, H, 70) : orl_camera_resized(&cam, W / 2, H / 2);
        block[k] = orl_widen_block(orl_view_need(c.w, c.h));
        if (orl_view_build(&scene, &c, &pose, 2, 1, block[k], orl_view_need(c.w, c.h), &view[k])) return -1;
        ceiling[k] = calloc((size_t)view[k].stride * (size_t)view[k].h, ORL_HORIZON);
        orl_view_bake(&view[k], 0, c.h, 2, ceiling[k]);
    }
    return 0;
}

static int tear_down(void **state)
{
    for (int k = 0; k < ORL_VIEWS; k++) { free(block[k]); free(ceiling[k]); }
    synth_scene_free(&scene);
    return scratch_remove(state);
}

static void write_file(const char *path)
{
    orl_view v[ORL_VIEWS];
    memcpy(v, view, sizeof v);
    for (int k = 0; k < ORL_VIEWS; k++) v[k].ceiling = ceiling[k];
    assert_int_equal(orl_baked_write(path, &scene, &cam, v, NULL), ORL_OK);
}

static void sun_at(float az, float el)
{
    float code[ORL_CODE];
    memcpy(code, scene.light.prior_mean, sizeof code);
    code[ORL_C_SUN_AZ] = az;
    code[ORL_C_SUN_EL] = el;
    orl_light_decode(&scene.light, code, &light);
}

static void comes_back(void **state)
{
    (void)state;
    orl_baked b;
    write_file(at("v.oriel"));
    assert_int_equal(orl_baked_open(at("v.oriel"), &b), ORL_OK);
    assert_true(b.photo.w == cam.w && b.photo.h == cam.h && b.photo.fx == cam.fx && b.photo.cy == cam.cy);
    assert_memory_equal(b.scene.light.prior_mean, scene.light.prior_mean, sizeof scene.light.prior_mean);
    for (int k = 0; k < ORL_VIEWS; k++) {
        const orl_view *a = &view[k], *r = &b.view[k];
        size_t n = (size_t)a->stride * (size_t)a->h;
        assert_true(a->w == r->w && a->h == r->h && a->stride == r->stride && a->cam.fx == r->cam.fx);
        assert_memory_equal(a->pose.R, r->pose.R, sizeof a->pose.R);
        assert_memory_equal(a->grid_from_cam, r->grid_from_cam, sizeof a->grid_from_cam);
        assert_memory_equal(a->phi_scale, r->phi_scale, sizeof a->phi_scale);
        for (int c = 0; c < 3; c++) {
            assert_memory_equal(a->normal[c], r->normal[c], n);
            assert_memory_equal(a->albedo[c], r->albedo[c], n);
        }
        assert_memory_equal(a->open, r->open, n);
        assert_memory_equal(a->cov, r->cov, n);
        assert_memory_equal(a->horizon, r->horizon, n * ORL_HORIZON);
        for (int g = 0; g < 2; g++) assert_memory_equal(a->phi[g], r->phi[g], n * ORL_SHADOW_DIM / 2);
        assert_memory_equal(a->depth, r->depth, n * 2);
        assert_memory_equal(ceiling[k], r->ceiling, n * ORL_HORIZON);
    }
    orl_baked_close(&b);
    orl_baked_close(&b);
    orl_scene s;
    assert_int_equal(orl_scene_open(at("v.oriel"), &s), ORL_OK);
    assert_true(!s.bmap && s.view[0] && s.view[1]);
    size_t bytes, again;
    assert_int_equal(orl_scene_write(at("w.oriel"), &s, &bytes), ORL_OK);           /* write, read, write: the same bytes */
    again = s.map_bytes;
    orl_scene_close(&s);
    assert_int_equal(bytes, again);
}

/* The share of sunny-side pixels whose sun a baked view gets wrong, over suns all around. */
static void suns_agree(void **state)
{
    (void)state;
    orl_baked b;
    orl_view baked;
    int wrong = 0, all = 0, shut = 0, roof = 0;
    write_file(at("v.oriel"));
    assert_int_equal(orl_baked_open(at("v.oriel"), &b), ORL_OK);
    void *room = orl_widen_block(orl_view_attach_need(W, H));
    assert_int_equal(orl_view_attach(&b.view[1], room, orl_view_attach_need(W, H) - 1, &baked), ORL_E_MEMORY);
    assert_int_equal(orl_view_attach(&b.view[1], room, orl_view_attach_need(W, H), &baked), ORL_OK);
    size_t n = (size_t)baked.stride * H;
    for (size_t i = 0; i < n * ORL_HORIZON; i++) roof += baked.ceiling[i] > 0;
    for (int i = 0; i < 24; i++) {
        sun_at((float)i * 0.9f - 3, 0.1f + 0.055f * (float)i);
        orl_view_trace_sun(&view[1], &light, 0, H, orl_cpu_detect(), 1);
        orl_view_trace_sun(&baked, &light, 0, H, orl_cpu_detect(), 2);
        for (int p = 0; p < W * H; p++) {
            orl_sample q, other;
            orl_view_sample(&view[1], p % W, p / W, &q);
            orl_view_sample(&baked, p % W, p / W, &other);
            float facing = q.normal[0] * light.sun_dir[0] + q.normal[1] * light.sun_dir[1] + q.normal[2] * light.sun_dir[2];
            if (q.cov < 1 || facing < 0.1f) continue;
            float traced = orl_light_sun_visibility(&light, &q);
            wrong += fabsf(traced - orl_light_sun_visibility(&light, &other)) > 0.5f;
            shut += traced < 0.5f;
            all++;
        }
    }
    print_message("%d of %d pixels wrong, %d in shadow; %d azimuths of pixels with a roof\n", wrong, all, shut, roof);
    assert_true(all > 20000 && shut > 0.05 * all && roof > 100);
    assert_true(wrong < 0.03 * all);
    free(room);
    orl_baked_close(&b);
}

/* A pixel with a roof over it: lit by a low sun, shut from a high one, as adaptation sees it and as it is shaded. */
static void roofs_hide_high_suns(void **state)
{
    (void)state;
    orl_view v = { .w = 32, .h = 1, .stride = 32, .cam = synth_camera(32, 1, 40) };
    static uint16_t depth[32];
    static uint8_t albedo[32], open[32], cov[32], horizon[ORL_HORIZON][32], above[ORL_HORIZON][32], rgb[3 * 32];
    static int8_t flat[32], up[32], phi[32 * ORL_SHADOW_DIM / 2];
    memset(cov, 255, sizeof cov);
    memset(up, 127, sizeof up);
    memset(albedo, 128, sizeof albedo);
    for (int k = 0; k < ORL_HORIZON; k++) {
        above[k][1] = 170;                  /* from 30 degrees on */
        horizon[k][2] = 170;                /* up to 60 degrees */
    }
    v.normal[0] = v.normal[1] = flat; v.normal[2] = up; v.albedo[0] = v.albedo[1] = v.albedo[2] = albedo; v.depth = depth; v.open = open; v.cov = cov; v.horizon = horizon[0]; v.phi[0] = v.phi[1] = phi; v.ceiling = above[0];
    for (int i = 0; i < 9; i++) v.grid_from_cam[i] = i % 4 == 0;
    void *room = orl_widen_block(orl_view_attach_need(32, 1)), *tables = orl_widen_block(orl_view_light_need());
    assert_int_equal(orl_view_attach(&v, room, orl_view_attach_need(32, 1), &v), ORL_OK);
    static const struct { float el; int want[3]; } CASE[] = { { 10, { 1, 1, 0 } }, { 45, { 1, 0, 0 } }, { 75, { 1, 0, 1 } }, { 89.9f, { 1, 0, 1 } } };
    for (size_t c = 0; c < sizeof CASE / sizeof *CASE; c++) {
        sun_at(0.3f, CASE[c].el * 0.0174533f);
        orl_view_light *t = orl_view_light_make(&v, &light, tables, orl_view_light_need());
        orl_view_trace_sun(&v, &light, 0, 1, orl_cpu_detect(), 1);
        orl_view_shade(&v, t, orl_cpu_detect(), 0, 1, rgb, sizeof rgb);
        for (int p = 0; p < 3; p++) {
            orl_sample q;
            orl_view_sample(&v, p, 0, &q);
            float want[3];
            orl_light_shade(&light, &q, want);
            for (int k = 0; k < 3; k++) if (fabsf(rgb[3 * p + k] - 255 * fminf(fmaxf(want[k], 0), 1)) > 2.5f) fail_msg("sun at %.0f degrees, pixel %d: %d, not %.1f", (double)CASE[c].el, p, rgb[3 * p + k], 255.0 * (double)want[k]);
            assert_true(fabsf(orl_light_sun_visibility(&light, &q) - (float)CASE[c].want[p]) < 0.02f);
        }
    }
    free(room); free(tables);
}

static void threads_agree(void **state)
{
    (void)state;
    size_t n = (size_t)view[0].stride * (size_t)view[0].h * ORL_HORIZON;
    uint8_t *other = calloc(n, 1), *before = malloc(n);
    memcpy(before, view[0].horizon, n);
    orl_view_bake(&view[0], 0, view[0].h / 2, 1, other);
    orl_view_bake(&view[0], view[0].h / 2, view[0].h, 3, other);
    assert_memory_equal(other, ceiling[0], n);
    assert_memory_equal(before, view[0].horizon, n);
    free(other); free(before);
}

/* Of the file, with sound checksums: one field of a section changed. */
static void refused(int which, size_t offset, const void *bytes, size_t n, const char *names)
{
    orl_scene s;
    orl_baked b;
    assert_int_equal(orl_scene_open(at("v.oriel"), &s), ORL_OK);
    uint8_t *copy = malloc(s.view_bytes[which]);
    orl_scene t = s;
    memcpy(copy, s.view[which], s.view_bytes[which]);
    memcpy(copy + offset, bytes, n);
    t.view[which] = copy;
    t.map = NULL;
    assert_int_equal(orl_scene_write(at("x.oriel"), &t, NULL), ORL_OK);
    memset(&b, 7, sizeof b);
    assert_int_not_equal(orl_baked_open(at("x.oriel"), &b), ORL_OK);
    if (!strstr(orl_error_text(), names) || !strstr(orl_error_text(), which ? "VWID" : "VPHO") || !strstr(orl_error_text(), "x.oriel")) fail_msg("'%s' does not name %s", orl_error_text(), names);
    free(copy);
    orl_scene_close(&s);
}

static void hostile_files(void **state)
{
    (void)state;
    orl_scene s;
    orl_baked b;
    write_file(at("v.oriel"));
    const int32_t zero = 0, huge = 20000, model = 9, wider = W + 32;
    const double nan = NAN, minus = -5;
    const float scale = INFINITY;
    const int8_t normal = -128;
    for (int k = 0; k < ORL_VIEWS; k++) {
        refused(k, 0, &model, 4, "lens");
        refused(k, 4, &zero, 4, "view of");
        refused(k, 8, &huge, 4, "view of");
        refused(k, 4, &wider, 4, "bytes for");
        refused(k, 12, &zero, 4, "photo of");
        refused(k, 20, "x", 1, "reserved");
        refused(k, 24, &nan, 8, "lens of the view");
        refused(k, 88, &minus, 8, "lens of the photo");
        refused(k, 152, &minus, 8, "pose");
        refused(k, 224, &nan, 8, "pose");
        refused(k, 248, &nan, 8, "grid");
        refused(k, 320, &nan, 8, "grid");
        refused(k, 344, &scale, 4, "phi_scale[0]");
        refused(k, 384 + 5, &normal, 1, "normal of pixel 5, 0");
    }
    assert_int_equal(orl_scene_write(at("s.oriel"), &scene, NULL), ORL_OK);
    assert_int_equal(orl_baked_open(at("s.oriel"), &b), ORL_E_FORMAT);
    assert_non_null(strstr(orl_error_text(), "no baked view"));
    assert_int_equal(orl_baked_open(at("none.oriel"), &b), ORL_E_IO);
    assert_int_equal(orl_scene_open(at("v.oriel"), &s), ORL_OK);
    orl_scene half = s;
    half.view[1] = NULL;
    assert_int_equal(orl_scene_write(at("y.oriel"), &half, NULL), ORL_E_FORMAT);            /* one view alone */
    half = scene;
    memcpy(half.view, s.view, sizeof half.view);
    memcpy(half.view_bytes, s.view_bytes, sizeof half.view_bytes);
    assert_int_equal(orl_scene_write(at("y.oriel"), &half, NULL), ORL_E_FORMAT);            /* views beside a surface */
    half = s;
    half.view_bytes[0] = 100;
    half.map = NULL;
    assert_int_equal(orl_scene_write(at("y.oriel"), &half, NULL), ORL_OK);
    assert_int_equal(orl_baked_open(at("y.oriel"), &b), ORL_E_FORMAT);
    assert_non_null(strstr(orl_error_text(), "VPHO: 100 bytes"));
    orl_scene_close(&s);
}

/* Bytes changed at random, checksums sound: refused, or a view that can be lit and shown. */
static void random_bytes(void **state)
{
    (void)state;
    uint64_t seed = getenv("SEED") ? strtoull(getenv("SEED"), NULL, 10) : (uint64_t)time(NULL), r = seed;
    int taken = 0, named = 0;
    print_message("seed %llu\n", (unsigned long long)seed);
    write_file(at("v.oriel"));
    orl_scene s;
    assert_int_equal(orl_scene_open(at("v.oriel"), &s), ORL_OK);
    for (int round = 0; round < 150; round++) {
        orl_scene t = s;
        uint8_t *copy[ORL_VIEWS];
        for (int k = 0; k < ORL_VIEWS; k++) {
            t.view[k] = copy[k] = malloc(s.view_bytes[k]);
            memcpy(copy[k], s.view[k], s.view_bytes[k]);
            for (int i = 0; i < round % 4 + 1; i++) {
                r = r * 6364136223846793005u + 1442695040888963407u;
                copy[k][(r >> 33) % (round & 1 ? 384 : s.view_bytes[k])] ^= (uint8_t)(1u << (r >> 29 & 7));
            }
        }
        t.map = NULL;
        assert_int_equal(orl_scene_write(at("x.oriel"), &t, NULL), ORL_OK);
        orl_baked b;
        if (orl_baked_open(at("x.oriel"), &b)) named += strstr(orl_error_text(), "x.oriel") != NULL;
        else {
            taken++;
            for (int k = 0; k < ORL_VIEWS; k++) {
                orl_view v;
                size_t need = orl_view_attach_need(b.view[k].w, b.view[k].h);
                void *room = orl_widen_block(need), *tables = orl_widen_block(orl_view_light_need());
                uint8_t *rgb = malloc((size_t)b.view[k].w * (size_t)b.view[k].h * 3);
                assert_int_equal(orl_view_attach(&b.view[k], room, need, &v), ORL_OK);
                sun_at(0.4f * (float)round, 0.5f);
                orl_view_light *l = orl_view_light_make(&v, &light, tables, orl_view_light_need());
                orl_view_trace_sun(&v, &light, 0, v.h, orl_cpu_detect(), 1);
                orl_view_shade(&v, l, orl_cpu_detect(), 0, v.h, rgb, 3 * (size_t)v.w);
                for (int i = 0; i < v.w * v.h; i++) {
                    orl_sample q;
                    orl_view_sample(&v, i % v.w, i / v.w, &q);
                    assert_true(isfinite(q.normal[0] + q.albedo[1] + q.phi[3] + q.dir[2]));
                }
                free(room); free(tables); free(rgb);
            }
            orl_baked_close(&b);
        }
        for (int k = 0; k < ORL_VIEWS; k++) free(copy[k]);
    }
    orl_scene_close(&s);
    print_message("%d taken, %d refused\n", taken, named);
    assert_true(taken > 20 && named > 20 && taken + named == 150);
}

int main(void)
{
    const struct CMUnitTest tests[] = { cmocka_unit_test(comes_back), cmocka_unit_test(suns_agree), cmocka_unit_test(roofs_hide_high_suns), cmocka_unit_test(threads_agree), cmocka_unit_test(hostile_files), cmocka_unit_test(random_bytes) };
    return cmocka_run_group_tests(tests, set_up, tear_down);
}
