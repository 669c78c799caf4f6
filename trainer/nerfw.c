/* NeRF-W baseline (nerfw.h).
 *
 * A ray is cut into SAMPLES intervals by the inverse distribution of the weights that a coarse density grid predicts, blurred and mixed with a uniform share; a sample lies in each.
 *   features = encoding(x);  (log density, 15 features) = base(features);  c = colour(features, appearance);  (sigma_t, c_t, beta) = transient(features, transient code)
 *   T_k = exp(-sum_{j<k} (sigma_j + sigma_tj) delta_j),  alpha = 1 - exp(-sigma delta)
 *   C = sum_k T_k (alpha_k c_k + alpha_tk c_tk) + T_end sky(direction, appearance),  beta = beta_min + sum_k T_k alpha_tk beta_k
 * Loss, scaled by 2 beta_min^2 as in stage 1: |C - C*|^2 beta_min^2 / beta^2 + 2 beta_min^2 ln beta + transient optical depth + sky label against the static weight + distortion (mip-NeRF 360)
 * + SfM points, which stage 1 has too: a share of the rays go through them, and weight w_k at t_k far from the point's t costs 1 - 1 / (1 + ((t_k - t) / s)^2) (after Deng et al. 2022).
 * Samples behind a static transmittance of 1e-3 are dropped before the heads. */
#include "trainer/nerfw.h"
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "oriel/parallel.h"

enum { SAMPLES = 24, VIEW_SAMPLES = 32, RAYS = 32, POINT_RAYS = 4, ROWS = RAYS * VIEW_SAMPLES, MAX_MARCH = 1024, HEAD = 32, OUT = 16, UPDATE = 2048 };
#define BETA_MIN 0.06f
#define LAMBDA_SKY 0.1f
#define LAMBDA_TRANSIENT 0.012f
#define LAMBDA_DISTORTION 0.01f
#define LAMBDA_POINT 0.05f
#define POINT_SPREAD 3.0f           /* fine cells */
#define LAMBDA_CODE 1e-4f
#define UNIFORM 0.15f               /* share of samples that ignores the density grid */
#define PRIOR 1e-4f                 /* pull of a new photo's code to the training photos', a standard deviation off against the robust squared error */
#define DENSEST 1000.0f
#define END 1e-3f                   /* static transmittance behind which nothing is looked at */

typedef struct {
    int photo, px, py, first, n, head, m;   /* samples: rows [first, first + n) of the desk; heads: rows [head, head + m) */
    float o[3], d[3], to, sure;              /* to: distance of the SfM point that it goes through, and its weight; 0: none */
} ray;

struct nerfw_desk {
    ray ray[RAYS];
    float x[ROWS][3], t[ROWS], delta[ROWS], sigma[ROWS], march[MAX_MARCH + 2];
    float *feature, *base_hidden, *base, *colour_in, *colour_hidden, *colour, *trans_in, *trans_hidden, *trans, *sky_in, *sky_hidden, *sky;
    float *dfeature, *dbase, *dcolour_in, *dcolour, *dtrans_in, *dtrans, *dsky_in, *dsky;
    void *keep, *block;
    struct { uint32_t cell; float sigma; } *seen;   /* of this step's samples, for the density grid */
    int nseen;
    nerfw_losses loss;
};

static void desk_free(nerfw_desk *d)
{
    if (!d) return;
    free(d->block);
    free(d->keep);
    free(d->seen);
    free(d);
}

static nerfw_desk *desk_make(const nerfw *n)
{
    nerfw_desk *d = aligned_alloc(64, (sizeof *d + 63) & ~(size_t)63);
    if (!d) return NULL;
    memset(d, 0, sizeof *d);
    size_t rows = ROWS + MLP_PAD, want[] = { ENC_WIDTH, (size_t)n->base.hidden, OUT, HEAD, (size_t)n->colour.hidden, OUT, HEAD, (size_t)n->transient.hidden, OUT, HEAD, (size_t)n->sky.hidden, OUT,
                                             ENC_WIDTH, OUT, HEAD, OUT, HEAD, OUT, HEAD, OUT }, sum = 0;
    float **at[] = { &d->feature, &d->base_hidden, &d->base, &d->colour_in, &d->colour_hidden, &d->colour, &d->trans_in, &d->trans_hidden, &d->trans, &d->sky_in, &d->sky_hidden, &d->sky,
                     &d->dfeature, &d->dbase, &d->dcolour_in, &d->dcolour, &d->dtrans_in, &d->dtrans, &d->dsky_in, &d->dsky };
    enum { N = sizeof at / sizeof *at };
    for (int i = 0; i < N; i++) sum += want[i];
    float *p = d->block = aligned_alloc(64, rows * sum * sizeof *p);
    d->keep = aligned_alloc(64, (rows * n->enc.keep + 63) & ~(size_t)63);
    d->seen = malloc(((size_t)n->opt.rays / (size_t)(n->opt.threads ? n->opt.threads : 1) + 1) * SAMPLES * sizeof *d->seen);
    if (!p || !d->keep || !d->seen) { desk_free(d); return NULL; }
    memset(p, 0, rows * sum * sizeof *p);
    for (int i = 0; i < N; i++) { *at[i] = p; p += rows * want[i]; }
    return d;
}

static int longest(const frame *f)
{
    int s = 0;
    for (int a = 0; a < 3; a++) s = f->dims[a] > s ? f->dims[a] : s;
    return s;
}

/* All that a file restores. */
static orl_err build(nerfw *n, const frame *f, int nphotos, const nerfw_options *opt, int threads)
{
    n->opt = *opt;
    n->f = *f;
    n->nphotos = nphotos;
    n->heuristics = 1;
    n->cell = (float)longest(f) / NERFW_CELLS;
    size_t cells = 1;
    for (int a = 0; a < 3; a++) {
        n->gn[a] = (int)ceilf((float)f->dims[a] / n->cell);
        cells *= (size_t)n->gn[a];
    }
    orl_err e = enc_init(&n->enc, opt->encoding, f->dims, opt->seed, threads);
    if (!e) e = mlp_init(&n->base, 3, (int[]){ ENC_WIDTH, 64, 64, OUT }, 0.5f, opt->seed + 1, threads);
    if (!e) e = mlp_init(&n->colour, 2, (int[]){ HEAD, 64, OUT }, 0.5f, opt->seed + 2, threads);
    if (!e) e = mlp_init(&n->transient, 2, (int[]){ HEAD, 64, OUT }, 0.5f, opt->seed + 3, threads);
    if (!e) e = mlp_init(&n->sky, 2, (int[]){ HEAD, 64, OUT }, 0.5f, opt->seed + 4, threads);
    if (!e) e = grid_init(&n->codes, (int[3]){ nphotos - 1, 0, 0 }, 1, 2 * NERFW_CODE, threads);
    if (!e && !(n->density = malloc(cells * sizeof(float)))) e = orl_fail(ORL_E_MEMORY, "no memory for a density grid of %zu cells", cells);
    return e;
}

