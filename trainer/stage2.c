/* Stage 2 (Zhao, Yang et al., MM 2022, section 3.3): alternates between the photos' codes, found by the very Gauss-Newton that adapts new photos, and Adam steps on what the photos share.
 * Pixels are reduced to surface points once; for an opaque surface and an affine tone this deferred form equals the volume-rendered one. Targets: the photo where stage 1 found no transient,
 * the static branch's occlusion-free colour elsewhere. */
#include "trainer/stage2.h"
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "oriel/parallel.h"
#include "trainer/order.h"
#include "trainer/ranks.h"
#include "trainer/texture.h"

static const int ALBEDO_CELL[ALBEDO_LEVELS] = { 1, 4, 16 }, GROUND_CELL[GROUND_LEVELS] = { 8, 32, 128 }, BACKDROP_CELL[BACKDROP_LEVELS] = { 1, 4, 16 };
static const float ALBEDO_LR[ALBEDO_LEVELS] = { 0.015f, 0.012f, 0.006f }, GROUND_LR[GROUND_LEVELS] = { 0.012f, 0.008f, 0.006f };
static const float ALBEDO_PLAIN[ALBEDO_LEVELS] = { 0.05f, 0.01f, 0 }, FLOOR_PLAIN[ALBEDO_LEVELS] = { 4.0f, 0.12f, 0 }, GROUND_PLAIN[GROUND_LEVELS] = { 0.05f, 0.02f, 0.005f }, BACKDROP_PLAIN[BACKDROP_LEVELS] = { 0.2f, 0.05f, 0 };
enum { SHARED = ORL_SKY_Q * 3 * ORL_SKY_Y + 3, ADAPT_SAMPLES = 1200, TRACE_EVERY = 4, LEAST_SKY = 16, MOST_PIXELS = 16 << 20 };     /* of all photos */
enum { DETAIL = 2 };            /* base colour's textures: times the rounds' pixels that they are found from */
/* Ground near the photographers is in few photos, and who stands there in them would stain it: the fewer see it, the more it is drawn to the colour of the ground that many see. */
enum { PATCH = 8, FEW = 6 };    /* fine cells; photos */
#define LEAST_OPAQUE 32.0f      /* of the backdrop, 0..255: what is learned of it */
#define PULL 4.0f               /* over the square of the photos that see it */

static const float BACKDROP_START[3] = { 0.3f, 0.3f, 0.3f };     /* where no photo shows it */
/* Photos under lights of their own hardly tell a bright floor from a floor in much light: what floors and walls usually are decides. Ground reflects about 0.2 (Liu & Jordan 1963), paving a little more;
 * stone is seldom white. PULL_*: towards it, per pixel. */
#define FLOOR_START 0.25f
#define STONE_START 0.4f
#define PULL_FLOOR 1e-2f
#define PULL_STONE 1e-3f

const char *const WITHOUT_NAME[WITHOUTS] = { "tone", "shadow", "visibility", "ground", "distill", "sky-prior" };

/* A step that visits every one of n places in turn, widely spread at first: near the golden section of n, and no divisor in common with it. */
static uint32_t stride(uint32_t n)
{
    uint32_t step = (uint32_t)(0.6180339887 * n);
    for (;; step++) {
        uint32_t a = n, b = step;
        while (b) { uint32_t c = a % b; a = b; b = c; }
        if (a == 1) return step;
    }
}

/* Of a black or a burnt-out photo adaptation learns no light (adapt.c), so base colour must not learn from it. */
static int says_something(const stage2_pixel *q, uint32_t n)
{
    uint32_t good = 0;
    for (uint32_t i = 0; i < n; i++) {
        const uint8_t *c = q[i].rgb;
        good += (uint32_t)orl_adapt_telling((const float[]){ c[0] / 255.0f, c[1] / 255.0f, c[2] / 255.0f });
    }
    return good > n / 200;
}

static void fill_pixels(stage2 *s, const stage1 *s1, int k, stage2_pixel *out, uint32_t *count)
{
    const world_photo *p = &s->w->photos[k];
    rng r = rng_make(s->opt.seed, 0x9b0f, (uint64_t)k);
    float o[3] = { (float)p->centre[0], (float)p->centre[1], (float)p->centre[2] }, d[3];
    const uint32_t all = (uint32_t)p->w * (uint32_t)p->h, most = (uint32_t)s->detail;
    uint32_t n = 0, at = rng_below(&r, all), step = stride(all);
    int sky_left = s->opt.pixels / 5;
    for (uint32_t tries = 0; tries < all && n < most; tries++) {
        at = at >= all - step ? at - (all - step) : at + step;
        int x = (int)(at % (uint32_t)p->w), y = (int)(at / (uint32_t)p->w), label = world_label(p, x, y);
        world_ray(p, x + 0.5, y + 0.5, d);
        surface_hit h;
        int met = surface_meet(s->surf, o, d, LEAST_OPAQUE, &h);
        int sky = label == WORLD_SKY || (met != MET_SURFACE && met != MET_BACKDROP && label == WORLD_UNKNOWN && d[2] > 0.08f);   /* unknown, nothing there, above the horizon: most likely sky */
        if (sky ? met == MET_SURFACE || sky_left == 0 : met == MET_NOTHING || (met == MET_BACKDROP && label == WORLD_UNKNOWN)) continue;
        stage2_pixel *q = &out[n];
        memset(q, 0, sizeof *q);
        float passing = s->opt.without & WITHOUT_DISTILL ? 0 : stage1_transient(s1, k, x + 0.5f, y + 0.5f);
        world_rgb(p, x, y, q->rgb);
        if (sky) {
            if (passing > 0.5f) continue;
            memcpy(q->x, d, sizeof d);
            q->weight = label == WORLD_SKY ? 255 : 96;
            sky_left--;
            n++;
            continue;
        }
        q->surface = (uint8_t)met;
        memcpy(q->x, h.x, sizeof h.x);
        memcpy(q->n, h.n, sizeof h.n);
        q->weight = 255;
        if (met != MET_SURFACE) {               /* stage 1 knows no colour there */
            if (passing > 0.5f) continue;
            q->open = 255;
            n++;
            continue;
        }
        float teacher[3], diff = 0;
        stage1_colour(s1, k, h.x, teacher);
        for (int a = 0; a < 3; a++) diff += fabsf(teacher[a] - q->rgb[a] / 255.0f);
        if ((passing > 0.5f || diff > 0.6f) && !(s->opt.without & WITHOUT_DISTILL)) {
            for (int a = 0; a < 3; a++) q->rgb[a] = (uint8_t)(teacher[a] * 255.0f + 0.5f);
            q->weight = 64;
        }
        grid_cell c;
        v8 v[3] = { { 0 } };
        grid_find(&s->surf->lite, h.x, &c);
        grid_vector(&s->surf->lite, &c, 3, v);
        const float *f = (const float *)v;
        q->open = (uint8_t)(fminf(fmaxf(f[0], 0), 1) * 255.0f + 0.5f);
        for (int a = 0; a < ORL_HORIZON; a++) q->horizon[a] = (uint8_t)(fminf(f[1 + a] * (1 / 1.5707963f), 1) * 255.0f + 0.5f);
        n++;
    }
    *count = says_something(out, n) ? n : 0;
}

