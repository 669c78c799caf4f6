/* Stage 1 gradients against finite differences, repeatability of a step, and steps that are dropped, on a tiny synthetic world. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <cmocka.h>
#include "oriel/image.h"
#include "tests/wall_world.h"
#include "trainer/stage1.h"
#include "trainer/stage2.h"

/* Perturbs the entries with the largest gradients of a grid and compares. Sample positions do not depend on the parameters here: the whole box lies within the band of sigma 4. */
static int check_grid(stage1 *s, grid *g, const char *name, float h, double tolerance)
{
    stage1_losses l;
    size_t n = g->nverts * (size_t)g->c, best[6] = { 0 };
    stage1_gradients(s, &l);
    double grad[6];
    for (int k = 0; k < 6; k++) {
        float top = 0;
        for (size_t i = 0; i < n; i++) {
            int used = 0;
            for (int j = 0; j < k; j++) used |= best[j] == i;
            if (!used && fabsf(g->g[0][i]) > top) { top = fabsf(g->g[0][i]); best[k] = i; }
        }
        grad[k] = g->g[0][best[k]];
    }
    int bad = 0;
    for (int k = 0; k < 6; k++) {
        float keep = g->p[best[k]];
        g->p[best[k]] = keep + h;
        stage1_gradients(s, &l);
        double up = l.total;
        g->p[best[k]] = keep - h;
        stage1_gradients(s, &l);
        double down = l.total;
        g->p[best[k]] = keep;
        double fd = (up - down) / (2 * h), rel = fabs(fd - grad[k]) / (fabs(fd) + fabs(grad[k]) + 1e-3);
        if (rel > tolerance) { printf("%s[%zu]: gradient %g, finite difference %g\n", name, best[k], grad[k], fd); bad++; }
    }
    for (int q = 0; q < SDF_LEVELS; q++) { memset(s->sdf[q].g[0], 0, s->sdf[q].nverts * 4); }
    memset(s->feat[0].g[0], 0, s->feat[0].nverts * FEAT * 4);
    memset(s->feat[1].g[0], 0, s->feat[1].nverts * FEAT * 4);
    memset(s->codes.g[0], 0, s->codes.nverts * FEAT * 4);
    memset(s->transient.g[0], 0, s->transient.nverts * 8 * 4);
    return bad;
}

static void gradients_match_finite_differences(void **state)
{
    (void)state;
    for (int transient = 0; transient < 2; transient++) {
        world w;
        stage1 s;
        make_world(&w);
        assert_int_equal(stage1_init(&s, &w, &(stage1_options){ 64, 100, 7, 1, 4.0f }), ORL_OK);
        assert_int_equal(stage1_start(&s, &w, NULL), ORL_OK);
        s.heuristics = 0;
        s.step = transient ? 6 : 0;             /* the transient branch joins at a twentieth of the run */
        rng r = rng_make(3, 0, 0);
        for (int l = 0; l < FEAT_LEVELS; l++) for (size_t i = 0; i < s.feat[l].nverts * FEAT; i++) s.feat[l].p[i] = 0.2f * rng_normal(&r);
        for (size_t i = 0; i < s.transient.nverts * 8; i++) s.transient.p[i] = 0.5f * rng_normal(&r);
        for (size_t i = 0; i < s.sdf[2].nverts; i++) s.sdf[2].p[i] = fminf(s.sdf[2].p[i], 8.0f);
        int bad = check_grid(&s, &s.sdf[2], "sdf[2]", 2e-3f, 0.03) + check_grid(&s, &s.sdf[3], "sdf[3]", 2e-3f, 0.03) + check_grid(&s, &s.feat[0], "feat[0]", 1e-2f, 0.02)
                + check_grid(&s, &s.feat[1], "feat[1]", 1e-2f, 0.02) + check_grid(&s, &s.codes, "codes", 1e-2f, 0.02);
        if (transient) bad += check_grid(&s, &s.transient, "transient", 1e-2f, 0.02);
        assert_int_equal(bad, 0);
        stage1_free(&s);
        world_free(&w);
    }
}

static void steps_repeat(void **state)
{
    (void)state;
    world w;
    make_world(&w);
    float seen[2][3];
    for (int run = 0; run < 2; run++) {
        stage1 s;
        stage1_losses l;
        assert_int_equal(stage1_init(&s, &w, &(stage1_options){ 64, 30, 7, 2, 0 }), ORL_OK);
        assert_int_equal(stage1_start(&s, &w, NULL), ORL_OK);
        for (int i = 0; i < 30; i++) {
            stage1_step(&s, &l);
            assert_true(isfinite(l.total));
        }
        for (int i = 0; i < 3; i++) seen[run][i] = stage1_sdf(&s, (float[]){ 5.0f + 9 * i, 18, 9 }, NULL);
        stage1_free(&s);
    }
    assert_memory_equal(seen[0], seen[1], sizeof seen[0]);
    world_free(&w);
}