static float start_density(const nerfw *n) { return 0.5f / (float)longest(&n->f); }     /* optical depth of a half along the box */

orl_err nerfw_init(nerfw *n, const world *w, const nerfw_options *opt)
{
    memset(n, 0, sizeof *n);
    nerfw_options o = *opt;
    o.threads = o.threads < 1 ? 1 : o.threads < GRID_THREADS ? o.threads : GRID_THREADS;
    orl_err e = build(n, &w->frame, w->nphotos, &o, o.threads);
    n->w = w;
    for (int t = 0; !e && t < o.threads; t++) if (!(n->desk[t] = desk_make(n))) e = orl_fail(ORL_E_MEMORY, "no memory for a thread's samples");
    if (e) { nerfw_free(n); return e; }
    for (size_t i = 0; i < (size_t)n->gn[0] * (size_t)n->gn[1] * (size_t)n->gn[2]; i++) n->density[i] = start_density(n);
    for (int k = 0; k < n->nphotos; k++) {
        rng r = rng_make(o.seed, 0xc0de, (uint64_t)k);
        float *c = n->codes.p + grid_at(&n->codes, k, 0, 0) * 2 * NERFW_CODE;
        for (int j = 0; j < 2 * NERFW_CODE; j++) c[j] = 0.1f * rng_normal(&r);
    }
    return ORL_OK;
}

void nerfw_free(nerfw *n)
{
    enc_free(&n->enc);
    mlp_free(&n->base); mlp_free(&n->colour); mlp_free(&n->transient); mlp_free(&n->sky);
    grid_free(&n->codes);
    free(n->density);
    for (int t = 0; t < GRID_THREADS; t++) desk_free(n->desk[t]);
    memset(n, 0, sizeof *n);
}

/* ---- elementary functions, eight at a time ---- */

typedef int32_t i8 __attribute__((vector_size(32)));

/* exp, relative error under 2e-7, argument clamped to +-80. NaN gives a finite value. */
static inline v8 exp8(v8 x)
{
    v8 zero = { 0 }, hi = zero + 80, lo = zero - 80;
    i8 below = x < hi, above = x > lo;
    x = (v8)((below & (i8)x) | (~below & (i8)hi));
    x = (v8)((above & (i8)x) | (~above & (i8)lo));
    v8 magic = zero + 12582912.0f, k = (x * 1.44269504f + magic) - magic;
    v8 r = (x - k * 0.693359375f) + k * 2.12194440e-4f;
    v8 p = 1.0f + r * (1.0f + r * (0.5f + r * (1.6666667e-1f + r * (4.1666660e-2f + r * (8.3333810e-3f + r * (1.3888874e-3f + r * 1.98e-4f))))));
    return (v8)((i8)p + (__builtin_convertvector(k, i8) << 23));
}
static inline v8 sigmoid8(v8 x) { return 1.0f / (1.0f + exp8(-x)); }
/* 1 - exp(-depth); most samples are in thin air, where two terms do. */
static inline float opacity(float depth) { return depth > 0.02f ? 1 - expf(-depth) : depth - 0.5f * depth * depth; }

/* ---- rays ---- */

static size_t cell_of(const nerfw *n, const float x[3])
{
    int i[3];
    for (int a = 0; a < 3; a++) {
        float q = x[a] / n->cell;
        i[a] = q > 0 ? q < (float)n->gn[a] ? (int)q : n->gn[a] - 1 : 0;
        if (i[a] >= n->gn[a]) i[a] = n->gn[a] - 1;
    }
    return ((size_t)i[2] * (size_t)n->gn[1] + (size_t)i[1]) * (size_t)n->gn[0] + (size_t)i[0];
}

/* Cuts the ray into `count` intervals, uniform / (1 + uniform) of them without regard to the density grid; rows from r->first on. g NULL: samples at the middles. */
static void ray_sample(const nerfw *n, nerfw_desk *d, ray *r, int count, float uniform, rng *g)
{
    float t0, t1, *w = d->march + 1;
    r->n = 0;
    if (!box_clip(n->f.dims, r->o, r->d, &t0, &t1)) return;
    if (t0 <= 0) t0 = 1;
    if (!(t1 - t0 > 0.5f)) return;
    int K = (int)ceilf((t1 - t0) / n->cell);
    K = K < 1 ? 1 : K > MAX_MARCH ? MAX_MARCH : K;
    float step = (t1 - t0) / (float)K, trans = 1, sum = 0, prev = 0;
    for (int k = 0; k < K; k++) {
        float t = t0 + ((float)k + 0.5f) * step, x[3];
        for (int a = 0; a < 3; a++) x[a] = r->o[a] + t * r->d[a];
        float depth = trans > 1e-3f ? 0.5f * n->density[cell_of(n, x)] * step : 0;  /* half of it: the grid's error must not hide what is behind */
        float a = opacity(depth);
        w[k] = trans * a;
        trans *= 1 - a;
    }
    w[-1] = w[K] = 0;
    for (int k = 0; k < K; k++) {
        float here = w[k];
        w[k] = 0.25f * prev + 0.5f * here + 0.25f * w[k + 1] + uniform / (float)K;
        prev = here;
        sum += w[k];
    }
    float edge = t0, done = 0;
    int k = 0;
    for (int i = 0; i < count; i++) {
        float next = t1;
        if (i + 1 < count) {
            float u = sum * ((float)(i + 1) + (g ? 0.8f * (rng_f(g) - 0.5f) : 0)) / (float)count;
            while (k < K - 1 && done + w[k] < u) done += w[k++];
            next = t0 + step * ((float)k + fminf((u - done) / w[k], 1));
        }
        int row = r->first + i;
        d->delta[row] = fmaxf(next - edge, 1e-4f);
        d->t[row] = edge + d->delta[row] * (g ? rng_f(g) : 0.5f);
        for (int a = 0; a < 3; a++) d->x[row][a] = r->o[a] + d->t[row] * r->d[a];
        edge = next;
    }
    r->n = count;
}

