/* Corrections of poses and lenses: disturbed cameras come back, by SfM points alone and by pixels alone. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <cmocka.h>
#include "trainer/refine.h"

enum { W = 96, H = 72, PHOTOS = 3, POINTS = 150 };

/* A slanted wall, y = 40 + 0.3 x - 0.2 z, painted with waves some cells long. */
static float wall(const float x[3]) { return (40 + 0.3f * x[0] - 0.2f * x[2] - x[1]) / sqrtf(1.13f); }
static void paint(const float x[3], float rgb[3])
{
    for (int c = 0; c < 3; c++) rgb[c] = 0.5f + 0.2f * sinf(0.5f * x[0] + (float)c) + 0.2f * sinf(0.6f * x[2] + 0.3f * x[0] + 2 * (float)c);
}

/* Photos of the wall by true cameras, then cameras off by a third of a degree, half a cell and 0.3 % of the focal length. */
static void make(world *w, stage1 *s, world_photo truth[PHOTOS])
{
    rng r = rng_make(5, 0, 0);
    memset(w, 0, sizeof *w);
    w->frame = (frame){ .R = { 1, 0, 0, 0, 1, 0, 0, 0, 1 }, .scale = 1, .dims = { 64, 64, 48 } };
    w->nphotos = PHOTOS;
    w->photos = calloc(PHOTOS, sizeof *w->photos);
    w->obs = calloc(PHOTOS * POINTS, sizeof *w->obs);
    w->points = calloc(POINTS, sizeof *w->points);
    w->npoints = POINTS;
    for (int i = 0; i < POINTS; i++) {
        float *x = w->points[i].x;
        x[0] = 14 + 36 * rng_f(&r); x[2] = 10 + 26 * rng_f(&r);
        x[1] = 40 + 0.3f * x[0] - 0.2f * x[2] - 6 * rng_f(&r) * (float)(i & 1);
        w->points[i].weight = 1;
    }
    for (int k = 0; k < PHOTOS; k++) {
        world_photo *p = &w->photos[k];
        p->w = W; p->h = H;
        assert_int_equal(orl_camera_from_params(&p->given_cam, ORL_CAM_PINHOLE, W, H, (double[]){ 90, 90, W / 2.0, H / 2.0 }, 4), ORL_OK);
        memcpy(p->given_axes, (double[9]){ 1, 0, 0, 0, 0, 1, 0, -1, 0 }, sizeof p->given_axes);
        memcpy(p->given_centre, (double[3]){ 22 + 10 * k, 2, 18 + 5 * k }, sizeof p->given_centre);
        world_correct(p);
        static uint8_t px[W * H * 3];
        for (int y = 0; y < H; y++)
            for (int x = 0; x < W; x++) {
                float d[3], q[3], rgb[3];
                world_ray(p, x + 0.5, y + 0.5, d);
                float o[3] = { (float)p->centre[0], (float)p->centre[1], (float)p->centre[2] }, slope = (0.3f * d[0] - 0.2f * d[2] - d[1]) / sqrtf(1.13f), t = -wall(o) / slope;
                for (int a = 0; a < 3; a++) q[a] = o[a] + t * d[a];
                paint(q, rgb);
                for (int c = 0; c < 3; c++) px[3 * (y * W + x) + c] = (uint8_t)(255 * rgb[c] + 0.5f);
            }
        assert_int_equal(world_photo_fill(p, W, H, px, NULL, 0), ORL_OK);
        p->obs_begin = w->nobs;
        for (int i = 0; i < POINTS; i++) {
            double uv[2] = { 0, 0 };
            assert_true(world_project(p, w->points[i].x, uv, NULL));
            if (i % 15 == 0) uv[0] += 30;       /* some matches are wrong */
            w->obs[w->nobs++] = (world_obs){ (float)uv[0] + 0.2f * rng_normal(&r), (float)uv[1] + 0.2f * rng_normal(&r), (uint32_t)i };
        }
        p->obs_count = POINTS;
        truth[k] = *p;
        double a = k - 1, b = k == 0 ? 1 : k == 1 ? -1 : 0, off[WORLD_FIX] = { 0.004 * a, 0.005 * b, 0.003 * (a + b), -0.4 * b, 0.4 * a, 0.4 * b, 0.003 * a, 0 };     /* nothing in common */
        memcpy(p->fix, off, sizeof off);
        world_correct(p);
        p->given_cam = p->cam;
        memcpy(p->given_axes, p->axes, sizeof p->axes);
        memcpy(p->given_centre, p->centre, sizeof p->centre);
        memset(p->fix, 0, sizeof p->fix);
    }
    assert_int_equal(stage1_init(s, w, &(stage1_options){ 64, 100, 7, 2, 0 }), ORL_OK);
    grid *g = &s->sdf[0], *f = &s->feat[0];
    for (int z = 0; z < g->n[2]; z++) for (int y = 0; y < g->n[1]; y++) for (int x = 0; x < g->n[0]; x++) g->p[grid_at(g, x, y, z)] = wall((float[]){ (float)x, (float)y, (float)z });
    for (int z = 0; z < f->n[2]; z++) for (int y = 0; y < f->n[1]; y++) for (int x = 0; x < f->n[0]; x++) paint((float[]){ 2.0f * (float)x, 2.0f * (float)y, 2.0f * (float)z }, f->p + grid_at(f, x, y, z) * FEAT);
    for (int k = 0; k < PHOTOS; k++) for (int a = 0; a < 3; a++) s->codes.p[grid_at(&s->codes, k, 0, 0) * FEAT + 4 + (size_t)a] = 1;
}