/* Place on the ground's plan. */
static void ground_plan(const stage2 *s, const float x[3], float y[3])
{
    for (int a = 0; a < 2; a++) y[a] = x[a] + (float)s->surf->f.dims[a];
    y[2] = 0;
}

/* Base colour out of nested grids, and where it came from. excess: before the clamp minus after. */
enum { MOST_LEVELS = ALBEDO_LEVELS };
_Static_assert((int)GROUND_LEVELS <= (int)MOST_LEVELS && (int)BACKDROP_LEVELS <= (int)MOST_LEVELS, "room for all colours' levels");
typedef struct { grid_cell at[MOST_LEVELS]; v4 level[MOST_LEVELS]; float excess[3]; } colour_cells;
typedef struct { colour_cells a; grid_cell s; } cells;

static void colour(const grid *g, int levels, const float x[3], const float base[3], float rgb[3], colour_cells *c)
{
    v4 a = { base[0], base[1], base[2], 0 };
    for (int l = 0; l < levels; l++) {
        grid_find(&g[l], x, &c->at[l]);
        c->level[l] = (v4){ 0 };
        grid_vector4(&g[l], &c->at[l], &c->level[l]);
        a += c->level[l];
    }
    for (int k = 0; k < 3; k++) {
        rgb[k] = a[k] < 0.02f ? 0.02f : a[k] > 1.0f ? 1.0f : a[k];
        c->excess[k] = a[k] - rgb[k];
    }
}

static void ground_colour(const stage2 *s, const float x[3], float rgb[3], colour_cells *c)
{
    float plan[3];
    ground_plan(s, x, plan);
    colour(s->ground, GROUND_LEVELS, plan, s->common, rgb, c);
}

/* Place on the backdrop, for its grids. */
static void backdrop_plan(const stage2 *s, const float x[3], float y[3])
{
    double uv[2];
    surface_backdrop_place(s->surf, x, uv);
    y[0] = (float)uv[0];
    y[1] = (float)uv[1];
    y[2] = 0;
}

static void backdrop_colour(const stage2 *s, const float x[3], float rgb[3], colour_cells *c)
{
    float plan[3];
    backdrop_plan(s, x, plan);
    colour(s->backdrop, BACKDROP_LEVELS, plan, BACKDROP_START, rgb, c);
}

/* d: dL / d rgb. plain: how strongly a level's detail that few pixels ask for stays away. */
static void colour_back(grid *g, int levels, int thread, const colour_cells *c, const float d[3], const float plain[])
{
    v4 da = { d[0] + c->excess[0], d[1] + c->excess[1], d[2] + c->excess[2], 0 };      /* back into range: the scene file clamps vertices, not sums */
    for (int l = 0; l < levels; l++) grid_vector4_back(&g[l], thread, &c->at[l], da + plain[l] * c->level[l]);
}

static int is_ground(const stage2 *s, const stage2_pixel *q)
{
    return q->surface == MET_GROUND || (q->surface == MET_SURFACE && q->n[2] > 0.85f && fabsf(q->x[2] - frame_ground_height(&s->surf->f, q->x)) < 0.02f * (float)s->surf->f.dims[0]);
}

/* Fills few: counts, by patches of the ground's plan, the photos with a pixel there. */
static orl_err count_views(stage2 *s)
{
    const int *dims = s->surf->f.dims, patches[2] = { 3 * dims[0] / PATCH, 3 * dims[1] / PATCH };
    size_t n = (size_t)patches[0] * (size_t)patches[1], all = s->begin[s->w->nphotos];
    uint32_t *patch = malloc((all + 1) * sizeof *patch);        /* of each pixel; n: no ground */
    uint32_t *photo = calloc(n + 1, sizeof *photo), *seen = calloc(n + 1, sizeof *seen);
    if (!patch || !photo || !seen) { free(patch); free(photo); free(seen); return orl_fail(ORL_E_MEMORY, "stage 2: no memory for %zu patches of ground", n); }
    for (int k = 0; k < s->w->nphotos; k++)
        for (uint32_t i = s->begin[k]; i < s->begin[k + 1]; i++) {
            int at[2];
            float plan[3];
            ground_plan(s, s->px[i].x, plan);
            for (int a = 0; a < 2; a++) {
                float t = plan[a] / PATCH;
                at[a] = !(t > 0) ? 0 : t < (float)patches[a] ? (int)t : patches[a] - 1;
            }
            uint32_t p = patch[i] = is_ground(s, &s->px[i]) ? (uint32_t)(at[1] * patches[0] + at[0]) : (uint32_t)n;
            if (photo[p] == (uint32_t)k + 1) continue;
            photo[p] = (uint32_t)k + 1;
            seen[p]++;
        }
    for (size_t i = 0; i < all; i++) s->px[i].few = (uint8_t)(patch[i] < n && seen[patch[i]] < FEW ? seen[patch[i]] : 0);
    free(patch);
    free(photo);
    free(seen);
    return ORL_OK;
}

