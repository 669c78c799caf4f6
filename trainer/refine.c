/* Poses and lenses refined with the scene (refine.h).
 * Unknowns of a photo, counted from what was given: turn omega (camera axes, radians), shift tau (camera axes, fine cells), ln focal length, k1; a point in camera axes becomes
 * exp(omega) p - tau, first order. Residuals are differentiated numerically, each unknown by what moves the picture half a pixel: any lens model will do, and the photo needs no gradient image. */
#include "trainer/refine.h"
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "oriel/parallel.h"
#include "trainer/order.h"

enum { N = WORLD_FIX, PIXELS = 1000, ITERATIONS = 4, SIGHTINGS = 2000 };
#define PHOTO_SHARE 0.1         /* of a pixel's weight: its neighbours err alike, and so does the appearance model */
#define WORST 8.0               /* pixels: what is farther off is a wrong match, whatever the pose */

typedef struct { float x[3], rgb[3]; } target;          /* a surface point and its static colour in the photo */
typedef struct { const world *w; const world_photo *given; const target *t; int nt; double step[N], sigma_obs, sigma_rgb, cost; } problem;

/* Way along a ray to the SDF's first sign change; 0 if there is none. */
static int hit(const stage1 *s, const float o[3], const float d[3], float x[3])
{
    float t, t1, before = 0;
    if (!box_clip(s->w->frame.dims, o, d, &t, &t1)) return 0;
    for (int k = 0; k < 200 && t < t1; k++) {
        for (int a = 0; a < 3; a++) x[a] = o[a] + t * d[a];
        float f = stage1_sdf(s, x, NULL);
        if (!(f > 0)) {
            if (k == 0) return 0;
            float back = (t - before) * f / (f - stage1_sdf(s, (float[3]){ o[0] + before * d[0], o[1] + before * d[1], o[2] + before * d[2] }, NULL));
            for (int a = 0; a < 3; a++) x[a] -= back * d[a];
            return 1;
        }
        before = t;
        t += fmaxf(0.8f * f, 0.3f);
    }
    return 0;
}

static int find_targets(const stage1 *s, int k, rng *r, target *out)
{
    const world_photo *p = &s->w->photos[k];
    float o[3] = { (float)p->centre[0], (float)p->centre[1], (float)p->centre[2] }, d[3];
    int n = 0;
    for (int tries = 0; tries < 3 * PIXELS && n < PIXELS; tries++) {
        int x = (int)rng_below(r, (uint32_t)p->w), y = (int)rng_below(r, (uint32_t)p->h);
        uint8_t px[3];
        world_rgb(p, x, y, px);
        if (world_label(p, x, y) != WORLD_SCENE || stage1_transient(s, k, x + 0.5f, y + 0.5f) > 0.3f || px[0] >= 254 || px[1] >= 254 || px[2] >= 254 || px[0] + px[1] + px[2] < 6) continue;
        world_ray(p, x + 0.5, y + 0.5, d);
        if (!hit(s, o, d, out[n].x)) continue;
        stage1_colour(s, k, out[n].x, out[n].rgb);
        n++;
    }
    return n;
}

static int sample(const world_photo *p, const double uv[2], float rgb[3])
{
    float u = (float)uv[0] - 0.5f, v = (float)uv[1] - 0.5f;
    if (!(u >= 0 && v >= 0 && u < (float)(p->w - 1) && v < (float)(p->h - 1))) return 0;
    int x = (int)u, y = (int)v;
    float fu = u - (float)x, fv = v - (float)y;
    uint8_t px[4][3];
    for (int k = 0; k < 4; k++) world_rgb(p, x + (k & 1), y + (k >> 1), px[k]);
    for (int c = 0; c < 3; c++) rgb[c] = ((1 - fv) * ((1 - fu) * px[0][c] + fu * px[1][c]) + fv * ((1 - fu) * px[2][c] + fu * px[3][c])) * (1.0f / 255);
    return 1;
}

/* Residual of sighting or pixel i at a pose: its entries in units of sigma; 0: none. */
static int residual(const problem *q, const world_photo *p, int i, double r[3])
{
    double uv[2];
    int pixel = i - (int)p->obs_count;
    if (pixel < 0) {
        const world_obs *o = &q->w->obs[p->obs_begin + (uint32_t)i];
        if (!world_project(p, q->w->points[o->point].x, uv, NULL)) return 0;
        r[0] = (uv[0] - o->u) / q->sigma_obs;
        r[1] = (uv[1] - o->v) / q->sigma_obs;
        return 2;
    }
    const target *t = &q->t[pixel];
    float rgb[3];
    if (!world_project(p, t->x, uv, NULL) || !sample(p, uv, rgb)) return 0;
    for (int c = 0; c < 3; c++) r[c] = (rgb[c] - t->rgb[c]) / q->sigma_rgb;
    return 3;
}

