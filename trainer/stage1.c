/* Stage 1: SDF, appearance and transients from photos (losses: Zhao, Yang et al., MM 2022, section 3.2; NeuS alpha; NeRF-W's photometric loss).
 *
 * A ray is marched by the distance itself: far steps in free space, then samples only in the band where the logistic CDF S(f / sigma) leaves 1. With samples k along the ray
 *   alpha_k = max(1 - S(f_k) / S(f_{k-1}), 0),  T_k = prod_{j<k} (1 - alpha_j),  w_k = T_k alpha_k,  W = sum w_k,
 * free space before the first sample counting as S = 1. Colour is linear in the features, so they are composited first and turned into colour once per ray:
 *   C = gain * (H_base + sum_j l_j H_j) + bias * W + background * (1 - W).
 * Transients live in the photo, not in space (one alpha, colour and beta every few pixels, in front of everything): cheaper than NeRF-W's transient volume and as able to explain passers-by.
 * f is linear in the grids' values and so is its gradient: the Eikonal and smoothness losses need no second derivatives. */
#include "trainer/stage1.h"
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "oriel/parallel.h"
#include "trainer/complete.h"
#include "trainer/fuse.h"
#include "trainer/ranks.h"

enum { MAX_SAMPLES = 64, MAX_MARCH = 128 };
static const int SDF_CELL[SDF_LEVELS] = { 1, 2, 4, 16 }, FEAT_CELL[FEAT_LEVELS] = { 2, 8 };
#define BETA_MIN 0.06f

/* Weights of the loss terms; the photometric one is scaled so that it is the plain squared error where no transient is. */
#define PHOTO_SHAPES 0.2f        /* share of the photometric and sky gradients that moves the surface: light differs from photo to photo, and its noise is not shape */
#define SKY_SHAPES 1.0f          /* the same for rays that end in the sky: no light excuses a surface there */
#define LAMBDA_SKY 0.1f
#define LAMBDA_EIKONAL 0.01f
#define LAMBDA_SMOOTH 0.03f
#define LAMBDA_SQUARE 0.3f
#define LAMBDA_POINT 0.02f
#define LAMBDA_STEREO 0.02f
#define LAMBDA_NORMAL 0.02f
#define LAMBDA_FREE 0.05f
#define LAMBDA_HULL 0.004f
#define LAMBDA_MATCH 2.0f
#define MATCH_MOST 0.5f          /* slope of a match, a cell: what is steeper is chance */
#define LAMBDA_TRANSIENT 0.012f

/* Vertices of a level take the lattice's values, less what the coarser level (NULL: none) says there. */
static void start_level(grid *g, const int dims[3], const float *lattice, int cell, const grid *coarser)
{
    int n[3], step = (int)g->cell / cell;
    for (int a = 0; a < 3; a++) n[a] = dims[a] / cell + 1;
    for (int z = 0; z * step < n[2]; z++)
        for (int y = 0; y * step < n[1]; y++)
            for (int x = 0; x * step < n[0]; x++) {
                int at[3] = { x * step, y * step, z * step };
                size_t i = grid_at(g, x, y, z);
                float v = lattice[((size_t)at[2] * (size_t)n[1] + (size_t)at[1]) * (size_t)n[0] + (size_t)at[0]];
                if (coarser) {
                    float q[3] = { (float)(at[0] * cell), (float)(at[1] * cell), (float)(at[2] * cell) };
                    grid_cell c;
                    grid_find(coarser, q, &c);
                    v -= grid_value(coarser, &c, NULL);
                    if (v == 0) continue;
                }
                g->p[i] = v;
                grid_mark(g, i);
            }
}

typedef struct { stage1 *s; fuse f; } fuse_job;

#define FUSE_BAND 4.0f           /* fine cells from the hull's surface */

/* Layers of tiles, so that each is marked by one thread. */
static void fuse_layers(void *user, int begin, int end)
{
    fuse_job *j = user;
    const grid *hull = &j->s->hull;
    grid *g = &j->s->fused;
    const int *dims = j->s->w->frame.dims;
    for (int z = 4 * begin; z < 4 * end && z <= dims[2]; z++)
        for (int y = 0; y <= dims[1]; y++)
            for (int x = 0; x <= dims[0]; x++) {
                float q[3] = { (float)x, (float)y, (float)z }, side[3] = { 0 }, sure;
                grid_cell c;
                grid_find(hull, q, &c);
                float at = grid_value(hull, &c, NULL);
                if (fabsf(at) > FUSE_BAND) continue;
                grid_value(hull, &c, side);
                float f = fuse_distance(&j->f, q, side, &sure);
                if (!(sure > 0)) continue;
                size_t i = grid_at(g, x, y, z);
                g->p[i] = sure * (f - at);
                grid_mark(g, i);
            }
}