/* Sixteen polynomials of a direction: spherical harmonics up to degree 3 but for their scale. */
static void direction(const float d[3], float *o)
{
    float x = d[0], y = d[1], z = d[2];
    const float v[16] = { 1, x, y, z, x * y, y * z, z * x, x * x - y * y, 1.5f * z * z - 0.5f, x * y * z, x * (x * x - 3 * y * y), y * (3 * x * x - y * y), z * (2.5f * z * z - 1.5f),
                          x * (5 * z * z - 1), y * (5 * z * z - 1), z * (x * x - y * y) };
    memcpy(o, v, sizeof v);
}

static int padded(int rows) { return (rows + MLP_PAD - 1) & ~(MLP_PAD - 1); }

/* Rows of samples: encoding, base, density. */
static void density_rows(const nerfw *n, nerfw_desk *d, int rows)
{
    int all = padded(rows);
    for (int i = rows; i < all; i++) memset(d->x[i], 0, sizeof d->x[i]);
    enc_forward(&n->enc, all, (const float (*)[3])d->x, d->feature, d->keep);
    mlp_forward(&n->base, all, d->feature, d->base_hidden, d->base);
    float bias = logf(start_density(n));
    for (int i = 0; i < all; i += 8) {
        v8 raw;
        for (int j = 0; j < 8; j++) raw[j] = d->base[(size_t)(i + j) * OUT] + bias;
        v8 sigma = exp8(raw), most = (v8){ 0 } + DENSEST;
        i8 low = sigma < most;
        *(v8u *)&d->sigma[i] = (v8)((low & (i8)sigma) | (~low & (i8)most));
    }
}

/* Samples of the desk's rays up to where the static transmittance ends: rows for the heads, features and codes side by side. code: NULL, or one for all rays. Returns the rows. */
static int head_rows(const nerfw *n, nerfw_desk *d, int rays, const float *code, int transient)
{
    int rows = 0;
    for (int k = 0; k < rays; k++) {
        ray *r = &d->ray[k];
        const float *c = code ? code : n->codes.p + grid_at(&n->codes, r->photo, 0, 0) * 2 * NERFW_CODE;
        float depth = 0;
        r->head = rows;
        for (r->m = 0; r->m < r->n && depth < -logf(END); r->m++) {
            size_t row = (size_t)(r->first + r->m);
            memcpy(d->colour_in + (size_t)rows * HEAD, d->base + row * OUT, OUT * sizeof(float));
            memcpy(d->colour_in + (size_t)rows * HEAD + OUT, c, NERFW_CODE * sizeof(float));
            if (transient) {
                memcpy(d->trans_in + (size_t)rows * HEAD, d->base + row * OUT, OUT * sizeof(float));
                memcpy(d->trans_in + (size_t)rows * HEAD + OUT, c + NERFW_CODE, NERFW_CODE * sizeof(float));
            }
            depth += d->sigma[row] * d->delta[row];
            rows++;
        }
        direction(r->d, d->sky_in + (size_t)k * HEAD);
        memcpy(d->sky_in + (size_t)k * HEAD + 16, c, NERFW_CODE * sizeof(float));
    }
    for (int i = rows; i < padded(rows); i++) {
        memset(d->colour_in + (size_t)i * HEAD, 0, HEAD * sizeof(float));
        memset(d->trans_in + (size_t)i * HEAD, 0, HEAD * sizeof(float));
    }
    return rows;
}

static void colours(const nerfw *n, nerfw_desk *d, int rows)
{
    mlp_forward(&n->colour, padded(rows), d->colour_in, d->colour_hidden, d->colour);
    for (int i = 0; i < rows; i++) *(v8 *)(d->colour + (size_t)i * OUT) = sigmoid8(*(v8 *)(d->colour + (size_t)i * OUT));
    mlp_forward(&n->sky, RAYS, d->sky_in, d->sky_hidden, d->sky);
    for (int i = 0; i < RAYS; i++) *(v8 *)(d->sky + (size_t)i * OUT) = sigmoid8(*(v8 *)(d->sky + (size_t)i * OUT));
}

/* ---- training ---- */

static void pick_ray(const nerfw *n, ray *r, int through_point, rng *g)
{
    const world *w = n->w;
    r->photo = (int)rng_below(g, (uint32_t)w->nphotos);
    const world_photo *p = &w->photos[r->photo];
    for (int try = 0; try < 2; try++) {         /* sky teaches little per ray: half of it is enough, as in stage 1 */
        r->px = (int)rng_below(g, (uint32_t)p->w);
        r->py = (int)rng_below(g, (uint32_t)p->h);
        if (world_label(p, r->px, r->py) != WORLD_SKY || !(rng_u32(g) & 1)) break;
    }
    for (int a = 0; a < 3; a++) r->o[a] = (float)p->centre[a];
    r->to = r->sure = 0;
    world_ray(p, r->px + 0.5, r->py + 0.5, r->d);
    if (!through_point || !p->obs_count) return;
    const world_obs *q = &w->obs[p->obs_begin + rng_below(g, p->obs_count)];
    if (!(q->u >= 0) || !(q->v >= 0) || q->u >= (float)p->w || q->v >= (float)p->h) return;
    const float *x = w->points[q->point].x;
    r->px = (int)q->u;
    r->py = (int)q->v;
    r->sure = w->points[q->point].weight;
    world_ray(p, q->u, q->v, r->d);
    for (int a = 0; a < 3; a++) r->to += (x[a] - r->o[a]) * r->d[a];
}

