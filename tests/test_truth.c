/* Figures against ground truth, on a scene whose truth is the scene itself: each figure says so, and says what was changed in the truth. */
#include "tests/scratch.h"
#include <math.h>
#include "oriel/cpu.h"
#include "oriel/image.h"
#include "oriel/view.h"
#include "tests/synth_scene.h"
#include "trainer/truth.h"

enum { W = 96, H = 64 };
#define TURN 0.4                    /* of the scene against the world */
#define SUN_AZ 0.7                  /* world, radians */
#define SUN_EL 0.6

static const truth_options OPTIONS = { .long_side = W, .threads = 1 };
static orl_scene scene;
static orl_dataset data;
static orl_photo photo;
static orl_view view;
static void *block;

/* Directions in the world, from the scene's similarity. */
static void to_world(const double d[3], double out[3])
{
    const double *m = scene.world_to_grid;
    for (int k = 0; k < 3; k++) out[k] = (m[k] * d[0] + m[4 + k] * d[1] + m[8 + k] * d[2]) / SYNTH_SCALE;
}

static void put(const char *name, float (*value)(const orl_sample *q, size_t at, int c), int channels)
{
    orl_imagef im;
    assert_int_equal(orl_imagef_alloc(&im, W, H, channels), ORL_OK);
    for (size_t i = 0; i < W * H; i++) {
        orl_sample q;
        orl_view_sample(&view, (int)(i % W), (int)(i / W), &q);
        for (int c = 0; c < channels; c++) im.px[i * (size_t)channels + (size_t)c] = value(&q, i, c);
    }
    assert_int_equal(orl_exr_write(at("%s", name), &im, channels == 1 ? "Y" : "R,G,B"), ORL_OK);
    orl_imagef_free(&im);
}

static size_t own(size_t i) { return i / W * (size_t)view.stride + i % W; }

static float true_depth(const orl_sample *q, size_t i, int c)
{
    double ray[3];
    (void)c;
    if (q->cov < 0.5f) return 0;
    orl_camera_unproject(&view.cam, (double)(i % W) + 0.5, (double)(i / W) + 0.5, ray);
    return (float)(view.depth[own(i)] / 16.0 * scene.cell_world / sqrt(ray[0] * ray[0] + ray[1] * ray[1] + 1));
}

static float true_normal(const orl_sample *q, size_t i, int c)
{
    double n[3] = { q->normal[0], q->normal[1], q->normal[2] }, world[3];
    (void)i;
    to_world(n, world);
    return q->cov < 0.5f ? 0 : (float)world[c];
}

static float true_albedo(const orl_sample *q, size_t i, int c) { (void)i; return q->cov < 0.5f ? 0 : q->albedo[c] * (c == 0 ? 0.5f : c == 1 ? 0.8f : 0.9f); }
static float grey(const orl_sample *q, size_t i, int c) { (void)q; (void)i; (void)c; return 0.4f; }

static orl_light light;
static double up;                   /* what a white horizontal surface shows under the panorama */
static float relit(const orl_sample *q, size_t i, int c)
{
    orl_sample s = *q;
    float rgb[3];
    (void)i;
    s.cov = 1;
    orl_light_shade(&light, &s, rgb);
    return 3 * (q->cov * orl_light_decode_srgb(rgb[c]) + (1 - q->cov) * 0.5f / (float)up);
}

/* An even sky with a sun. */
static void panorama(const char *name)
{
    enum { PW = 256, PH = 128 };
    orl_imagef im;
    assert_int_equal(orl_imagef_alloc(&im, PW, PH, 3), ORL_OK);
    for (int i = 0; i < PW * PH * 3; i++) im.px[i] = 0.5f;
    int x = (int)((0.5 - SUN_AZ / (2 * M_PI)) * PW), y = (int)((0.5 - SUN_EL / M_PI) * PH);
    for (int c = 0; c < 3; c++) im.px[3 * (y * PW + x) + c] = 3000;
    assert_int_equal(orl_exr_write(at("%s", name), &im, "R,G,B"), ORL_OK);
    orl_imagef_free(&im);
}