/* The finest level: where stereo points lie, their moving least squares instead of the hull. */
static orl_err start_fused(stage1 *s)
{
    fuse_job j = { .s = s };
    orl_err e = grid_init(&s->fused, s->w->frame.dims, 1, 1, 0);
    if (e || !s->st || !s->st->npoints) return e;
    if ((e = fuse_init(&j.f, s->st, &s->hull, s->w->frame.dims))) return e;
    orl_parallel(s->opt.threads, s->w->frame.dims[2] / 4 + 1, 1, fuse_layers, &j);
    fuse_free(&j.f);
    for (size_t t = 0; t < s->fused.ntiles; t++) {
        if (!s->fused.live[t]) continue;
        memcpy(s->sdf[0].p + t * GRID_TILE, s->fused.p + t * GRID_TILE, GRID_TILE * sizeof(float));
        s->sdf[0].live[t] = 1;
    }
    return ORL_OK;
}

/* The first SDF, fine cells. */
static float first_value(const stage1 *s, const float x[3])
{
    grid_cell c;
    grid_find(&s->hull, x, &c);
    float f = grid_value(&s->hull, &c, NULL);
    grid_find(&s->fused, x, &c);
    return f + grid_value(&s->fused, &c, NULL);
}

orl_err stage1_init(stage1 *s, const world *w, const stage1_options *opt)
{
    memset(s, 0, sizeof *s);
    s->w = w;
    s->opt = *opt;
    s->heuristics = 1;
    orl_err e = ORL_OK;
    for (int l = 0; !e && l < SDF_LEVELS; l++) e = grid_init(&s->sdf[l], w->frame.dims, SDF_CELL[l], 1, opt->threads);
    for (int l = 0; !e && l < FEAT_LEVELS; l++) e = grid_init(&s->feat[l], w->frame.dims, FEAT_CELL[l], FEAT, opt->threads);
    int tw = 0, th = 0;
    for (int k = 0; k < w->nphotos; k++) {
        tw = w->photos[k].w > tw ? w->photos[k].w : tw;
        th = w->photos[k].h > th ? w->photos[k].h : th;
    }
    if (!e) e = grid_init(&s->codes, (int[3]){ w->nphotos, 1, 1 }, 1, FEAT, opt->threads);
    const float longest = (float)(tw > th ? tw : th);
    s->transient_px = fmaxf(TRANSIENT_PX, longest / TRANSIENT_CELLS);
    while (s->transient_px < longest && ((double)tw / s->transient_px + 1) * ((double)th / s->transient_px + 1) * w->nphotos > TRANSIENT_ALL) s->transient_px *= 1.1f;
    if (!e) e = grid_init(&s->transient, (int[3]){ (int)((float)tw / s->transient_px) + 1, (int)((float)th / s->transient_px) + 1, w->nphotos }, 1, 8, opt->threads);
    if (e) stage1_free(s);
    return e;
}

orl_err stage1_start(stage1 *s, world *w, stereo *st)
{
    const int cell = SDF_CELL[1];
    float *hull = NULL;
    s->st = st;
    if (st) s->square = st->facings;
    orl_err e = grid_init(&s->hull, w->frame.dims, cell, 1, 0);
    if (!e) e = hull_unsky(w, st, s->opt.threads);
    if (!e) e = hull_build(w, st, cell, s->opt.threads, &hull);
    if (!e && st && st->npoints) {
        start_level(&s->hull, w->frame.dims, hull, cell, NULL);
        free(hull);
        e = complete_planes(w, st, &s->hull, s->opt.threads);
        if (!e) e = hull_build(w, st, cell, s->opt.threads, &hull);
    }
    if (e) return e;
    hull_relabel(w, hull, cell, s->opt.threads);
    start_level(&s->hull, w->frame.dims, hull, cell, NULL);
    start_level(&s->sdf[2], w->frame.dims, hull, cell, NULL);
    start_level(&s->sdf[1], w->frame.dims, hull, cell, &s->sdf[2]);
    free(hull);
    if ((e = start_fused(s))) return e;
    for (int k = 0; k < w->nphotos; k++) {
        const world_photo *p = &w->photos[k];
        size_t i = grid_at(&s->codes, k, 0, 0);
        float *c = s->codes.p + i * FEAT;
        rng r = rng_make(s->opt.seed, 0xc0de, (uint64_t)k);
        for (int j = 0; j < APPEARANCE; j++) c[j] = 0.3f * rng_normal(&r);
        double mean[3] = { 0 }, count = 1e-9;
        for (int q = 0; q < p->w * p->h; q += 7) {
            uint8_t rgb[3];
            if (world_label(p, q % p->w, q / p->w) == WORLD_SKY) continue;
            world_rgb(p, q % p->w, q / p->w, rgb);
            for (int a = 0; a < 3; a++) mean[a] += rgb[a] / 255.0;
            count++;
        }
        for (int a = 0; a < 3; a++) {
            c[4 + a] = 1.0f;
            c[7 + a] = c[10 + a] = (float)(mean[a] / count);
        }
        grid_mark(&s->codes, i);
    }
    return ORL_OK;
}