/* Median base colour of ground that many photos see. */
static void find_common(stage2 *s)
{
    enum { MOST = 1 << 14 };
    static float v[3][MOST];
    size_t n = 0, all = s->begin[s->w->nphotos], step = all / MOST + 1;
    for (size_t i = 0; i < all && n < MOST; i += step) {
        float a[3];
        colour_cells from;
        if (s->px[i].few || !is_ground(s, &s->px[i])) continue;
        if (s->px[i].surface == MET_GROUND) ground_colour(s, s->px[i].x, a, &from);
        else stage2_albedo(s, s->px[i].x, a);
        for (int c = 0; c < 3; c++) v[c][n] = a[c];
        n++;
    }
    for (int c = 0; c < 3; c++) {
        order_floats(v[c], n);
        s->common[c] = n ? v[c][n / 2] : FLOOR_START;
    }
}

/* Mean and spread of the photos' mean sky colours, in the scene file's steps. */
static void find_skies(stage2 *s)
{
    double sum[3] = { 0 }, square[3] = { 0 };
    int n = 0;
    for (int k = 0; k < s->w->nphotos; k++) {
        double rgb[3] = { 0 };
        int sky = 0;
        for (uint32_t i = s->begin[k]; i < s->begin[k + 1]; i++) {
            if (s->px[i].surface || s->px[i].weight < 255) continue;
            for (int c = 0; c < 3; c++) rgb[c] += s->px[i].rgb[c];
            sky++;
        }
        if (sky < LEAST_SKY) continue;
        for (int c = 0; c < 3; c++) {
            rgb[c] /= sky;
            sum[c] += rgb[c];
            square[c] += rgb[c] * rgb[c];
        }
        n++;
    }
    for (int c = 0; c < 3; c++) {
        double mean = sum[c] / fmax(n, 1), std = sqrt(fmax(square[c] / fmax(n, 1) - mean * mean, 0));
        s->light.sky_mean[c] = (float)(n > 2 ? floor(mean + 0.5) : 0) / 255;
        s->light.sky_std[c] = (float)(n > 2 ? floor(fmax(std, 25) + 0.5) : 0) / 255;
    }
}

typedef struct { stage2 *s; const stage1 *s1; uint32_t *count; } pixel_job;

static void pixel_range(void *user, int begin, int end)
{
    pixel_job *j = user;
    for (int k = begin; k < end; k++) fill_pixels(j->s, j->s1, k, j->s->px + (size_t)k * (size_t)j->s->detail, &j->count[k]);
}

/* Starts that break the saddle where a code and its basis are both zero. */
static void sky_generator_start(orl_light_model *m)
{
    const int own = ORL_SKY_Q - ORL_SKY_DIM;
    for (int c = 0; c < 3; c++) {
        m->sky_gen[own + 0][c][0] = 0.12f;                              /* brighter */
        m->sky_gen[own + 1][c][0] = c == 0 ? 0.1f : c == 2 ? -0.1f : 0;  /* warmer */
        m->sky_gen[own + 2][c][3] = 0.15f;                              /* brighter upwards */
        m->sky_gen[own + 3][c][8] = 0.05f;                              /* brighter at the zenith and the horizon than between */
    }
}

/* Holds the codes of what is left out at zero, and takes the prior of sun and sky away, wherever codes are found: the scene file has only this prior. */
static void leave_out(stage2 *s)
{
    unsigned w = s->opt.without;
    orl_light_model *m = &s->light;
    for (int k = 0; k < ORL_CODE; k++) {
        int tone = k >= ORL_C_TONE, shadow = k >= ORL_C_SHADOW && !tone, gone = tone ? w & WITHOUT_TONE : shadow ? w & WITHOUT_SHADOW : 0, free = !tone && !shadow && w & WITHOUT_SKY_PRIOR;
        if (!gone && !free) continue;
        for (int i = 0; i < ORL_CODE; i++) m->prior_prec[k][i] = m->prior_prec[i][k] = 0;
        m->prior_prec[k][k] = gone ? 1e8f : 1e-2f;
        if (gone) m->prior_mean[k] = 0;
    }
    if (w & WITHOUT_SKY_PRIOR) memset(m->sky_std, 0, sizeof m->sky_std);
    if (w & WITHOUT_GROUND) memset(m->ground, 0, sizeof m->ground);
}

