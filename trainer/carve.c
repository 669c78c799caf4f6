/* Silhouettes: what a photo sees as sky is free, and so is a ball around it (surface.h).
 * A vertex that projects into a photo's sky, r pixels from the nearest pixel that is none, has no surface within r pixels times its depth over the focal length: a lower bound on its signed distance. Masks err,
 * so the bound that counts in full is one that one other photo or more exceeds; a photo alone may take off no more than a skin. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "oriel/parallel.h"
#include "trainer/surface.h"

enum { VOTERS = 128, MAP_PIXELS = 1 << 19, UNIT = 8, SHARE = 32, MOST_NEED = VOTERS / SHARE + 2 };   /* UNIT: steps a pixel in a map. SHARE: one more photo must agree for so many that take the vertex in */
#define BAND 3.0f               /* fine cells: bounds are cut here, and what is deeper inside stays */
#define SKIN 2.0f               /* fine cells */

typedef struct { const world_photo *p; int w, h, side; uint8_t *far; } sky_map;     /* far: pixels of the photo to the next one that is no sky, times UNIT; each entry stands for side x side of them */
typedef struct { surface *s; sky_map *map; int voters, failed; } trim_job;

/* Chamfer distance (3, 4) from the labels. */
static void map_range(void *user, int begin, int end)
{
    trim_job *j = user;
    for (int k = begin; k < end; k++) {
        sky_map *m = &j->map[k];
        const world_photo *p = m->p;
        m->side = 1;
        while ((size_t)(p->w / m->side) * (size_t)(p->h / m->side) > MAP_PIXELS) m->side++;
        m->w = p->w / m->side;
        m->h = p->h / m->side;
        size_t n = (size_t)m->w * (size_t)m->h;
        m->far = malloc(n + 1);
        if (!m->far) { __atomic_store_n(&j->failed, 1, __ATOMIC_RELAXED); continue; }
        for (size_t i = 0; i < n; i++) m->far[i] = world_label(p, (int)(i % (size_t)m->w) * m->side + m->side / 2, (int)(i / (size_t)m->w) * m->side + m->side / 2) == WORLD_SKY ? 255 : 0;
        static const int DX[4] = { -1, -1, 0, 1 }, DY[4] = { 0, -1, -1, -1 };
        for (int sweep = 0; sweep < 2; sweep++)
            for (size_t q = 0; q < n; q++) {
                size_t i = sweep ? n - 1 - q : q;
                int x = (int)(i % (size_t)m->w), y = (int)(i / (size_t)m->w), best = m->far[i];
                for (int d = 0; d < 4; d++) {
                    int u = x + (sweep ? -DX[d] : DX[d]), v = y + (sweep ? -DY[d] : DY[d]);
                    if (u < 0 || v < 0 || u >= m->w || v >= m->h) continue;
                    int there = m->far[(size_t)v * (size_t)m->w + (size_t)u] + (DX[d] && DY[d] ? UNIT * 4 / 3 : UNIT) * m->side;
                    if (there < best) best = there;
                }
                m->far[i] = (uint8_t)best;
            }
    }
}

/* The lower bounds that enough photos give and that half as many do; 0: none. */
static void bounds_at(const trim_job *j, const float x[3], float *sure, float *maybe)
{
    float best[MOST_NEED] = { 0 };
    int inside = 0;
    for (int k = 0; k < j->voters; k++) {
        const sky_map *m = &j->map[k];
        double uv[2], z;
        if (!world_sees(m->p, x, uv, &z)) continue;
        int u = (int)uv[0] / m->side, v = (int)uv[1] / m->side;
        if (u >= m->w || v >= m->h) continue;          /* the rest of a division by side */
        inside++;
        float b = ((float)m->far[(size_t)v * (size_t)m->w + (size_t)u] / UNIT - 0.5f * (float)m->side) * (float)(z / m->p->cam.fx);
        for (int i = 0; i < MOST_NEED && b > 0; i++) if (b > best[i]) { float t = best[i]; best[i] = b; b = t; }
    }
    *sure = best[1 + inside / SHARE];
    *maybe = best[inside / (2 * SHARE)];
}

static void trim_range(void *user, int begin, int end)
{
    trim_job *j = user;
    surface *s = j->s;
    for (int at = begin; at < end; at++) {
        if (s->bmap[at] < 0) continue;
        float *v = s->sdf + (size_t)s->bmap[at] * ORL_BRICK_VERTS;
        int bx = at % s->nb[0], by = at / s->nb[0] % s->nb[1], bz = at / s->nb[0] / s->nb[1];
        for (int i = 0; i < ORL_BRICK_VERTS; i++) {
            float x[3] = { (float)(8 * bx + i % 9), (float)(8 * by + i / 9 % 9), (float)(8 * bz + i / 81) };
            float sure, maybe;
            if (!(fabsf(v[i]) < BAND)) continue;
            bounds_at(j, x, &sure, &maybe);
            float b = maybe > 0 ? fminf(maybe, v[i] + SKIN) : v[i];
            if (sure > b && sure > 0) b = sure;
            if (b > v[i]) v[i] = fminf(b, BAND);
        }
    }
}

orl_err surface_carve(surface *s, const world *w, int threads)
{
    trim_job j = { .s = s };
    uint8_t *use = world_cover(w, VOTERS, SIZE_MAX);
    j.map = calloc((size_t)w->nphotos, sizeof *j.map);
    orl_err e = use && j.map ? ORL_OK : orl_fail(ORL_E_MEMORY, "silhouettes: no memory");
    for (int k = 0; !e && k < w->nphotos; k++) if (use[k]) j.map[j.voters++].p = &w->photos[k];
    if (!e) orl_parallel(threads, j.voters, 1, map_range, &j);
    if (!e && j.failed) e = orl_fail(ORL_E_MEMORY, "silhouettes: no memory");
    if (!e) orl_parallel(threads, s->nb[0] * s->nb[1] * s->nb[2], 64, trim_range, &j);
    for (int k = 0; k < j.voters; k++) free(j.map[k].far);
    free(j.map);
    free(use);
    return e;
}