void stage1_freeze(stage1 *s)
{
    for (int l = 0; l < SDF_LEVELS; l++) grid_freeze(&s->sdf[l]);
    for (int l = 0; l < FEAT_LEVELS; l++) grid_freeze(&s->feat[l]);
    grid_freeze(&s->codes);
    grid_freeze(&s->transient);
    grid_free(&s->hull);
    grid_free(&s->fused);
    s->st = NULL;
    s->watch = NULL;
}

void stage1_free(stage1 *s)
{
    for (int l = 0; l < SDF_LEVELS; l++) grid_free(&s->sdf[l]);
    for (int l = 0; l < FEAT_LEVELS; l++) grid_free(&s->feat[l]);
    grid_free(&s->hull);
    grid_free(&s->fused);
    grid_free(&s->codes);
    grid_free(&s->transient);
}

/* Coarse to fine: the finest level in use, and the width of the logistic in fine cells. */
typedef struct { int finest; float sigma, band, delta, lr; int transient; } schedule;

static schedule schedule_at(const stage1 *s)
{
    float t = (float)s->step / (float)(s->opt.steps > 0 ? s->opt.steps : 1);
    schedule c;
    c.finest = t < 0.2f && !(s->st && s->st->npoints) ? 1 : 0;
    float u = t < 0.9f ? t / 0.9f : 1.0f;
    int longest = 0;
    for (int a = 0; a < 3; a++) longest = s->w->frame.dims[a] > longest ? s->w->frame.dims[a] : longest;
    float wide = 1.2f * fmaxf(1.0f, (float)longest / 256);     /* what the first SDF may be off by, whatever the cell */
    c.sigma = wide * expf(logf(0.4f / wide) * u);
    if (s->opt.sigma > 0) c.sigma = s->opt.sigma;
    c.band = 5.0f * c.sigma;
    c.delta = fmaxf(0.9f * c.sigma, 0.5f);
    c.lr = expf(logf(0.08f) * t);
    c.transient = t > 0.05f;
    return c;
}

typedef struct { grid_cell c[SDF_LEVELS]; float f, grad[3]; } sdf_point;

static void sdf_eval(const stage1 *s, int finest, const float x[3], sdf_point *o)
{
    o->f = 0;
    o->grad[0] = o->grad[1] = o->grad[2] = 0;
    for (int l = finest; l < SDF_LEVELS; l++) {
        grid_find(&s->sdf[l], x, &o->c[l]);
        o->f += grid_value(&s->sdf[l], &o->c[l], o->grad);
    }
}

static void sdf_back(stage1 *s, int thread, int finest, const sdf_point *o, float df, const float *dgrad)
{
    for (int l = finest; l < SDF_LEVELS; l++) grid_value_back(&s->sdf[l], thread, &o->c[l], df, dgrad);
}

static float far_value(const stage1 *s, const float x[3])
{
    grid_cell c;
    float f = 0;
    for (int l = 2; l < SDF_LEVELS; l++) {
        grid_find(&s->sdf[l], x, &c);
        f += grid_value(&s->sdf[l], &c, NULL);
    }
    return f;
}

typedef struct {
    sdf_point p;
    float log_s, s_val, alpha, trans, weight;   /* alpha between the previous sample and this one */
    int chained;                                /* previous sample is this one's neighbour (else free space) */
    grid_cell fc[FEAT_LEVELS];
    v8 h[2];
    float x[3];
} ray_sample;

typedef struct {
    stage1 *s;
    schedule c;
    ray_sample *ray[GRID_THREADS];
    stage1_losses loss[GRID_THREADS];
} step_job;

