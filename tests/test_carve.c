/* Silhouettes: a ball learned too fat gets its size back from the sky around it, and one photo's bad mask takes off no more than a skin. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <cmocka.h>
#include "trainer/stereo.h"
#include "trainer/surface.h"

enum { SIDE = 64, VIEWS = 16, W = 96, BRICKS = SIDE / 8 };
static const float MIDDLE = SIDE / 2;
#define TRUE_RADIUS 14.0f
#define FAT 16.0f

/* Cameras around the ball at the height of its middle, 100 cells away; the sky is what misses the true ball. hole: this photo (or none, -1) sees a patch of sky in its middle. */
static void make(world *w, surface *s, int hole)
{
    memset(w, 0, sizeof *w);
    w->photos = calloc(VIEWS, sizeof *w->photos);
    w->nphotos = VIEWS;
    for (int a = 0; a < 3; a++) w->frame.dims[a] = SIDE;
    for (int k = 0; k < VIEWS; k++) {
        world_photo *p = &w->photos[k];
        float angle = (float)k * 6.2831853f / VIEWS, c = cosf(angle), n = sinf(angle);
        const double axes[9] = { -n, 0, -c, c, 0, -n, 0, -1, 0 };
        uint8_t rgb[3 * W * W] = { 0 }, sky[W * W];
        assert_int_equal(orl_camera_from_params(&p->cam, ORL_CAM_PINHOLE, W, W, (double[4]){ 200, 200, W / 2.0, W / 2.0 }, 4), ORL_OK);
        memcpy(p->axes, axes, sizeof axes);
        p->centre[0] = MIDDLE + 100 * c;
        p->centre[1] = MIDDLE + 100 * n;
        p->centre[2] = MIDDLE;
        p->w = p->h = W;
        for (int i = 0; i < W * W; i++) {
            float d[3], along = 0, off = 0;
            world_ray(p, i % W + 0.5, i / W + 0.5, d);
            for (int a = 0; a < 3; a++) along += d[a] * (MIDDLE - (float)p->centre[a]);
            for (int a = 0; a < 3; a++) { float m = (float)p->centre[a] + along * d[a] - MIDDLE; off += m * m; }
            sky[i] = off > TRUE_RADIUS * TRUE_RADIUS || (k == hole && abs(i % W - W / 2) < 6 && abs(i / W - W / 2) < 6) ? 255 : 0;
        }
        assert_int_equal(world_photo_fill(p, W, W, rgb, sky, 0), ORL_OK);
    }
    memset(s, 0, sizeof *s);
    s->f = w->frame;
    s->bmap = malloc(sizeof *s->bmap * BRICKS * BRICKS * BRICKS);
    s->sdf = malloc(sizeof *s->sdf * BRICKS * BRICKS * BRICKS * ORL_BRICK_VERTS);
    for (int b = 0; b < BRICKS * BRICKS * BRICKS; b++) {
        s->bmap[b] = b;
        for (int i = 0; i < ORL_BRICK_VERTS; i++) {
            float x = (float)(b % BRICKS * 8 + i % 9) - MIDDLE, y = (float)(b / BRICKS % BRICKS * 8 + i / 9 % 9) - MIDDLE, z = (float)(b / BRICKS / BRICKS * 8 + i / 81) - MIDDLE;
            s->sdf[(size_t)b * ORL_BRICK_VERTS + (size_t)i] = sqrtf(x * x + y * y + z * z) - FAT;
        }
    }
    for (int a = 0; a < 3; a++) s->nb[a] = BRICKS;
    s->nbricks = BRICKS * BRICKS * BRICKS;
}

/* Distance of the surface from the middle, towards the horizon between two cameras, at the given height. */
static float radius(const surface *s, float angle, float height)
{
    float o[3] = { MIDDLE + 60 * cosf(angle), MIDDLE + 60 * sinf(angle), MIDDLE + height }, d[3] = { -cosf(angle), -sinf(angle), 0 };
    surface_hit h;
    return surface_march(s, o, d, &h) ? sqrtf((60 - h.t) * (60 - h.t) + height * height) : 0;
}

static void fat_ball_gets_its_size_back(void **state)
{
    (void)state;
    for (int hole = -1; hole < 1; hole++) {
        world w;
        surface s, again;
        make(&w, &s, hole);
        make(&w, &again, hole);
        assert_true(fabsf(radius(&s, 0.1f, 0) - FAT) < 0.1f);
        assert_int_equal(surface_carve(&s, &w, 1), ORL_OK);
        for (int i = 0; i < 24; i++) {
            float r[2] = { radius(&s, 0.26f * (float)i, 0), radius(&s, 0.26f * (float)i, 8) };
            for (int k = 0; k < 2; k++) assert_true(r[k] > TRUE_RADIUS - 0.3f && r[k] < TRUE_RADIUS + 0.8f);  /* the second nearest tangent of 32 passes up to 0.6 outside; a pixel is 0.5 */
        }
        assert_int_equal(surface_carve(&again, &w, 2), ORL_OK);
        assert_memory_equal(s.sdf, again.sdf, sizeof *s.sdf * s.nbricks * ORL_BRICK_VERTS);
        surface_free(&s);
        surface_free(&again);
        world_free(&w);
    }
}

