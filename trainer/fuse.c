/* Oriented points of many photos to one surface (fuse.h).
 *
 * Distance: implicit moving least squares (Kolluri 2005), made robust after Oeztireli, Guennebaud and Gross (2009). At a query point x,
 *   f(x) = sum_i w_i n_i . (x - p_i) / sum_i w_i,   w_i = weight_i * exp(-tangential distance^2 / 2 SPREAD^2) * exp(-(n_i . (x - p_i) - f)^2 / 2 SHEET^2),
 * where the last factor, absent in the first of ROUNDS evaluations, takes other sheets and gross errors out.
 * Visibility: a point that lies well before what other photos measure along the same rays is no surface (Merrell et al. 2007). */
#include "trainer/fuse.h"
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "oriel/parallel.h"

enum { BIN = 2, ROUNDS = 3 };
#define REACH 3.0f              /* fine cells: points farther than this say nothing */
#define SPREAD 1.0f
#define SHEET 1.0f
#define AROUND 1.5f             /* as SPREAD, for normals */
#define ENOUGH 1.5f             /* sum of weights that makes half of full confidence */
#define SEEN_THROUGH 0.03f      /* share of its distance by which a point must lie before what a photo measures */
#define SAME 0.012f

orl_err fuse_init(fuse *f, const stereo *st, const int dims[3])
{
    size_t bins = 1;
    memset(f, 0, sizeof *f);
    f->points = st->points;
    for (int a = 0; a < 3; a++) bins *= (size_t)(f->n[a] = dims[a] / BIN + 1);
    f->begin = calloc(bins + 2, sizeof *f->begin);
    f->index = malloc(((size_t)st->npoints + 1) * sizeof *f->index);
    if (!f->begin || !f->index) { fuse_free(f); return orl_fail(ORL_E_MEMORY, "fusion: no memory for %zu bins", bins); }
    for (int place = 0; place < 2; place++) {   /* counting sort: sizes, their running sum, places */
        for (uint32_t i = 0; i < st->npoints; i++) {
            const float *x = st->points[i].x;
            size_t b = 0;
            int out = 0;
            for (int a = 2; a >= 0; a--) {
                out |= !(x[a] >= 0) || x[a] > (float)dims[a];
                if (!out) b = b * (size_t)f->n[a] + (size_t)((int)x[a] / BIN);
            }
            if (out) continue;
            if (place) f->index[f->begin[b + 1]++] = i;
            else f->begin[b + 2]++;
        }
        for (size_t b = 2; !place && b < bins + 2; b++) f->begin[b] += f->begin[b - 1];
    }
    return ORL_OK;
}

void fuse_free(fuse *f)
{
    free(f->begin);
    free(f->index);
    memset(f, 0, sizeof *f);
}

typedef struct { float h, tangent2, weight; const stereo_point *p; } near_point;

/* Points within REACH of x, at most cap, on the given side. */
static int gather(const fuse *f, const float x[3], const float side[3], near_point *out, int cap)
{
    int lo[3], hi[3], n = 0;
    for (int a = 0; a < 3; a++) {
        lo[a] = (int)floorf((x[a] - REACH) / BIN);
        hi[a] = (int)floorf((x[a] + REACH) / BIN);
        lo[a] = lo[a] < 0 ? 0 : lo[a];
        hi[a] = hi[a] >= f->n[a] ? f->n[a] - 1 : hi[a];
    }
    for (int bz = lo[2]; bz <= hi[2]; bz++)
        for (int by = lo[1]; by <= hi[1]; by++) {
            size_t row = ((size_t)bz * (size_t)f->n[1] + (size_t)by) * (size_t)f->n[0];
            if (hi[0] < lo[0]) continue;
            for (uint32_t k = f->begin[row + (size_t)lo[0]], end = f->begin[row + (size_t)hi[0] + 1]; k < end && n < cap; k++) {
                const stereo_point *p = &f->points[f->index[k]];
                float d[3] = { x[0] - p->x[0], x[1] - p->x[1], x[2] - p->x[2] }, d2 = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
                if (d2 > REACH * REACH || p->n[0] * side[0] + p->n[1] * side[1] + p->n[2] * side[2] <= 0) continue;
                near_point *q = &out[n++];
                q->h = p->n[0] * d[0] + p->n[1] * d[1] + p->n[2] * d[2];
                q->tangent2 = d2 - q->h * q->h;
                q->weight = p->weight;
                q->p = p;
            }
        }
    return n;
}

