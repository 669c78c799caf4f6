/* `oriel bench`: what a pose that was never seen costs up to its first whole picture. */
#include <math.h>
#include <stdlib.h>
#include "oriel/cpu.h"
#include "runtime/commands.h"
#include "oriel/widen.h"

enum { RUNS = 5 };

/* Stage by stage. */
static orl_err stages(const orl_widen_config *c, const uint8_t *photo, uint8_t *wide, orl_pose_seconds *out)
{
    orl_widen w;
    double t[5] = { orl_seconds() };
    size_t need = orl_widen_need(c);
    void *block = orl_widen_block(need);            /* each time afresh, as a program's first is */
    orl_err e = block ? orl_widen_init(c, block, need, &w) : orl_fail(ORL_E_MEMORY, "no memory for a view of %d x %d", c->wide.w, c->wide.h);
    t[1] = orl_seconds();
    if (!e) e = orl_widen_adapt(&w, photo);
    t[2] = orl_seconds();
    if (!e) e = orl_widen_render(&w, photo, wide);
    t[3] = orl_seconds();
    if (!e) orl_view_trace_sun(&w.wide, w.light, 0, w.wide.h, c->cpu, c->threads);     /* again, to tell it from the light */
    t[4] = orl_seconds();
    free(block);
    double sun = t[4] - t[3];
    *out = (orl_pose_seconds){ t[1] - t[0], t[2] - t[1] - sun, sun, t[3] - t[2], 0 };
    return e;
}

/* As `oriel extend` does it: light is found while the wide view is marched. */
static orl_err whole(const orl_widen_config *c, const uint8_t *photo, uint8_t *wide, double *seconds)
{
    orl_widen w;
    double a = orl_seconds();
    size_t need = orl_widen_need(c);
    void *block = orl_widen_block(need);
    orl_err e = block ? orl_widen_start(c, photo, block, need, &w) : orl_fail(ORL_E_MEMORY, "no memory for a view of %d x %d", c->wide.w, c->wide.h);
    if (!e) e = orl_widen_render(&w, photo, wide);
    *seconds = orl_seconds() - a;
    free(block);
    return e;
}

orl_err orl_bench_pose(const orl_scene *s, const orl_view_pose *from, const orl_view_pose *to, const uint8_t *photo, int quick, int threads, orl_pose_seconds *out)
{
    orl_widen_config c = { .scene = s, .photo = from->cam, .wide = to->cam, .photo_pose = from->pose, .wide_pose = to->pose, .blend = 1, .no_skip = ORL_SKIP_SAME, .quick = quick, .threads = threads, .cpu = orl_cpu_detect() };
    uint8_t *wide = malloc((size_t)to->cam.w * (size_t)to->cam.h * 3);
    orl_pose_seconds best = { INFINITY, INFINITY, INFINITY, INFINITY, INFINITY }, now;
    orl_err e = wide ? ORL_OK : orl_fail(ORL_E_MEMORY, "no memory for pictures");
    for (int i = 0; !e && i < RUNS; i++) {
        e = stages(&c, photo, wide, &now);
        if (!e) e = whole(&c, photo, wide, &now.all);
        if (e) break;
        best = (orl_pose_seconds){ fmin(best.views, now.views), fmin(best.light, now.light), fmin(best.sun, now.sun), fmin(best.picture, now.picture), fmin(best.all, now.all) };
    }
    free(wide);
    if (!e) *out = best;
    return e;
}
