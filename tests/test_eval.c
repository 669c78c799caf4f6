/* The half-photo protocol: warps reach what a plane allows, and no pixel that is to be scored can reach a prediction. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#include <cmocka.h>
#include "oriel/cpu.h"
#include "oriel/view.h"
#include "tests/synth_scene.h"
#include "trainer/eval.h"

enum { PHOTOS = 14, SIDE = 12, W = 96, H = 72 };    /* photo 0 is the test photo */

static uint32_t state;
static uint32_t next(void) { return (state = state * 1664525u + 1013904223u) >> 8; }

/* A painted plane z = 10 seen by cameras in a row, each photo in colours of its own. */
static char dir[64];
static struct {
    orl_dataset data;
    orl_photo photo[PHOTOS];
    orl_colmap_point point[SIDE * SIDE];
    orl_colmap_obs obs[PHOTOS * SIDE * SIDE];
} wall;

static void paint(double X, double Y, int photo, uint8_t rgb[3])
{
    double base[3] = { 0.5 + 0.25 * sin(2.1 * X + Y), 0.5 + 0.25 * sin(1.3 * Y - 0.7 * X + 1), 0.5 + 0.25 * cos(1.7 * X) * sin(0.9 * Y) };
    for (int c = 0; c < 3; c++) rgb[c] = (uint8_t)(255 * (base[c] * (1 - 0.03 * ((photo * (c + 2)) % 7)) + 0.02 * ((photo + c) % 5)) + 0.5);
}

static orl_image render(const orl_photo *p, int photo)
{
    orl_image im;
    double c[3];
    assert_int_equal(orl_image_alloc(&im, W, H, 3), ORL_OK);
    orl_pose_centre(&p->pose, c);
    for (int y = 0; y < H; y++)
        for (int x = 0; x < W; x++) {
            double d[3], r[3];
            orl_camera_unproject(&p->cam, x + 0.5, y + 0.5, d);
            orl_pose_ray(&p->pose, d, r);
            double t = (10 - c[2]) / r[2];
            paint(c[0] + t * r[0], c[1] + t * r[1], photo, im.px + (y * W + x) * 3);
        }
    return im;
}

static int make_wall(void **s)
{
    (void)s;
    strcpy(dir, "/tmp/oriel-eval-XXXXXX");
    if (!mkdtemp(dir)) return -1;
    uint32_t nobs = 0;
    for (int i = 0; i < SIDE * SIDE; i++) {
        double x = -6 + 12.0 * (i % SIDE) / (SIDE - 1), y = -5 + 10.0 * (i / SIDE) / (SIDE - 1);
        wall.point[i] = (orl_colmap_point){ .xyz = { x, y, 10 }, .track_length = PHOTOS - 1 };
    }
    for (int i = 0; i < PHOTOS; i++) {
        orl_photo *p = &wall.photo[i];
        double yaw = 0.02 * (i - 6), q[4] = { cos(yaw / 2), 0, sin(yaw / 2), 0 }, t[3] = { -0.15 * (i - 6), 0.05 * (i % 3), 0.1 * (i % 4) };
        snprintf(p->name, sizeof p->name, "%02d.png", i);
        snprintf(p->path, sizeof p->path, "%s/%02d.png", dir, i);
        p->test = i == 0;
        if (orl_camera_from_params(&p->cam, ORL_CAM_SIMPLE_PINHOLE, W, H, (double[]){ 90, W / 2.0, H / 2.0 }, 3)) return -1;
        if (orl_pose_from_quat(&p->pose, q, t)) return -1;
        orl_image im = render(p, i);
        orl_err e = orl_image_write(p->path, &im);
        orl_image_free(&im);
        if (e) return -1;
        p->obs_begin = nobs;
        for (int k = 0; i && k < SIDE * SIDE; k++) {
            double cam[3], uv[2];
            orl_pose_apply(&p->pose, wall.point[k].xyz, cam);
            if (orl_camera_project(&p->cam, cam, uv) && uv[0] >= 0 && uv[0] < W && uv[1] >= 0 && uv[1] < H)
                wall.obs[nobs++] = (orl_colmap_obs){ (float)uv[0], (float)uv[1], k };
        }
        p->obs_count = nobs - p->obs_begin;
    }
    wall.data = (orl_dataset){ .photos = wall.photo, .nphotos = PHOTOS, .obs = wall.obs,
                                .nobs = nobs, .points = wall.point, .npoints = SIDE * SIDE };
    return 0;
}

