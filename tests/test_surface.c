/* The surface in bricks: no ray falls through, level ground is open to the whole sky however it lies in its bricks, and a wall raises the horizon on its side. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <cmocka.h>
#include "trainer/surface.h"

enum { NB = 8, LAYER = 2 };
#define WALL 40                 /* x beyond which it stands: on a border of bricks, and off it */
#define TOP 20.0f               /* its height over the ground */

static float shape(const float x[3], float ground, float wall)
{
    float d = x[2] - ground;
    if (wall > 0) d = fminf(d, fmaxf(wall - x[0], x[2] - ground - TOP));
    return fmaxf(d, -2);        /* as fusion leaves it: flat a little way in */
}

/* Bricks where the sign changes, and none elsewhere. */
static void make(surface *s, float ground, float wall)
{
    memset(s, 0, sizeof *s);
    for (int a = 0; a < 3; a++) s->f.dims[a] = 8 * (s->nb[a] = NB);
    s->bmap = malloc(NB * NB * NB * sizeof *s->bmap);
    s->sdf = malloc((size_t)NB * NB * NB * ORL_BRICK_VERTS * sizeof *s->sdf);
    for (int b = 0; b < NB * NB * NB; b++) {
        float *v = s->sdf + (size_t)s->nbricks * ORL_BRICK_VERTS, lo = 1e9f, hi = -1e9f;
        for (int i = 0; i < ORL_BRICK_VERTS; i++) {
            float x[3] = { (float)(b % NB * 8 + i % 9), (float)(b / NB % NB * 8 + i / 9 % 9), (float)(b / NB / NB * 8 + i / 81) };
            v[i] = shape(x, ground, wall);
            lo = fminf(lo, v[i]);
            hi = fmaxf(hi, v[i]);
        }
        s->bmap[b] = lo <= 0 && hi > -0.25f ? (int32_t)s->nbricks++ : -1;
    }
}

/* Openness and horizons where x lies, as the renderer interpolates them. */
static void light_at(const surface *s, const float x[3], float out[24])
{
    grid_cell c;
    v8 v[3] = { { 0 } };
    grid_find(&s->lite, x, &c);
    grid_vector(&s->lite, &c, 3, v);
    memcpy(out, v, sizeof v);
}

static void level_ground_is_open(void **state)
{
    (void)state;
    for (float h = 0.25f; h < 8; h += 0.5f) {
        surface s;
        float ground = 8 * LAYER + h, f[24];
        make(&s, ground, 0);
        assert_int_equal(s.nbricks, NB * NB);
        assert_int_equal(surface_light(&s, 2), ORL_OK);
        for (int i = 0; i < 64; i++) {
            float x[3] = { 2.3f + 7.5f * (float)(i % 8), 1.7f + 7.6f * (float)(i / 8), ground };
            light_at(&s, x, f);
            assert_true(f[0] > 0.99f);
            for (int a = 0; a < ORL_HORIZON; a++) assert_true(f[1 + a] < 0.01f);
        }
        surface_free(&s);
    }
}

static void wall_raises_the_horizon(void **state)
{
    (void)state;
    for (int i = 0; i < 24; i++) {
        surface s;
        float ground = 8 * LAYER + 0.25f + 1.5f * (float)(i % 6), wall = WALL + 0.1f * (float)(i / 6), f[24];
        make(&s, ground, wall);
        assert_int_equal(surface_light(&s, 2), ORL_OK);
        for (float away = 6; away < 30; away += 4) {
            float x[3] = { wall - away, 30, ground }, up = atanf(TOP / away);
            light_at(&s, x, f);
            assert_true(fabsf(f[1] - up) < 0.16f);      /* azimuth 0: the wall; 12 elevations, a lift of 2 cells, vertices 4 apart */
            assert_true(f[1 + ORL_HORIZON / 2] < 0.01f);
            assert_true(fabsf(f[0] - 0.5f * (1 + cosf(up))) < 0.05f);       /* of a wall without end; this one ends */
        }
        surface_free(&s);
    }
}

/* No ray falls through, whichever way the surface lies in its bricks. */
static void rays_meet_the_ground(void **state)
{
    (void)state;
    for (float h = 0; h < 8; h += 0.05f) {
        surface s;
        surface_hit hit;
        float ground = 8 * LAYER + h;
        make(&s, ground, 0);
        for (int i = 0; i < 200; i++) {
            float o[3] = { 4 + 0.013f * (float)i, 5, 60 }, d[3] = { 0.3f, 0.002f * (float)i, -1 }, len = sqrtf(d[0] * d[0] + d[1] * d[1] + 1);
            for (int a = 0; a < 3; a++) d[a] /= len;
            assert_true(surface_march(&s, o, d, &hit));
            assert_true(fabsf(hit.x[2] - ground) < 0.02f);
        }
        surface_free(&s);
    }
}

/* What light meets, an eye does not: bricks of a wall left out, rays that enter there and meet the next ones from behind. */
static void cuts_are_passed_through(void **state)
{
    (void)state;
    surface s;
    surface_hit hit;
    make(&s, 8 * LAYER + 1, WALL + 0.1f);
    s.bmap[((LAYER + 1) * NB + 3) * NB + WALL / 8] = -1;
    for (int i = 0; i < 100; i++) {
        float o[3] = { 20, 3, 28 + 0.01f * (float)i }, d[3] = { 0.707f, 0.7071f, 0.005f }, t = (WALL - o[0]) / d[0];
        o[1] = 25 + 0.05f * (float)i - t * d[1];
        assert_true(surface_march(&s, o, d, &hit) && hit.cut);
        assert_int_equal(surface_meet(&s, o, d, 128, &hit), MET_NOTHING);
        d[2] = -0.1f;
        o[2] -= t * d[2];
        assert_int_equal(surface_meet(&s, o, d, 128, &hit), MET_GROUND);
    }
    surface_free(&s);
}

int main(void)
{
    const struct CMUnitTest tests[] = { cmocka_unit_test(level_ground_is_open), cmocka_unit_test(wall_raises_the_horizon),
                                        cmocka_unit_test(rays_meet_the_ground), cmocka_unit_test(cuts_are_passed_through) };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
