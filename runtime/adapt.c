/* Adaptation of the codes to one photo: Levenberg-Marquardt on the 37 x 37 normal equations, Geman-McClure weights whose scale shrinks as it goes (wide at first, so that a wrong
 * start can still see the right answer), a Gaussian prior. Cold: every sun direction gets a few steps on a subsample, the best two are polished on all samples.
 * Neighbouring pixels share their errors, so a photo counts as at most INDEPENDENT samples against the prior, however many are given. */
#include "oriel/adapt.h"
#include <math.h>
#include <string.h>
#include "oriel/math.h"
#include "oriel/parallel.h"

enum { N = ORL_CODE, LANES = 4, BLOCKS = (N + LANES - 1) / LANES, COARSE_SAMPLES = 250, COARSE_STEPS = 6, INDEPENDENT = 400, PARTS = 4, PART_LEAST = 150, DESKS = 4, STARTS = 128 };        /* PARTS: samples are summed in, from PART_LEAST each on; DESKS: at which starts are tried side by side */
typedef float v4 __attribute__((vector_size(16)));
#define PI 3.14159265f
#define TAU_COARSE 1.0f     /* scale of the robust weights on the residual's RGB norm: first and last of the coarse stage, */
#define TAU_MIDDLE 0.4f
#define TAU_SIGMAS 3.46f    /* and the final one in sigmas: two a channel */

/* Normal equations at a code: H = J^T W J + prior (upper triangle by rows), gradient, cost. */
typedef struct {
    v4 h[N][BLOCKS];
    float g[N];
    double cost, cost_before;       /* at the scale of the next step, and at the scale of the last */
    double weight, kept, square;    /* sums: of weights, of robust weights, of robustly weighted squares */
} normal;

/* What a part of the samples adds to them. rho: robust costs at the two scales. */
typedef struct {
    v4 h[N][BLOCKS], across[ORL_C_TONE][3], within[3][LANES];       /* across: light x a channel's tone; within: its tone x itself; lanes as tone_entry */
    float g[N];
    double rho, rho_before, weight, kept, square;
} part;

typedef struct {
    orl_light light;
    orl_light_jac jac;
    normal eq[2];
    part parts[PARTS];
    double l[N][N];
    const orl_light_model *m;
    const orl_sample *s;
    size_t n;
    float prior_weight, sigma, enough;
    int threads;
    uint8_t fixed[N];
} state;

orl_adapt_options orl_adapt_defaults(void) { return (orl_adapt_options){ 12, 8, 1.0f, 0.05f, 1, 1e-4f, 0 }; }
static size_t room(void) { return (sizeof(state) + 63) & ~(size_t)63; }
size_t orl_adapt_need(void) { return DESKS * room(); }

static float clampf(float x, float lo, float hi) { return x > lo ? x < hi ? x : hi : lo; }
static float wrap(float a) { a -= 2 * PI * (float)(int)(a * (1 / (2 * PI))); return a > PI ? a - 2 * PI : a < -PI ? a + 2 * PI : a; }

/* All numbers finite: infinities and NaN survive a multiplication by zero. */
static int usable(const orl_sample *s)
{
    if (!(s->weight > 0)) return 0;
    const float *f = (const float *)s;
    float zero = 0;
    for (size_t k = 0; k < sizeof *s / sizeof *f; k++) zero += f[k] * 0;
    return zero == 0;
}

/* What skies look like in other photos, for photos that show little of theirs: from the horizon to the zenith it counts as one pixel with the skies' own spread, and is never taken for an outlier. */
static void believe_in_sky(state *w, normal *q)
{
    static const float UP[4] = { 0.1f, 0.35f, 0.7f, 0.95f };
    const orl_light_model *m = w->m;
    if (!(m->sky_std[0] > 0 || m->sky_std[1] > 0 || m->sky_std[2] > 0)) return;
    for (int k = 0; k < 4; k++) {
        orl_sample s;
        float rgb[3], J[3][N];
        memset(&s, 0, sizeof s);
        s.dir[0] = sqrtf(1 - UP[k] * UP[k]);
        s.dir[2] = UP[k];
        orl_light_shade_jac(&w->light, &w->jac, &s, rgb, J);
        for (int c = 0; c < 3; c++) {
            if (!(m->sky_std[c] > 0)) continue;
            float a = 0.25f * w->prior_weight / (m->sky_std[c] * m->sky_std[c]), r = rgb[c] - m->sky_mean[c];
            for (int i = 0; i < N; i++) {
                if (J[c][i] == 0) continue;
                q->g[i] += a * J[c][i] * r;
                float *h = (float *)q->h[i];
                for (int b = i; b < N; b++) h[b] += a * J[c][i] * J[c][b];
            }
            q->cost += 0.5 * a * r * r;
            q->cost_before += 0.5 * a * r * r;
        }
    }
}

