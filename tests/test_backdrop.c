/* The backdrop: where rays meet its walls, that a skyline beyond the box is found again at its distance, that disagreement is no skyline, and how a view shows it. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <cmocka.h>
#include "oriel/view.h"
#include "tests/synth_scene.h"
#include "trainer/backdrop.h"

static double between(double lo, double hi) { return lo + (hi - lo) * rand() / RAND_MAX; }

static void rays_meet_the_walls(void **state)
{
    (void)state;
    const orl_backdrop b = { { 40, 60 }, 30 };
    const double middle[2] = { 32, 20 };
    const float ground[3] = { 5, 0.01f, -0.02f };
    int met[4] = { 0 }, over = 0;
    srand(1);
    for (int i = 0; i < 20000; i++) {
        double o[3] = { between(-5, 70), between(-35, 75), 8 }, d[3] = { between(-1, 1), between(-1, 1), between(-0.1, 0.6) }, t, uv[2], back[2], x[3];
        double len = sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
        for (int a = 0; a < 3; a++) d[a] /= len;
        if (!orl_backdrop_meet(&b, middle, ground, o, d, &t, uv)) { over++; continue; }
        for (int a = 0; a < 3; a++) x[a] = o[a] + t * d[a];
        double along = fabs(x[0] - middle[0]) / 40, across = fabs(x[1] - middle[1]) / 60, up = x[2] - (5 + (double)ground[1] * x[0] + (double)ground[2] * x[1]);
        assert_true(t > 0 && fabs(fmax(along, across) - 1) < 1e-9);
        assert_true(uv[0] >= 0 && uv[0] < ORL_BACK_COLS && uv[1] >= 0 && uv[1] < ORL_BACK_ROWS);
        assert_true(fabs(uv[1] - fmax(up, 0) / 30 * ORL_BACK_ROWS) < 1e-9);
        assert_true(orl_backdrop_place(&b, middle, ground, x, back) && fabs(back[0] - uv[0]) < 1e-5 && fabs(back[1] - uv[1]) < 1e-9);
        int wall = (int)uv[0] / ORL_BACK_WALL;
        met[wall]++;
        assert_int_equal(wall, along > across ? (d[0] < 0) : 2 + (d[1] < 0));
        float n[3];
        orl_backdrop_normal(uv[0], n);
        assert_true((double)n[0] * d[0] + (double)n[1] * d[1] < 0 && n[2] > 0);
        uint32_t first, share[4];
        orl_backdrop_texels(uv, &first, share);
        assert_true(share[0] + share[1] + share[2] + share[3] == 256 && first + ORL_BACK_COLS + 1 < ORL_BACK_TEXELS);
        assert_true((int)(first % ORL_BACK_COLS) / ORL_BACK_WALL == wall && (int)((first + 1) % ORL_BACK_COLS) / ORL_BACK_WALL == wall);
    }
    assert_true(met[0] > 1000 && met[1] > 1000 && met[2] > 1000 && met[3] > 1000 && over > 100);
    double t, uv[2];
    const double inside[3] = { 32, 20, 8 }, outside[3] = { 100, 20, 8 }, away[3] = { 1, 0, 0 }, back[3] = { -1, 0, 0 }, up[3] = { 0, 0, 1 }, no[3] = { NAN, 0, 1 };
    assert_int_equal(orl_backdrop_meet(&b, middle, ground, outside, away, &t, uv), 0);
    assert_true(orl_backdrop_meet(&b, middle, ground, outside, back, &t, uv) && fabs(t - 108) < 1e-9);
    assert_int_equal(orl_backdrop_meet(&b, middle, ground, inside, up, &t, uv), 0);
    assert_int_equal(orl_backdrop_meet(&b, middle, ground, inside, no, &t, uv), 0);
    assert_int_equal(orl_backdrop_meet(&(orl_backdrop){ { 40, 60 }, 0 }, middle, ground, inside, away, &t, uv), 0);
}

/* ---- trainer */

enum { SIDE = 64, VIEWS = 72, W = 96, H = 64 };
enum { NO_SKYLINE, SKYLINE, NOISE };
static const orl_backdrop TRUTH = { { SIDE, SIDE }, 0.3f * SIDE };      /* walls twice as far as the box's */

static double skyline(double u) { return 20 + 14 * sin(u * (2 * 3.14159265358979 / ORL_BACK_COLS) * 6); }