orl_err stage2_init(stage2 *s, const world *w, const surface *surf, const stage1 *s1, const orl_light_model *light, const stage2_options *opt)
{
    memset(s, 0, sizeof *s);
    s->w = w;
    s->surf = surf;
    s->opt = *opt;
    if (light) s->light = *light;
    orl_err e = ORL_OK;
    for (int l = 0; !e && l < ALBEDO_LEVELS; l++) e = grid_init(&s->albedo[l], surf->f.dims, ALBEDO_CELL[l], 4, opt->threads);
    for (int l = 0; !e && l < GROUND_LEVELS; l++) {
        int c = GROUND_CELL[l], plan[3] = { (3 * surf->f.dims[0] + c - 1) / c * c, (3 * surf->f.dims[1] + c - 1) / c * c, c };
        e = grid_init(&s->ground[l], plan, c, 4, opt->threads);
    }
    for (int l = 0; !e && l < BACKDROP_LEVELS; l++) e = grid_init(&s->backdrop[l], (const int[3]){ ORL_BACK_COLS, ORL_BACK_ROWS, BACKDROP_CELL[l] }, BACKDROP_CELL[l], 4, opt->threads);
    if (!e) e = grid_init(&s->shadow, surf->f.dims, 4, ORL_SHADOW_DIM, opt->threads);
    if (e || !s1) { if (e) stage2_free(s); return e; }
    sky_generator_start(&s->light);
    size_t n = (size_t)w->nphotos;
    const int bound = MOST_PIXELS / w->nphotos;
    if (s->opt.pixels > bound) s->opt.pixels = bound;
    s->detail = s->opt.pixels > bound / DETAIL ? bound : DETAIL * s->opt.pixels;
    const size_t most = (size_t)s->detail;
    s->order = malloc(n * sizeof *s->order);
    s->codes = calloc(n, sizeof *s->codes);
    s->begin = calloc(n + 1, sizeof *s->begin);
    s->px = malloc((n * most + 1) * sizeof *s->px);
    s->adam = calloc(2 * SHARED, sizeof *s->adam);
    uint32_t *count = calloc(n, sizeof *count);
    if (!s->order || !s->codes || !s->begin || !s->px || !s->adam || !count) { free(count); stage2_free(s); return orl_fail(ORL_E_MEMORY, "stage 2: no memory for %zu photos", n); }
    for (size_t k = 0; k < n; k++) memcpy(s->codes[k], s->light.prior_mean, sizeof s->codes[k]);
    pixel_job j = { s, s1, count };
    orl_parallel(opt->threads, w->nphotos, 1, pixel_range, &j);
    for (size_t k = 0; k < n; k++) {
        memmove(s->px + s->begin[k], s->px + k * most, count[k] * sizeof *s->px);
        s->begin[k + 1] = s->begin[k] + count[k];
    }
    free(count);
    stage2_pixel *fit = realloc(s->px, ((size_t)s->begin[n] + 1) * sizeof *fit);
    if (fit) s->px = fit;
    if ((e = count_views(s))) { stage2_free(s); return e; }
    find_skies(s);
    leave_out(s);
    rng r = rng_make(opt->seed, 0x54ad, 0), turn = rng_make(opt->seed, 0x04de, 0);
    for (int k = 0; k < w->nphotos; k++) {
        int at = w->nphotos > STAGE2_VISITS ? (int)rng_below(&turn, (uint32_t)k + 1) : k;
        s->order[k] = s->order[at];
        s->order[at] = k;
    }
    /* Base colour starts at its coarsest level, also where no photo reaches; shadow features start as long waves. */
    grid *g = &s->albedo[ALBEDO_LEVELS - 1];
    for (int z = 0; z < g->n[2]; z++)
        for (int y = 0; y < g->n[1]; y++)
            for (int x = 0; x < g->n[0]; x++) {
                const float at[3] = { (float)x * g->cell, (float)y * g->cell, (float)z * g->cell };
                size_t i = grid_at(g, x, y, z);
                for (int c = 0; c < 3; c++) g->p[4 * i + (size_t)c] = fabsf(at[2] - frame_ground_height(&surf->f, at)) < 0.6f * g->cell ? FLOOR_START : STONE_START;
                grid_mark(g, i);
            }
    float wave[ORL_SHADOW_DIM][4], longest = (float)surf->f.dims[0];
    for (int q = 0; q < ORL_SHADOW_DIM; q++) for (int a = 0; a < 4; a++) wave[q][a] = rng_normal(&r) * (a < 3 ? 12.0f / longest : 3.0f);
    for (size_t b = 0; b < (size_t)surf->nb[0] * (size_t)surf->nb[1] * (size_t)surf->nb[2]; b++) {
        if (surf->bmap[b] < 0) continue;
        int o[3] = { (int)(b % (size_t)surf->nb[0]) * 2, (int)(b / (size_t)surf->nb[0] % (size_t)surf->nb[1]) * 2, (int)(b / ((size_t)surf->nb[0] * (size_t)surf->nb[1])) * 2 };
        for (int v = 0; v < ORL_LITE_VERTS; v++) {
            int x = o[0] + v % 3, y = o[1] + v / 3 % 3, z = o[2] + v / 9;
            size_t at = grid_at(&s->shadow, x, y, z);
            for (int q = 0; q < ORL_SHADOW_DIM; q++)
                s->shadow.p[at * ORL_SHADOW_DIM + (size_t)q] = 0.5f * sinf(4.0f * (wave[q][0] * (float)x + wave[q][1] * (float)y + wave[q][2] * (float)z) + wave[q][3]);
            grid_mark(&s->shadow, at);
        }
    }
    return ORL_OK;
}

void stage2_free(stage2 *s)
{
    for (int l = 0; l < ALBEDO_LEVELS; l++) grid_free(&s->albedo[l]);
    for (int l = 0; l < GROUND_LEVELS; l++) grid_free(&s->ground[l]);
    for (int l = 0; l < BACKDROP_LEVELS; l++) grid_free(&s->backdrop[l]);
    grid_free(&s->shadow);
    skin_free(&s->skin);
    free(s->order);
    free(s->codes);
    free(s->begin);
    free(s->px);
    free(s->adam);
    memset(s, 0, sizeof *s);
}

static void look_up(const stage2 *s, const float x[3], orl_sample *o, cells *c)
{
    v8 phi[1] = { { 0 } };
    colour(s->albedo, ALBEDO_LEVELS, x, (float[3]){ 0 }, o->albedo, &c->a);
    grid_find(&s->shadow, x, &c->s);
    grid_vector(&s->shadow, &c->s, 1, phi);
    for (int k = 0; k < ORL_SHADOW_DIM; k++) o->phi[k] = phi[0][k];
}

void stage2_albedo(const stage2 *s, const float x[3], float rgb[3])
{
    colour_cells c;
    colour(s->albedo, ALBEDO_LEVELS, x, (float[3]){ 0 }, rgb, &c);
}

void stage2_surface_sample(const stage2 *s, const surface_hit *h, orl_sample *out)
{
    const float *x = h->x;
    cells c;
    int b[3];
    look_up(s, x, out, &c);
    int32_t brick = s->skin.n ? surface_brick(s->surf, x, b) : -1;
    if (brick >= 0) skin_colour(&s->skin, (uint32_t)brick, b, x, h->grad, out->albedo);
    memcpy(out->normal, h->n, sizeof out->normal);
    v8 v[3] = { { 0 } };
    grid_cell lc;
    grid_find(&s->surf->lite, x, &lc);
    grid_vector(&s->surf->lite, &lc, 3, v);
    const float *f = (const float *)v;
    out->open = fminf(fmaxf(f[0], 0), 1);
    memcpy(out->horizon, f + 1, sizeof out->horizon);
    out->cov = 1;
}