/* Loss of one ray and its gradients into the desk's rows. Rows of the heads hold colours by now, trans rows (density, r, g, b, beta, its slope). */
static void ray_loss(nerfw *n, nerfw_desk *d, int k, int with_transient)
{
    ray *r = &d->ray[k];
    nerfw_losses *L = &d->loss;
    const world_photo *p = &n->w->photos[r->photo];
    const float *sky = d->sky + (size_t)k * OUT;
    int m = r->m, label = world_label(p, r->px, r->py);
    uint8_t rgb[3];
    world_rgb(p, r->px, r->py, rgb);
    float alpha[SAMPLES], alpha_t[SAMPLES], trans[SAMPLES], own[SAMPLES], beta_k[SAMPLES];    /* own: static weights without transients */
    float T = 1, Ts = 1, C[3] = { 0 }, beta = BETA_MIN, depth_t = 0;
    for (int i = 0; i < m; i++) {
        size_t row = (size_t)(r->first + i), h = (size_t)(r->head + i);
        float delta = d->delta[row];
        const float *c = d->colour + h * OUT, *q = d->trans + h * OUT;
        alpha[i] = opacity(d->sigma[row] * delta);
        alpha_t[i] = beta_k[i] = 0;
        if (with_transient) {
            alpha_t[i] = opacity(q[0] * delta);
            beta_k[i] = 0.3f * q[4];
            depth_t += q[0] * delta;
        }
        trans[i] = T;
        own[i] = Ts * alpha[i];
        for (int a = 0; a < 3; a++) C[a] += T * (alpha[i] * c[a] + alpha_t[i] * (with_transient ? q[1 + a] : 0));
        beta += T * alpha_t[i] * beta_k[i];
        T *= (1 - alpha[i]) * (1 - alpha_t[i]);
        Ts *= 1 - alpha[i];
    }
    float dC[3], err2 = 0;
    for (int a = 0; a < 3; a++) {
        C[a] += T * sky[a];
        dC[a] = C[a] - (float)rgb[a] * (1.0f / 255.0f);
        err2 += dC[a] * dC[a];
    }
    float scale = BETA_MIN * BETA_MIN / (beta * beta), loss = err2 * scale;
    float dbeta = 0, W = 1 - Ts, dW = 0;
    L->mse += err2 / 3;
    if (with_transient) {
        dbeta = -2 * err2 * scale / beta + 2 * BETA_MIN * BETA_MIN / beta;
        loss += 2 * BETA_MIN * BETA_MIN * logf(beta) + LAMBDA_TRANSIENT * depth_t;
        L->transient += 1 - expf(-depth_t);
    }
    if ((label == WORLD_SKY || label == WORLD_SCENE) && r->n) {
        float Wc = W < 1e-3f ? 1e-3f : W > 0.999f ? 0.999f : W;
        float bce = label == WORLD_SKY ? -logf(1 - Wc) : -logf(Wc);
        loss += LAMBDA_SKY * bce;
        L->sky += bce;
        if (W == Wc) dW = LAMBDA_SKY * (label == WORLD_SKY ? 1 / (1 - Wc) : -1 / Wc);
    }
    /* Distortion: sum_ij w_i w_j |t_i - t_j| + sum_i w_i^2 delta_i / 3, distances in box lengths. dd: its slope by w_i. */
    float dd[SAMPLES], unit = 1 / (float)longest(&n->f), w_before = 0, wt_before = 0, w_all = 0, wt_all = 0, distortion = 0;
    for (int i = 0; i < m; i++) {
        float t = d->t[r->first + i] * unit;
        w_all += own[i];
        wt_all += own[i] * t;
    }
    for (int i = 0; i < m; i++) {
        float t = d->t[r->first + i] * unit, w = own[i], one = w * d->delta[r->first + i] * unit / 3;
        w_before += w;
        wt_before += w * t;
        float cross = t * w_before - wt_before + (wt_all - wt_before) - t * (w_all - w_before);
        distortion += w * (cross + one);
        dd[i] = LAMBDA_DISTORTION * 2 * (cross + one);
    }
    loss += LAMBDA_DISTORTION * distortion;
    L->distortion += distortion;
    for (int i = 0; i < m && r->to > 0; i++) {
        float off = (d->t[r->first + i] - r->to) / POINT_SPREAD, gain = LAMBDA_POINT * r->sure / (1 + off * off);
        loss -= own[i] * gain;
        dd[i] -= gain;
    }
    L->total += loss;
    for (int a = 0; a < 3; a++) dC[a] *= 2 * scale;

    float *ds = d->dsky + (size_t)k * OUT;
    float later = 0, later_own = 0;
    for (int a = 0; a < 3; a++) {
        ds[a] = dC[a] * T * sky[a] * (1 - sky[a]);
        later += dC[a] * T * sky[a];
    }
    for (int i = m - 1; i >= 0; i--) {
        size_t row = (size_t)(r->first + i), h = (size_t)(r->head + i);
        const float *c = d->colour + h * OUT, *q = d->trans + h * OUT;
        float *dc = d->dcolour + h * OUT, *dq = d->dtrans + h * OUT, delta = d->delta[row], v = 0, vt = dbeta * beta_k[i];
        float near = n->heuristics && d->t[row] < p->near ? d->t[row] * d->t[row] / (p->near * p->near) : 1;   /* few others look on there, and floaters grow (Philip & Deschaintre 2023) */
        for (int a = 0; a < 3; a++) {
            v += dC[a] * c[a];
            dc[a] = near * dC[a] * trans[i] * alpha[i] * c[a] * (1 - c[a]);
        }
        float dsigma = delta * (trans[i] * (1 - alpha[i]) * v - later + (1 - W) * dW);
        if (with_transient) {
            for (int a = 0; a < 3; a++) {
                vt += dC[a] * q[1 + a];
                dq[1 + a] = near * dC[a] * trans[i] * alpha_t[i] * q[1 + a] * (1 - q[1 + a]);
            }
            float dsigma_t = delta * (trans[i] * (1 - alpha_t[i]) * vt - later + LAMBDA_TRANSIENT);
            dq[0] = q[0] < DENSEST ? near * dsigma_t * q[0] : 0;
            dq[4] = near * dbeta * trans[i] * alpha_t[i] * 0.3f * q[5];
        }
        /* own_i = Ts_i alpha_i: the static transmittance before i is own_i / alpha_i */
        float before = alpha[i] > 1e-12f ? own[i] / alpha[i] : 0;
        dsigma += delta * (before * (1 - alpha[i]) * dd[i] - later_own);
        later_own += own[i] * dd[i];
        later += trans[i] * (alpha[i] * v + alpha_t[i] * vt);
        d->dbase[row * OUT] = d->sigma[row] < DENSEST ? near * dsigma * d->sigma[row] : 0;
    }
}