/* Marches one ray; returns the number of samples. */
static int ray_march(const stage1 *s, const schedule *c, const float o[3], const float d[3], rng *r, ray_sample *out)
{
    float t0, t1, trans = 1, prev_log = 0;
    int n = 0, chained = 0;
    if (!box_clip(s->w->frame.dims, o, d, &t0, &t1)) return 0;
    float t = t0 + c->delta * rng_f(r);
    if (t0 <= 0) t += 1.0f;
    for (int k = 0; k < MAX_MARCH && t < t1 && n < MAX_SAMPLES; k++) {
        float x[3] = { o[0] + t * d[0], o[1] + t * d[1], o[2] + t * d[2] };
        if (!chained) {
            float far = far_value(s, x) - c->band - 3.0f;
            if (far > 0) { t += fminf(0.8f * far, 48.0f) + c->delta; continue; }
        }
        ray_sample *q = &out[n];
        sdf_eval(s, c->finest, x, &q->p);
        if (q->p.f > c->band) {
            t += fmaxf(c->delta, 0.8f * (q->p.f - c->band));
            chained = 0;
            prev_log = 0;
            continue;
        }
        float e = q->p.f / c->sigma;
        /* ln S = -ln(1 + exp(-e)) */
        q->log_s = e > 0 ? -log1pf(expf(-e)) : e - log1pf(expf(e));
        q->s_val = expf(q->log_s);
        float ratio = expf(q->log_s - prev_log);
        q->alpha = ratio < 1 ? 1 - ratio : 0;
        q->trans = trans;
        q->weight = trans * q->alpha;
        q->chained = chained;
        trans *= 1 - q->alpha;
        memcpy(q->x, x, sizeof x);
        prev_log = q->log_s;
        chained = 1;
        n++;
        if (trans < 2e-3f && s->heuristics) break;
        t += c->delta;
    }
    return n;
}

static float huber_slope(float x, float k) { return x > k ? k : x < -k ? -k : x; }
static float huber(float x, float k) { float a = fabsf(x); return a > k ? k * (a - 0.5f * k) : 0.5f * x * x; }

/* What the hull found free stays free: f >= a share of the hull's distance at a random point of the ray. Without it, passers-by and noise of light heap up before surfaces that show little texture. */
static void train_free(step_job *job, int thread, rng *r, const float o[3], const float d[3])
{
    stage1 *s = job->s;
    float t0, t1, x[3];
    if (!box_clip(s->w->frame.dims, o, d, &t0, &t1)) return;
    float t = t0 + (t1 - t0) * rng_f(r);
    for (int a = 0; a < 3; a++) x[a] = o[a] + t * d[a];
    float want = 0.7f * (first_value(s, x) - 1.0f);
    if (want < 0.5f) return;
    sdf_point e;
    sdf_eval(s, job->c.finest, x, &e);
    if (e.f >= want) return;
    job->loss[thread].total += LAMBDA_FREE * huber(e.f - want, 2.0f);
    sdf_back(s, thread, job->c.finest, &e, LAMBDA_FREE * huber_slope(e.f - want, 2.0f), NULL);
}

/* Where the ray meets the surface, the photo's patch shall match what others show: moves the crossing to where it does so best. */
static void train_match(step_job *job, int thread, rng *r, int photo, const float d[3], const ray_sample *ray, int n)
{
    stage1 *s = job->s;
    int k = 1;
    while (k < n && !(ray[k].chained && ray[k].p.f <= 0 && ray[k - 1].p.f > 0)) k++;
    if (k >= n) return;
    float share = ray[k - 1].p.f / (ray[k - 1].p.f - ray[k].p.f), x[3], normal[3], len = 0, facing = 0;
    for (int a = 0; a < 3; a++) x[a] = ray[k - 1].x[a] + share * (ray[k].x[a] - ray[k - 1].x[a]);
    sdf_point e;
    sdf_eval(s, job->c.finest, x, &e);
    for (int a = 0; a < 3; a++) len += e.grad[a] * e.grad[a];
    len = sqrtf(len) + 1e-6f;
    for (int a = 0; a < 3; a++) {
        normal[a] = e.grad[a] / len;
        facing -= normal[a] * d[a];
    }
    if (facing < 0.15f) return;
    float slope = stereo_slope(s->watch, photo, x, normal, r);
    slope = fminf(fmaxf(slope, -MATCH_MOST), MATCH_MOST);
    if (slope != 0) sdf_back(s, thread, job->c.finest, &e, LAMBDA_MATCH * slope / (fmaxf(facing, 0.3f) * len), NULL);   /* d cell / d f along the ray: 1 / -(grad . d) */
}

