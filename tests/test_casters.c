/* Casters: a ray past a box, and a tower out of the shadows that it throws in two photos; nothing out of one photo alone, out of rays that all arrive, or across what cameras look through. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>
#include <cmocka.h>
#include "trainer/casters.h"

enum { SIDE = 60, RAYS = 4 * SIDE * SIDE };
static const orl_casters TOWER = { 1, { { { 100, -120 }, { 0.8f, 0.6f }, { 40, 25 }, 150 } } };
static caster_ray rays[RAYS];

static void sun_of(float az, float el, double d[3])
{
    d[0] = (double)(cosf(el) * cosf(az));
    d[1] = (double)(cosf(el) * sinf(az));
    d[2] = (double)sinf(el);
}

static void a_box_stops_rays(void **state)
{
    (void)state;
    const orl_casters *t = &TOWER, none = { 0 };
    const double far = ORL_CASTER_FAR, up[3] = { 0, 0, 1 }, south[3] = { 0, -0.8, 0.6 }, level[3] = { 0, -1, 0 };
    assert_true(orl_casters_hide(t, (double[]){ 100, -120, 10 }, up, far));             /* in it */
    assert_false(orl_casters_hide(t, (double[]){ 100, -120, 151 }, up, far));           /* on its roof */
    assert_false(orl_casters_hide(t, (double[]){ 100, 0, 10 }, up, far));
    assert_true(orl_casters_hide(t, (double[]){ 100, 0, 10 }, level, far));
    assert_false(orl_casters_hide(t, (double[]){ 100, 0, 10 }, level, 60));             /* ends before it */
    assert_false(orl_casters_hide(t, (double[]){ 100, -240, 10 }, level, far));         /* behind it */
    assert_false(orl_casters_hide(t, (double[]){ 0, 0, 10 }, level, far));              /* beside it */
    assert_true(orl_casters_hide(t, (double[]){ 100, 0, 10 }, south, far));
    assert_false(orl_casters_hide(t, (double[]){ 100, 0, 100 }, south, far));           /* over it */
    assert_false(orl_casters_hide(t, (double[]){ (double)NAN, 0, 10 }, south, far));
    assert_false(orl_casters_hide(&none, (double[]){ 100, -120, 10 }, up, far));
}

/* A floor under four suns, `low` of which the tower hides from a part of it. */
static void light_floor(int low)
{
    static const float sun[4][2] = { { -1.5f, 0.5f }, { -1.9f, 0.55f }, { 0.4f, 0.7f }, { -1.6f, 1.3f } };
    for (int i = 0; i < RAYS; i++) {
        caster_ray *r = &rays[i];
        int k = i / (SIDE * SIDE), at = i % (SIDE * SIDE);
        *r = (caster_ray){ .o = { at % SIDE * 5.0, at / SIDE * 5.0, 10 }, .photo = k };
        sun_of(sun[k][0], sun[k][1], r->d);
        int hidden = k < low && orl_casters_hide(&TOWER, r->o, r->d, ORL_CASTER_FAR);
        r->open = (hidden ? -0.8f : 0.8f) / (2 * SIDE * SIDE);
        if (i % 11 == 3) r->open *= -0.5f;      /* dark stones and bright ones */
    }
}

/* Share of places under a sun that no photo had where casters and the tower agree about its shadow. */
static float agreement(const orl_casters *c)
{
    double d[3];
    int both = 0, any = 0;
    sun_of(-1.7f, 0.52f, d);
    for (int i = 0; i < SIDE * SIDE; i++) {
        int is = orl_casters_hide(c, rays[i].o, d, ORL_CASTER_FAR), should = orl_casters_hide(&TOWER, rays[i].o, d, ORL_CASTER_FAR);
        both += is && should;
        any += is || should;
    }
    return any ? (float)both / (float)any : 1;
}

static void two_photos_show_a_tower(void **state)
{
    (void)state;
    orl_casters c, again;
    light_floor(2);
    assert_int_equal(casters_fit(rays, RAYS, NULL, 0, 10, 300, 7, 1, &c), ORL_OK);
    assert_int_equal(c.n, 1);
    assert_true(agreement(&c) > 0.7f);
    assert_int_equal(casters_fit(rays, RAYS, NULL, 0, 10, 300, 7, 2, &again), ORL_OK);
    assert_memory_equal(&again.box, &c.box, (size_t)c.n * sizeof *c.box);               /* whatever the thread count */
    /* A camera that looks through where it must stand. */
    caster_sight sight[64];
    for (int i = 0; i < 64; i++) {
        sight[i] = (caster_sight){ .o = { 150, 150, 12 }, .far = ORL_CASTER_FAR };
        sun_of(-3.1f + 0.049f * (float)i, 0.05f, sight[i].d);
    }
    assert_int_equal(casters_fit(rays, RAYS, sight, 64, 10, 300, 7, 2, &c), ORL_OK);
    assert_int_equal(c.n, 0);
}

static void one_photo_shows_none(void **state)
{
    (void)state;
    orl_casters c;
    for (int low = 0; low < 2; low++) {
        light_floor(low);
        assert_int_equal(casters_fit(rays, RAYS, NULL, 0, 10, 300, 7, 2, &c), ORL_OK);
        assert_int_equal(c.n, 0);
    }
    assert_int_equal(casters_fit(rays, 0, NULL, 0, 10, 300, 7, 2, &c), ORL_OK);
    assert_int_equal(c.n, 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = { cmocka_unit_test(a_box_stops_rays), cmocka_unit_test(two_photos_show_a_tower), cmocka_unit_test(one_photo_shows_none) };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
