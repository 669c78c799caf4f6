/* Planes where stereo is blind: a wall with a patch without points, before which the hull stands out. The patch is filled in the wall's plane by every photo that looks on; nothing is added
 * where points are, where the hull is too far off, or where too little is known. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <cmocka.h>
#include "trainer/complete.h"

enum { SIDE = 96, VIEWS = 3, W = 64, CELL = 2 };
#define WALL 60.0f
#define HALF 12.0f              /* of the patch */

typedef struct { world w; grid hull; stereo st; } place;

static int in_patch(float x, float z, float half) { return fabsf(x - SIDE / 2) < half && fabsf(z - SIDE / 2) < half; }

/* Cameras before the wall y = WALL look along y, one from aside. bulge: cells that the hull stands out; spacing: of the points along the wall. */
static void make(place *p, float bulge, float spacing)
{
    memset(p, 0, sizeof *p);
    p->w.photos = calloc(VIEWS, sizeof *p->w.photos);
    p->w.nphotos = VIEWS;
    for (int a = 0; a < 3; a++) p->w.frame.dims[a] = SIDE;
    for (int k = 0; k < VIEWS; k++) {
        world_photo *v = &p->w.photos[k];
        static const uint8_t rgb[3 * W * W];
        const double axes[9] = { 1, 0, 0, 0, 0, 1, 0, -1, 0 };
        assert_int_equal(orl_camera_from_params(&v->cam, ORL_CAM_PINHOLE, W, W, (double[4]){ 60, 60, W / 2.0, W / 2.0 }, 4), ORL_OK);
        memcpy(v->axes, axes, sizeof axes);
        v->centre[0] = SIDE / 2 + 9 * (k - 1);
        v->centre[1] = -10;
        v->centre[2] = SIDE / 2;
        assert_int_equal(world_photo_fill(v, W, W, rgb, NULL, 0), ORL_OK);
    }
    assert_int_equal(grid_init(&p->hull, p->w.frame.dims, CELL, 1, 0), ORL_OK);
    for (int z = 0; z <= SIDE / CELL; z++)
        for (int y = 0; y <= SIDE / CELL; y++)
            for (int x = 0; x <= SIDE / CELL; x++) {
                size_t at = grid_at(&p->hull, x, y, z);
                p->hull.p[at] = WALL - (float)(y * CELL) - (in_patch((float)(x * CELL), (float)(z * CELL), HALF) ? bulge : 0);
                grid_mark(&p->hull, at);
            }
    int n = (int)(SIDE / spacing);
    p->st.points = malloc((size_t)(VIEWS * n * n) * sizeof *p->st.points);
    p->st.begin = calloc(VIEWS + 1, sizeof *p->st.begin);
    rng r = rng_make(7, 0, 0);
    for (uint32_t k = 0; k < VIEWS; k++) {
        for (int i = 0; i < n * n; i++) {
            float x = spacing * (float)(i % n), z = spacing * (float)(i / n);
            if (in_patch(x, z, HALF)) continue;
            p->st.points[p->st.npoints++] = (stereo_point){ .x = { x, WALL + 0.3f * rng_normal(&r), z }, .n = { 0, -1, 0 }, .photo = k, .weight = 0.5f };
        }
        p->st.begin[k + 1] = p->st.npoints;
    }
}

static void unmake(place *p)
{
    grid_free(&p->hull);
    stereo_free(&p->st);
    world_free(&p->w);
}

static void fills_the_patch(void **state)
{
    (void)state;
    place given, p, q;
    make(&given, 5, 1.6f);
    make(&p, 5, 1.6f);
    make(&q, 5, 1.6f);
    assert_int_equal(complete_planes(&p.w, &p.st, &p.hull, 1), ORL_OK);
    assert_int_equal(complete_planes(&q.w, &q.st, &q.hull, 2), ORL_OK);
    assert_int_equal(p.st.npoints, q.st.npoints);
    assert_memory_equal(p.st.points, q.st.points, p.st.npoints * sizeof *p.st.points);
    for (int k = 0; k < VIEWS; k++) {
        uint32_t old = given.st.begin[k + 1] - given.st.begin[k], first = p.st.begin[k];
        assert_int_equal(p.st.found[k], old);
        assert_memory_equal(p.st.points + first, given.st.points + given.st.begin[k], old * sizeof *p.st.points);
        assert_true(p.st.begin[k + 1] - first - old > 60);       /* 24 cells are 20 pixels here, a ray every second one */
        for (uint32_t i = first + old; i < p.st.begin[k + 1]; i++) {
            const stereo_point *x = &p.st.points[i];
            assert_true(in_patch(x->x[0], x->x[2], HALF + 2));
            assert_true(fabsf(x->x[1] - WALL) < 0.15f);
            assert_true(x->n[1] < -0.99f);
            assert_int_equal(x->photo, k);
        }
    }
    FILE *f = tmpfile();                        /* what is saved is what stereo found */
    stereo back;
    assert_int_equal(stereo_save(&p.st, f), ORL_OK);
    rewind(f);
    assert_int_equal(stereo_load(&back, &p.w, f, "points"), ORL_OK);
    fclose(f);
    assert_int_equal(back.npoints, given.st.npoints);
    assert_memory_equal(back.points, given.st.points, back.npoints * sizeof *back.points);
    assert_memory_equal(back.begin, given.st.begin, (VIEWS + 1) * sizeof *back.begin);
    stereo_free(&back);
    unmake(&given);
    unmake(&p);
    unmake(&q);
}

static void leaves_the_rest(void **state)
{
    (void)state;
    static const struct { float bulge, spacing; } NONE[3] = { { 30, 0.8f }, { 5, 24 }, { 5, 200 } };       /* a body of its own; too few points; none */
    for (int i = 0; i < 3; i++) {
        place p;
        make(&p, NONE[i].bulge, NONE[i].spacing);
        uint32_t n = p.st.npoints;
        assert_int_equal(complete_planes(&p.w, &p.st, &p.hull, 2), ORL_OK);
        assert_int_equal(p.st.npoints, n);
        unmake(&p);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = { cmocka_unit_test(fills_the_patch), cmocka_unit_test(leaves_the_rest) };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