/* Entry of a channel's tone: k 0..2 its row of A, 3 its b. */
static int tone_entry(int c, int k) { return k < 3 ? ORL_C_TONE + 3 * c + k : ORL_C_TONE + 9 + c; }

static void place_tone(const part *w, normal *q)
{
    for (int c = 0; c < 3; c++)
        for (int k = 0; k < LANES; k++) {
            int to = tone_entry(c, k);
            for (int i = 0; i < ORL_C_TONE; i++) ((float *)q->h[i])[to] = w->across[i][c][k];
            for (int i = 0; i <= k; i++) ((float *)q->h[tone_entry(c, i)])[to] = w->within[c][i][k];
        }
}

typedef struct { state *w; float t2, b2; size_t stride; int parts; } summing;

/* Sums part k of the samples. */
static void add_part(const summing *j, int k)
{
    state *w = j->w;
    part *q = &w->parts[k];
    size_t count = (w->n + j->stride - 1) / j->stride, from = count * (size_t)k / (size_t)j->parts, to = count * (size_t)(k + 1) / (size_t)j->parts;
    memset(q, 0, sizeof *q);
    for (size_t i = from; i < to; i++) {
        const orl_sample *s = &w->s[i * j->stride];
        if (!usable(s)) continue;
        float rgb[3], J[3][N], r[3], e2 = 0;
        orl_light_shade_jac(&w->light, &w->jac, s, rgb, J);
        v4 d[3][BLOCKS] = { { { 0 } } };
        for (int c = 0; c < 3; c++) {
            r[c] = rgb[c] - s->rgb[c];
            if (r[c] > 0 && s->rgb[c] >= 250.0f / 255) { r[c] = 0; continue; }  /* saturated: any brighter model fits, and the row stays zero */
            memcpy(d[c], J[c], sizeof J[c]);
            e2 += r[c] * r[c];
        }
        float share = j->t2 / (e2 + j->t2), a = s->weight * share * share;
        q->rho += s->weight * e2 * share;
        q->rho_before += s->weight * e2 * (j->b2 / (e2 + j->b2));
        q->weight += s->weight;
        q->kept += a;
        q->square += a * e2;
        const float *j0 = (const float *)d[0], *j1 = (const float *)d[1], *j2 = (const float *)d[2];
        v4 tone[3];                                                             /* a channel's own tone: three of A, one of b; other channels' is nothing to it */
        for (int c = 0; c < 3; c++) {
            const float *t = (const float *)d[c] + ORL_C_TONE;
            tone[c] = (v4){ t[3 * c], t[3 * c + 1], t[3 * c + 2], t[9 + c] };
        }
        for (int m = 0; m < ORL_C_TONE; m++) {                                  /* many rows are empty: sky pixels have no shadow, surfaces no sky code */
            if (j0[m] == 0 && j1[m] == 0 && j2[m] == 0) continue;
            float a0 = a * j0[m], a1 = a * j1[m], a2 = a * j2[m];
            q->g[m] += a0 * r[0] + a1 * r[1] + a2 * r[2];
            for (int b = m / LANES; b <= ORL_C_TONE / LANES; b++) q->h[m][b] += a0 * d[0][b] + a1 * d[1][b] + a2 * d[2][b];
            q->across[m][0] += a0 * tone[0];
            q->across[m][1] += a1 * tone[1];
            q->across[m][2] += a2 * tone[2];
        }
        for (int c = 0; c < 3; c++)
            for (int m = 0; m < LANES; m++) {
                float at = a * tone[c][m];
                q->within[c][m] += at * tone[c];
                q->g[tone_entry(c, m)] += at * r[c];
            }
    }
}