/* The light of that panorama, by hand. */
static void by_hand(void)
{
    double world[3] = { cos(SUN_AZ) * cos(SUN_EL), sin(SUN_AZ) * cos(SUN_EL), sin(SUN_EL) }, sun[3] = { 0 }, area = 2 * M_PI / 256 * M_PI / 128 * cos(SUN_EL);
    float env[ORL_ENV][3], code[ORL_CODE];
    for (int k = 0; k < 3; k++) for (int c = 0; c < 3; c++) sun[k] += scene.world_to_grid[4 * k + c] * world[c] / SYNTH_SCALE;
    up = (0.5 * M_PI + 3000 * area * sin(SUN_EL)) / M_PI;
    for (int w = 0; w < ORL_ENV; w++) for (int c = 0; c < 3; c++) env[w][c] = (float)(0.5 / up);
    memcpy(code, scene.light.prior_mean, sizeof code);
    memset(code + ORL_C_TONE, 0, ORL_TONE_DIM * sizeof *code);
    code[ORL_C_SUN_AZ] = (float)atan2(sun[1], sun[0]);
    code[ORL_C_SUN_EL] = (float)SUN_EL;
    for (int c = 0; c < 3; c++) code[ORL_C_SUN_RGB + c] = (float)log(3000 * area / up);
    orl_light_from_env(&scene.light, (const float (*)[3])env, code, &light);
}

static int set_up(void **state)
{
    if (scratch_make(state)) return -1;
    synth_scene_make(&scene, 8, 8, 6);
    for (int k = 0; k < 3; k++)                 /* ground truth has z up: the world is the scene's frame turned about it */
        for (int c = 0; c < 3; c++) scene.world_to_grid[4 * k + c] = SYNTH_SCALE * (k == 2 || c == 2 ? k == c : k == c ? cos(TURN) : k ? sin(TURN) : -sin(TURN));
    photo = (orl_photo){ .name = "a.jpg", .test = 1, .cam = synth_camera(W, H, 60) };
    photo.pose = synth_look(&scene, (double[]){ 60, 2, 30 }, (double[]){ 32, 32, 20 });
    data = (orl_dataset){ .photos = &photo, .nphotos = 1 };
    strcpy(data.dir, scratch);
    block = aligned_alloc(64, orl_view_need(W, H));
    if (!block || orl_view_build(&scene, &photo.cam, &photo.pose, 2, 1, block, orl_view_need(W, H), &view)) return -1;
    make_way(at("gt/env/"));
    put_text(at("gt/photo_params.json"), "{ \"a\": { \"sun_dir\": null } }\n");
    put("gt/a_depth.exr", true_depth, 1);
    put("gt/a_normal.exr", true_normal, 3);
    by_hand();
    orl_view_trace_sun(&view, &light, 0, H, ORL_CPU_REF, 1);
    return 0;
}

static int tear_down(void **state)
{
    free(block);
    synth_scene_free(&scene);
    return scratch_remove(state);
}

static double get(const figure *f, int n, const char *key)
{
    for (int i = 0; i < n; i++) if (!strcmp(f[i].key, key)) return f[i].v;
    fail_msg("no figure %s", key);
    return 0;
}

static void geometry_is_its_own_truth(void **state)
{
    (void)state;
    figure f[TRUTH_FIGURES];
    int n = 0;
    assert_int_equal(truth_geometry(&data, &scene, &OPTIONS, f, &n), ORL_OK);
    assert_true(get(f, n, "depth_median_rel") < 1e-3);
    assert_true(get(f, n, "normal_mean_deg") < 0.1);
    assert_true(get(f, n, "sky_covered") < 0.02);              /* pixels on the rim */
}