static int remove_wall(void **s)
{
    (void)s;
    for (int i = 0; i < PHOTOS; i++) unlink(wall.photo[i].path);
    return rmdir(dir);
}

static double psnr_right(const orl_image *a, const orl_image *b)
{
    orl_imagef p, q;
    double db = 0;
    assert_int_equal(orl_image_to_float(a, &p), ORL_OK);
    assert_int_equal(orl_image_to_float(b, &q), ORL_OK);
    assert_int_equal(orl_metrics_psnr(&p, &q, W / 2, W, &db), ORL_OK);
    orl_imagef_free(&p); orl_imagef_free(&q);
    return db;
}

static void depth_of_a_plane(void **s)
{
    (void)s;
    float inv[W * H];
    double worst = 0;
    assert_int_equal(baselines_inverse_depth(&wall.data, &wall.photo[0].cam, &wall.photo[0].pose, inv), ORL_OK);
    for (int y = 0; y < H; y++)
        for (int x = 0; x < W; x++) {
            double d[3], r[3], c[3];
            orl_camera_unproject(&wall.photo[0].cam, x + 0.5, y + 0.5, d);
            orl_pose_ray(&wall.photo[0].pose, d, r);
            orl_pose_centre(&wall.photo[0].pose, c);
            double z = (10 - c[2]) / r[2] / sqrt(d[0] * d[0] + d[1] * d[1] + 1);
            worst = fmax(worst, fabs(inv[y * W + x] * z - 1));
        }
    assert_true(worst < 0.02);
}

static void warps_fit_a_plane(void **s)
{
    (void)s;
    baselines base;
    eval_prediction p;
    orl_image photo = render(&wall.photo[0], 0);
    assert_int_equal(baselines_open(&wall.data, 512, &base), ORL_OK);
    eval_setup setup = { .base = &base, .threads = 1 };
    assert_int_equal(eval_predict(&setup, &wall.photo[0].cam, &wall.photo[0].pose, &photo, W / 2, &p), ORL_OK);
    double row = psnr_right(&photo, &p.rgb[EVAL_ROW_MEAN]), nearest = psnr_right(&photo, &p.rgb[EVAL_NEAREST]);
    double median = psnr_right(&photo, &p.rgb[EVAL_MEDIAN]);
    printf("plane: row mean %.1f, nearest %.1f, median %.1f dB\n", row, nearest, median);
    assert_true(nearest > 30 && median > 30 && row < 25);
    assert_null(p.rgb[EVAL_FIXED].px);
    assert_null(p.rgb[EVAL_FLOAT].px);
    eval_prediction_free(&p);
    baselines_close(&base);
    orl_image_free(&photo);
}

/* Without SfM points the warps fall back to the row mean. */
static void no_geometry(void **s)
{
    (void)s;
    baselines base;
    eval_prediction p;
    orl_photo alone[PHOTOS];
    memcpy(alone, wall.photo, sizeof alone);
    for (int i = 0; i < PHOTOS; i++) alone[i].obs_count = 0;
    orl_dataset bare = { .photos = alone, .nphotos = PHOTOS };
    orl_image photo = render(&wall.photo[0], 0);
    assert_int_equal(baselines_open(&bare, 512, &base), ORL_OK);
    eval_setup setup = { .base = &base, .threads = 1 };
    assert_int_equal(eval_predict(&setup, &wall.photo[0].cam, &wall.photo[0].pose, &photo, W / 2, &p), ORL_OK);
    assert_memory_equal(p.rgb[EVAL_NEAREST].px, p.rgb[EVAL_ROW_MEAN].px, W * H * 3);
    assert_memory_equal(p.rgb[EVAL_MEDIAN].px, p.rgb[EVAL_ROW_MEAN].px, W * H * 3);
    eval_prediction_free(&p);
    baselines_close(&base);
    orl_image_free(&photo);
}

/* The leak test. Noise over the right half must leave every code and every pixel of every prediction as they were; with the whole photo
 * given out, all must move (else this test could not see a leak). */
