/* What walls face: found in noisy normals of a turned building and not in a heap of stones; normals near a direction turn to it, others keep their bits. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <cmocka.h>
#include "trainer/facing.h"

#define DEG 0.017453293f
enum { POINTS = 60000 };

static void unit3(float *v)
{
    float len = sqrtf(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    for (int a = 0; a < 3; a++) v[a] /= len;
}

static float angle(const float *a, const float *b) { return acosf(fminf(a[0] * b[0] + a[1] * b[1] + a[2] * b[2], 1)) / DEG; }

/* A share of the normals face up, or one of three walls (the fourth is unseen) of a building turned by `turn`, with noise; the rest face anywhere. */
static stereo make_points(float square, float noise, float turn)
{
    stereo st = { .points = calloc(POINTS, sizeof(stereo_point)), .npoints = POINTS };
    rng r = rng_make(11, 0, 0);
    assert_non_null(st.points);
    for (int i = 0; i < POINTS; i++) {
        float *n = st.points[i].n;
        st.points[i].weight = 0.5f + 0.5f * rng_f(&r);
        int wall = (int)rng_below(&r, 4);
        float az = turn + (float)wall * 90 * DEG;
        if (rng_f(&r) < square) {
            n[0] = wall < 3 ? cosf(az) : 0;
            n[1] = wall < 3 ? sinf(az) : 0;
            n[2] = wall < 3 ? 0 : 1;
        }
        float spread = n[0] != 0 || n[2] != 0 ? noise : 1;
        for (int a = 0; a < 3; a++) n[a] += spread * rng_normal(&r);
        unit3(n);
    }
    return st;
}

static void finds_the_walls(void **state)
{
    (void)state;
    for (int k = 0; k < 3; k++) {
        const float turn[] = { 17 * DEG, 0, 88.5f * DEG };
        stereo st = make_points(0.6f, 0.2f, turn[k]);
        orl_facings f;
        facings_find(&st, &f);
        assert_int_equal(f.n, 4);
        assert_true(f.dir[0][2] == 1);
        for (int wall = 0; wall < 3; wall++) {
            float want[3] = { cosf(turn[k] + (float)wall * 90 * DEG), sinf(turn[k] + (float)wall * 90 * DEG), 0 }, best = 180;
            for (int i = 1; i < f.n; i++) best = fminf(best, angle(f.dir[i], want));
            assert_true(best < 1);
        }
        float before = 0, after = 0, up[3] = { 0, 0, 1 };
        for (int i = 0; i < POINTS; i++) if (angle(st.points[i].n, up) < 30) before += angle(st.points[i].n, up);
        facings_square(&f, &st);
        for (int i = 0; i < POINTS; i++) if (angle(st.points[i].n, up) < 30) after += angle(st.points[i].n, up);
        assert_true(after < 0.6f * before);
        free(st.points);
    }
}

static void finds_none(void **state)
{
    (void)state;
    orl_facings f;
    stereo heap = make_points(0, 0, 0), few = make_points(1, 0.1f, 0);
    facings_find(&heap, &f);
    assert_int_equal(f.n, 0);
    few.npoints = 150;
    facings_find(&few, &f);
    assert_int_equal(f.n, 0);
    free(heap.points);
    free(few.points);
}

static void turns_what_is_near(void **state)
{
    (void)state;
    const orl_facings f = { 2, { { 0, 0, 1 }, { 1, 0, 0 } } };
    float last = -1, to[3];
    for (int d = 0; d <= 90; d++) {
        float n[3] = { 0, sinf((float)d * DEG), cosf((float)d * DEG) }, was[3], up[3] = { 0, 0, 1 };
        memcpy(was, n, sizeof was);
        orl_facing_turn(&f, n);
        assert_true(fabsf(n[0] * n[0] + n[1] * n[1] + n[2] * n[2] - 1) < 1e-5f);
        float now = acosf(fminf(n[2], 1)) / DEG;
        assert_true(now > last - 0.05f && now < (float)d + 0.05f);      /* nearer, and in the same order */
        if (d > 1 && d < 20) assert_true(now < 0.72f * (float)d);
        if (d > 40) assert_memory_equal(n, was, sizeof was);
        assert_true((orl_facing_near(&f, was, to) > 0) == (angle(was, up) < 39.99f) || d == 40);
        last = now;
    }
    float odd[][3] = { { NAN, 0, 0 }, { 0, 0, 0 }, { -1, 0, 0 }, { INFINITY, 0, 0 } };
    for (int i = 0; i < 3; i++) assert_true(orl_facing_near(&f, odd[i], to) == 0);
    assert_true(orl_facing_near(&f, odd[3], to) <= 1);
    const orl_facings none = { 0 };
    float n[3] = { 0, 0, 1 };
    assert_true(orl_facing_near(&none, n, to) == 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = { cmocka_unit_test(finds_the_walls), cmocka_unit_test(finds_none), cmocka_unit_test(turns_what_is_near) };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