/* What photos show as scene stays, what only unlabelled pixels show goes, beside the rest too. */
static void guesses_go(void **state)
{
    (void)state;
    float down[3] = { 0, 0, -1 }, from[3] = { MIDDLE + 0.5f, MIDDLE + 0.5f, SIDE - 1 };
    for (int unlabelled = 0; unlabelled < 2; unlabelled++) {
        world w;
        surface s;
        surface_hit h;
        make(&w, &s, -1);
        for (int k = 0; k < VIEWS && unlabelled; k++) for (int i = 0; i < W * W / 2; i++) world_set_label(&w.photos[k], i % W, i / W, WORLD_UNKNOWN);
        assert_int_equal(surface_prune(&s, &w, 1), ORL_OK);
        assert_true(radius(&s, 0.1f, -1) > FAT - 0.1f);
        assert_true(surface_march(&s, from, down, &h));
        assert_true(unlabelled ? h.cut && h.x[2] < MIDDLE + 8 : !h.cut && h.x[2] > MIDDLE + FAT - 0.1f);
        surface_free(&s);
        world_free(&w);
    }
}

/* Stone that one photo's mask calls sky, and others' stereo points lie on, is unknown; the sky around the ball stays sky. */
static void stone_is_no_sky(void **state)
{
    (void)state;
    world w;
    surface s;
    stereo st = { .begin = calloc(VIEWS + 1, sizeof *st.begin) };
    make(&w, &s, 3);
    for (int i = 0; i < W * W * 7 / 8; i++) world_set_label(&w.photos[3], i % W, i / W, abs(i % W - W / 2) < 6 && abs(i / W - W / 2) < 6 ? WORLD_SKY : WORLD_SCENE);    /* the patch is a share of its sky */
    st.points = malloc(sizeof *st.points * VIEWS * W * W);
    for (int k = 0; k < VIEWS; k++) {
        const world_photo *p = &w.photos[k];
        for (int i = 0; i < W * W; i++) {       /* the ball as each photo measures it */
            float d[3], along = 0, off = 0;
            world_ray(p, i % W + 0.5, i / W + 0.5, d);
            for (int a = 0; a < 3; a++) along += d[a] * (MIDDLE - (float)p->centre[a]);
            for (int a = 0; a < 3; a++) { float m = (float)p->centre[a] + along * d[a] - MIDDLE; off += m * m; }
            if (off > TRUE_RADIUS * TRUE_RADIUS) continue;
            stereo_point *q = &st.points[st.npoints++];
            float t = along - sqrtf(TRUE_RADIUS * TRUE_RADIUS - off);
            for (int a = 0; a < 3; a++) q->n[a] = ((q->x[a] = (float)p->centre[a] + t * d[a]) - MIDDLE) / TRUE_RADIUS;
            q->photo = (uint32_t)k;
            q->weight = 1;
        }
        st.begin[k + 1] = st.npoints;
    }
    int patch[3] = { 0 }, sky = 0, lost = 0;
    uint8_t *was = malloc(VIEWS * W * W);
    for (int i = 0; i < VIEWS * W * W; i++) was[i] = (uint8_t)world_label(&w.photos[i / (W * W)], i % W, i / W % W);
    assert_int_equal(hull_unsky(&w, &st, 2), ORL_OK);
    for (int k = 0; k < VIEWS; k++)
        for (int i = 0; i < W * W; i++) {
            int label = world_label(&w.photos[k], i % W, i / W);
            if (k == 3 && abs(i % W - W / 2) < 6 && abs(i / W - W / 2) < 6) { patch[label]++; continue; }
            sky += was[k * W * W + i] == WORLD_SKY;
            lost += was[k * W * W + i] != label;
        }
    assert_int_equal(patch[WORLD_UNKNOWN], 11 * 11);
    assert_true(sky > VIEWS * W * W / 2 && lost == 0);
    free(was);
    stereo_free(&st);
    surface_free(&s);
    world_free(&w);
}

/* A single photo takes off a skin, photos without sky nothing. */
static void few_change_little(void **state)
{
    (void)state;
    world w;
    surface s, was;
    make(&w, &s, -1);
    make(&w, &was, -1);
    int all = w.nphotos;
    w.nphotos = 1;
    assert_int_equal(surface_carve(&s, &w, 1), ORL_OK);
    int thinner = 0;
    for (size_t i = 0; i < (size_t)s.nbricks * ORL_BRICK_VERTS; i++) {
        assert_true(s.sdf[i] >= was.sdf[i] && s.sdf[i] <= was.sdf[i] + 2.001f);
        thinner += s.sdf[i] > was.sdf[i];
    }
    assert_true(thinner > 0);
    w.nphotos = all;
    memcpy(s.sdf, was.sdf, sizeof *s.sdf * s.nbricks * ORL_BRICK_VERTS);
    for (int k = 0; k < VIEWS; k++) for (int i = 0; i < W * W; i++) world_set_label(&w.photos[k], i % W, i / W, WORLD_SCENE);
    assert_int_equal(surface_carve(&s, &w, 1), ORL_OK);
    assert_memory_equal(s.sdf, was.sdf, sizeof *s.sdf * s.nbricks * ORL_BRICK_VERTS);
    surface_free(&s);
    surface_free(&was);
    world_free(&w);
}

int main(void)
{
    const struct CMUnitTest tests[] = { cmocka_unit_test(fat_ball_gets_its_size_back), cmocka_unit_test(guesses_go), cmocka_unit_test(stone_is_no_sky), cmocka_unit_test(few_change_little) };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