static void factors_are_their_own_truth(void **state)
{
    (void)state;
    figure f[TRUTH_FIGURES];
    int n = 0;
    put("gt/a_albedo.exr", true_albedo, 3);
    put("gt/a_relit_noon.exr", relit, 3);
    panorama("gt/env/relit_noon.exr");
    assert_int_equal(truth_factors(&data, &scene, &OPTIONS, f, &n), ORL_OK);
    print_message("base colour %.1f dB, relit %.1f dB, without shadow %.1f dB\n", get(f, n, "albedo_psnr"), get(f, n, "relit_psnr"), get(f, n, "relit_noshadow_psnr"));
    assert_true(get(f, n, "albedo_psnr") > 50);                 /* a factor a channel is free */
    assert_true(get(f, n, "relit_psnr") > 50);                  /* and so is one in all */
    assert_true(get(f, n, "relit_noshadow_psnr") < get(f, n, "relit_psnr") - 3);

    put("gt/a_albedo.exr", grey, 3);
    n = 0;
    assert_int_equal(truth_factors(&data, &scene, &OPTIONS, f, &n), ORL_OK);
    assert_true(get(f, n, "albedo_psnr") < 30);                 /* no scale makes a pattern grey */
}

/* ---- a clip ---- */

enum { CLIP = 12, CLIP_JUMP = 6 };

static void camera_line(FILE *f, const char *name, const orl_camera *c, const orl_pose *p)
{
    double q[4];
    orl_pose_to_quat(p, q);
    fprintf(f, "%s PINHOLE %d %d %.12f %.12f %.12f %.12f %.12f %.12f %.12f %.12f %.12f %.12f %.12f\n", name, c->w, c->h, c->fx, c->fy, c->cx, c->cy,
            q[0], q[1], q[2], q[3], p->t[0], p->t[1], p->t[2]);
}

/* The view under a light, as path. */
static void shoot(orl_view *v, const float *code, const char *path)
{
    orl_image im;
    void *room = aligned_alloc(64, (orl_view_light_need() + 63) & ~(size_t)63);
    assert_int_equal(orl_image_alloc(&im, v->w, v->h, 3), ORL_OK);
    orl_light_decode(&scene.light, code, &light);
    orl_view_trace_sun(v, &light, 0, v->h, ORL_CPU_REF, 1);
    orl_view_shade(v, orl_view_light_make(v, &light, room, orl_view_light_need()), ORL_CPU_REF, 0, v->h, im.px, (size_t)v->w * 3);
    assert_int_equal(orl_image_write(path, &im), ORL_OK);
    orl_image_free(&im);
    free(room);
}

