/* Ground that one photo sees takes the colour of the ground that many see, and no shadow of its own; ground that many see keeps its own colour. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <cmocka.h>
#include "tests/wall_world.h"
#include "trainer/stage2.h"

/* Level ground in front of the camera instead of the photos' pixels: grey to the left; a stain to the right, that `few` photos see. */
static void lay_ground(stage2 *s, int few)
{
    rng r = rng_make(3, 0, 0);
    const int *dims = s->surf->f.dims;
    for (uint32_t i = 0; i < s->begin[s->w->nphotos]; i++) {
        stage2_pixel *q = &s->px[i];
        memset(q, 0, sizeof *q);
        q->x[0] = (float)dims[0] * rng_f(&r);
        q->x[1] = (float)dims[1] * rng_f(&r);
        q->x[2] = s->surf->f.ground[0];
        q->n[2] = 1;
        q->open = q->weight = 255;
        q->surface = 1;
        int stain = q->x[0] > 0.75f * (float)dims[0];
        memcpy(q->rgb, stain ? (uint8_t[3]){ 200, 20, 190 } : (uint8_t[3]){ 120, 118, 115 }, 3);
        q->few = (uint8_t)(stain ? few : 0);
    }
}

static void few_photos_leave_no_stain(void **state)
{
    (void)state;
    float off[2];
    for (int few = 0; few < 2; few++) {
        world w;
        stage1 s1;
        surface surf;
        stage2 s;
        stage2_losses l;
        orl_light_model light;
        make_world(&w);
        orl_light_model_default(&light);
        assert_int_equal(stage1_init(&s1, &w, &(stage1_options){ 64, 1, 7, 1, 0 }), ORL_OK);
        assert_int_equal(stage1_start(&s1, &w, NULL), ORL_OK);
        assert_int_equal(surface_build(&s1, &surf), ORL_OK);
        assert_int_equal(surface_light(&surf, 1), ORL_OK);
        assert_int_equal(stage2_init(&s, &w, &surf, &s1, &light, &(stage2_options){ 2000, 20, 6, 7, 1 }), ORL_OK);
        lay_ground(&s, few);
        for (int i = 0; i < 20; i++) stage2_round(&s, &l);
        float x[3] = { 0.9f * (float)surf.f.dims[0], 0.5f * (float)surf.f.dims[1], surf.f.ground[0] }, stain[3], grey[3];
        stage2_albedo(&s, x, stain);
        x[0] = 0.3f * (float)surf.f.dims[0];
        stage2_albedo(&s, x, grey);
        off[few] = 0;
        for (int c = 0; c < 3; c++) {
            assert_true(fabsf(grey[c] - s.common[c]) < 0.05f);
            off[few] += fabsf(stain[c] - s.common[c]);
        }
        stage2_free(&s);
        surface_free(&surf);
        stage1_free(&s1);
        world_free(&w);
    }
    assert_true(off[0] > 0.3f);
    assert_true(off[1] < 0.15f * off[0]);
}

int main(void)
{
    const struct CMUnitTest tests[] = { cmocka_unit_test(few_photos_leave_no_stain) };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
