/* Ground that one photo sees takes the colour of the ground that many see, and no shadow of its own; ground that many see keeps its own colour. What a fit is told to leave out has no say. Textures come closer to the photos than the grids, and take nothing from ground
 * that few photos see. Photos that show nothing leave the others as they were. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <cmocka.h>
#include "tests/wall_world.h"
#include "trainer/texture.h"

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

enum { SOUND, BLACK, WHITE, SKY, GREY, KINDS };

static void spoil(world_photo *p, int kind)
{
    if (kind == SKY) memcpy(p->axes, (double[9]){ 1, 0, 0, 0, 1, 0, 0, 0, 1 }, sizeof p->axes);         /* it looks up */
    for (int i = 0; i < p->w * p->h; i++) {
        if (kind == BLACK || kind == WHITE) memset(p->rgb + 3 * i, kind == WHITE ? 255 : 0, 3);
        if (kind == GREY) memset(p->rgb + 3 * i, p->rgb[3 * i + 1], 3);
        if (kind == SKY) world_set_label(p, i % p->w, i / p->w, WORLD_SKY);
    }
}

typedef struct { world w; stage1 s1; surface surf; stage2 s; } stages;

/* poor: what photo 0 is. */
static void start(stages *t, unsigned without, int poor)
{
    orl_light_model light;
    make_world(&t->w);
    spoil(&t->w.photos[0], poor);
    orl_light_model_default(&light);
    assert_int_equal(stage1_init(&t->s1, &t->w, &(stage1_options){ 64, 1, 7, 1, 0 }), ORL_OK);
    assert_int_equal(stage1_start(&t->s1, &t->w, NULL), ORL_OK);
    assert_int_equal(surface_build(&t->s1, &t->surf), ORL_OK);
    assert_int_equal(surface_light(&t->surf, 1), ORL_OK);
    if (without & WITHOUT_VISIBILITY) surface_uncover(&t->surf);
    assert_int_equal(stage2_init(&t->s, &t->w, &t->surf, &t->s1, &light, &(stage2_options){ 2000, 20, 6, 7, 1, without }), ORL_OK);
}

static void end(stages *t)
{
    stage2_free(&t->s);
    surface_free(&t->surf);
    stage1_free(&t->s1);
    world_free(&t->w);
}

static void few_photos_leave_no_stain(void **state)
{
    (void)state;
    float off[2];
    for (int few = 0; few < 2; few++) {
        stages t;
        stage2_losses l;
        start(&t, WITHOUT_VISIBILITY, SOUND);      /* nothing stands on this ground */
        lay_ground(&t.s, few);
        for (int i = 0; i < 20; i++) stage2_round(&t.s, &l);
        const frame *f = &t.surf.f;
        float x[3] = { 0.9f * (float)f->dims[0], 0.5f * (float)f->dims[1], f->ground[0] }, stain[3], grey[3];
        stage2_albedo(&t.s, x, stain);
        x[0] = 0.3f * (float)f->dims[0];
        stage2_albedo(&t.s, x, grey);
        off[few] = 0;
        for (int c = 0; c < 3; c++) {
            assert_true(fabsf(grey[c] - t.s.common[c]) < 0.05f);
            off[few] += fabsf(stain[c] - t.s.common[c]);
        }
        end(&t);
    }
    print_message("stain of one photo %.3f, of many %.3f\n", off[1], off[0]);
    assert_true(off[0] > 0.2f);
    assert_true(off[1] < 0.15f * off[0]);
}

/* Largest code of a kind over the photos. */
static float most(const stage2 *s, int from, int to)
{
    float m = 0;
    for (int k = 0; k < s->w->nphotos; k++) for (int i = from; i < to; i++) m = fmaxf(m, fabsf(s->codes[k][i]));
    return m;
}

static void what_is_left_out_has_no_say(void **state)
{
    (void)state;
    stages all, none;
    stage2_losses l;
    const unsigned without = WITHOUT_TONE | WITHOUT_SHADOW | LIGHT_PAPER | WITHOUT_SKY_PRIOR;
    start(&all, 0, SOUND);
    start(&none, without, SOUND);
    for (int i = 0; i < 6; i++) { stage2_round(&all.s, &l); stage2_round(&none.s, &l); }
    stage2_prior(&all.s);
    stage2_prior(&none.s);
    assert_true(most(&all.s, ORL_C_TONE, ORL_CODE) > 0.01f && most(&all.s, ORL_C_SHADOW, ORL_C_TONE) > 0.01f);
    assert_true(most(&none.s, ORL_C_SHADOW, ORL_CODE) < 1e-4f);
    assert_true(none.s.light.prior_prec[ORL_C_TONE][ORL_C_TONE] >= 1e8f && none.s.light.prior_prec[ORL_C_ENV][ORL_C_ENV] < 0.02f && all.s.light.prior_prec[ORL_C_ENV][ORL_C_ENV] > 0.02f);
    assert_true(none.s.light.sky_std[0] == 0 && none.s.light.ground[0] == 0 && none.s.light.ground[1] == 0 && none.s.light.ground[2] == 0);
    int hidden[2] = { 0 };
    for (int a = 0; a < 2; a++) {
        const stages *t = a ? &none : &all;
        for (uint32_t i = 0; i < t->s.begin[t->w.nphotos]; i++) {
            const stage2_pixel *q = &t->s.px[i];
            if (q->surface != MET_SURFACE) continue;
            int h = q->open < 255;
            for (int k = 0; k < ORL_HORIZON; k++) h |= q->horizon[k] > 0;
            hidden[a] += h;
        }
    }
    assert_true(hidden[0] > 0);
    assert_int_equal(hidden[1], 0);
    end(&all);
    end(&none);
}

