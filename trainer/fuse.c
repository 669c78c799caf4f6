/* Oriented points of many photos to one surface (fuse.h).
 *
 * Distance: implicit moving least squares (Kolluri 2005), made robust after Oeztireli, Guennebaud and Gross (2009). At a query point x,
 *   f(x) = sum_i w_i n_i . (x - p_i) / sum_i w_i,   w_i = weight_i * exp(-tangential distance^2 / 2 SPREAD^2) * exp(-(n_i . (x - p_i) - f)^2 / 2 SHEET^2),
 * where the last factor, absent in the first of ROUNDS evaluations, takes other sheets and gross errors out.
 * Refitting normals to the points around was tried and made the surface worse. */
#include "trainer/fuse.h"
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { BIN = 2, ROUNDS = 3 };
#define REACH 3.0f              /* fine cells: points farther than this say nothing */
#define SPREAD 0.8f
#define SHEET 0.8f
#define FREE 2.0f               /* fine cells before the hull: other photos saw through there */
#define ENOUGH 1.5f             /* sum of weights that makes half of full confidence */

orl_err fuse_init(fuse *f, const stereo *st, const grid *hull, const int dims[3])
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
            grid_cell c;
            grid_find(hull, x, &c);
            if (grid_value(hull, &c, NULL) > FREE) continue;
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

typedef struct { float h, tangent2, weight; } near_point;

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