void stage2_ground_sample(const stage2 *s, const float x[3], orl_sample *out)
{
    colour_cells c;
    memset(out, 0, sizeof *out);
    ground_colour(s, x, out->albedo, &c);
    out->normal[2] = out->open = out->cov = 1;
}

void stage2_backdrop_texel(const stage2 *s, int texel, float rgb[3])
{
    colour_cells c;
    colour(s->backdrop, BACKDROP_LEVELS, (float[3]){ (float)(texel % ORL_BACK_COLS) + 0.5f, (float)(texel / ORL_BACK_COLS) + 0.5f, 0 }, BACKDROP_START, rgb, &c);
}

void stage2_backdrop_sample(const stage2 *s, const float x[3], const float n[3], orl_sample *out)
{
    colour_cells c;
    memset(out, 0, sizeof *out);
    backdrop_colour(s, x, out->albedo, &c);
    memcpy(out->normal, n, sizeof out->normal);
    out->open = out->cov = 1;
}

static void make_sample(const stage2 *s, const stage2_pixel *q, orl_sample *o, cells *c)
{
    memset(o, 0, sizeof *o);
    for (int a = 0; a < 3; a++) o->rgb[a] = q->rgb[a] * (1.0f / 255.0f);
    o->weight = q->weight * (1.0f / 255.0f);
    if (!q->surface) {
        memcpy(o->dir, q->x, sizeof o->dir);
        return;
    }
    if (q->surface == MET_GROUND) ground_colour(s, q->x, o->albedo, &c->a);
    else if (q->surface == MET_BACKDROP) backdrop_colour(s, q->x, o->albedo, &c->a);
    else look_up(s, q->x, o, c);
    memcpy(o->normal, q->n, sizeof o->normal);
    o->open = q->open * (1.0f / 255.0f);
    o->fix = q->fix * (1.0f / 127.0f);
    for (int a = 0; a < ORL_HORIZON; a++) o->horizon[a] = q->horizon[a] * (1.5707963f / 255.0f);
    o->cov = 1;
}

void stage2_sample(const stage2 *s, const stage2_pixel *q, orl_sample *out)
{
    cells c;
    make_sample(s, q, out, &c);
}

float stage2_says(const stage2 *s, const stage2_pixel *q) { return q->few ? 0 : is_ground(s, q) ? ALBEDO_PLAIN[0] / FLOOR_PLAIN[0] : 1; }

/* The pixels of photo k that rounds take: [begin[k], rounds_end(k)). */
static uint32_t rounds_end(const stage2 *s, int k)
{
    uint32_t most = s->begin[k] + (uint32_t)s->opt.pixels;
    return most < s->begin[k + 1] ? most : s->begin[k + 1];
}

/* Visits of a round, and visit i of round `round`: its photo, and the round of its visit before; -1: none. */
static int visits(const stage2 *s) { return s->w->nphotos < STAGE2_VISITS ? s->w->nphotos : STAGE2_VISITS; }
static int visit(const stage2 *s, int i, int *before)
{
    int64_t turn = (int64_t)s->round * visits(s) + i;
    if (before) *before = turn < s->w->nphotos ? -1 : (int)((turn - s->w->nphotos) / visits(s));
    return s->order[turn % s->w->nphotos];
}

int stage2_visited(const stage2 *s) { return (int)fmin(s->w->nphotos, (double)s->round * visits(s)); }

/* The share of thread t of this rank: visits that share.first + k * share.all is. */
typedef struct { int first, all; } share;
static share share_of(const stage2 *s, int t) { return (share){ ranks_mine() * s->opt.threads + t, ranks_count() * s->opt.threads }; }

int stage2_traces(const stage2 *s, const orl_light *l) { return l->sun_dir[2] > 0 && !(s->opt.without & WITHOUT_VISIBILITY); }

float stage2_fix(const stage2 *s, const orl_light *l, const float x[3], const float n[3], const orl_sample *o)
{
    return stage2_traces(s, l) ? (float)surface_sunlit(s->surf, x, n, l->sun_dir) - orl_light_sun_visibility(l, o) : 0;
}

void stage2_trace_sun(stage2 *s, int k, uint32_t end, const float code[ORL_CODE], orl_light *light)
{
    orl_light_decode(&s->light, code, light);
    for (uint32_t i = s->begin[k]; i < end; i++) {
        stage2_pixel *q = &s->px[i];
        orl_sample o;
        if (!q->surface) continue;
        for (int a = 0; a < ORL_HORIZON; a++) o.horizon[a] = q->horizon[a] * (1.5707963f / 255.0f);
        o.fix = 0;
        q->fix = (int8_t)lrintf(127 * stage2_fix(s, light, q->x, q->n, &o));
    }
}

typedef struct { float code[ORL_CODE]; double rms; int degenerate; } visit_result;
typedef struct { stage2 *s; visit_result *out; } code_job;