static void add_parts(void *user, int begin, int end)
{
    for (int k = begin; k < end; k++) add_part(user, k);
}

/* The parts' sums in their order, all in the first. */
static void gather(state *w, int parts, normal *q)
{
    part *all = &w->parts[0];
    for (int k = 1; k < parts; k++) {
        const part *p = &w->parts[k];
        for (int m = 0; m < ORL_C_TONE; m++) {
            for (int b = m / LANES; b <= ORL_C_TONE / LANES; b++) all->h[m][b] += p->h[m][b];
            for (int c = 0; c < 3; c++) all->across[m][c] += p->across[m][c];
        }
        for (int c = 0; c < 3; c++) for (int m = 0; m < LANES; m++) all->within[c][m] += p->within[c][m];
        for (int m = 0; m < N; m++) all->g[m] += p->g[m];
        all->rho += p->rho;
        all->rho_before += p->rho_before;
        all->weight += p->weight;
        all->kept += p->kept;
        all->square += p->square;
    }
    memcpy(q->h, all->h, sizeof q->h);
    memcpy(q->g, all->g, sizeof q->g);
    q->weight = all->weight;
    q->kept = all->kept;
    q->square = all->square;
    place_tone(all, q);
}

static void evaluate(state *w, const float *code, float tau_before, float tau, size_t stride, normal *q)
{
    size_t count = (w->n + stride - 1) / stride;
    summing j = { w, tau * tau, tau_before * tau_before, stride, count >= PARTS * PART_LEAST ? PARTS : 1 };
    orl_light_decode(w->m, code, &w->light);
    orl_light_jac_decode(w->m, &w->light, &w->jac);
    orl_parallel(j.parts > 1 ? w->threads : 1, j.parts, 1, add_parts, &j);
    gather(w, j.parts, q);
    float scale = (q->weight > INDEPENDENT ? INDEPENDENT / (float)q->weight : 1) / (w->sigma * w->sigma);
    float d[N];
    double prior = 0;
    for (int k = 0; k < N; k++) d[k] = code[k] - w->m->prior_mean[k];
    d[ORL_C_SUN_AZ] = wrap(d[ORL_C_SUN_AZ]);
    for (int k = 0; k < N; k++) {
        float *h = (float *)q->h[k], pd = 0;
        for (int i = k; i < N; i++) h[i] = h[i] * scale + w->prior_weight * w->m->prior_prec[k][i];
        for (int i = 0; i < N; i++) pd += w->m->prior_prec[k][i] * d[i];
        q->g[k] = q->g[k] * scale + w->prior_weight * pd;
        prior += 0.5 * w->prior_weight * d[k] * pd;
    }
    q->cost = 0.5 * scale * w->parts[0].rho + prior;
    q->cost_before = 0.5 * scale * w->parts[0].rho_before + prior;
    believe_in_sky(w, q);
}

/* Cholesky factor of H + damping; fixed entries become identity rows. 0 if not positive definite. */
static int factor(state *w, const normal *q, double damping)
{
    for (int i = 0; i < N; i++)
        for (int j = 0; j <= i; j++) {
            double s = w->fixed[i] || w->fixed[j] ? i == j : ((const float *)q->h[j])[i];
            if (i == j) s += damping * (s > 0 ? s : 0) + 1e-6;
            for (int k = 0; k < j; k++) s -= w->l[i][k] * w->l[j][k];
            if (i == j && !(s > 1e-9)) return 0;
            w->l[i][j] = i == j ? sqrt(s) : s / w->l[j][j];
        }
    return 1;
}

static void solve(const state *w, double x[N])
{
    for (int i = 0; i < N; i++) {
        for (int k = 0; k < i; k++) x[i] -= w->l[i][k] * x[k];
        x[i] /= w->l[i][i];
    }
    for (int i = N - 1; i >= 0; i--) {
        for (int k = i + 1; k < N; k++) x[i] -= w->l[k][i] * x[k];
        x[i] /= w->l[i][i];
    }
}