static void train_chunk(nerfw *n, int thread, int rays, float progress, rng *g)
{
    nerfw_desk *d = n->desk[thread];
    int rows = 0, with_transient = progress > 0.05f;
    float uniform = UNIFORM + expf(-10 * progress);     /* at first the density grid knows nothing */
    for (int k = 0; k < rays; k++) {
        ray *r = &d->ray[k];
        pick_ray(n, r, k < POINT_RAYS, g);
        r->first = rows;
        ray_sample(n, d, r, SAMPLES, uniform, g);
        rows += r->n;
    }
    density_rows(n, d, rows);
    for (int i = 0; i < rows; i++) {
        d->seen[d->nseen].cell = (uint32_t)cell_of(n, d->x[i]);
        d->seen[d->nseen++].sigma = d->sigma[i];
    }
    int heads = head_rows(n, d, rays, NULL, with_transient), all = padded(rows), hall = padded(heads);
    for (int k = rays; k < RAYS; k++) memset(d->sky_in + (size_t)k * HEAD, 0, HEAD * sizeof(float));
    colours(n, d, heads);
    if (with_transient) {
        float tbias = logf(0.1f * start_density(n));
        mlp_forward(&n->transient, hall, d->trans_in, d->trans_hidden, d->trans);
        for (int i = 0; i < heads; i++) {
            float *q = d->trans + (size_t)i * OUT;
            v8 s = sigmoid8(*(v8 *)q);
            q[0] = fminf(expf(q[0] + tbias), DENSEST);
            q[4] = q[4] > 15 ? q[4] : -logf(1 - s[4]);          /* softplus */
            q[5] = s[4];
            for (int a = 1; a < 4; a++) q[a] = s[a];
        }
    }
    memset(d->dbase, 0, (size_t)all * OUT * sizeof(float));
    memset(d->dcolour, 0, (size_t)hall * OUT * sizeof(float));
    memset(d->dtrans, 0, (size_t)hall * OUT * sizeof(float));
    memset(d->dsky, 0, (size_t)RAYS * OUT * sizeof(float));
    for (int k = 0; k < rays; k++) ray_loss(n, d, k, with_transient);
    mlp_backward(&n->colour, thread, hall, d->colour_in, d->colour_hidden, d->dcolour, d->dcolour_in);
    if (with_transient) mlp_backward(&n->transient, thread, hall, d->trans_in, d->trans_hidden, d->dtrans, d->dtrans_in);
    mlp_backward(&n->sky, thread, RAYS, d->sky_in, d->sky_hidden, d->dsky, d->dsky_in);
    for (int k = 0; k < rays; k++) {
        ray *r = &d->ray[k];
        size_t at = grid_at(&n->codes, r->photo, 0, 0);
        float *gc = n->codes.g[thread] + at * 2 * NERFW_CODE;
        const float *c = n->codes.p + at * 2 * NERFW_CODE;
        n->codes.dirty[thread][at / GRID_TILE] = 1;
        for (int i = 0; i < r->m; i++) {
            float *db = d->dbase + (size_t)(r->first + i) * OUT;
            const float *dc = d->dcolour_in + (size_t)(r->head + i) * HEAD, *dq = d->dtrans_in + (size_t)(r->head + i) * HEAD;
            for (int j = 0; j < OUT; j++) { db[j] += dc[j]; gc[j] += dc[OUT + j]; }
            if (with_transient) for (int j = 0; j < OUT; j++) { db[j] += dq[j]; gc[NERFW_CODE + j] += dq[OUT + j]; }
        }
        for (int j = 0; j < NERFW_CODE; j++) gc[j] += d->dsky_in[(size_t)k * HEAD + 16 + (size_t)j];
        for (int j = 0; j < 2 * NERFW_CODE; j++) {
            gc[j] += 2 * LAMBDA_CODE * c[j];
            d->loss.total += LAMBDA_CODE * c[j] * c[j];
        }
        d->loss.samples += r->n;
    }
    mlp_backward(&n->base, thread, all, d->feature, d->base_hidden, d->dbase, d->dfeature);
    enc_backward(&n->enc, thread, all, d->keep, d->dfeature);
}

typedef struct { nerfw *n; float progress; } step_job;

static void step_range(void *user, int begin, int end)
{
    step_job *job = user;
    nerfw *n = job->n;
    for (int t = begin; t < end; t++) {
        int T = n->opt.threads;
        rng r = rng_make(n->opt.seed, (uint64_t)n->step, (uint64_t)t);
        int rays = (int)((int64_t)n->opt.rays * (t + 1) / T - (int64_t)n->opt.rays * t / T);
        memset(&n->desk[t]->loss, 0, sizeof n->desk[t]->loss);
        n->desk[t]->nseen = 0;
        for (int i = 0; i < rays; i += RAYS) train_chunk(n, t, rays - i < RAYS ? rays - i : RAYS, job->progress, &r);
    }
}

void nerfw_gradients(nerfw *n, float progress, nerfw_losses *out)
{
    step_job job = { n, progress };
    orl_parallel(n->opt.threads, n->opt.threads, 1, step_range, &job);
    memset(out, 0, sizeof *out);
    for (int t = 0; t < n->opt.threads; t++)
        for (size_t i = 0; i < sizeof *out / sizeof(double); i++) ((double *)out)[i] += ((double *)&n->desk[t]->loss)[i];
    double inv = 1.0 / n->opt.rays;
    out->mse *= inv; out->sky *= inv; out->transient *= inv; out->distortion *= inv;
}

/* Density grid, first part: what the step's samples saw, thread after thread; up quickly, down slowly. */
static void update_seen(nerfw *n)
{
    for (int t = 0; t < n->opt.threads; t++) {
        const nerfw_desk *d = n->desk[t];
        for (int i = 0; i < d->nseen; i++) {
            float *c = &n->density[d->seen[i].cell], more = d->seen[i].sigma - *c;
            if (isfinite(more)) *c += (more > 0 ? 0.2f : 0.03f) * more;
        }
    }
}

/* Second part, for cells where no sample goes: UPDATE cells a step, in an order that visits all; a random point of each. Thread t takes the t-th part, each cell has one writer. */
static void update_range(void *user, int begin, int end)
{
    nerfw *n = ((step_job *)user)->n;
    size_t cells = (size_t)n->gn[0] * (size_t)n->gn[1] * (size_t)n->gn[2], rounds = (cells + UPDATE - 1) / UPDATE;
    for (int t = begin; t < end; t++) {
        nerfw_desk *d = n->desk[t];
        rng r = rng_make(n->opt.seed, (uint64_t)n->step, 0x100u + (uint64_t)t);
        int lo = (int)((int64_t)UPDATE * t / n->opt.threads), hi = (int)((int64_t)UPDATE * (t + 1) / n->opt.threads);
        for (int b = lo; b < hi; b += ROWS) {
            int rows = hi - b < ROWS ? hi - b : ROWS;
            for (int i = 0; i < rows; i++) {
                size_t c = (size_t)(b + i) * rounds + (size_t)n->step % rounds, at[3];
                if (c >= cells) c = cells - 1;
                at[0] = c % (size_t)n->gn[0]; at[1] = c / (size_t)n->gn[0] % (size_t)n->gn[1]; at[2] = c / (size_t)n->gn[0] / (size_t)n->gn[1];
                for (int a = 0; a < 3; a++) d->x[i][a] = ((float)at[a] + rng_f(&r)) * n->cell;
            }
            density_rows(n, d, rows);
            for (int i = 0; i < rows; i++) {
                size_t c = (size_t)(b + i) * rounds + (size_t)n->step % rounds;
                if (c >= cells || !isfinite(d->sigma[i])) continue;
                n->density[c] = fmaxf(0.8f * n->density[c], d->sigma[i]);
            }
        }
    }
}

