/* Fusion of oriented points: a noisy plane, its other side, and what floats before it. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <stddef.h>
#include <cmocka.h>
#include "trainer/fuse.h"

enum { SIDE = 48, N = 6000 };
static const int DIMS[3] = { SIDE, SIDE, SIDE };
static const float UP[3] = { 0, 0, 1 }, DOWN[3] = { 0, 0, -1 };

/* Points around z = 20, every tenth at z = 30 instead; normals up, both a little off. */
static stereo make(stereo_point *p, float noise)
{
    rng r = rng_make(7, 1, 2);
    for (int i = 0; i < N; i++) {
        p[i] = (stereo_point){ .x = { SIDE * rng_f(&r), SIDE * rng_f(&r), (i % 10 ? 20 : 30) + noise * rng_normal(&r) }, .weight = 1 };
        float nx = 0.2f * rng_normal(&r), ny = 0.2f * rng_normal(&r), l = 1 / sqrtf(nx * nx + ny * ny + 1);
        p[i].n[0] = nx * l; p[i].n[1] = ny * l; p[i].n[2] = l;
    }
    return (stereo){ .points = p, .npoints = N };
}

/* The hull: height over a level. */
static grid hull(float level)
{
    grid g;
    assert_int_equal(grid_init(&g, DIMS, 2, 1, 0), ORL_OK);
    for (int z = 0; z <= SIDE / 2; z++)
        for (int y = 0; y <= SIDE / 2; y++)
            for (int x = 0; x <= SIDE / 2; x++) g.p[grid_at(&g, x, y, z)] = 2 * (float)z - level;
    return g;
}

static void plane_is_found(void **state)
{
    (void)state;
    stereo_point *p = malloc(N * sizeof *p);
    stereo st = make(p, 0.3f);
    grid g = hull(20);
    fuse f;
    double off = 0;
    assert_int_equal(fuse_init(&f, &st, &g, DIMS), ORL_OK);
    for (int y = 8; y < 40; y += 2)
        for (int x = 8; x < 40; x += 2) {
            float q[3] = { (float)x, (float)y, 21 }, sure, d = fuse_distance(&f, q, UP, &sure);
            assert_true(sure > 0.5f);
            off += fabs(d - 1) / 256;
        }
    assert_true(off < 0.15);                                /* one point is 0.3 off, and its normal 16 degrees */
    float q[3] = { 24, 24, 21 }, sure;
    assert_true(fuse_distance(&f, q, DOWN, &sure) == 0 && sure == 0);    /* nothing looks down */
    fuse_free(&f);
    grid_free(&g);
    free(p);
}

static void free_space_stays_free(void **state)
{
    (void)state;
    stereo_point *p = malloc(N * sizeof *p);
    stereo st = make(p, 0.3f);
    for (int k = 0; k < 2; k++) {
        grid g = hull(k ? 29 : 20);                         /* saw through z = 30, or did not */
        fuse f;
        int found = 0;
        assert_int_equal(fuse_init(&f, &st, &g, DIMS), ORL_OK);
        for (int x = 8; x < 40; x++) {
            float q[3] = { (float)x, 24, 30 }, sure;
            fuse_distance(&f, q, UP, &sure);
            found += sure > 0;
        }
        assert_true(k ? found > 25 : found == 0);
        fuse_free(&f);
        grid_free(&g);
    }
    free(p);
}

/* No point, or points outside the box and at no place at all: nothing is sure. */
static void nothing_is_nothing(void **state)
{
    (void)state;
    stereo_point p[3] = { { .x = { NAN, 1, 1 }, .n = { 0, 0, 1 }, .weight = 1 }, { .x = { -5, 1, 1 }, .n = { 0, 0, 1 }, .weight = 1 }, { .x = { 1, 1, 1e30f }, .n = { 0, 0, 1 }, .weight = 1 } };
    grid g = hull(20);
    for (uint32_t n = 0; n <= 3; n += 3) {
        stereo st = { .points = p, .npoints = n };
        fuse f;
        float q[3] = { 1, 1, 1 }, sure = 1;
        assert_int_equal(fuse_init(&f, &st, &g, DIMS), ORL_OK);
        assert_true(fuse_distance(&f, q, UP, &sure) == 0 && sure == 0);
        fuse_free(&f);
    }
    grid_free(&g);
}

int main(void)
{
    const struct CMUnitTest tests[] = { cmocka_unit_test(plane_is_found), cmocka_unit_test(free_space_stays_free), cmocka_unit_test(nothing_is_nothing) };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
