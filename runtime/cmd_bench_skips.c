/* Part of `oriel bench`: what is skipped (oriel/view.h, runtime/skips.h), each with and without, in turn, and what that does to the picture. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "oriel/cpu.h"
#include "runtime/baked.h"
#include "runtime/bench.h"
#include "runtime/commands.h"
#include "runtime/skips.h"

typedef struct { const orl_bench *b; orl_widen *w; const orl_light *light; const uint8_t *photo; uint8_t *picture[2]; size_t bytes; } desk;

/* name: the switch, then what it is of. */
static void put(const desk *d, const char *name, const double seconds[2], double change_db)
{
    char title[80];
    snprintf(title, sizeof title, "skip: %s", name);
    orl_bench_row r = { ORL_BENCH_ROW, .name = title, .seconds = seconds[0] };
    r.without = seconds[1];
    r.change_db = change_db;
    orl_bench_put(d->b, &r);
}

static double change(const desk *d) { return orl_bench_psnr(d->picture[0], d->picture[1], d->bytes); }

/* Pictures as `run` makes them, with what it skips and without `bits`. same: how often this light was shaded before. */
static orl_err render(const desk *d, const char *name, unsigned bits, int same)
{
    orl_widen *w = d->w;
    double best[2] = { INFINITY, INFINITY }, spent = 0;
    orl_err e = ORL_OK;
    w->same = 0;
    for (int i = 0; !e && i < 2 && same; i++) e = orl_widen_render(w, d->photo, d->picture[0]);       /* the second is kept */
    for (int i = 0; !e && (i < 2 * ORL_BENCH_RUNS || (spent < 0.4 && i < 400)); i++) {
        const int without = i & 1;
        w->config.no_skip = w->wide.no_skip = without ? bits & ~(unsigned)ORL_SKIP_SAME : 0;
        w->same = without ? 0 : same;
        double a = orl_seconds();
        e = orl_widen_render(w, d->photo, d->picture[without]);
        a = orl_seconds() - a;
        best[without] = fmin(best[without], a);
        spent += a;
    }
    w->config.no_skip = w->wide.no_skip = 0;
    w->same = 0;
    if (!e) put(d, name, best, change(d));
    return e;
}

/* The shadow features of a scene that has none: as if this were one. */
static orl_err shadow(const desk *d)
{
    float scale[ORL_SHADOW_DIM];
    orl_view *v = &d->w->wide;
    memcpy(scale, v->phi_scale, sizeof scale);
    memset(v->phi_scale, 0, sizeof scale);
    d->w->tables = orl_view_light_make(v, d->light, d->w->light_block, orl_view_light_need());
    orl_err e = render(d, "shadow, of a scene without", ORL_SKIP_SHADOW, 0);
    memcpy(v->phi_scale, scale, sizeof scale);
    d->w->tables = orl_view_light_make(v, d->light, d->w->light_block, orl_view_light_need());
    return e;
}

static void shade(const desk *d, orl_view *v, uint8_t *rgb)
{
    orl_view_trace_sun(v, d->light, 0, v->h, orl_cpu_detect(), 0);
    orl_view_shade(v, orl_view_light_make(v, d->light, d->w->light_block, orl_view_light_need()), orl_cpu_detect(), 0, v->h, rgb, 3 * (size_t)v->w);
}

/* Steps through empty bricks: the view marched with their distances and one by one. *marched: seconds with them. */
static orl_err empty(const desk *d, const orl_bench_place *p, void *block, size_t need, double *marched)
{
    orl_scene crowded = *p->scene;
    int32_t *bmap = NULL;
    double best[2] = { INFINITY, INFINITY };
    orl_err e = orl_skips_crowd(&crowded, &bmap);
    for (int i = 0; !e && i < 4; i++) {
        const int without = i & 1;
        orl_view v;
        double a = orl_seconds();
        e = orl_view_build(without ? &crowded : p->scene, p->cam, p->pose, 2, 1, block, need, &v);
        best[without] = fmin(best[without], orl_seconds() - a);
        v.scene = p->scene;                 /* the suns of both, by the same steps */
        if (!e && i < 2) shade(d, &v, d->picture[without]);
    }
    free(bmap);
    if (!e) put(d, "empty, bricks in the march", best, change(d));
    *marched = best[0];
    return e;
}

/* A fixed camera's geometry, baked: attached (and its file opened and checked) instead of marched. Its suns are looked up, which tells it from the one that is marched and traced. */
static orl_err geometry(const desk *d, const orl_bench_place *p, const char *baked_path, double marched, void *block, size_t need)
{
    const orl_camera *c = p->cam;
    orl_view v, attached;
    void *rest = orl_widen_block(orl_view_attach_need(c->w, c->h));
    double best[2] = { INFINITY, marched };
    orl_err e = rest ? orl_view_build(p->scene, c, p->pose, 2, 0, block, need, &v) : orl_fail(ORL_E_MEMORY, "no memory for a view of %d x %d", c->w, c->h);
    if (!e) shade(d, &v, d->picture[1]);
    for (int i = 0; !e && i < ORL_BENCH_RUNS; i++) {
        orl_baked again = { 0 };
        double a = orl_seconds();
        if (baked_path) e = orl_baked_open(baked_path, &again);
        if (!e) e = orl_view_attach(baked_path ? &again.view[1] : &v, rest, orl_view_attach_need(c->w, c->h), &attached);
        best[0] = fmin(best[0], orl_seconds() - a);
        if (!e && i == ORL_BENCH_RUNS - 1) shade(d, &attached, d->picture[0]);
        orl_baked_close(&again);
    }
    if (!e) put(d, baked_path ? "bake, file opened" : "bake, view attached", best, change(d));
    free(rest);
    return e;
}

orl_err orl_bench_skips(const orl_bench *b, orl_widen *w, const orl_light *l, const uint8_t *photo, const orl_bench_place *place, const char *baked_path)
{
    desk d = { .b = b, .w = w, .light = l, .photo = photo, .bytes = 3 * (size_t)w->wide.w * (size_t)w->wide.h };
    size_t need = place ? orl_view_need(place->cam->w, place->cam->h) : 64;
    void *block = orl_widen_block(need);
    double marched = NAN;
    for (int k = 0; k < 2; k++) d.picture[k] = malloc(d.bytes);
    orl_err e = block && d.picture[0] && d.picture[1] ? ORL_OK : orl_fail(ORL_E_MEMORY, "no memory for pictures of %d x %d", w->wide.w, w->wide.h);
    if (!e) {
        orl_view_trace_sun(&w->wide, l, 0, w->wide.h, orl_cpu_detect(), 1);
        w->tables = orl_view_light_make(&w->wide, l, w->light_block, orl_view_light_need());
        e = render(&d, "photo, pixels under it", ORL_SKIP_PHOTO, 0);
    }
    if (!e) e = render(&d, "sky, runs without surface", ORL_SKIP_SKY, 0);
    if (!e) e = shadow(&d);
    if (!e) e = render(&d, "same, light of the last picture", ORL_SKIP_SAME, 2);
    if (!e && place) e = empty(&d, place, block, need, &marched);
    if (!e && place) e = geometry(&d, place, baked_path, marched, block, need);
    free(block);
    for (int k = 0; k < 2; k++) free(d.picture[k]);
    return e;
}