static void code_photos(void *user, int begin, int end)
{
    code_job *j = user;
    stage2 *s = j->s;
    for (int t = begin; t < end; t++) {
        size_t bytes = (orl_adapt_need() + 63) & ~(size_t)63;
        void *work = aligned_alloc(64, bytes);
        orl_sample *smp = malloc(ADAPT_SAMPLES * sizeof *smp);
        orl_light *light = malloc(sizeof *light);
        share of = share_of(s, t);
        for (int v = of.first; v < visits(s); v += of.all) {
            int before, k = visit(s, v, &before), R = s->opt.rounds;
            int cold = before < 0 || (before < R / 10 && s->round >= R / 10) || (before < R / 4 && s->round >= R / 4) || (before < R / 2 && s->round >= R / 2);
            visit_result *o = &j->out[v];
            memcpy(o->code, s->codes[k], sizeof o->code);
            if (!work || !smp || !light) continue;
            uint32_t n = rounds_end(s, k) - s->begin[k], use = n < ADAPT_SAMPLES ? n : ADAPT_SAMPLES;
            rng r = rng_make(s->opt.seed, 0xada0 + (uint64_t)s->round, (uint64_t)k);
            for (uint32_t i = 0; i < use; i++) {
                cells c;
                make_sample(s, &s->px[s->begin[k] + rng_below(&r, n)], &smp[i], &c);
                if (cold) smp[i].fix = 0;       /* of a sun that is not this one */
            }
            orl_adapt_options opt = orl_adapt_defaults();
            if (!cold) opt.max_iterations = 3;
            orl_adapt_result res;
            memset(&res, 0, sizeof res);
            if (orl_adapt(&s->light, smp, use, cold ? NULL : s->codes[k], &opt, work, bytes, &res)) continue;
            o->degenerate = res.status == ORL_ADAPT_DEGENERATE;
            int sound = isfinite(res.rms);
            for (int i = 0; i < ORL_CODE; i++) sound &= isfinite(res.code[i]);
            if (!sound) continue;
            memcpy(o->code, res.code, sizeof res.code);
            o->rms = res.rms;
            if (cold || s->round % TRACE_EVERY == 0 || s->w->nphotos > STAGE2_VISITS) stage2_trace_sun(s, k, rounds_end(s, k), o->code, light);
        }
        free(work);
        free(smp);
        free(light);
    }
}

typedef struct { float shared[SHARED]; double mse, weight; } grad_sum;
typedef struct { stage2 *s; int step; grad_sum *sum; orl_light *lights; } grad_job;     /* sum: of each thread of each rank; lights: of each visit */

float stage2_robust(float err2)
{
    float r = 0.15f * 0.15f / (err2 + 0.15f * 0.15f);
    return r * r;
}

float stage2_residual(const orl_light *light, const stage2_pixel *q, const orl_sample *o, float d[3])
{
    float rgb[3], err2 = 0;
    orl_light_shade(light, o, rgb);
    for (int a = 0; a < 3; a++) {
        d[a] = rgb[a] - o->rgb[a];
        if (q->rgb[a] >= 250 && d[a] > 0) d[a] = 0;     /* saturated: brighter is as good */
        err2 += d[a] * d[a];
    }
    float scale = 2 * o->weight * stage2_robust(err2);
    for (int a = 0; a < 3; a++) d[a] *= scale;
    return err2;
}

static void grad_photos(void *user, int begin, int end)
{
    grad_job *j = user;
    stage2 *s = j->s;
    for (int t = begin; t < end; t++) {
        share of = share_of(s, t);
        grad_sum *sum = &j->sum[of.first];
        for (int v = of.first; v < visits(s); v += of.all) {
            int k = visit(s, v, NULL);
            uint32_t n = rounds_end(s, k) - s->begin[k];
            const orl_light *light = &j->lights[v];
            float d_ground[3] = { 0 }, d_sky[3][ORL_SKY_Y] = { { 0 } };
            for (uint32_t i = (uint32_t)j->step; i < n; i += (uint32_t)s->opt.steps) {
                orl_sample o;
                cells c;
                const stage2_pixel *q = &s->px[s->begin[k] + i];
                make_sample(s, q, &o, &c);
                float d[3], d_albedo[3] = { 0 }, d_phi[ORL_SHADOW_DIM] = { 0 }, err2 = stage2_residual(light, q, &o, d);
                sum->mse += o.weight * err2 / 3;
                sum->weight += o.weight;
                orl_light_shade_back(&s->light, light, &o, d, q->surface ? d_albedo : NULL, q->surface ? d_phi : NULL, q->surface ? d_ground : NULL, q->surface ? NULL : d_sky);
                if (!q->surface) continue;
                float pull = q->few ? PULL / (float)(q->few * q->few) : 0;
                for (int a = 0; a < 3; a++) d_albedo[a] += pull * (o.albedo[a] - s->common[a]);
                if (q->surface == MET_GROUND) {
                    colour_back(s->ground, GROUND_LEVELS, t, &c.a, d_albedo, GROUND_PLAIN);
                    continue;
                }
                if (q->surface == MET_BACKDROP) {
                    colour_back(s->backdrop, BACKDROP_LEVELS, t, &c.a, d_albedo, BACKDROP_PLAIN);
                    continue;
                }
                int floor = is_ground(s, q);
                for (int a = 0; a < 3; a++) d_albedo[a] += floor ? PULL_FLOOR * (o.albedo[a] - FLOOR_START) : PULL_STONE * (o.albedo[a] - STONE_START);
                colour_back(s->albedo, ALBEDO_LEVELS, t, &c.a, d_albedo, floor ? FLOOR_PLAIN : ALBEDO_PLAIN);
                if (i & 1 && floor) {         /* what shows of the ground tells how it goes on */
                    colour_cells g;
                    orl_sample on = o;
                    float d_on[3] = { 0 };
                    ground_colour(s, q->x, on.albedo, &g);
                    stage2_residual(light, q, &on, d);
                    orl_light_shade_back(&s->light, light, &on, d, d_on, NULL, NULL, NULL);
                    for (int a = 0; a < 3; a++) d_on[a] += pull * (on.albedo[a] - s->common[a]);
                    colour_back(s->ground, GROUND_LEVELS, t, &g, d_on, GROUND_PLAIN);
                }
                v8 dp[1];
                for (int a = 0; a < ORL_SHADOW_DIM; a++) dp[0][a] = d_phi[a] + (1e-4f + 0.1f * pull) * o.phi[a];
                grid_vector_back(&s->shadow, t, &c.s, 1, dp);
            }
            float *g = sum->shared, q[ORL_SKY_Q] = { 1, light->code[ORL_C_SUN_EL] };
            memcpy(q + 2, light->code + ORL_C_ENV, (ORL_ENV_DIM + ORL_SKY_DIM) * sizeof(float));
            for (int b = 0; b < ORL_SKY_Q; b++) for (int a = 0; a < 3; a++) for (int y = 0; y < ORL_SKY_Y; y++) *g++ += q[b] * d_sky[a][y];
            for (int a = 0; a < 3; a++) *g++ += d_ground[a];
        }
    }
}