static void train_ray(step_job *job, int thread, rng *r)
{
    stage1 *s = job->s;
    const schedule *c = &job->c;
    stage1_losses *L = &job->loss[thread];
    const world *w = s->w;
    int photo = (int)rng_below(r, (uint32_t)w->nphotos);
    const world_photo *p = &w->photos[photo];
    int px = (int)rng_below(r, (uint32_t)p->w), py = (int)rng_below(r, (uint32_t)p->h);
    int label = world_label(p, px, py);
    if (label == WORLD_SKY && (rng_u32(r) & 1)) {      /* sky teaches little per ray: half of it is enough */
        px = (int)rng_below(r, (uint32_t)p->w); py = (int)rng_below(r, (uint32_t)p->h);
        label = world_label(p, px, py);
    }
    int sky = label == WORLD_SKY, scene = label == WORLD_SCENE;
    float o[3] = { (float)p->centre[0], (float)p->centre[1], (float)p->centre[2] }, d[3];
    world_ray(p, px + 0.5, py + 0.5, d);
    ray_sample *ray = job->ray[thread];
    int n = ray_march(s, c, o, d, r, ray);
    L->samples += n;
    train_free(job, thread, r, o, d);
    float W = 0, least = s->heuristics ? 1e-3f : 0;     /* weight that is worth a colour */
    v8 H[2] = { { 0 } };
    for (int k = 0; k < n; k++) {
        ray_sample *q = &ray[k];
        W += q->weight;
        q->h[0] = q->h[1] = (v8){ 0 };
        if (sky || q->weight < least) continue;
        for (int l = 0; l < FEAT_LEVELS; l++) {
            grid_find(&s->feat[l], q->x, &q->fc[l]);
            grid_vector(&s->feat[l], &q->fc[l], 2, q->h);
        }
        H[0] += q->weight * q->h[0];
        H[1] += q->weight * q->h[1];
    }
    float g_w = 0;                              /* d loss / d W */
    v8 dH[2] = { { 0 } };
    size_t ci = grid_at(&s->codes, photo, 0, 0) * FEAT;
    const float *code = s->codes.p + ci, *l = code, *gain = code + 4, *bias = code + 7, *back = code + 10;

    if (sky || scene) {
        float Wc = W < 1e-3f ? 1e-3f : W > 0.999f ? 0.999f : W;
        float bce = sky ? -logf(1 - Wc) : -logf(Wc);
        L->sky += bce;
        L->total += LAMBDA_SKY * bce;
        if (W == Wc) g_w += LAMBDA_SKY * (sky ? 1 / (1 - Wc) : -1 / Wc);
    }
    if (!sky) {
        const float *h = (const float *)H;
        float stat[3], C[3], target[3], lin[3];
        uint8_t rgb[3];
        world_rgb(p, px, py, rgb);
        for (int a = 0; a < 3; a++) {
            lin[a] = h[a];
            for (int j = 0; j < APPEARANCE; j++) lin[a] += l[j] * h[3 + 3 * j + a];
            stat[a] = gain[a] * lin[a] + bias[a] * W + back[a] * (1 - W);
            target[a] = rgb[a] * (1.0f / 255.0f);
        }
        grid_cell tc;
        v8 tv[1] = { { 0 } };
        float at = 0, beta = BETA_MIN, sp = 0;
        if (c->transient) {
            float tx[3] = { (px + 0.5f) / s->transient_px, (py + 0.5f) / s->transient_px, (float)photo };
            grid_find(&s->transient, tx, &tc);
            grid_vector(&s->transient, &tc, 1, tv);
            at = 1 / (1 + expf(3.0f - tv[0][0]));
            sp = tv[0][4] > 15 ? tv[0][4] : log1pf(expf(tv[0][4]));
            beta = BETA_MIN + at * 0.3f * sp;
        }
        float err2 = 0, dC[3], scale = BETA_MIN * BETA_MIN / (beta * beta);
        for (int a = 0; a < 3; a++) {
            C[a] = (1 - at) * stat[a] + at * (0.5f + tv[0][1 + a]);
            float e = C[a] - target[a];
            if ((rgb[a] >= 254 && e > 0) || (rgb[a] <= 1 && e < 0)) e = 0;    /* clipped: what lies beyond is as good */
            err2 += e * e;
            dC[a] = 2 * e * scale;
        }
        L->mse += err2 / 3;
        L->photo += err2 * scale;
        L->total += err2 * scale;
        L->transient += at;
        if (c->transient) {
            /* photometric * 2 beta_min^2: |C - C*|^2 scale + beta_min^2 * 2 ln(beta) + lambda * density */
            float dbeta = -2 * err2 * scale / beta + 2 * BETA_MIN * BETA_MIN / beta;
            float dat = dbeta * 0.3f * sp + LAMBDA_TRANSIENT / (1.001f - at);
            L->total += BETA_MIN * BETA_MIN * 2 * logf(beta) - LAMBDA_TRANSIENT * logf(1.001f - at);
            v8 dt[1] = { { 0 } };
            for (int a = 0; a < 3; a++) {
                dat += dC[a] * (0.5f + tv[0][1 + a] - stat[a]);
                dt[0][1 + a] = dC[a] * at;
            }
            dt[0][0] = dat * at * (1 - at);
            dt[0][4] = dbeta * at * 0.3f * (1 - expf(-sp));
            grid_vector_back(&s->transient, thread, &tc, 1, dt);
        }
        float *gc = s->codes.g[thread] + ci, *dh = (float *)dH;
        s->codes.dirty[thread][ci / FEAT / GRID_TILE] = 1;
        for (int a = 0; a < 3; a++) {
            float ds = dC[a] * (1 - at);
            dh[a] = ds * gain[a];
            for (int j = 0; j < APPEARANCE; j++) {
                dh[3 + 3 * j + a] = ds * gain[a] * l[j];
                gc[j] += ds * gain[a] * h[3 + 3 * j + a];
            }
            gc[4 + a] += ds * lin[a] + 1e-3f * (gain[a] - 1);
            L->total += 0.5e-3 * (gain[a] - 1) * (gain[a] - 1);
            gc[7 + a] += ds * W;
            gc[10 + a] += ds * (1 - W);
            g_w += ds * (bias[a] - back[a]);
        }
        for (int j = 0; j < APPEARANCE; j++) { gc[j] += 1e-4f * l[j]; L->total += 0.5e-4 * l[j] * l[j]; }
    }

    if (s->watch && s->heuristics && scene && W > 0.5f) train_match(job, thread, r, photo, d, ray, n);

    /* Reverse through the composition. */
    float inv_s = 1 / c->sigma, later = 0, carry = 0;   /* later = sum_{j>k} g_j w_j; carry = d loss / d f_k from the sample behind it */
    for (int k = n - 1; k >= 0; k--) {
        ray_sample *q = &ray[k];
        float g = g_w, dist = 0;
        for (int a = 0; a < 3; a++) dist += (q->x[a] - o[a]) * d[a];
        /* Near a camera few others look on and floaters grow: gradients fade there (Philip & Deschaintre 2023). */
        float near = dist < p->near ? dist * dist / (p->near * p->near) : 1;
        float shapes = (sky ? SKY_SHAPES : PHOTO_SHAPES) * near;
        if (!s->heuristics) near = shapes = 1;
        if (!sky && q->weight >= least) {
            v8 m = dH[0] * q->h[0] + dH[1] * q->h[1];
            for (int a = 0; a < 8; a++) g += m[a];
            v8 dh[2] = { near * q->weight * dH[0], near * q->weight * dH[1] };
            for (int lv = 0; lv < FEAT_LEVELS; lv++) grid_vector_back(&s->feat[lv], thread, &q->fc[lv], 2, dh);
        }
        float ratio = 1 - q->alpha;
        float da = g * q->trans - later / fmaxf(ratio, 1e-3f);
        later += g * q->weight;
        float df = carry;
        carry = 0;
        if (q->alpha > 0) {
            df -= shapes * da * ratio * (1 - q->s_val) * inv_s;
            if (q->chained) carry = shapes * da * ratio * (1 - ray[k - 1].s_val) * inv_s;
        }
        float off = q->p.f - first_value(s, q->x);
        L->total += LAMBDA_HULL * huber(off, 2.0f);
        df += LAMBDA_HULL * huber_slope(off, 2.0f);
        float norm = sqrtf(q->p.grad[0] * q->p.grad[0] + q->p.grad[1] * q->p.grad[1] + q->p.grad[2] * q->p.grad[2]) + 1e-6f;
        float ek = LAMBDA_EIKONAL * 2 * (norm - 1) / norm;
        L->eikonal += (norm - 1) * (norm - 1);
        L->total += LAMBDA_EIKONAL * (norm - 1) * (norm - 1);
        float dg[3] = { ek * q->p.grad[0], ek * q->p.grad[1], ek * q->p.grad[2] };
        if (s->heuristics && q->weight > 0.15f) {                /* normals vary slowly: compare with a point about a cell aside */
            float step = c->finest == 0 ? 1.5f : c->finest == 1 ? 2.5f : 5.0f;
            float y[3];
            for (int a = 0; a < 3; a++) y[a] = q->x[a] + step * (2 * rng_f(r) - 1);
            sdf_point b;
            sdf_eval(s, c->finest, y, &b);
            float db[3], ks = LAMBDA_SMOOTH * q->weight;
            for (int a = 0; a < 3; a++) {
                float diff = q->p.grad[a] - b.grad[a];
                dg[a] += 2 * ks * diff;
                db[a] = -2 * ks * diff;
                L->total += ks * diff * diff;
            }
            float to[3], n[3] = { q->p.grad[0] / norm, q->p.grad[1] / norm, q->p.grad[2] / norm }, square = LAMBDA_SQUARE * q->weight * orl_facing_near(&s->square, n, to);
            for (int a = 0; square > 0 && a < 3; a++) dg[a] += 2 * square * (q->p.grad[a] - to[a]);     /* walls are mostly square to each other */
            sdf_back(s, thread, c->finest, &b, 0, db);
        }
        sdf_back(s, thread, c->finest, &q->p, df, dg);
    }
}