static world_photo moved(const world_photo *given, const double fix[N])
{
    world_photo p = *given;
    memcpy(p.fix, fix, sizeof p.fix);
    world_correct(&p);
    return p;
}

/* Normal equations and cost at fix; weights are Cauchy's. A NULL: cost only. Gone: what leaves the picture costs as much as an outlier of three sigma. */
static double normal_equations(const problem *q, const double fix[N], double A[N][N], double b[N])
{
    world_photo p = moved(q->given, fix), side[2 * N];
    int count = (int)p.obs_count + q->nt, stride = p.obs_count > SIGHTINGS ? (int)(p.obs_count / SIGHTINGS) : 1;
    double cost = 0, r[3], up[3] = { 0 }, down[3] = { 0 };
    for (int j = 0; A && j < 2 * N; j++) {
        double f[N];
        memcpy(f, fix, sizeof f);
        f[j / 2] += j & 1 ? -q->step[j / 2] : q->step[j / 2];
        side[j] = moved(q->given, f);
    }
    if (A) memset(A, 0, sizeof(double[N][N]));
    if (b) memset(b, 0, sizeof(double[N]));
    for (int i = 0; i < count; i += i < (int)p.obs_count ? stride : 1) {
        int pixel = i >= (int)p.obs_count, n = residual(q, &p, i, r);
        double share = pixel ? PHOTO_SHARE : 1, rr = 9, J[N][3];
        if (n) for (int c = rr = 0; c < n; c++) rr += r[c] * r[c];
        cost += share * log1p(rr);
        if (!A || !n) continue;
        int whole = 1;
        for (int j = 0; j < N && whole; j++) {
            whole = residual(q, &side[2 * j], i, up) == n && residual(q, &side[2 * j + 1], i, down) == n;
            for (int c = 0; c < n; c++) J[j][c] = (up[c] - down[c]) / (2 * q->step[j]);
        }
        if (!whole) continue;
        double k = share / (1 + rr);
        for (int j = 0; j < N; j++) {
            for (int c = 0; c < n; c++) b[j] -= k * J[j][c] * r[c];
            for (int m = 0; m <= j; m++) for (int c = 0; c < n; c++) A[j][m] += k * J[j][c] * J[m][c];
        }
    }
    for (int j = 0; j < N; j++) {               /* a weak hold for what nothing determines: 20 pixels' worth */
        double h = 1 / (40 * q->step[j]);
        cost += h * h * fix[j] * fix[j];
        if (A) { A[j][j] += h * h; b[j] -= h * h * fix[j]; }
    }
    return cost;
}

/* x of (A + damping diag A) x = b by Cholesky; 0 if that is singular. */
static int solve(double A[N][N], const double b[N], double damping, double x[N])
{
    double L[N][N] = { { 0 } };
    for (int i = 0; i < N; i++)
        for (int j = 0; j <= i; j++) {
            double s = A[i][j] * (i == j ? 1 + damping : 1);
            for (int k = 0; k < j; k++) s -= L[i][k] * L[j][k];
            if (i == j && !(s > 0)) return 0;
            L[i][j] = i == j ? sqrt(s) : s / L[j][j];
        }
    for (int i = 0; i < N; i++) {
        x[i] = b[i];
        for (int k = 0; k < i; k++) x[i] -= L[i][k] * x[k];
        x[i] /= L[i][i];
    }
    for (int i = N - 1; i >= 0; i--) {
        for (int k = i + 1; k < N; k++) x[i] -= L[k][i] * x[k];
        x[i] /= L[i][i];
    }
    return 1;
}

/* Median size of the residuals from..to, for sigma = 1. */
static double scatter(const problem *q, const world_photo *p, int from, int to, double *v)
{
    int n = 0;
    double r[3];
    for (int i = from; i < to; i++) {
        int c = residual(q, p, i, r);
        if (c) v[n++] = sqrt((r[0] * r[0] + r[1] * r[1] + (c > 2 ? r[2] * r[2] : 0)) / c);
    }
    return order_percentile(v, (size_t)n, 0.5);
}

typedef struct { world *w; const stage1 *s; uint64_t seed; int round; } refine_job;