void nerfw_step(nerfw *n, float progress, nerfw_losses *out)
{
    step_job job = { n, progress };
    int T = n->opt.threads;
    nerfw_gradients(n, progress, out);
    float lr = expf(logf(0.03f) * progress), warm = fminf(1, (float)(n->step + 1) / 50);
    enc_adam(&n->enc, 2e-2f * lr * warm, T);
    mlp_adam(&n->base, 4e-3f * lr * warm, 0);
    mlp_adam(&n->colour, 4e-3f * lr * warm, 0);
    if (progress > 0.05f) mlp_adam(&n->transient, 4e-3f * lr * warm, 0);
    mlp_adam(&n->sky, 4e-3f * lr * warm, 0);
    if (grid_sum(&n->codes, T)) grid_adam(&n->codes, 5e-3f * lr * warm, T);
    else grid_drop(&n->codes);
    update_seen(n);
    orl_parallel(T, T, 1, update_range, &job);
    n->step++;
}

/* ---- file ---- */

typedef struct {
    char magic[8];                  /* "ORLNERFW" */
    uint32_t version, encoding;
    frame f;
    int32_t nphotos, step;
    uint64_t seed, bytes;           /* bytes: of the whole file */
} file_head;
enum { VERSION = 1 };

/* The file's parts after the header, in order. */
typedef struct { void *at; size_t floats; } part;
enum { PARTS = 7 };
static void parts(const nerfw *n, part p[PARTS])
{
    const part list[PARTS] = {
        { n->density, (size_t)n->gn[0] * (size_t)n->gn[1] * (size_t)n->gn[2] }, { n->enc.p, n->enc.units * 8 }, { n->base.p, n->base.size }, { n->colour.p, n->colour.size },
        { n->transient.p, n->transient.size }, { n->sky.p, n->sky.size }, { n->codes.p, n->codes.nverts * 2 * NERFW_CODE },
    };
    memcpy(p, list, sizeof list);
}

static uint64_t file_bytes(const part p[PARTS])
{
    uint64_t b = sizeof(file_head);
    for (int i = 0; i < PARTS; i++) b += p[i].floats * sizeof(float);
    return b;
}

orl_err nerfw_save(const nerfw *n, const char *path)
{
    file_head h;
    part p[PARTS];
    parts(n, p);
    memset(&h, 0, sizeof h);
    memcpy(h.magic, "ORLNERFW", 8);
    h.version = VERSION;
    h.encoding = (uint32_t)n->opt.encoding;
    memcpy(&h.f, &n->f, sizeof h.f);
    h.nphotos = n->nphotos;
    h.step = n->step;
    h.seed = n->opt.seed;
    h.bytes = file_bytes(p);
    char *all = malloc(h.bytes), *at = all;
    if (!all) return orl_fail(ORL_E_MEMORY, "%s: no memory for %llu bytes", path, (unsigned long long)h.bytes);
    memcpy(at, &h, sizeof h);
    at += sizeof h;
    for (int i = 0; i < PARTS; i++) {
        memcpy(at, p[i].at, p[i].floats * sizeof(float));
        at += p[i].floats * sizeof(float);
    }
    orl_err e = orl_file_write(path, all, h.bytes);
    free(all);
    return e;
}

static orl_err check_head(const file_head *h, const char *path)
{
    if (memcmp(h->magic, "ORLNERFW", 8)) return orl_fail(ORL_E_FORMAT, "%s: not a NeRF-W model", path);
    if (h->version != VERSION) return orl_fail(ORL_E_UNSUPPORTED, "%s: version %u, this program reads %d", path, h->version, VERSION);
    if (h->encoding >= ENC_KINDS) return orl_fail(ORL_E_FORMAT, "%s: encoding %u", path, h->encoding);
    if (h->nphotos < 1 || h->nphotos > 1000000 || h->step < 0) return orl_fail(ORL_E_RANGE, "%s: %d photos, step %d", path, h->nphotos, h->step);
    int fine = isfinite(h->f.scale) && h->f.scale > 0;
    for (int i = 0; i < 9; i++) fine = fine && fabs(h->f.R[i]) <= 1.001;
    for (int a = 0; a < 3; a++) fine = fine && isfinite(h->f.offset[a]) && h->f.dims[a] >= 16 && h->f.dims[a] <= 8192;
    return fine ? ORL_OK : orl_fail(ORL_E_RANGE, "%s: frame is out of range", path);
}

orl_err nerfw_load(const char *path, nerfw *out)
{
    uint8_t *bytes = NULL;
    size_t size;
    nerfw n;
    file_head h;
    part p[PARTS];
    memset(&n, 0, sizeof n);
    orl_err e = orl_file_read(path, (size_t)1 << 31, &bytes, &size);
    if (e) return e;
    if (size < sizeof h) { e = orl_fail(ORL_E_FORMAT, "%s: header is cut short", path); goto done; }
    memcpy(&h, bytes, sizeof h);
    if ((e = check_head(&h, path))) goto done;
    if (h.bytes != size) { e = orl_fail(ORL_E_FORMAT, "%s: %zu bytes, its header says %llu", path, size, (unsigned long long)h.bytes); goto done; }
    if ((e = build(&n, &h.f, h.nphotos, &(nerfw_options){ .encoding = (enc_kind)h.encoding, .seed = h.seed }, 0))) goto done;
    n.step = h.step;
    parts(&n, p);
    if (file_bytes(p) != size) { e = orl_fail(ORL_E_FORMAT, "%s: %zu bytes, its box and photos take %llu", path, size, (unsigned long long)file_bytes(p)); goto done; }
    const uint8_t *at = bytes + sizeof h;
    for (int i = 0; i < PARTS; i++) {
        memcpy(p[i].at, at, p[i].floats * sizeof(float));
        at += p[i].floats * sizeof(float);
        for (size_t k = 0; k < p[i].floats; k++)
            if (!(fabsf(((float *)p[i].at)[k]) < 1e6f)) { e = orl_fail(ORL_E_RANGE, "%s: part %d, value %zu is out of range", path, i, k); goto done; }
    }
    mlp_refresh(&n.base); mlp_refresh(&n.colour); mlp_refresh(&n.transient); mlp_refresh(&n.sky);
    *out = n;
    memset(&n, 0, sizeof n);
done:
    free(bytes);
    nerfw_free(&n);
    return e;
}