/* A measured point: it lies on the surface, whose normal there is n (NULL: unknown), and the way to the camera is free. Returns |f|. */
static float train_surface(step_job *job, int thread, rng *r, const float point[3], const float *n, const double centre[3], float lambda, float lambda_normal)
{
    stage1 *s = job->s;
    const schedule *c = &job->c;
    const int *dims = s->w->frame.dims;
    for (int a = 0; a < 3; a++) if (!(point[a] >= 0) || point[a] > (float)dims[a]) return 0;
    sdf_point e;
    sdf_eval(s, c->finest, point, &e);
    float off = fabsf(e.f), dg[3], d[3], dist = 0, x[3];
    job->loss[thread].total += lambda * huber(e.f, 2.0f);
    for (int a = 0; n && a < 3; a++) {
        dg[a] = 2 * lambda_normal * (e.grad[a] - n[a]);
        job->loss[thread].total += lambda_normal * (e.grad[a] - n[a]) * (e.grad[a] - n[a]);
    }
    sdf_back(s, thread, c->finest, &e, lambda * huber_slope(e.f, 2.0f), n ? dg : NULL);

    for (int a = 0; a < 3; a++) { d[a] = (float)centre[a] - point[a]; dist += d[a] * d[a]; }
    dist = sqrtf(dist);
    float u = rng_f(r), t = 3.0f + (dist - 3.0f) * u * u;
    if (dist < 6) return off;
    for (int a = 0; a < 3; a++) x[a] = point[a] + d[a] / dist * t;
    for (int a = 0; a < 3; a++) if (x[a] < 0 || x[a] > (float)dims[a]) return off;
    float want = fminf(0.3f * t, 2.0f * c->sigma);
    sdf_eval(s, c->finest, x, &e);
    if (e.f >= want) return off;
    job->loss[thread].total += lambda * huber(e.f - want, 2.0f);
    sdf_back(s, thread, c->finest, &e, lambda * huber_slope(e.f - want, 2.0f), NULL);
    return off;
}