/* Cameras in an empty box under the true skyline, looking all around; what stands on the horizon is labelled as hull_relabel does. */
static void make(world *w, surface *s, int how)
{
    const double middle[2] = { SIDE / 2.0, SIDE / 2.0 };
    memset(w, 0, sizeof *w);
    w->photos = calloc(VIEWS, sizeof *w->photos);
    w->nphotos = VIEWS;
    for (int a = 0; a < 3; a++) w->frame.dims[a] = SIDE;
    w->frame.ground[0] = 2;
    srand(7);
    for (int k = 0; k < VIEWS; k++) {
        world_photo *p = &w->photos[k];
        double angle = k * 6.2831853 * 7 / VIEWS, c = cos(angle), n = sin(angle);
        const double axes[9] = { -n, 0, -c, c, 0, -n, 0, -1, 0 };
        uint8_t rgb[3 * W * H] = { 0 }, sky[W * H];
        assert_int_equal(orl_camera_from_params(&p->cam, ORL_CAM_PINHOLE, W, H, (double[4]){ 70, 70, W / 2.0, H / 2.0 }, 4), ORL_OK);
        memcpy(p->axes, axes, sizeof axes);
        p->centre[0] = between(8, SIDE - 8);
        p->centre[1] = between(8, SIDE - 8);
        p->centre[2] = 6;
        for (int i = 0; i < W * H; i++) {
            float d[3];
            double t, uv[2];
            p->w = W;
            world_ray(p, i % W + 0.5, i / W + 0.5, d);
            int met = orl_backdrop_meet(&TRUTH, middle, w->frame.ground, p->centre, (double[3]){ d[0], d[1], d[2] }, &t, uv);
            sky[i] = d[2] < 0 || (how == NOISE ? rand() % 20 == 0 : how == SKYLINE && met && uv[1] < skyline(uv[0])) ? 0 : 255;     /* what falls meets the ground */
        }
        assert_int_equal(world_photo_fill(p, W, H, rgb, sky, 0), ORL_OK);
        for (int i = 0; i < W * H; i++) if (world_label(p, i % W, i / W) == WORLD_SCENE) world_set_label(p, i % W, i / W, WORLD_BEYOND);
    }
    memset(s, 0, sizeof *s);
    s->f = w->frame;
    for (int a = 0; a < 3; a++) s->nb[a] = SIDE / 8;
    s->bmap = malloc(sizeof *s->bmap * (SIDE / 8) * (SIDE / 8) * (SIDE / 8));
    for (int b = 0; b < SIDE / 8 * (SIDE / 8) * (SIDE / 8); b++) s->bmap[b] = -127;
}

static void clean(world *w, surface *s)
{
    for (int k = 0; k < VIEWS; k++) {
        free(w->photos[k].labels);
        free(w->photos[k].rgb);
    }
    free(w->photos);
    surface_free(s);
}

static void a_skyline_is_found(void **state)
{
    (void)state;
    world w;
    surface s;
    make(&w, &s, SKYLINE);
    assert_int_equal(backdrop_find(&s, &w, NULL, 1), ORL_OK);
    assert_true(s.back.half[0] == TRUTH.half[0] && s.back.half[1] == TRUTH.half[1] && s.back.height > 0);
    int wrong = 0, all = 0;
    for (int i = 0; i < ORL_BACK_TEXELS; i++) {
        double off = i / ORL_BACK_COLS + 0.5 - skyline(i % ORL_BACK_COLS + 0.5);
        if (fabs(off) < 3) continue;            /* a texel, and a pixel's width */
        all++;
        wrong += (s.opacity[i] > 127) != (off < 0);
    }
    assert_true(wrong < all / 25);
    uint8_t *one = malloc(ORL_BACK_TEXELS);
    memcpy(one, s.opacity, ORL_BACK_TEXELS);
    assert_int_equal(backdrop_find(&s, &w, NULL, 3), ORL_OK);
    assert_memory_equal(one, s.opacity, ORL_BACK_TEXELS);
    free(one);
    /* a ray meets it where it is as opaque as asked */
    surface_hit hit;
    float o[3] = { SIDE / 2, SIDE / 2, 6 }, low[3] = { 1, -0.667f, 0.02f }, high[3] = { 1, -0.667f, 0.25f };
    assert_int_equal(surface_meet(&s, o, low, 128, &hit), MET_BACKDROP);
    assert_true(fabsf(hit.x[0] - SIDE * 1.5f) < 1e-3f && hit.n[0] < 0);
    assert_int_equal(surface_meet(&s, o, low, SURFACE_NO_BACKDROP, &hit), MET_NOTHING);
    assert_int_equal(surface_meet(&s, o, high, 128, &hit), MET_NOTHING);
    clean(&w, &s);
}