/* ---- a new photo ---- */

/* What the code is fitted on: rays of the known part with the samples that count, geometry done. */
typedef struct {
    int rays, rows;
    float (*target)[3], *end, *weight;  /* per ray: colour and transmittance into the sky; per row: weight */
    int *first;                         /* rows of a ray: [first[k], first[k + 1]) */
    float *in, *hidden, *out, *dout, *din, *sky_in, *sky_hidden, *sky, *dsky, *dsky_in;
} fit_set;

enum { FIT_RAYS = 2048, FIT_STEPS = 200, FIT_TRIALS = 64 };

static void *zeros(size_t floats)
{
    size_t bytes = (floats * sizeof(float) + 63) & ~(size_t)63;
    void *p = aligned_alloc(64, bytes);
    if (p) memset(p, 0, bytes);
    return p;
}

/* Static weights of a ray's samples (first m of them); returns the transmittance behind. */
static float weights(const nerfw_desk *d, const ray *r, float *w)
{
    float T = 1;
    for (int i = 0; i < r->m; i++) {
        float a = 1 - expf(-d->sigma[r->first + i] * d->delta[r->first + i]);
        w[i] = T * a;
        T *= 1 - a;
    }
    return T;
}

static void view_ray(const world_photo *v, double x, double y, ray *r)
{
    memset(r, 0, sizeof *r);
    for (int a = 0; a < 3; a++) r->o[a] = (float)v->centre[a];
    world_ray(v, x, y, r->d);
}

static int set_make(fit_set *f, const nerfw *n)
{
    size_t R = FIT_RAYS, most = R * 16;
    f->target = zeros(3 * R); f->end = zeros(R); f->weight = zeros(most); f->first = zeros(R + 1);
    f->in = zeros(most * HEAD); f->hidden = zeros(most * (size_t)n->colour.hidden); f->out = zeros(most * OUT); f->dout = zeros(most * OUT); f->din = zeros(most * HEAD);
    f->sky_in = zeros(R * HEAD); f->sky_hidden = zeros(R * (size_t)n->sky.hidden); f->sky = zeros(R * OUT); f->dsky = zeros(R * OUT); f->dsky_in = zeros(R * HEAD);
    return f->target && f->end && f->weight && f->first && f->in && f->hidden && f->out && f->dout && f->din && f->sky_in && f->sky_hidden && f->sky && f->dsky && f->dsky_in;
}

static void set_free(fit_set *f)
{
    free(f->target); free(f->end); free(f->weight); free(f->first); free(f->in); free(f->hidden); free(f->out); free(f->dout); free(f->din);
    free(f->sky_in); free(f->sky_hidden); free(f->sky); free(f->dsky); free(f->dsky_in);
}

static void set_fill(fit_set *f, const nerfw *n, nerfw_desk *d, const world_photo *view, const orl_image *known)
{
    rng g = rng_make(1, 0xf17, 0);
    float zero[NERFW_CODE] = { 0 }, w[VIEW_SAMPLES];
    for (int b = 0; b < FIT_RAYS; b += RAYS) {
        int rows = 0;
        for (int k = 0; k < RAYS; k++) {
            ray *r = &d->ray[k];
            int x = (int)rng_below(&g, (uint32_t)known->w), y = (int)rng_below(&g, (uint32_t)known->h);
            view_ray(view, x + 0.5, y + 0.5, r);
            for (int a = 0; a < 3; a++) f->target[b + k][a] = (float)known->px[((size_t)y * (size_t)known->w + (size_t)x) * 3 + (size_t)a] / 255;
            r->first = rows;
            ray_sample(n, d, r, VIEW_SAMPLES, UNIFORM, NULL);
            rows += r->n;
        }
        density_rows(n, d, rows);
        head_rows(n, d, RAYS, zero, 0);
        for (int k = 0; k < RAYS; k++) {
            const ray *r = &d->ray[k];
            f->first[b + k] = f->rows;
            f->end[b + k] = weights(d, r, w);
            memcpy(f->sky_in + (size_t)(b + k) * HEAD, d->sky_in + (size_t)k * HEAD, HEAD * sizeof(float));
            for (int i = 0; i < r->m; i++) {
                if (w[i] < 5e-3f || f->rows >= FIT_RAYS * 16) continue;
                memcpy(f->in + (size_t)f->rows * HEAD, d->base + (size_t)(r->first + i) * OUT, OUT * sizeof(float));
                f->weight[f->rows++] = w[i];
            }
        }
    }
    f->rays = FIT_RAYS;
    f->first[f->rays] = f->rows;
}

/* Robust loss of a code, mean over rays (Cauchy's, scale 0.1), and its gradient where grad is not NULL. */
static double set_loss(fit_set *f, const nerfw *n, const float *code, float *grad)
{
    const float k2 = 0.1f * 0.1f;
    int all = padded(f->rows);
    double loss = 0;
    for (int i = 0; i < all; i++) memcpy(f->in + (size_t)i * HEAD + OUT, code, NERFW_CODE * sizeof(float));
    for (int i = 0; i < f->rays; i++) memcpy(f->sky_in + (size_t)i * HEAD + 16, code, NERFW_CODE * sizeof(float));
    mlp_forward(&n->colour, all, f->in, f->hidden, f->out);
    mlp_forward(&n->sky, f->rays, f->sky_in, f->sky_hidden, f->sky);
    for (int i = 0; i < all; i++) *(v8 *)(f->out + (size_t)i * OUT) = sigmoid8(*(v8 *)(f->out + (size_t)i * OUT));
    for (int i = 0; i < f->rays; i++) *(v8 *)(f->sky + (size_t)i * OUT) = sigmoid8(*(v8 *)(f->sky + (size_t)i * OUT));
    for (int k = 0; k < f->rays; k++) {
        float C[3], e2 = 0;
        const float *s = f->sky + (size_t)k * OUT;
        for (int a = 0; a < 3; a++) {
            C[a] = f->end[k] * s[a];
            for (int i = f->first[k]; i < f->first[k + 1]; i++) C[a] += f->weight[i] * f->out[(size_t)i * OUT + (size_t)a];
            C[a] -= f->target[k][a];
            e2 += C[a] * C[a];
        }
        loss += k2 * log1pf(e2 / k2) / f->rays;
        float slope = 2 / (1 + e2 / k2) / (float)f->rays;
        for (int a = 0; a < 3; a++) {
            f->dsky[(size_t)k * OUT + (size_t)a] = slope * C[a] * f->end[k] * s[a] * (1 - s[a]);
            for (int i = f->first[k]; i < f->first[k + 1]; i++) {
                float c = f->out[(size_t)i * OUT + (size_t)a];
                f->dout[(size_t)i * OUT + (size_t)a] = slope * C[a] * f->weight[i] * c * (1 - c);
            }
        }
    }
    if (!grad) return loss;
    mlp_backward((mlp *)&n->colour, -1, all, f->in, f->hidden, f->dout, f->din);
    mlp_backward((mlp *)&n->sky, -1, f->rays, f->sky_in, f->sky_hidden, f->dsky, f->dsky_in);
    for (int j = 0; j < NERFW_CODE; j++) {
        double s = 0;
        for (int i = 0; i < f->rows; i++) s += f->din[(size_t)i * HEAD + (size_t)(OUT + j)];
        for (int i = 0; i < f->rays; i++) s += f->dsky_in[(size_t)i * HEAD + (size_t)(16 + j)];
        grad[j] = (float)s;
    }
    return loss;
}