static void train_point(step_job *job, int thread, rng *r)
{
    const world *w = job->s->w;
    if (!w->nobs) return;
    const world_photo *p;
    do p = &w->photos[rng_below(r, (uint32_t)w->nphotos)]; while (!p->obs_count);
    const world_point *q = &w->points[w->obs[p->obs_begin + rng_below(r, p->obs_count)].point];
    job->loss[thread].points += train_surface(job, thread, r, q->x, NULL, p->centre, LAMBDA_POINT * q->weight, 0);
}

static void train_stereo(step_job *job, int thread, rng *r)
{
    const stereo *st = job->s->st;
    if (!st || !st->npoints) return;
    const stereo_point *q = &st->points[rng_below(r, st->npoints)];
    train_surface(job, thread, r, q->x, q->n, job->s->w->photos[q->photo].centre, LAMBDA_STEREO * q->weight, LAMBDA_NORMAL * q->weight);
}

static void step_range(void *user, int begin, int end)
{
    step_job *job = user;
    stage1 *s = job->s;
    for (int t = begin; t < end; t++) {
        int all = s->opt.threads * ranks_count(), me = s->opt.threads * ranks_mine() + t;      /* threads of all ranks */
        rng r = rng_make(s->opt.seed, (uint64_t)s->step, (uint64_t)me);
        int rays = (int)((int64_t)s->opt.rays * (me + 1) / all - (int64_t)s->opt.rays * me / all);
        for (int i = 0; i < rays; i++) {
            train_ray(job, t, &r);
            if ((i & 3) == 0) train_point(job, t, &r);
            train_stereo(job, t, &r);
        }
    }
}