/* Keeps a code where the model means something. */
static void confine(const state *w, float *code)
{
    if (!w->fixed[ORL_C_SUN_AZ]) code[ORL_C_SUN_AZ] = wrap(code[ORL_C_SUN_AZ]);
    for (int k = 1; k < N; k++) {
        if (w->fixed[k]) continue;
        if (k == ORL_C_SUN_EL) code[k] = clampf(code[k], -0.1f, 1.5f);
        else if (k < ORL_C_ENV) code[k] = clampf(code[k], -8, 6);
        else if (k < ORL_C_TONE) code[k] = clampf(code[k], -8, 8);
        else code[k] = clampf(code[k], -1.5f, 1.5f);
    }
}

typedef struct { float code[N]; double cost; int steps, status; } descent;

/* Descends from d->code; leaves the equations at the result in *last. */
static void descend(state *w, descent *d, float tau, float tau_end, int max_steps, size_t stride, normal **last)
{
    normal *at = &w->eq[0], *next = &w->eq[1];
    double lambda = 1e-3;
    evaluate(w, d->code, tau, tau, stride, at);
    d->status = ORL_ADAPT_ITERATIONS;
    for (d->steps = 0; d->steps < max_steps; d->steps++) {
        while (!factor(w, at, lambda)) if ((lambda *= 10) > 1e8) { d->status = ORL_ADAPT_DEGENERATE; goto done; }
        double x[N];
        for (int k = 0; k < N; k++) x[k] = w->fixed[k] ? 0 : -at->g[k];
        solve(w, x);
        double longest = 1;                                                     /* no step beyond half a radian of sun or 1.5 units of anything else */
        for (int k = 0; k < N; k++) {
            double in_units = fabs(x[k]) * (k < ORL_C_SUN_RGB ? 2 : 1 / 1.5);
            if (in_units > longest) longest = in_units;
        }
        descent trial = *d;
        for (int k = 0; k < N; k++) trial.code[k] += (float)(x[k] / longest);
        confine(w, trial.code);
        float shrunk = fmaxf(tau_end, 0.6f * tau);
        evaluate(w, trial.code, tau, shrunk, stride, next);
        double gain = at->cost - next->cost_before;
        int settled = tau <= tau_end && fabs(gain) < (double)w->enough * at->cost + 1e-9;
        if (gain >= 0) {
            memcpy(d->code, trial.code, sizeof d->code);
            normal *swap = at;
            at = next;
            next = swap;
            lambda = fmax(lambda * 0.2, 1e-7);
            tau = shrunk;
        } else if ((lambda = fmax(lambda, 1e-4) * 8) > 1e6) settled = 1;
        if (settled) { d->status = ORL_ADAPT_CONVERGED; d->steps++; break; }
    }
done:
    d->cost = at->cost;
    *last = at;
}

int orl_adapt_telling(const float c[3])
{
    int black = c[0] < 3.0f / 255 && c[1] < 3.0f / 255 && c[2] < 3.0f / 255, burnt = c[0] >= 250.0f / 255 && c[1] >= 250.0f / 255 && c[2] >= 250.0f / 255;
    return !black && !burnt;
}

/* Does the photo say anything: some samples neither black nor burnt out. */
static int informative(const orl_sample *s, size_t n)
{
    double all = 0, good = 0;
    for (size_t i = 0; i < n; i++) {
        if (!usable(&s[i])) continue;
        all += s[i].weight;
        if (orl_adapt_telling(s[i].rgb)) good += s[i].weight;
    }
    return all > 0 && good > 0.005 * all;
}

/* A black-and-white photo: the three channels alike in nearly all samples. */
static int colourless(const orl_sample *s, size_t n)
{
    double all = 0, grey = 0;
    for (size_t i = 0; i < n; i++) {
        if (!usable(&s[i])) continue;
        const float *c = s[i].rgb, off = 2.5f / 255;
        all += s[i].weight;
        if (fabsf(c[0] - c[1]) < off && fabsf(c[1] - c[2]) < off && fabsf(c[2] - c[0]) < off) grey += s[i].weight;
    }
    return all > 0 && grey > 0.98 * all;
}