static void kiosk_is_its_own_truth(void **state)
{
    (void)state;
    orl_camera wide = synth_camera(160, 112, 75), near = synth_camera(160, 112, 45);
    orl_view v[2];
    void *room[2];
    const orl_camera *cam[2] = { &near, &wide };
    if (!strstr(orl_image_formats(), "jpeg")) skip();
    make_way(at("kiosk/frames/"));
    make_way(at("kiosk/gt_wide/"));
    for (int k = 0; k < 2; k++) {
        room[k] = aligned_alloc(64, (orl_view_need(160, 112) + 63) & ~(size_t)63);
        assert_int_equal(orl_view_build(&scene, cam[k], &photo.pose, 2, 1, room[k], orl_view_need(160, 112), &v[k]), ORL_OK);
    }
    FILE *f = fopen(at("kiosk/camera.txt"), "w"), *j = fopen(at("kiosk/frames.json"), "w");
    assert_true(f && j);
    camera_line(f, "frames", &near, &photo.pose);
    camera_line(f, "gt_wide", &wide, &photo.pose);
    fprintf(j, "{\"exposure_jump_frame\": %d, \"frames\": [", CLIP_JUMP);
    for (int i = 0; i < CLIP; i++) {
        float code[ORL_CODE];
        memcpy(code, scene.light.prior_mean, sizeof code);
        code[ORL_C_SUN_AZ] = 0.5f + 0.06f * (float)i;
        code[ORL_C_SUN_EL] = 0.6f;
        for (int k = 0; k < 3; k++) code[ORL_C_TONE + 4 * k] += i >= CLIP_JUMP ? -0.25f : 0;
        shoot(&v[0], code, at("kiosk/frames/%04d.jpg", i));
        if (i % 4 == 2) shoot(&v[1], code, at("kiosk/gt_wide/%04d.jpg", i));
        const double sun[3] = { light.sun_dir[0], light.sun_dir[1], light.sun_dir[2] };
        double world[3];
        to_world(sun, world);
        fprintf(j, "%s{\"frame\": %d, \"sun_dir\": [%.9f, %.9f, %.9f]}", i ? ", " : "", i, world[0], world[1], world[2]);
    }
    fprintf(j, "]}\n");
    fclose(f);
    fclose(j);
    figure got[TRUTH_FIGURES];
    int n = 0;
    assert_int_equal(truth_kiosk(&data, &scene, &OPTIONS, got, &n), ORL_OK);
    double psnr = get(got, n, "outside_psnr"), ssim = get(got, n, "outside_ssim"), ratio = get(got, n, "temporal_ratio");
    print_message("outside %.1f dB, SSIM %.3f; sun %.1f degrees off; render changes %.2f times as much; %.0f frames after the jump\n", psnr, ssim, get(got, n, "kiosk_sun_median_deg"), ratio, get(got, n, "jump_frames"));
    assert_true(psnr > 28 && ssim > 0.9 && get(got, n, "kiosk_sun_median_deg") < 8);
    assert_true(ratio > 0.5 && ratio < 1.2 && get(got, n, "jump_frames") <= 1);

    orl_image black;                            /* a wide truth that shows nothing of the kind */
    assert_int_equal(orl_image_alloc(&black, 160, 112, 3), ORL_OK);
    assert_int_equal(orl_image_write(at("kiosk/gt_wide/0002.jpg"), &black), ORL_OK);
    n = 0;
    assert_int_equal(truth_kiosk(&data, &scene, &OPTIONS, got, &n), ORL_OK);
    assert_true(get(got, n, "outside_psnr") < psnr - 5 && get(got, n, "outside_ssim") < ssim - 0.1);
    orl_image_free(&black);
    assert_int_equal(orl_image_alloc(&black, 80, 112, 3), ORL_OK);
    assert_int_equal(orl_image_write(at("kiosk/gt_wide/0002.jpg"), &black), ORL_OK);
    n = 0;
    assert_int_equal(truth_kiosk(&data, &scene, &OPTIONS, got, &n), ORL_E_FORMAT);
    assert_int_equal(n, 0);
    orl_image_free(&black);
    free(room[0]);
    free(room[1]);
}

static void truth_of_another_size_is_refused(void **state)
{
    (void)state;
    figure f[TRUTH_FIGURES];
    orl_imagef im;
    int n = 0;
    assert_int_equal(orl_imagef_alloc(&im, W / 2, H, 1), ORL_OK);
    assert_int_equal(orl_exr_write(at("gt/a_depth.exr"), &im, "Y"), ORL_OK);
    orl_imagef_free(&im);
    assert_int_equal(truth_factors(&data, &scene, &OPTIONS, f, &n), ORL_E_FORMAT);
    assert_non_null(strstr(orl_error_text(), "a_depth.exr"));
    assert_int_equal(n, 0);
    put("gt/a_depth.exr", true_depth, 1);
}

int main(void)
{
    const struct CMUnitTest tests[] = { cmocka_unit_test(geometry_is_its_own_truth), cmocka_unit_test(factors_are_their_own_truth), cmocka_unit_test(kiosk_is_its_own_truth), cmocka_unit_test(truth_of_another_size_is_refused) };
    return cmocka_run_group_tests(tests, set_up, tear_down);
}
