/* Volume rendering of a finished model (exact.h). */
#include "trainer/exact.h"
#include <math.h>
#include <string.h>

#define LEAST 1e-3f         /* weights below are the next sample's */

typedef struct { const stage2 *s; const orl_light *l; const float *d; float *rgb; } painter;

static void add(const painter *p, const orl_sample *s, float weight)
{
    float c[3];
    orl_light_shade(p->l, s, c);
    for (int k = 0; k < 3; k++) p->rgb[k] += weight * c[k];
}

static void add_hit(const painter *p, int met, const surface_hit *h, float weight)
{
    orl_sample q;
    if (met == MET_SURFACE) stage2_surface_sample(p->s, h, &q);
    else if (met == MET_GROUND) stage2_ground_sample(p->s, h->x, &q);
    else if (met == MET_BACKDROP) stage2_backdrop_sample(p->s, h->x, h->n, &q);
    else memset(&q, 0, sizeof q);
    memcpy(q.dir, p->d, sizeof q.dir);
    q.fix = 0;
    if (met != MET_NOTHING) q.fix = stage2_fix(p->s, p->l, h->x, h->n, &q);
    add(p, &q, weight);
}

/* A point beside the surface, with the normal of the SDF there. */
static void add_point(const painter *p, const float x[3], const int b[3], float weight)
{
    surface_hit h = { .x = { x[0], x[1], x[2] } };
    surface_gradient(p->s->surf, x, b, h.grad);
    float len = sqrtf(h.grad[0] * h.grad[0] + h.grad[1] * h.grad[1] + h.grad[2] * h.grad[2]);
    for (int a = 0; a < 3; a++) h.n[a] = len > 1e-6f ? h.grad[a] / len : a == 2;
    orl_facing_turn(&p->s->surf->facings, h.n);
    add_hit(p, MET_SURFACE, &h, weight);
}

void exact_ray(const stage2 *s, const orl_light *l, const float o[3], const float d[3], float opaque, float sigma, float rgb[3])
{
    const surface *surf = s->surf;
    const painter p = { s, l, d, rgb };
    const float step = sigma / 2, band = 5 * sigma;
    surface_hit behind;
    int met = surface_meet(surf, o, d, opaque, &behind), b[3], passing = 1;     /* passing: not yet in free space, or through a solid whose face no photo shows */
    float t, end, through = 1, kept = 0, before = 1;                            /* kept: weights too small for a sample of their own; before: S of the last sample */
    memset(rgb, 0, 3 * sizeof *rgb);
    if (!box_clip(surf->f.dims, o, d, &t, &end)) end = t = 0;
    if (met != MET_NOTHING) end = fminf(end, behind.t + (met == MET_SURFACE && !behind.cut ? 7 * sigma : 0));
    if (t > 0) passing = 0;
    while (t < end && through > LEAST) {
        const float x[3] = { o[0] + t * d[0], o[1] + t * d[1], o[2] + t * d[2] };
        if (surface_brick(surf, x, b) < 0) {
            const int skip = -surf->bmap[((size_t)b[2] * (size_t)surf->nb[1] + (size_t)b[1]) * (size_t)surf->nb[0] + (size_t)b[0]];
            float exit = 1e9f;
            for (int a = 0; a < 3; a++) if (fabsf(d[a]) > 1e-9f) exit = fminf(exit, (8.0f * (float)(d[a] > 0 ? b[a] + skip : b[a] - skip + 1) - o[a]) / d[a]);
            t = fmaxf(exit, t) + 0.02f;
            before = 1;
            passing = 2;                /* free space, but the next sample may be a cut */
            continue;
        }
        const float f = surface_value(surf, x), S = 1 / (1 + expf(-f / sigma));
        if (passing == 2) passing = f < -1.0f / 32;
        else if (passing) passing = f <= 0;
        if (!passing) {
            float alpha = fmaxf((before - S) / fmaxf(before, 1e-6f), 0);
            kept += through * alpha;
            through *= 1 - alpha;
            if (kept > LEAST) {
                add_point(&p, x, b, kept);
                kept = 0;
            }
            before = S;
        } else {
            before = 1;
        }
        t += fabsf(f) < band + step ? step : fminf(fabsf(f) - band, 3.5f);
    }
    add_hit(&p, met, &behind, through + kept);
}