void stage2_round(stage2 *s, stage2_losses *out)
{
    int T = s->opt.threads, R = s->opt.rounds, N = T * ranks_count();
    static orl_light lights[STAGE2_VISITS];
    static visit_result found[STAGE2_VISITS];
    static grad_sum sums[RANKS_MOST * GRID_THREADS];
    double mse = 0, weight = 0;
    memset(out, 0, sizeof *out);
    memset(found, 0, sizeof found);
    find_common(s);
    orl_parallel(T, T, 1, code_photos, &(code_job){ s, found });
    ranks_merge(found, sizeof found);
    for (int i = 0; i < visits(s); i++) {
        int k = visit(s, i, NULL);
        memcpy(s->codes[k], found[i].code, sizeof found[i].code);
        orl_light_decode(&s->light, s->codes[k], &lights[i]);
        out->adapt_rms += found[i].rms / visits(s);
        out->degenerate += found[i].degenerate;
    }
    enum { GRIDS = ALBEDO_LEVELS + GROUND_LEVELS + BACKDROP_LEVELS + 1 };
    grid *all[GRIDS] = { &s->shadow };
    float lr[GRIDS] = { 0.02f };
    for (int l = 0; l < ALBEDO_LEVELS; l++) { all[1 + l] = &s->albedo[l]; lr[1 + l] = ALBEDO_LR[l]; }
    for (int l = 0; l < GROUND_LEVELS; l++) { all[1 + ALBEDO_LEVELS + l] = &s->ground[l]; lr[1 + ALBEDO_LEVELS + l] = GROUND_LR[l]; }
    for (int l = 0; l < BACKDROP_LEVELS; l++) { all[1 + ALBEDO_LEVELS + GROUND_LEVELS + l] = &s->backdrop[l]; lr[1 + ALBEDO_LEVELS + GROUND_LEVELS + l] = GROUND_LR[l]; }
    float decay = expf(logf(0.1f) * (float)s->round / (float)(R > 0 ? R : 1));
    for (int step = 0; step < s->opt.steps; step++) {
        memset(sums, 0, (size_t)N * sizeof *sums);
        orl_parallel(T, T, 1, grad_photos, &(grad_job){ s, step, sums, lights });
        ranks_merge(sums, (size_t)N * sizeof *sums);
        double sum = 0;                         /* of all that must be a number */
        for (int t = 0; t < N; t++) {
            sum += sums[t].mse + sums[t].weight;
            for (int i = 0; i < SHARED; i++) sum += (double)sums[t].shared[i] * sums[t].shared[i];
        }
        int sound = sum < 1e30;
        for (int l = 0; l < GRIDS; l++) sound &= grid_sum(all[l], T);
        if (!sound) {
            for (int l = 0; l < GRIDS; l++) grid_drop(all[l]);
            out->dropped++;
            continue;
        }
        for (int t = 0; t < N; t++) { mse += sums[t].mse; weight += sums[t].weight; }
        for (int l = 0; l < GRIDS; l++) grid_adam(all[l], lr[l] * decay, T);
        float *sky = &s->light.sky_gen[0][0][0], *m = s->adam, *v = s->adam + SHARED;
        for (int i = 0; i < SHARED; i++) {
            float g = 0;
            for (int t = 0; t < N; t++) g += sums[t].shared[i];
            /* One photo sees little azimuth: terms that vary with it would be extrapolated wildly, so the generator keeps to elevation. */
            int y = i % ORL_SKY_Y;
            if (i < SHARED - 3 && y != 0 && y != 3 && y != 8) { sky[i] = 0; continue; }
            m[i] = 0.9f * m[i] + 0.1f * g;
            v[i] = 0.99f * v[i] + 0.01f * g * g;
            float up = decay * 0.004f * m[i] / (sqrtf(v[i]) + 1e-9f);
            if (i < SHARED - 3) sky[i] -= up;
            else if (!(s->opt.without & WITHOUT_GROUND)) {
                float *gr = &s->light.ground[i - (SHARED - 3)];
                *gr = fminf(fmaxf(*gr - up, 0.02f), 0.9f);
            }
        }
    }
    out->mse = mse / (weight > 0 ? weight : 1);
    s->round++;
}

/* Symmetric positive definite inverse by Cholesky, in place; 0 if singular. */
static int invert(double a[ORL_CODE][ORL_CODE])
{
    enum { N = ORL_CODE };
    static double l[N][N], x[N][N];
    memset(l, 0, sizeof l);
    for (int i = 0; i < N; i++)
        for (int j = 0; j <= i; j++) {
            double s = a[i][j];
            for (int k = 0; k < j; k++) s -= l[i][k] * l[j][k];
            if (i == j) { if (!(s > 1e-12)) return 0; l[i][i] = sqrt(s); }
            else l[i][j] = s / l[j][j];
        }
    for (int c = 0; c < N; c++) {
        double y[N];
        for (int i = 0; i < N; i++) {
            double s = i == c;
            for (int k = 0; k < i; k++) s -= l[i][k] * y[k];
            y[i] = s / l[i][i];
        }
        for (int i = N - 1; i >= 0; i--) {
            double s = y[i];
            for (int k = i + 1; k < N; k++) s -= l[k][i] * x[k][c];
            x[i][c] = s / l[i][i];
        }
    }
    memcpy(a, x, sizeof x);
    return 1;
}