/* Mean distance of the surface pixels of the photos from `first` on from the model, and by how much textures differ from the grids there. */
static float distance(const stages *t, int first, float *change)
{
    double sum = 0, off = 0;
    int n = 0;
    for (int k = first; k < t->w.nphotos; k++) {
        orl_light light;
        orl_light_decode(&t->s.light, t->s.codes[k], &light);
        for (uint32_t i = t->s.begin[k]; i < t->s.begin[k + 1]; i++) {
            const stage2_pixel *q = &t->s.px[i];
            surface_hit h = { 0 };
            orl_sample o = { 0 };
            int b[3];
            float rgb[3], grids[3];
            if (q->surface != MET_SURFACE || surface_brick(&t->surf, q->x, b) < 0) continue;
            memcpy(h.x, q->x, sizeof h.x);
            memcpy(h.n, q->n, sizeof h.n);
            surface_gradient(&t->surf, q->x, b, h.grad);
            stage2_surface_sample(&t->s, &h, &o);
            stage2_albedo(&t->s, q->x, grids);
            o.fix = q->fix / 127.0f;
            orl_light_shade(&light, &o, rgb);
            for (int c = 0; c < 3; c++) { sum += fabsf(rgb[c] - q->rgb[c] / 255.0f); off += fabsf(o.albedo[c] - grids[c]); }
            n += 3;
        }
    }
    assert_true(n > 150);
    *change = (float)(off / n);
    return (float)(sum / n);
}

static void textures_are_finer(void **state)
{
    (void)state;
    for (int few = 0; few < 2; few++) {
        stages t;
        stage2_losses l;
        float change;
        start(&t, 0, SOUND);
        for (int i = 0; i < 6; i++) stage2_round(&t.s, &l);
        for (uint32_t i = 0; i < t.s.begin[t.w.nphotos]; i++) t.s.px[i].few = (uint8_t)few;
        float grids = distance(&t, 0, &change);
        assert_true(change == 0);
        assert_int_equal(stage2_texture(&t.s), ORL_OK);
        assert_true(t.s.skin.n >= t.surf.nbricks);
        float textures = distance(&t, 0, &change);
        print_message("%s: off by %.4f with grids, by %.4f with textures; these differ by %.4f\n", few ? "few" : "all", grids, textures, change);
        if (few) assert_true(change < 0.005f);
        else assert_true(change > 0.008f && textures < 0.9f * grids);
        end(&t);
    }
}

/* One photo black, white, all sky, or grey beside a sound one: no step is lost, its code is a number (of black and white the prior's), and the sound photo is explained as well as with a sound
 * companion. Base colour learns nothing from black and white. */
static void poor_photos_do_no_harm(void **state)
{
    (void)state;
    float off[KINDS];
    for (int kind = 0; kind < KINDS; kind++) {
        stages t;
        stage2_losses l;
        start(&t, 0, kind);
        assert_true((t.s.begin[1] > t.s.begin[0]) == (kind != BLACK && kind != WHITE));
        float prior[ORL_CODE];
        memcpy(prior, t.s.light.prior_mean, sizeof prior);
        for (int i = 0; i < 8; i++) {
            stage2_round(&t.s, &l);
            assert_int_equal(l.dropped, 0);
            assert_int_equal(l.degenerate, kind == BLACK || kind == WHITE);
        }
        if (l.degenerate) assert_memory_equal(t.s.codes[0], prior, sizeof prior);
        stage2_prior(&t.s);
        for (int k = 0; k < 2; k++) for (int c = 0; c < ORL_CODE; c++) assert_true(isfinite(t.s.codes[k][c]) && isfinite(t.s.light.prior_mean[c]) && isfinite(t.s.light.prior_prec[c][c]));
        off[kind] = distance(&t, 1, &(float){ 0 });
        assert_int_equal(stage2_texture(&t.s), ORL_OK);
        print_message("kind %d: the other photo is off by %.4f\n", kind, off[kind]);
        assert_true(off[kind] < 1.1f * off[SOUND]);
        end(&t);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = { cmocka_unit_test(few_photos_leave_no_stain), cmocka_unit_test(what_is_left_out_has_no_say),
                                        cmocka_unit_test(textures_are_finer), cmocka_unit_test(poor_photos_do_no_harm) };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