void stage1_gradients(stage1 *s, stage1_losses *out)
{
    step_job job = { .s = s, .c = schedule_at(s) };
    int T = s->opt.threads, all = T * ranks_count();
    static stage1_losses loss[RANKS_MOST * GRID_THREADS];
    static ray_sample *scratch[GRID_THREADS];
    for (int t = 0; t < T; t++) {
        if (!scratch[t]) scratch[t] = aligned_alloc(64, (MAX_SAMPLES * sizeof(ray_sample) + 63) & ~(size_t)63);
        job.ray[t] = scratch[t];
    }
    orl_parallel(T, T, 1, step_range, &job);
    memset(out, 0, sizeof *out);
    memset(loss, 0, (size_t)all * sizeof *loss);
    memcpy(loss + T * ranks_mine(), job.loss, (size_t)T * sizeof *loss);
    ranks_merge(loss, (size_t)all * sizeof *loss);
    for (int t = 0; t < all; t++) {
        const double *a = (const double *)&loss[t];
        double *b = (double *)out;
        for (size_t i = 0; i < sizeof *out / sizeof(double); i++) b[i] += a[i];
    }
    double inv = 1.0 / s->opt.rays;
    out->photo *= inv; out->sky *= inv; out->mse *= inv; out->transient *= inv; out->points *= 4 * inv;
    out->eikonal /= out->samples > 0 ? out->samples : 1;
}

int stage1_step(stage1 *s, stage1_losses *out)
{
    schedule c = schedule_at(s);
    int T = s->opt.threads, n = 0, sound;
    grid *all[SDF_LEVELS + FEAT_LEVELS + 2];
    for (int l = 0; l < SDF_LEVELS; l++) all[n++] = &s->sdf[l];
    for (int l = 0; l < FEAT_LEVELS; l++) all[n++] = &s->feat[l];
    all[n++] = &s->codes;
    all[n++] = &s->transient;
    stage1_gradients(s, out);
    s->step++;
    sound = isfinite(out->total);
    for (int i = 0; i < n; i++) sound &= grid_sum(all[i], T);
    if (!sound) {
        for (int i = 0; i < n; i++) grid_drop(all[i]);
        return 0;
    }
    static const float LR[SDF_LEVELS] = { 0.03f, 0.04f, 0.06f, 0.08f };
    for (int l = c.finest; l < SDF_LEVELS; l++) grid_adam(&s->sdf[l], LR[l] * c.lr, T);
    for (int l = 0; l < FEAT_LEVELS; l++) grid_adam(&s->feat[l], 0.012f * (0.2f + 0.8f * c.lr), T);
    grid_adam(&s->codes, 0.004f * c.lr, T);
    grid_adam(&s->transient, 0.03f, T);
    if (s->step % 4 == 0) grid_trim(&s->transient);     /* steps reach other pixels each time, and in the end all of them */
    return 1;
}

float stage1_sdf(const stage1 *s, const float x[3], float grad[3])
{
    sdf_point p;
    sdf_eval(s, 0, x, &p);
    if (grad) memcpy(grad, p.grad, sizeof p.grad);
    return p.f;
}

void stage1_colour(const stage1 *s, int photo, const float x[3], float rgb[3])
{
    v8 H[2] = { { 0 } };
    for (int l = 0; l < FEAT_LEVELS; l++) {
        grid_cell c;
        grid_find(&s->feat[l], x, &c);
        grid_vector(&s->feat[l], &c, 2, H);
    }
    const float *h = (const float *)H, *code = s->codes.p + grid_at(&s->codes, photo, 0, 0) * FEAT;
    for (int a = 0; a < 3; a++) {
        float v = h[a];
        for (int j = 0; j < APPEARANCE; j++) v += code[j] * h[3 + 3 * j + a];
        v = code[4 + a] * v + code[7 + a];
        rgb[a] = v < 0 ? 0 : v > 1 ? 1 : v;
    }
}

float stage1_transient(const stage1 *s, int photo, float u, float v)
{
    grid_cell c;
    v8 tv[1] = { { 0 } };
    float x[3] = { u / s->transient_px, v / s->transient_px, (float)photo };
    grid_find(&s->transient, x, &c);
    grid_vector(&s->transient, &c, 1, tv);
    return 1 / (1 + expf(3.0f - tv[0][0]));
}