static void refine_range(void *user, int begin, int end)
{
    refine_job *job = user;
    for (int k = begin; k < end; k++) {
        world_photo *p = &job->w->photos[k];
        rng r = rng_make(job->seed, 0x9053 + (uint64_t)job->round, (uint64_t)k);
        target *t = malloc(PIXELS * sizeof *t);
        double *v = malloc((p->obs_count + PIXELS) * sizeof *v), depth = 0, z, uv[2], A[N][N], b[N], x[N], damping = 1e-3;
        int n = 0;
        if (!t || !v) { free(t); free(v); continue; }
        problem q = { .w = job->w, .given = p, .t = t, .sigma_obs = 1, .sigma_rgb = 1 };
        if (job->s) q.nt = find_targets(job->s, k, &r, t);
        for (uint32_t i = 0; i < p->obs_count; i++) if (world_project(p, job->w->points[job->w->obs[p->obs_begin + i].point].x, uv, &z)) v[n++] = z;
        depth = n ? order_percentile(v, (size_t)n, 0.5) : 0.5 * job->w->frame.dims[0];
        double px = 0.5 / p->cam.fx, half = 0.5 * p->w / p->cam.fx;
        for (int j = 0; j < 3; j++) { q.step[j] = px; q.step[3 + j] = px * depth; }
        q.step[5] /= half;                      /* forward, the picture moves less, */
        q.step[6] = px / half;                  /* and so with the focal length, */
        q.step[7] = px / (half * half * half);  /* and k1 */
        q.sigma_obs = fmax(1.5 * scatter(&q, p, 0, (int)p->obs_count, v), 0.1);
        q.sigma_rgb = fmax(1.5 * scatter(&q, p, (int)p->obs_count, (int)p->obs_count + q.nt, v), 0.02);
        if (p->obs_count + (uint32_t)q.nt < 30) { free(t); free(v); continue; }
        double fix[N], try[N], cost = 0;
        memcpy(fix, p->fix, sizeof fix);
        for (int i = 0; i < ITERATIONS; i++) {
            cost = normal_equations(&q, fix, A, b);
            int better = 0;
            for (int tries = 0; tries < 5 && !better; tries++, damping *= 10) {
                if (!solve(A, b, damping, x)) continue;
                for (int j = 0; j < N; j++) try[j] = fix[j] + x[j];
                better = normal_equations(&q, try, NULL, NULL) < cost;
            }
            if (!better) break;
            memcpy(fix, try, sizeof fix);
            damping *= 1e-2;
        }
        int sound = 1;
        for (int j = 0; j < N; j++) sound &= fabs(fix[j]) < 400 * q.step[j];        /* 200 pixels: no correction */
        if (sound) {
            memcpy(p->fix, fix, sizeof p->fix);
            world_correct(p);
        }
        free(t);
        free(v);
    }
}

static double reprojection(const world *w)
{
    double sum = 0, uv[2];
    uint32_t n = 0;
    for (int k = 0; k < w->nphotos; k++)
        for (uint32_t i = 0; i < w->photos[k].obs_count; i++, n++) {
            const world_obs *o = &w->obs[w->photos[k].obs_begin + i];
            double e = world_project(&w->photos[k], w->points[o->point].x, uv, NULL) ? hypot(uv[0] - o->u, uv[1] - o->v) : WORST;
            sum += fmin(e * e, WORST * WORST);
        }
    return n ? sqrt(sum / n) : 0;
}

void refine_photos(world *w, const stage1 *s, uint64_t seed, int round, int threads, refine_figures *out)
{
    refine_job job = { w, s, seed, round };
    memset(out, 0, sizeof *out);
    out->before = reprojection(w);
    orl_parallel(threads, w->nphotos, 1, refine_range, &job);
    out->after = reprojection(w);
    for (int k = 0; k < w->nphotos; k++) {
        const double *f = w->photos[k].fix;
        out->degrees += (f[0] * f[0] + f[1] * f[1] + f[2] * f[2]) / w->nphotos;
        out->cells += (f[3] * f[3] + f[4] * f[4] + f[5] * f[5]) / w->nphotos;
        out->focal += f[6] * f[6] / w->nphotos;
    }
    out->degrees = sqrt(out->degrees) * 180 / 3.14159265358979;
    out->cells = sqrt(out->cells);
    out->focal = sqrt(out->focal);
}

orl_err refine_save(const world *w, FILE *f)
{
    int bad = 0;
    for (int k = 0; k < w->nphotos; k++) bad |= fwrite(w->photos[k].fix, sizeof w->photos[k].fix, 1, f) != 1;
    return bad ? orl_fail(ORL_E_IO, "checkpoint: write failed") : ORL_OK;
}

orl_err refine_load(world *w, FILE *f, const char *path)
{
    for (int k = 0; k < w->nphotos; k++) {
        double fix[N];
        if (fread(fix, sizeof fix, 1, f) != 1) return orl_fail(ORL_E_FORMAT, "%s: corrections of photo %d are cut short", path, k);
        for (int j = 0; j < N; j++) if (!(fabs(fix[j]) < 1e4)) return orl_fail(ORL_E_RANGE, "%s: correction %d of photo %d is %g", path, j, k, fix[j]);
        memcpy(w->photos[k].fix, fix, sizeof fix);
        world_correct(&w->photos[k]);
    }
    return ORL_OK;
}