/* Adam from the best of the training photos' codes and their mean, drawn to their distribution. */
static void set_fit(fit_set *f, const nerfw *n, float *code)
{
    float mean[NERFW_CODE] = { 0 }, inv_var[NERFW_CODE], m[NERFW_CODE] = { 0 }, v[NERFW_CODE] = { 0 }, g[NERFW_CODE];
    for (int k = 0; k < n->nphotos; k++) for (int j = 0; j < NERFW_CODE; j++) mean[j] += n->codes.p[grid_at(&n->codes, k, 0, 0) * 2 * NERFW_CODE + (size_t)j] / (float)n->nphotos;
    for (int j = 0; j < NERFW_CODE; j++) {
        float var = 1e-3f;
        for (int k = 0; k < n->nphotos; k++) {
            float d = n->codes.p[grid_at(&n->codes, k, 0, 0) * 2 * NERFW_CODE + (size_t)j] - mean[j];
            var += d * d / (float)n->nphotos;
        }
        inv_var[j] = 1 / var;
    }
    memcpy(code, mean, sizeof mean);
    double best = set_loss(f, n, mean, NULL);
    for (int t = 0; t < FIT_TRIALS && t < n->nphotos; t++) {
        int k = (int)((int64_t)t * n->nphotos / (n->nphotos < FIT_TRIALS ? n->nphotos : FIT_TRIALS));
        const float *c = n->codes.p + grid_at(&n->codes, k, 0, 0) * 2 * NERFW_CODE;
        double loss = set_loss(f, n, c, NULL);
        if (!(loss < best)) continue;
        best = loss;
        memcpy(code, c, NERFW_CODE * sizeof(float));
    }
    for (int i = 1; i <= FIT_STEPS; i++) {
        set_loss(f, n, code, g);
        float lr = 0.03f * (1 - (float)(i - 1) / FIT_STEPS), c1 = 1 / (1 - powf(0.9f, (float)i)), c2 = 1 / (1 - powf(0.99f, (float)i));
        for (int j = 0; j < NERFW_CODE; j++) {
            float d = g[j] + 2 * PRIOR * inv_var[j] * (code[j] - mean[j]);
            m[j] = 0.9f * m[j] + 0.1f * d;
            v[j] = 0.99f * v[j] + 0.01f * d * d;
            code[j] -= lr * c1 * m[j] / (sqrtf(c2 * v[j]) + 1e-8f);
        }
    }
}

typedef struct { const nerfw *n; const world_photo *view; const float *code; nerfw_desk **desk; int threads; orl_image *out; } render_job;

static void render_range(void *user, int begin, int end)
{
    render_job *job = user;
    for (int t = begin; t < end; t++) {
        nerfw_desk *d = job->desk[t];
        int w = job->view->w, pixels = w * job->view->h;
        float wk[VIEW_SAMPLES];
        for (int b = t * RAYS; b < pixels; b += job->threads * RAYS) {
            int rays = pixels - b < RAYS ? pixels - b : RAYS, rows = 0;
            for (int k = 0; k < rays; k++) {
                view_ray(job->view, (b + k) % w + 0.5, (b + k) / w + 0.5, &d->ray[k]);
                d->ray[k].first = rows;
                ray_sample(job->n, d, &d->ray[k], VIEW_SAMPLES, UNIFORM, NULL);
                rows += d->ray[k].n;
            }
            density_rows(job->n, d, rows);
            colours(job->n, d, head_rows(job->n, d, rays, job->code, 0));
            for (int k = 0; k < rays; k++) {
                const ray *r = &d->ray[k];
                float T = weights(d, r, wk);
                for (int a = 0; a < 3; a++) {
                    float c = T * d->sky[k * OUT + a];
                    for (int i = 0; i < r->m; i++) c += wk[i] * d->colour[(size_t)(r->head + i) * OUT + (size_t)a];
                    job->out->px[(size_t)(b + k) * 3 + (size_t)a] = (uint8_t)(255 * (c > 0 ? c < 1 ? c : 1 : 0) + 0.5f);
                }
            }
        }
    }
}

orl_err nerfw_predict(const nerfw *n, const orl_camera *cam, const orl_pose *pose, const orl_image *known, int threads, float *code, orl_image *out)
{
    if (threads < 1) threads = orl_cores();
    if (threads > GRID_THREADS) threads = GRID_THREADS;
    nerfw_desk *desk[GRID_THREADS] = { NULL };
    world_photo view;
    fit_set f = { 0 };
    orl_image im = { 0 };
    orl_err e = known->c == 3 && known->h == cam->h && known->w >= 1 && known->w <= cam->w ? ORL_OK : orl_fail(ORL_E_RANGE, "known part of %d x %d, view of %d x %d", known->w, known->h, cam->w, cam->h);
    for (int t = 0; !e && t < threads; t++) if (!(desk[t] = desk_make(n))) e = orl_fail(ORL_E_MEMORY, "no memory for a thread's samples");
    if (!e && !set_make(&f, n)) e = orl_fail(ORL_E_MEMORY, "no memory to fit a code");
    if (!e) e = orl_image_alloc(&im, cam->w, cam->h, 3);
    if (!e) {
        frame_view(&n->f, cam, pose, &view);
        set_fill(&f, n, desk[0], &view, known);
        set_fit(&f, n, code);
        render_job job = { n, &view, code, desk, threads, &im };
        orl_parallel(threads, threads, 1, render_range, &job);
        *out = im;
    }
    set_free(&f);
    for (int t = 0; t < threads; t++) desk_free(desk[t]);
    return e;
}