static void check_leak(const eval_setup *setup, const orl_camera *cam, const orl_pose *pose, const orl_image *photo)
{
    eval_prediction p[4];
    orl_image painted;
    assert_int_equal(orl_image_alloc(&painted, W, H, 3), ORL_OK);
    memcpy(painted.px, photo->px, W * H * 3);
    for (int y = 0; y < H; y++)
        for (int x = W / 2; x < W; x++)
            for (int c = 0; c < 3; c++) painted.px[(y * W + x) * 3 + c] = (uint8_t)next();
    for (int k = 0; k < 4; k++)
        assert_int_equal(eval_predict(setup, cam, pose, k & 1 ? &painted : photo, k < 2 ? W / 2 : W, &p[k]), ORL_OK);
    for (int c = 0; c < EVAL_COLUMNS; c++) {
        if (!p[0].rgb[c].px) continue;
        assert_memory_equal(p[0].rgb[c].px, p[1].rgb[c].px, W * H * 3);
        assert_true(memcmp(p[2].rgb[c].px, p[3].rgb[c].px, W * H * 3) != 0);
    }
    if (setup->scene) {
        assert_memory_equal(p[0].adapt[EVAL_FIXED].code, p[1].adapt[EVAL_FIXED].code, sizeof p[0].adapt[0].code);
        assert_true(memcmp(p[2].adapt[EVAL_FIXED].code, p[3].adapt[EVAL_FIXED].code, sizeof p[0].adapt[0].code) != 0);
    }
    for (int k = 0; k < 4; k++) eval_prediction_free(&p[k]);
    orl_image_free(&painted);
}

static void warps_see_the_left_half_only(void **s)
{
    (void)s;
    baselines base;
    orl_image photo = render(&wall.photo[0], 0);
    assert_int_equal(baselines_open(&wall.data, 512, &base), ORL_OK);
    eval_setup setup = { .base = &base, .threads = 1 };
    check_leak(&setup, &wall.photo[0].cam, &wall.photo[0].pose, &photo);
    baselines_close(&base);
    orl_image_free(&photo);
}

/* The photo is the scene under a light of its own, so that adaptation has something to find. */
static void adaptation_sees_the_left_half_only(void **s)
{
    (void)s;
    orl_scene scene;
    orl_view view;
    orl_image photo;
    synth_scene_make(&scene, 8, 8, 6);
    orl_camera cam = synth_camera(W, H, 60);
    orl_pose pose = synth_look(&scene, (double[]){ 32, -30, 26 }, (double[]){ 32, 32, 18 });
    size_t need = orl_view_need(W, H);
    void *block = aligned_alloc(64, (need + 63) & ~(size_t)63);
    orl_light *light = malloc(sizeof *light);
    float code[ORL_CODE];
    memcpy(code, scene.light.prior_mean, sizeof code);
    code[ORL_C_SUN_AZ] = 2; code[ORL_C_SUN_EL] = 0.7f; code[ORL_C_ENV] += 0.5f;
    assert_int_equal(orl_view_build(&scene, &cam, &pose, 1, 1, block, need, &view), ORL_OK);
    assert_int_equal(orl_image_alloc(&photo, W, H, 3), ORL_OK);
    orl_light_decode(&scene.light, code, light);
    for (int y = 0; y < H; y++)
        for (int x = 0; x < W; x++) {
            orl_sample q;
            float rgb[3];
            orl_view_sample(&view, x, y, &q);
            orl_light_shade(light, &q, rgb);
            for (int c = 0; c < 3; c++) photo.px[(y * W + x) * 3 + c] = (uint8_t)(255 * (rgb[c] > 0 ? rgb[c] < 1 ? rgb[c] : 1 : 0) + 0.5f);
        }
    eval_setup setup = { .scene = &scene, .cpu = orl_cpu_detect(), .threads = 1 };
    eval_prediction p;
    assert_int_equal(eval_predict(&setup, &cam, &pose, &photo, W / 2, &p), ORL_OK);
    double db = psnr_right(&photo, &p.rgb[EVAL_FIXED]);
    printf("scene under its own light: %.1f dB on the right half, row mean %.1f\n", db, psnr_right(&photo, &p.rgb[EVAL_ROW_MEAN]));
    assert_true(db > 25);
    eval_prediction_free(&p);
    check_leak(&setup, &cam, &pose, &photo);
    orl_image_free(&photo);
    free(block); free(light);
    synth_scene_free(&scene);
}

int main(int argc, char **argv)
{
    state = argc > 1 ? (uint32_t)strtoul(argv[1], NULL, 0) : 20220610u;
    printf("seed %u\n", state);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(depth_of_a_plane), cmocka_unit_test(warps_fit_a_plane), cmocka_unit_test(no_geometry),
        cmocka_unit_test(warps_see_the_left_half_only),
        cmocka_unit_test(adaptation_sees_the_left_half_only),
    };
    return cmocka_run_group_tests(tests, make_wall, remove_wall);
}