void stage2_prior(stage2 *s)
{
    int n = stage2_visited(s);
    if (n < 1) return;
    static double cov[ORL_CODE][ORL_CODE], old[ORL_CODE][ORL_CODE];
    double mean[ORL_CODE] = { 0 };
    for (int i = 0; i < ORL_CODE; i++) for (int j = 0; j < ORL_CODE; j++) old[i][j] = s->light.prior_prec[i][j] + (i == j ? 1e-4 : 0);
    if (!invert(old)) return;
    for (int k = 0; k < n; k++) for (int i = 0; i < ORL_CODE; i++) mean[i] += s->codes[s->order[k]][i] / n;
    memset(cov, 0, sizeof cov);
    for (int k = 0; k < n; k++)
        for (int i = 0; i < ORL_CODE; i++)
            for (int j = 0; j < ORL_CODE; j++) cov[i][j] += (s->codes[s->order[k]][i] - mean[i]) * (s->codes[s->order[k]][j] - mean[j]) / n;
    /* Weight of the decoder's prior as if it were 12 photos; correlations are trusted half. */
    double a = n / (n + 12.0);
    for (int i = 0; i < ORL_CODE; i++)
        for (int j = 0; j < ORL_CODE; j++) {
            double emp = i == j ? cov[i][j] : 0.5 * cov[i][j];
            double lo = i == j ? 1e-4 : 0;
            cov[i][j] = a * emp + (1 - a) * old[i][j] + lo;
        }
    for (int i = 0; i < ORL_CODE; i++) s->light.prior_mean[i] = (float)(a * mean[i] + (1 - a) * s->light.prior_mean[i]);
    for (int j = 0; j < ORL_CODE; j++) if (j != ORL_C_SUN_AZ) cov[ORL_C_SUN_AZ][j] = cov[j][ORL_C_SUN_AZ] = 0;    /* azimuth: any */
    cov[ORL_C_SUN_AZ][ORL_C_SUN_AZ] = 1;
    s->light.prior_mean[ORL_C_SUN_AZ] = 0;
    if (!invert(cov)) return;
    for (int i = 0; i < ORL_CODE; i++)
        for (int j = 0; j < ORL_CODE; j++) s->light.prior_prec[i][j] = (float)(0.5 * (cov[i][j] + cov[j][i]));
    s->light.prior_prec[ORL_C_SUN_AZ][ORL_C_SUN_AZ] = 1e-4f;
    leave_out(s);
}

/* The traced suns of the pixels, which are many rounds' work. */
static int save_suns(const stage2 *s, FILE *f)
{
    uint32_t n = s->begin[s->w->nphotos];
    int bad = fwrite(&n, sizeof n, 1, f) != 1;
    for (uint32_t i = 0; i < n; i++) bad |= putc((uint8_t)s->px[i].fix, f) == EOF;
    return !bad;
}

/* Passed over where there are no pixels. */
static int load_suns(stage2 *s, FILE *f)
{
    uint32_t n;
    if (fread(&n, sizeof n, 1, f) != 1) return 0;
    if (!s->px) return !fseek(f, (long)n, SEEK_CUR);
    int c = n == s->begin[s->w->nphotos] ? 0 : EOF;
    for (uint32_t i = 0; c != EOF && i < n; i++) if ((c = getc(f)) != EOF) s->px[i].fix = (int8_t)c;
    return c != EOF;
}

orl_err stage2_save(const stage2 *s, FILE *f, int moments)
{
    int n = s->codes ? s->w->nphotos : 0;
    int bad = fwrite(&s->light, sizeof s->light, 1, f) != 1 || fwrite(&s->round, sizeof s->round, 1, f) != 1 || fwrite(&n, sizeof n, 1, f) != 1 || fwrite(s->common, sizeof s->common, 1, f) != 1;
    bad |= n && fwrite(s->codes, sizeof *s->codes, (size_t)n, f) != (size_t)n;
    if (moments) bad |= fwrite(s->adam, sizeof *s->adam, 2 * SHARED, f) != 2 * SHARED || !save_suns(s, f);
    orl_err e = bad ? orl_fail(ORL_E_IO, "checkpoint: write failed") : ORL_OK;
    for (int l = 0; !e && l < ALBEDO_LEVELS; l++) e = grid_save(&s->albedo[l], f, moments);
    for (int l = 0; !e && l < GROUND_LEVELS; l++) e = grid_save(&s->ground[l], f, moments);
    for (int l = 0; !e && l < BACKDROP_LEVELS; l++) e = grid_save(&s->backdrop[l], f, moments);
    if (!e) e = grid_save(&s->shadow, f, moments);
    return e ? e : skin_save(&s->skin, s->surf->nbricks, f);
}

orl_err stage2_load(stage2 *s, FILE *f, int moments, const char *path)
{
    int n, expect = s->codes ? s->w->nphotos : -1;
    if (fread(&s->light, sizeof s->light, 1, f) != 1 || fread(&s->round, sizeof s->round, 1, f) != 1 || fread(&n, sizeof n, 1, f) != 1 || fread(s->common, sizeof s->common, 1, f) != 1)
        return orl_fail(ORL_E_FORMAT, "%s: stage 2 header is cut short", path);
    if (n < 0 || n > 1000000 || (expect >= 0 && n != expect)) return orl_fail(ORL_E_RANGE, "%s: %d codes for %d photos", path, n, expect);
    if (!s->codes) s->codes = malloc(((size_t)n + 1) * sizeof *s->codes);
    if (!s->codes || fread(s->codes, sizeof *s->codes, (size_t)n, f) != (size_t)n) return orl_fail(ORL_E_FORMAT, "%s: codes are cut short", path);
    if (moments && fread(s->adam, sizeof *s->adam, 2 * SHARED, f) != 2 * SHARED) return orl_fail(ORL_E_FORMAT, "%s: stage 2 moments are cut short", path);
    if (moments && !load_suns(s, f)) return orl_fail(ORL_E_FORMAT, "%s: the pixels' suns are not those of these photos", path);
    orl_err e = ORL_OK;
    for (int l = 0; !e && l < ALBEDO_LEVELS; l++) e = grid_load(&s->albedo[l], f, moments, path);
    for (int l = 0; !e && l < GROUND_LEVELS; l++) e = grid_load(&s->ground[l], f, moments, path);
    for (int l = 0; !e && l < BACKDROP_LEVELS; l++) e = grid_load(&s->backdrop[l], f, moments, path);
    if (!e) e = grid_load(&s->shadow, f, moments, path);
    return e ? e : skin_load(&s->skin, s->surf->nbricks, f, path);
}