/* Rms distance in the picture, in pixels, between where true and present cameras see the points. */
static double off_by(const world *w, const world_photo truth[PHOTOS])
{
    double sum = 0, a[2] = { 0 }, b[2] = { 0 };
    for (int k = 0; k < PHOTOS; k++)
        for (int i = 0; i < POINTS; i++) {
            world_project(&truth[k], w->points[i].x, a, NULL);
            world_project(&w->photos[k], w->points[i].x, b, NULL);
            sum += (a[0] - b[0]) * (a[0] - b[0]) + (a[1] - b[1]) * (a[1] - b[1]);
        }
    return sqrt(sum / (PHOTOS * POINTS));
}

static void cameras_come_back(void **state)
{
    (void)state;
    for (int pixels = 0; pixels < 2; pixels++) {
        world w;
        stage1 s;
        world_photo truth[PHOTOS];
        refine_figures f;
        make(&w, &s, truth);
        double before = off_by(&w, truth), after;
        if (pixels) for (int k = 0; k < PHOTOS; k++) w.photos[k].obs_count = 0;
        for (int round = 0; round < 4; round++) refine_photos(&w, pixels ? &s : NULL, 1, round, 2, &f);
        after = off_by(&w, truth);
        printf("figure %s: %.3f -> %.3f px, corrections of %.3f degrees, %.2f cells, %.3f %% focal length\n", pixels ? "pixels" : "points", before, after, f.degrees, f.cells, 100 * f.focal);
        assert_true(before > 0.5);
        assert_true(after < (pixels ? 0.35 : 0.1) * before);
        stage1_free(&s);
        world_free(&w);
    }
}

/* What is right stays; the same call gives the same bits for any number of threads. */
static void right_cameras_stay(void **state)
{
    (void)state;
    double fix[2][PHOTOS][WORLD_FIX];
    for (int run = 0; run < 2; run++) {
        world w;
        stage1 s;
        world_photo truth[PHOTOS];
        refine_figures f;
        make(&w, &s, truth);
        for (int k = 0; k < PHOTOS; k++) {
            world_photo *p = &w.photos[k];
            p->given_cam = truth[k].cam;
            memcpy(p->given_axes, truth[k].axes, sizeof p->axes);
            memcpy(p->given_centre, truth[k].centre, sizeof p->centre);
            world_correct(p);
        }
        refine_photos(&w, &s, 1, 0, run + 1, &f);
        assert_true(off_by(&w, truth) < 0.1);
        for (int k = 0; k < PHOTOS; k++) memcpy(fix[run][k], w.photos[k].fix, sizeof fix[run][k]);
        stage1_free(&s);
        world_free(&w);
    }
    assert_memory_equal(fix[0], fix[1], sizeof fix[0]);
}

int main(void)
{
    const struct CMUnitTest tests[] = { cmocka_unit_test(cameras_come_back), cmocka_unit_test(right_cameras_stay) };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