/* One tone for all channels, the mean of theirs: what the photo does not show turns grey, too. */
static void drain(float code[N])
{
    float *a = code + ORL_C_TONE, *b = a + 9;
    float mean = (b[0] + b[1] + b[2]) / 3;
    for (int k = 0; k < 3; k++) {
        float in = (a[k] + a[3 + k] + a[6 + k] + 1) / 3;        /* of A = I + A' */
        for (int c = 0; c < 3; c++) a[3 * c + k] = in - (float)(c == k);
        b[k] = mean;
    }
}

static float per_sample(const normal *q, double cost)
{
    double samples = q->weight > 0 ? q->weight : 1;
    return (float)(cost / (samples < INDEPENDENT ? samples : INDEPENDENT));
}

static void finish(state *w, const descent *d, const normal *q, int steps, orl_adapt_result *out)
{
    memcpy(out->code, d->code, sizeof out->code);
    double samples = q->weight > 0 ? q->weight : 1;
    out->cost = per_sample(q, d->cost);
    out->rms = q->kept > 0 ? (float)sqrt(q->square / (3 * q->kept)) : 0;
    out->inliers = (float)(q->kept / samples);
    out->iterations = steps;
    out->status = (orl_adapt_status)d->status;
    int definite = factor(w, q, 0);
    for (int k = 0; k < N; k++) {               /* of the inverse's diagonal: the squared length of a column of L's inverse */
        double x[N] = { 0 }, sum = 0;
        x[k] = 1;
        for (int i = k; definite && i < N; i++) {
            for (int j = k; j < i; j++) x[i] -= w->l[i][j] * x[j];
            x[i] /= w->l[i][i];
            sum += x[i] * x[i];
        }
        out->std[k] = w->fixed[k] ? 0 : (float)sqrt(definite ? sum : 1);
    }
}

typedef struct { state *desk[DESKS]; descent *start; int count, steps; size_t stride; } trying;

static void copy_task(state *to, const state *w)
{
    to->m = w->m;
    to->s = w->s;
    to->n = w->n;
    to->prior_weight = w->prior_weight;
    to->sigma = w->sigma;
    to->enough = w->enough;
    to->threads = 1;
    memcpy(to->fixed, w->fixed, sizeof to->fixed);
}

/* Desk k takes every DESKS-th start. */
static void try_starts(void *user, int begin, int end)
{
    const trying *j = user;
    for (int k = begin; k < end; k++)
        for (int i = k; i < j->count; i += DESKS) {
            normal *q;
            descend(j->desk[k], &j->start[i], TAU_COARSE, TAU_MIDDLE, j->steps, j->stride, &q);
        }
}

static orl_err short_of_work(size_t bytes) { return orl_fail(ORL_E_MEMORY, "adapt: work block of %zu bytes, %zu needed, aligned to 64", bytes, orl_adapt_need()); }
static orl_err out_of_range(const orl_adapt_options *o) { return orl_fail(ORL_E_RANGE, "adapt: sigma %g, prior weight %g or %d azimuths out of range", o->sigma, o->prior_weight, o->azimuths); }

static int begin(state *w, const orl_light_model *m, const orl_sample *s, size_t n, const orl_adapt_options *o)
{
    if (!(o->sigma > 0) || !(o->prior_weight >= 0) || o->azimuths < 0 || o->azimuths > 64) return 0;
    w->m = m;
    w->s = s;
    w->n = n;
    w->prior_weight = o->prior_weight;
    w->sigma = o->sigma;
    w->enough = o->enough;
    w->threads = o->threads;
    for (int k = 0; k < N; k++)
        w->fixed[k] = (k < ORL_C_SHADOW && (o->frozen & 1)) || (k >= ORL_C_SHADOW && k < ORL_C_TONE && (o->frozen & 2)) || (k >= ORL_C_TONE && (o->frozen & 4)) || (k < ORL_C_SUN_RGB && (o->frozen & 8));
    return 1;
}

orl_err orl_adapt_cost(const orl_light_model *m, const orl_sample *s, size_t n, const float code[ORL_CODE], const orl_adapt_options *opt, void *work, size_t work_bytes, float *cost)
{
    orl_adapt_options o = opt ? *opt : orl_adapt_defaults();
    state *w = work;
    if (work_bytes < orl_adapt_need() || ((uintptr_t)work & 63)) return short_of_work(work_bytes);
    if (!begin(w, m, s, n, &o)) return out_of_range(&o);
    evaluate(w, code, TAU_SIGMAS * o.sigma, TAU_SIGMAS * o.sigma, 1, &w->eq[0]);
    *cost = per_sample(&w->eq[0], w->eq[0].cost);
    return ORL_OK;
}