float fuse_distance(const fuse *f, const float x[3], const float side[3], float *sure)
{
    enum { CAP = 512 };
    near_point near[CAP];
    int n = gather(f, x, side, near, CAP);
    float value = 0, total = 0;
    for (int i = 0; i < n; i++) near[i].weight *= expf(-near[i].tangent2 / (2 * SPREAD * SPREAD));
    for (int round = 0; round < ROUNDS; round++) {
        float sum = 0;
        total = 0;
        for (int i = 0; i < n; i++) {
            float off = near[i].h - value, w = near[i].weight * (round ? expf(-off * off / (2 * SHEET * SHEET)) : 1);
            sum += w * near[i].h;
            total += w;
        }
        if (total < 1e-6f) { *sure = 0; return 0; }
        value = sum / total;
    }
    *sure = total / (total + ENOUGH);
    return value;
}

/* ---- cleaning ---- */

static int unit(float v[3])
{
    float len = sqrtf(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    if (!(len > 1e-9f)) return 0;
    for (int a = 0; a < 3; a++) v[a] /= len;
    return 1;
}

typedef struct {
    const world *w;
    stereo *st;
    float **range;                  /* per photo at half size: distance of the nearest stereo point, 0 = none */
    uint8_t *drop;
    fuse f;
    float (*normal)[3];
} clean_job;

static int raster(const world_photo *p, const float x[3], size_t *at)
{
    double uv[2];
    if (!world_project(p, x, uv, NULL) || !(uv[0] >= 0) || !(uv[1] >= 0) || uv[0] >= p->w || uv[1] >= p->h) return 0;
    *at = (size_t)((int)uv[1] / 2) * (size_t)(p->w / 2 + 1) + (size_t)((int)uv[0] / 2);
    return 1;
}

static float distance_to(const world_photo *p, const float x[3])
{
    float d2 = 0;
    for (int a = 0; a < 3; a++) d2 += (x[a] - (float)p->centre[a]) * (x[a] - (float)p->centre[a]);
    return sqrtf(d2);
}

static void range_photos(void *user, int begin, int end)
{
    clean_job *j = user;
    for (int k = begin; k < end; k++) {
        const world_photo *p = &j->w->photos[k];
        float *r = j->range[k] = calloc((size_t)(p->w / 2 + 1) * (size_t)(p->h / 2 + 1), sizeof *r);
        for (uint32_t i = j->st->begin[k]; r && i < j->st->begin[k + 1]; i++) {
            size_t at;
            float d = distance_to(p, j->st->points[i].x);
            if (raster(p, j->st->points[i].x, &at) && (r[at] <= 0 || d < r[at])) r[at] = d;
        }
    }
}

static void judge_points(void *user, int begin, int end)
{
    clean_job *j = user;
    for (int i = begin; i < end; i++) {
        const stereo_point *q = &j->st->points[i];
        int same = 0, through = 0;
        for (int k = 0; k < j->w->nphotos; k++) {
            const world_photo *p = &j->w->photos[k];
            size_t at;
            if (k == (int)q->photo || !j->range[k] || !raster(p, q->x, &at) || j->range[k][at] <= 0) continue;
            float d = distance_to(p, q->x), r = j->range[k][at];
            if (fabsf(r - d) < SAME * d) same++;
            else if (r > (1 + SEEN_THROUGH) * d) through++;
        }
        j->drop[i] = through > same;
    }
}

/* A point's normal anew, from the places of the points around: least axis of their covariance, by power iteration on its complement from their mean normal on. */
static void refit_points(void *user, int begin, int end)
{
    enum { CAP = 256, ENOUGH_POINTS = 8, ITERATIONS = 24 };
    const clean_job *j = user;
    near_point near[CAP];
    for (int i = begin; i < end; i++) {
        const stereo_point *q = &j->st->points[i];
        float v[3] = { 0 }, centre[3] = { 0 }, total = 0, m[6] = { 0 };
        int n = gather(&j->f, q->x, q->n, near, CAP);
        for (int k = 0; k < n; k++) {
            const float *x = near[k].p->x, d[3] = { x[0] - q->x[0], x[1] - q->x[1], x[2] - q->x[2] }, h = near[k].h;
            float w = near[k].weight * expf(-near[k].tangent2 / (2 * AROUND * AROUND) - h * h / (2 * SHEET * SHEET));
            for (int a = 0; a < 3; a++) { v[a] += w * near[k].p->n[a]; centre[a] += w * d[a]; }
            total += w;
            m[0] += w * d[0] * d[0]; m[1] += w * d[0] * d[1]; m[2] += w * d[0] * d[2]; m[3] += w * d[1] * d[1]; m[4] += w * d[1] * d[2]; m[5] += w * d[2] * d[2];
        }
        float *out = j->normal[i], mean[3];
        memcpy(out, q->n, 3 * sizeof *out);
        if (!(total > 0) || !unit(v)) continue;
        memcpy(mean, v, sizeof mean);
        memcpy(out, v, sizeof v);
        if (n < ENOUGH_POINTS) continue;
        for (int a = 0; a < 3; a++) centre[a] /= total;
        float c[6] = { m[0] / total - centre[0] * centre[0], m[1] / total - centre[0] * centre[1], m[2] / total - centre[0] * centre[2], m[3] / total - centre[1] * centre[1],
                       m[4] / total - centre[1] * centre[2], m[5] / total - centre[2] * centre[2] }, trace = c[0] + c[3] + c[5];
        for (int k = 0; k < ITERATIONS; k++) {
            float u[3] = { (trace - c[0]) * v[0] - c[1] * v[1] - c[2] * v[2], (trace - c[3]) * v[1] - c[1] * v[0] - c[4] * v[2], (trace - c[5]) * v[2] - c[2] * v[0] - c[4] * v[1] };
            if (!unit(u)) break;
            memcpy(v, u, sizeof v);
        }
        if (v[0] * mean[0] + v[1] * mean[1] + v[2] * mean[2] > 0.5f) memcpy(out, v, sizeof v);
    }
}

orl_err fuse_clean(stereo *st, const world *w, int threads)
{
    clean_job j = { .w = w, .st = st };
    size_t photos = (size_t)w->nphotos;
    orl_err e = ORL_OK;
    if (!st->npoints) return ORL_OK;
    j.range = calloc(photos, sizeof *j.range);
    j.drop = calloc(st->npoints, 1);
    j.normal = malloc((size_t)st->npoints * sizeof *j.normal);
    if (!j.range || !j.drop || !j.normal) { e = orl_fail(ORL_E_MEMORY, "fusion: no memory for %u points", st->npoints); goto done; }
    orl_parallel(threads, w->nphotos, 1, range_photos, &j);
    orl_parallel(threads, (int)st->npoints, 4096, judge_points, &j);
    uint32_t n = 0;
    for (int k = 0; k < w->nphotos; k++) {
        uint32_t begin = st->begin[k], end = st->begin[k + 1];
        st->begin[k] = n;
        for (uint32_t i = begin; i < end; i++) if (!j.drop[i]) st->points[n++] = st->points[i];
    }
    st->begin[w->nphotos] = st->npoints = n;
    if ((e = fuse_init(&j.f, st, w->frame.dims))) goto done;
    orl_parallel(threads, (int)n, 4096, refit_points, &j);
    for (uint32_t i = 0; i < n; i++) memcpy(st->points[i].n, j.normal[i], sizeof st->points[i].n);
done:
    for (int k = 0; j.range && k < w->nphotos; k++) free(j.range[k]);
    free(j.range);
    free(j.drop);
    free(j.normal);
    fuse_free(&j.f);
    return e;
}
