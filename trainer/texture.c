/* Base colour in textures (texture.h): the rounds' grids are coarse and see few of the photos' pixels. With codes known, each pixel gives its base colour in closed form (skin.h has the rest). What a photo is off by
 * over many pixels is light or tone that its codes miss; it is taken away, so that photos agree where their pixels interleave. */
#include "trainer/texture.h"
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "oriel/parallel.h"

enum { NODE = 16 };             /* pixels from node to node of a photo's misfit */
#define NO_PLACE UINT32_MAX
#define SHADE_LEAST 1e-3f       /* light, over pi, under which a pixel tells no base colour */

typedef struct {
    stage2 *s;
    uint32_t *place;                /* of each pixel: first its brick, then its place among the samples; NO_PLACE: not on the surface */
    skin_sample *sample;
    int failed;
} texture_job;

static void brick_range(void *user, int begin, int end)
{
    texture_job *j = user;
    for (int i = begin; i < end; i++) {
        const stage2_pixel *q = &j->s->px[i];
        int b[3];
        j->place[i] = q->surface == MET_SURFACE ? (uint32_t)surface_brick(j->s->surf, q->x, b) : NO_PLACE;
    }
}

/* A pixel before its photo's tone: displayed colour seen and modelled, base colour by the grids, and light (linear = base colour x light). Weight 0: says nothing. */
typedef struct { float seen[3], model[3], base[3], light[3], weight; } untoned;

static void untone(const stage2 *s, const orl_light *light, const float inv[9], const stage2_pixel *q, untoned *p)
{
    orl_sample o;
    float e[3], d[3], rgb[3];
    stage2_sample(s, q, &o);
    float err2 = stage2_residual(light, q, &o, d);
    orl_light_shade(light, &o, rgb);
    orl_light_irradiance(light, &o, e);
    p->weight = o.weight * stage2_robust(err2) * stage2_says(s, q);
    for (int a = 0; a < 3; a++) {
        if (q->rgb[a] >= 250 && rgb[a] > o.rgb[a]) p->weight = 0;      /* saturated: brighter is as good */
        p->seen[a] = 0;
        for (int b = 0; b < 3; b++) p->seen[a] += inv[3 * a + b] * (o.rgb[b] - light->tone_b[b]);
        p->base[a] = o.albedo[a];
        p->light[a] = e[a] * 0.318309886f;
        p->model[a] = orl_light_encode(p->base[a] * p->light[a]);
        if (!(p->light[a] > SHADE_LEAST)) p->weight = 0;
    }
}

/* Inverse of a tone's matrix; 0: close to singular. */
static int invert3(const float m[3][3], float out[9])
{
    float det = 0;
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++) {
            int i1 = (i + 1) % 3, i2 = (i + 2) % 3, k1 = (k + 1) % 3, k2 = (k + 2) % 3;
            out[3 * k + i] = m[i1][k1] * m[i2][k2] - m[i1][k2] * m[i2][k1];
        }
    for (int k = 0; k < 3; k++) det += m[0][k] * out[3 * k];
    if (!(fabsf(det) > 0.02f)) return 0;
    for (int i = 0; i < 9; i++) out[i] /= det;
    return 1;
}

/* What a photo's pixels have over the model at large: a field on nodes NODE pixels apart, bilinear. That is light and tone that the codes miss, and no base colour's detail. */
typedef struct { int nx, ny; float (*sum)[4]; } misfit;          /* sum: weighted, and the weights */
typedef struct { int first; float w[4]; } misfit_place;

static misfit_place misfit_at(const misfit *m, const double uv[2])
{
    float at[2];
    int first[2];
    for (int a = 0; a < 2; a++) {
        float t = fminf(fmaxf((float)uv[a] / NODE, 0), (float)((a ? m->ny : m->nx) - 2) + 0.999f);
        first[a] = (int)t;
        at[a] = t - (float)first[a];
    }
    misfit_place p = { first[1] * m->nx + first[0], { 0 } };
    for (int k = 0; k < 4; k++) p.w[k] = (k & 1 ? at[0] : 1 - at[0]) * (k & 2 ? at[1] : 1 - at[1]);
    return p;
}

static void misfit_add(const misfit *m, const double uv[2], const untoned *p)
{
    misfit_place at = misfit_at(m, uv);
    for (int k = 0; k < 4; k++) {
        float *g = m->sum[at.first + (k & 1) + (k >> 1) * m->nx], w = at.w[k] * p->weight;
        for (int c = 0; c < 3; c++) g[c] += w * (p->seen[c] - p->model[c]);
        g[3] += w;
    }
}

static void misfit_look(const misfit *m, const double uv[2], float off[3])
{
    misfit_place at = misfit_at(m, uv);
    float all = 0;
    off[0] = off[1] = off[2] = 0;
    for (int k = 0; k < 4; k++) {
        const float *g = m->sum[at.first + (k & 1) + (k >> 1) * m->nx];
        if (!(g[3] > 0)) continue;
        for (int c = 0; c < 3; c++) off[c] += at.w[k] * g[c] / g[3];
        all += at.w[k];
    }
    for (int c = 0; c < 3; c++) off[c] = all > 0 ? off[c] / all : 0;
}