orl_err orl_adapt(const orl_light_model *m, const orl_sample *s, size_t n, const float *init,
                  const orl_adapt_options *opt, void *work, size_t work_bytes, orl_adapt_result *out)
{
    if (work_bytes < orl_adapt_need() || ((uintptr_t)work & 63)) return short_of_work(work_bytes);
    orl_adapt_options o = opt ? *opt : orl_adapt_defaults();
    state *w = work;
    if (!begin(w, m, s, n, &o)) return out_of_range(&o);
    descent from = { .cost = 0 }, best[2] = { { .cost = INFINITY }, { .cost = INFINITY } };
    for (int k = 0; k < N; k++) from.code[k] = init && init[k] - init[k] == 0 ? init[k] : m->prior_mean[k];
    confine(w, from.code);
    normal *q = &w->eq[0];
    float tau_end = TAU_SIGMAS * o.sigma;
    int steps = 0;
    if (!informative(s, n)) {
        w->n = 0;
        from.status = ORL_ADAPT_DEGENERATE;
        evaluate(w, from.code, tau_end, tau_end, 1, q);
        from.cost = q->cost;
        finish(w, &from, q, 0, out);
        return ORL_OK;
    }
    if (init || o.azimuths == 0) {
        best[0] = from;
        descend(w, &best[0], 1.6f * tau_end, tau_end, o.max_iterations, 1, &q);
        finish(w, &best[0], q, best[0].steps, out);
    } else {
        static const float ELEVATION[2] = { 0.45f, 1.0f };
        size_t stride = n > COARSE_SAMPLES ? n / COARSE_SAMPLES : 1;
        int turn = !w->fixed[ORL_C_SUN_AZ];
        descent start[STARTS];
        trying j = { { w }, start, turn ? 2 * o.azimuths : 1, o.max_iterations < COARSE_STEPS ? o.max_iterations : COARSE_STEPS, stride };
        for (int k = 1; k < DESKS; k++) {
            j.desk[k] = (state *)((char *)work + (size_t)k * room());
            copy_task(j.desk[k], w);
        }
        for (int i = 0; i < j.count; i++) {
            start[i] = from;
            if (!turn) continue;
            start[i].code[ORL_C_SUN_AZ] = wrap((float)(i / 2) * (2 * PI / (float)o.azimuths));
            start[i].code[ORL_C_SUN_EL] = ELEVATION[i % 2];
        }
        orl_parallel(o.threads, DESKS, 1, try_starts, &j);
        for (int i = 0; i < j.count; i++) {
            const descent *d = &start[i];
            steps += d->steps;
            if (d->status == ORL_ADAPT_DEGENERATE) continue;
            int same = fabsf(wrap(d->code[0] - best[0].code[0])) < 0.3f;        /* the runner-up should stand elsewhere */
            if (d->cost < best[0].cost) {
                if (!same) best[1] = best[0];
                best[0] = *d;
            } else if (!same && d->cost < best[1].cost) best[1] = *d;
        }
        float tau = fmaxf(TAU_MIDDLE, tau_end);
        orl_adapt_result r[2];
        int found = 0;
        for (int b = 0; b < 2 && best[b].cost < INFINITY; b++) {
            descend(w, &best[b], tau, tau_end, o.max_iterations, 1, &q);
            steps += best[b].steps;
            finish(w, &best[b], q, 0, &r[b]);
            found++;
        }
        if (found) *out = found == 2 && r[1].cost < r[0].cost && r[1].status != ORL_ADAPT_DEGENERATE ? r[1] : r[0];
        else {
            from.status = ORL_ADAPT_DEGENERATE;
            finish(w, &from, q, 0, out);
        }
        out->iterations = steps;
    }
    if (out->status == ORL_ADAPT_DEGENERATE) memcpy(out->code, from.code, sizeof out->code);
    else if (!w->fixed[ORL_C_TONE] && colourless(s, n)) drain(out->code);
    return ORL_OK;
}