/* Checksum of all that a step may move. */
static uint32_t state_of(const grid *const *all, int n)
{
    uint32_t crc = 0;
    for (int i = 0; i < n; i++) {
        size_t bytes = all[i]->nverts * (size_t)all[i]->c * sizeof(float);
        crc = orl_crc32(all[i]->v, bytes, orl_crc32(all[i]->m, bytes, orl_crc32(all[i]->p, bytes, crc)));
    }
    return crc;
}

/* As if one ray of thread k had brought `what` for the SDF around x. */
static void poison(grid *g, int thread, const float x[3], float what)
{
    grid_cell c;
    grid_find(g, x, &c);
    grid_value_back(g, thread, &c, what, NULL);
}

static void steps_without_finite_gradients_are_dropped(void **state)
{
    (void)state;
    const float at[3] = { 16, 18, 9 }, hostile[] = { NAN, INFINITY, -1e30f };
    const stage2_options o2 = { 400, 4, 6, 7, 2, 0 };
    world w;
    stage1 s;
    stage1_losses l;
    make_world(&w);
    assert_int_equal(stage1_init(&s, &w, &(stage1_options){ 64, 60, 7, 2, 0 }), ORL_OK);
    assert_int_equal(stage1_start(&s, &w, NULL), ORL_OK);
    const grid *all[] = { &s.sdf[0], &s.sdf[1], &s.sdf[2], &s.sdf[3], &s.feat[0], &s.feat[1], &s.codes, &s.transient };
    for (int i = 0, k = 0; i < 60; i++) {
        uint32_t before = state_of(all, 8);
        int bad = i >= 20 && i < 23;
        if (bad) poison(&s.sdf[1], k & 1, at, hostile[k]), k++;
        assert_int_equal(stage1_step(&s, &l), !bad);
        assert_int_equal(state_of(all, 8) == before, bad);
    }
    assert_int_equal(s.step, 60);
    assert_true(isfinite(l.total));

    /* a parameter that is no number is found by the first step that meets it, and mended */
    size_t hurt = s.sdf[2].ax[4] + s.sdf[2].ay[5] + s.sdf[2].az[2];
    s.sdf[2].p[hurt] = NAN;
    s.opt.steps = 100;
    int taken = 0;
    for (int i = 0; i < 20; i++) taken += stage1_step(&s, &l);
    assert_in_range(taken, 15, 19);
    assert_true(isfinite(s.sdf[2].p[hurt]) && isfinite(l.total));

    surface surf;
    stage2 s2;
    stage2_losses l2;
    orl_light_model light;
    orl_light_model_default(&light);
    assert_int_equal(surface_build(&s, &surf), ORL_OK);
    assert_int_equal(surface_light(&surf, 2), ORL_OK);
    assert_int_equal(stage2_init(&s2, &w, &surf, &s, &light, &o2), ORL_OK);
    assert_true(s2.begin[2] > 100);
    const grid *shared[] = { &s2.albedo[0], &s2.albedo[1], &s2.albedo[2], &s2.shadow };
    uint32_t before = state_of(shared, 4);
    v4 nothing = { NAN, 0, 0, 0 };
    s2.opt.steps = 1;                           /* a round of one step, which is dropped */
    grid_cell c;
    grid_find(&s2.albedo[2], at, &c);
    grid_vector4_back(&s2.albedo[2], 1, &c, nothing);
    stage2_round(&s2, &l2);
    assert_int_equal(l2.dropped, 1);
    assert_int_equal(state_of(shared, 4), before);
    s2.opt.steps = 6;
    stage2_round(&s2, &l2);
    assert_int_equal(l2.dropped, 0);
    assert_int_not_equal(state_of(shared, 4), before);
    assert_true(isfinite(l2.mse) && isfinite(l2.adapt_rms));
    stage2_free(&s2);
    surface_free(&surf);
    stage1_free(&s);
    world_free(&w);
}

/* The logistic as sharp and as blunt as a float bears: losses stay finite, no step is dropped. */
static void sharpness_has_no_limits(void **state)
{
    (void)state;
    const float sigma[] = { 1e-30f, 1e-6f, 1e-2f, 1e2f, 1e6f, 1e30f };
    for (size_t i = 0; i < sizeof sigma / sizeof *sigma; i++) {
        world w;
        stage1 s;
        stage1_losses l;
        int taken = 0;
        make_world(&w);
        assert_int_equal(stage1_init(&s, &w, &(stage1_options){ 64, 30, 7, 2, sigma[i] }), ORL_OK);
        assert_int_equal(stage1_start(&s, &w, NULL), ORL_OK);
        for (int k = 0; k < 15; k++) taken += stage1_step(&s, &l) && isfinite(l.total);
        printf("figure sigma %g: %d of 15 steps taken, loss %.4g, mse %.4g\n", (double)sigma[i], taken, l.total, l.mse);
        assert_int_equal(taken, 15);
        assert_true(isfinite(stage1_sdf(&s, (float[]){ 9, 9, 9 }, NULL)));
        stage1_free(&s);
        world_free(&w);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = { cmocka_unit_test(gradients_match_finite_differences), cmocka_unit_test(steps_repeat), cmocka_unit_test(steps_without_finite_gradients_are_dropped),
                                        cmocka_unit_test(sharpness_has_no_limits) };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