static void no_skyline_is_made_up(void **state)
{
    (void)state;
    for (int how = 0; how < 3; how++) {
        world w;
        surface s;
        make(&w, &s, how);
        assert_int_equal(backdrop_find(&s, &w, NULL, 2), ORL_OK);
        assert_int_equal(s.back.height > 0, how == SKYLINE);
        clean(&w, &s);
    }
}

/* ---- runtime */

static void a_view_shows_it(void **state)
{
    (void)state;
    enum { BW = 96, BH = 64 };
    static uint8_t rgba[ORL_BACK_TEXELS][4], ground[ORL_GROUND_SIDE * ORL_GROUND_SIDE][3];
    orl_scene scene;
    synth_scene_make(&scene, 8, 8, 6);
    for (int i = 0; i < ORL_BACK_TEXELS; i++) memcpy(rgba[i], (uint8_t[4]){ 200, 20, 100, i / ORL_BACK_COLS < 40 ? i % ORL_BACK_COLS < ORL_BACK_WALL ? 160 : 255 : 0 }, 4);
    scene.ground_albedo = ground[0];
    scene.ground[0] = (float)SYNTH_GROUND;
    orl_camera cam = synth_camera(BW, BH, 100);
    orl_view v[4];
    void *block[4];
    for (int k = 0; k < 4; k++) {               /* none; one ray, four rays a pixel; four rays towards walls of full opacity */
        const double eye[3] = { 4, 4, SYNTH_GROUND + 6 }, to[3] = { k < 3 ? 40 : 4, k < 3 ? 4 : -40, SYNTH_GROUND + 10 };
        orl_pose pose = synth_look(&scene, eye, to);
        scene.backdrop_rgba = k ? rgba[0] : NULL;
        scene.backdrop = (orl_backdrop){ { 96, 96 }, 40 };
        block[k] = aligned_alloc(64, orl_view_need(BW, BH));
        assert_int_equal(orl_view_build(&scene, &cam, &pose, k > 1 ? 2 : 1, 1 + k % 2, block[k], orl_view_need(BW, BH), &v[k]), ORL_OK);
    }
    int shown = 0, half = 0, full = 0, same = 0;
    for (int y = 0; y < BH; y++)
        for (int x = 0; x < BW; x++) {
            orl_sample s[4];
            const double middle[2] = { 32, 32 };
            for (int k = 0; k < 4; k++) orl_view_sample(&v[k], x, y, &s[k]);
            double t, uv[2];
            if (s[0].cov > 0) { same++; continue; }
            int on = orl_backdrop_meet(&scene.backdrop, middle, scene.ground, v[1].eye, (double[3]){ s[0].dir[0], s[0].dir[1], s[0].dir[2] }, &t, uv);
            if (on && uv[1] > 38 && uv[1] < 42) continue;
            on &= uv[1] < 40;
            assert_int_equal(s[1].cov > 0, on);
            if (!on) continue;
            shown++;
            assert_true(fabsf(s[1].albedo[0] - 200.0f * 200 / 65025) < 4e-3f /* a view's byte */ && s[1].open == 1 && s[1].normal[2] > 0.65f && s[1].normal[2] < 0.75f);
            if (uv[0] < ORL_BACK_WALL - 8) half += s[2].cov > 0.6f && s[2].cov < 0.9f;     /* 160 of 255: three rays of four */
            full += s[3].cov == 1;
        }
    assert_true(shown > 500 && half > 150 && full > 300 && same > 500);
    scene.backdrop_rgba = NULL;
    scene.ground_albedo = NULL;
    for (int k = 0; k < 4; k++) free(block[k]);
    synth_scene_free(&scene);
}

int main(void)
{
    const struct CMUnitTest tests[] = { cmocka_unit_test(rays_meet_the_walls), cmocka_unit_test(a_skyline_is_found), cmocka_unit_test(no_skyline_is_made_up), cmocka_unit_test(a_view_shows_it) };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