static void sample_of(const stage2 *s, const stage2_pixel *q, const untoned *p, const float off[3], skin_sample *out)
{
    int b[3];
    float grad[3], rgb[3], slope[3];
    if (surface_brick(s->surf, q->x, b) < 0) return;
    surface_gradient(s->surf, q->x, b, grad);
    for (int c = 0; c < 3; c++) {
        rgb[c] = orl_light_decode_srgb(p->seen[c] - off[c]) / p->light[c];
        slope[c] = (orl_light_encode(p->base[c] * 1.1f * p->light[c]) - p->model[c]) / (0.1f * p->base[c]);
    }
    skin_say(out, b, q->x, grad, rgb, slope, p->weight);
}

static void texture_photos(void *user, int begin, int end)
{
    texture_job *j = user;
    stage2 *s = j->s;
    for (int v = begin; v < end; v++) {
        int k = s->order[v];
        const world_photo *p = &s->w->photos[k];
        uint32_t first = s->begin[k], last = s->begin[k + 1];
        float inv[9];
        double uv[2];
        misfit m = { p->w / NODE + 2, p->h / NODE + 2, NULL };
        orl_light *light = malloc(sizeof *light);
        untoned *all = malloc(((size_t)(last - first) + 1) * sizeof *all);
        m.sum = calloc((size_t)m.nx * (size_t)m.ny, sizeof *m.sum);
        int ok = light && all && m.sum;
        if (!ok) __atomic_store_n(&j->failed, 1, __ATOMIC_RELAXED);
        ok = ok && v < stage2_visited(s);
        if (ok) stage2_trace_sun(s, k, last, s->codes[k], light);
        ok = ok && invert3(light->tone_a, inv);
        for (uint32_t i = first; ok && i < last; i++) {
            untoned *u = &all[i - first];
            if (j->place[i] == NO_PLACE) continue;
            untone(s, light, inv, &s->px[i], u);
            if (!world_project(p, s->px[i].x, uv, NULL)) u->weight = 0;
            if (u->weight > 0) misfit_add(&m, uv, u);
        }
        for (uint32_t i = first; i < last; i++) {
            const untoned *u = &all[i - first];
            float off[3];
            if (j->place[i] == NO_PLACE) continue;
            skin_sample *out = &j->sample[j->place[i]];
            memset(out, 0, sizeof *out);
            if (!ok || !(u->weight > 0) || !world_project(p, s->px[i].x, uv, NULL)) continue;
            misfit_look(&m, uv, off);
            sample_of(s, &s->px[i], u, off, out);
        }
        free(light);
        free(all);
        free(m.sum);
    }
}

static void coarse_colour(const void *user, const float x[3], float rgb[3]) { stage2_albedo(user, x, rgb); }

orl_err stage2_texture(stage2 *s)
{
    size_t n = s->begin[s->w->nphotos], bricks = s->surf->nbricks;
    for (int l = 0; l < ALBEDO_LEVELS; l++) grid_freeze(&s->albedo[l]);
    for (int l = 0; l < GROUND_LEVELS; l++) grid_freeze(&s->ground[l]);
    for (int l = 0; l < BACKDROP_LEVELS; l++) grid_freeze(&s->backdrop[l]);
    grid_freeze(&s->shadow);
    uint32_t *place = malloc((n + 1) * sizeof *place), *first = calloc(bricks + 2, sizeof *first);
    skin_sample *sample = NULL;
    orl_err e = skin_init(&s->skin, s->surf, s->opt.threads);
    if (!e && (!place || !first)) e = orl_fail(ORL_E_MEMORY, "base colour: no memory for %zu pixels", n);
    if (!e) {
        texture_job j = { s, place, NULL, 0 };
        orl_parallel(s->opt.threads, (int)n, 4096, brick_range, &j);
        for (size_t i = 0; i < n; i++) if (place[i] != NO_PLACE) first[place[i] + 2]++;
        for (size_t i = 2; i < bricks + 2; i++) first[i] += first[i - 1];
        for (size_t i = 0; i < n; i++) if (place[i] != NO_PLACE) place[i] = first[place[i] + 1]++;         /* the pixels of brick i are then [first[i], first[i + 1]) */
        j.sample = sample = malloc(((size_t)first[bricks] + 1) * sizeof *sample);
        if (sample) orl_parallel(s->opt.threads, s->w->nphotos, 1, texture_photos, &j);
        e = !sample || j.failed ? orl_fail(ORL_E_MEMORY, "base colour: no memory for samples") : skin_fit(&s->skin, s->surf, sample, first, coarse_colour, s, s->opt.threads);
    }
    free(place);
    free(first);
    free(sample);
    return e;
}
