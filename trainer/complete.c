/* Local planes (complete.h). Points are averaged over voxels; for every block of the hull's surface that no point lies near, the plane through a voxel and its normal that most of its
 * neighbourhood agrees on is refined by least squares. It must have enough support, little behind it (photos would have seen through it) and lie near the block. */
#include "trainer/complete.h"
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "oriel/parallel.h"

enum { VOXEL = 2, BLOCK = 8, TRIES = 64, REFITS = 3, LEAST = 40 };      /* VOXEL, BLOCK: fine cells */
#define REACH 16.0f             /* fine cells around a block: whence its plane */
#define THIN 1.0f               /* fine cells off a plane that still lie in it */
#define ALIKE 0.8f              /* cosine between its normal and theirs */
#define FRONT 2.0f              /* a plane may lie so far before the hull, */
#define BACK 12.0f              /* or so far behind it */
#define FACING 0.12f            /* cosine under which a ray only grazes a plane */
#define SOUND 8.0f              /* voxels, nearer ones counting more, that make a plane */
#define AGAINST 0.5f            /* what a voxel behind it takes off */
#define FIRM 0.5f               /* weight that makes a voxel count */

typedef struct { float x[3], n[3], w; } voxel;
typedef struct { float n[3], d; } plane;        /* n . x = d; the normal looks to where it is free */
typedef struct { plane in; int marked, sound; } cube;
typedef struct {
    const world *w; const stereo *st; const grid *hull;
    int nv[3], nb[3];
    uint32_t *at;                   /* per voxel of the lattice: index + 1 */
    voxel *v;
    cube *b;
    stereo_point **more; uint32_t *nmore;       /* of each photo */
    int failed, emit, step;         /* step: pixels between two rays */
} job;

static size_t place(const int n[3], const float x[3], float size)
{
    size_t at = 0;
    for (int a = 2; a >= 0; a--) {
        int i = (int)(x[a] / size);
        at = at * (size_t)n[a] + (size_t)(i < 0 ? 0 : i >= n[a] ? n[a] - 1 : i);
    }
    return at;
}

static int inside(const world *w, const float x[3]) { return x[0] >= 0 && x[1] >= 0 && x[2] >= 0 && x[0] <= (float)w->frame.dims[0] && x[1] <= (float)w->frame.dims[1] && x[2] <= (float)w->frame.dims[2]; }

/* NULL: holds too little. */
static const voxel *voxel_at(const job *j, int x, int y, int z)
{
    if (x < 0 || y < 0 || z < 0 || x >= j->nv[0] || y >= j->nv[1] || z >= j->nv[2]) return NULL;
    uint32_t at = j->at[((size_t)z * (size_t)j->nv[1] + (size_t)y) * (size_t)j->nv[0] + (size_t)x];
    return at && j->v[at - 1].w >= FIRM ? &j->v[at - 1] : NULL;
}

/* ---- planes ---- */

static float over(const plane *p, const float x[3]) { return p->n[0] * x[0] + p->n[1] * x[1] + p->n[2] * x[2] - p->d; }
static float alike(const plane *p, const voxel *v) { return p->n[0] * v->n[0] + p->n[1] * v->n[1] + p->n[2] * v->n[2]; }

/* Voxels that lie in it, the nearer to c and to it the more, less those behind it. 0: too far from c. */
static float plane_score(const plane *p, const voxel *const *near, int n, const float c[3])
{
    float in = 0, behind = 0, from = over(p, c);
    if (from > BACK + BLOCK / 2 || from < -FRONT - BLOCK / 2) return 0;
    for (int i = 0; i < n; i++) {
        float h = over(p, near[i]->x), same = alike(p, near[i]), away = 0;
        for (int a = 0; a < 3; a++) away += (near[i]->x[a] - c[a]) * (near[i]->x[a] - c[a]);
        float w = 1 / (1 + away / (0.25f * REACH * REACH));
        if (fabsf(h) < THIN && same > ALIKE) in += w * (1 - h * h / (THIN * THIN));
        else if (h < -2 * THIN && same > 0) behind += w;
    }
    return in - AGAINST * behind;
}

/* Least squares on the voxels that lie in p: through their mean, its normal their scatter's smallest eigenvector (inverse iteration, from p's). 0: too few. */
static int plane_fit(const plane *p, const voxel *const *near, int n, plane *out)
{
    double m[6] = { 0 }, mean[3] = { 0 }, count = 0;
    for (int pass = 0; pass < 2; pass++)
        for (int i = 0; i < n; i++) {
            const float *x = near[i]->x;
            if (!(fabsf(over(p, x)) < THIN) || !(alike(p, near[i]) > ALIKE)) continue;
            if (!pass) {
                for (int a = 0; a < 3; a++) mean[a] += x[a];
                count++;
                continue;
            }
            double e[3] = { x[0] - mean[0] / count, x[1] - mean[1] / count, x[2] - mean[2] / count };
            m[0] += e[0] * e[0]; m[1] += e[0] * e[1]; m[2] += e[0] * e[2]; m[3] += e[1] * e[1]; m[4] += e[1] * e[2]; m[5] += e[2] * e[2];
        }
    if (count < 4) return 0;
    memcpy(out->n, p->n, sizeof out->n);
    double t = 1e-6 * (m[0] + m[3] + m[5]) + 1e-12, a = m[0] + t, b = m[1], c = m[2], d = m[3] + t, e = m[4], f = m[5] + t;
    double i0 = d * f - e * e, i1 = c * e - b * f, i2 = b * e - c * d, i3 = a * f - c * c, i4 = b * c - a * e, i5 = a * d - b * b;     /* the inverse, but for a factor */
    for (int k = 0; k < 8; k++) {
        const float *v = out->n;
        double x = i0 * v[0] + i1 * v[1] + i2 * v[2], y = i1 * v[0] + i3 * v[1] + i4 * v[2], z = i2 * v[0] + i4 * v[1] + i5 * v[2], l = sqrt(x * x + y * y + z * z);
        if (!(l > 0)) return 0;
        out->n[0] = (float)(x / l); out->n[1] = (float)(y / l); out->n[2] = (float)(z / l);
    }
    out->d = (float)((out->n[0] * mean[0] + out->n[1] * mean[1] + out->n[2] * mean[2]) / count);
    return 1;
}

/* The best of TRIES planes through a voxel with its normal, refitted while that makes it better. */
static float plane_find(const voxel *const *near, int n, const float c[3], rng dice, plane *best)
{
    float most = 0;
    for (int k = 0; k < TRIES + REFITS; k++) {
        plane p = { .d = 0 };
        if (k < TRIES) {
            const voxel *v = near[rng_below(&dice, (uint32_t)n)];
            memcpy(p.n, v->n, sizeof p.n);
            p.d = over(&p, v->x);
        } else if (!(most > 0) || !plane_fit(best, near, n, &p)) break;
        float score = plane_score(&p, near, n, c);
        if (!(score > most)) continue;
        most = score;
        *best = p;
    }
    return most;
}

static void block_range(void *user, int begin, int end)
{
    enum { R = (int)REACH / VOXEL, SIDE = 2 * R + 1 };
    job *j = user;
    const voxel **near = malloc((size_t)SIDE * SIDE * SIDE * sizeof *near);
    if (!near) { __atomic_store_n(&j->failed, 1, __ATOMIC_RELAXED); return; }
    for (int i = begin; i < end; i++) {
        cube *b = &j->b[i];
        if (!b->marked) continue;
        int at[3] = { i % j->nb[0], i / j->nb[0] % j->nb[1], i / j->nb[0] / j->nb[1] }, q[3], n = 0;
        float c[3];
        for (int a = 0; a < 3; a++) {
            c[a] = (float)BLOCK * ((float)at[a] + 0.5f);
            q[a] = (int)c[a] / VOXEL;
        }
        for (int z = q[2] - R; z <= q[2] + R; z++)
            for (int y = q[1] - R; y <= q[1] + R; y++)
                for (int x = q[0] - R; x <= q[0] + R; x++) {
                    const voxel *v = voxel_at(j, x, y, z);
                    if (v) near[n++] = v;
                }
        b->sound = n >= LEAST && plane_find(near, n, c, rng_make(0xb10c, (uint64_t)i, 0), &b->in) > SOUND;
    }
    free(near);
}

/* ---- rays ---- */

/* Where a ray first meets the hull; t, 0 = nowhere. */
static float meet(const job *j, const float o[3], const float d[3], float x[3])
{
    float t, t1, before = 0;
    if (!box_clip(j->w->frame.dims, o, d, &t, &t1)) return 0;
    int out = 0;
    for (int k = 0; k < 512 && t < t1; k++) {
        for (int a = 0; a < 3; a++) x[a] = o[a] + t * d[a];
        grid_cell c;
        grid_find(j->hull, x, &c);
        float f = grid_value(j->hull, &c, NULL);
        if (f <= 0 && out) {
            float s = before / (before - f), back = fmaxf(0.9f * before, 0.5f) * (1 - s);
            t -= back;
            for (int a = 0; a < 3; a++) x[a] = o[a] + t * d[a];
            return t;
        }
        out |= f > 0;
        before = f;
        t += fmaxf(0.9f * f, 0.5f);
    }
    return 0;
}

static int bare(const job *j, const float x[3])
{
    int q[3];
    for (int a = 0; a < 3; a++) q[a] = (int)(x[a] / VOXEL);
    for (int k = 0; k < 27; k++) if (voxel_at(j, q[0] + k % 3 - 1, q[1] + k / 3 % 3 - 1, q[2] + k / 9 - 1)) return 0;
    return 1;
}

/* Every photo's rays through pixels that have no point of their own. emit 0: marks the blocks that they meet bare; 1: puts points on the blocks' planes. */
static void photo_range(void *user, int begin, int end)
{
    job *j = user;
    for (int k = begin; k < end; k++) {
        const world_photo *p = &j->w->photos[k];
        int step = j->step, hw = p->w / step + 1;
        uint32_t cap = 0, *has = stereo_hits(j->st, j->w, k, step);
        if (!has) { __atomic_store_n(&j->failed, 1, __ATOMIC_RELAXED); continue; }
        float o[3] = { (float)p->centre[0], (float)p->centre[1], (float)p->centre[2] };
        for (int y = 0; y + step <= p->h; y += step)
            for (int x = 0; x + step <= p->w; x += step) {
                if (has[y / step * hw + x / step] || world_label(p, x + step / 2, y + step / 2) == WORLD_SKY) continue;
                float d[3], at[3];
                world_ray(p, x + 0.5 * step, y + 0.5 * step, d);
                float t = meet(j, o, d, at);
                if (!(t > 0) || !bare(j, at)) continue;
                cube *b = &j->b[place(j->nb, at, BLOCK)];
                if (!j->emit) {
                    __atomic_store_n(&b->marked, 1, __ATOMIC_RELAXED);
                    continue;
                }
                if (!b->sound) continue;
                float facing = -(b->in.n[0] * d[0] + b->in.n[1] * d[1] + b->in.n[2] * d[2]), off = over(&b->in, at);
                if (!(facing > FACING) || off > BACK || off < -FRONT) continue;
                if (j->nmore[k] == cap) {
                    stereo_point *more = realloc(j->more[k], (cap = cap ? 2 * cap : 1024) * sizeof *more);
                    if (!more) {
                        __atomic_store_n(&j->failed, 1, __ATOMIC_RELAXED);
                        free(has);
                        return;
                    }
                    j->more[k] = more;
                }
                stereo_point *q = &j->more[k][j->nmore[k]++];
                for (int a = 0; a < 3; a++) { q->x[a] = at[a] + off / facing * d[a]; q->n[a] = b->in.n[a]; }
                q->photo = (uint32_t)k;
                q->weight = COMPLETE_WEIGHT;
            }
        free(has);
    }
}

/* ---- all of it ---- */

static orl_err voxels_make(job *j)
{
    uint32_t n = 0, cap = 0;
    for (uint32_t i = 0; i < j->st->npoints; i++) {
        const stereo_point *q = &j->st->points[i];
        if (!inside(j->w, q->x)) continue;
        uint32_t *at = &j->at[place(j->nv, q->x, VOXEL)];
        if (!*at) {
            if (n == cap) {
                voxel *more = realloc(j->v, (cap = cap ? 2 * cap : 1 << 16) * sizeof *more);
                if (!more) return orl_fail(ORL_E_MEMORY, "planes: no memory for %u voxels", cap);
                j->v = more;
            }
            j->v[n] = (voxel){ 0 };
            *at = ++n;
        }
        voxel *v = &j->v[*at - 1];
        for (int a = 0; a < 3; a++) { v->x[a] += q->weight * q->x[a]; v->n[a] += q->weight * q->n[a]; }
        v->w += q->weight;
    }
    for (uint32_t i = 0; i < n; i++) {
        voxel *v = &j->v[i];
        float l = sqrtf(v->n[0] * v->n[0] + v->n[1] * v->n[1] + v->n[2] * v->n[2]);
        for (int a = 0; a < 3; a++) { v->x[a] /= fmaxf(v->w, 1e-9f); v->n[a] /= fmaxf(l, 1e-9f); }
    }
    return ORL_OK;
}

/* Each photo's new points behind its own: from the last photo on, in place. */
static orl_err append(const job *j, stereo *st)
{
    size_t photos = (size_t)j->w->nphotos, all = st->npoints;
    for (size_t k = 0; k < photos; k++) all += j->nmore[k];
    uint32_t *found = malloc((photos + 1) * sizeof *found);
    stereo_point *points = found ? realloc(st->points, (all + 1) * sizeof *points) : NULL;
    if (!points) { free(found); return orl_fail(ORL_E_MEMORY, "planes: no memory for %zu points", all); }
    uint32_t end = st->npoints, to = (uint32_t)all;
    for (size_t k = photos; k-- > 0;) {
        uint32_t from = st->begin[k];
        found[k] = end - from;
        st->begin[k + 1] = to;
        to -= j->nmore[k];
        if (j->nmore[k]) memcpy(points + to, j->more[k], j->nmore[k] * sizeof *points);
        to -= found[k];
        memmove(points + to, points + from, found[k] * sizeof *points);
        end = from;
    }
    st->points = points;
    st->npoints = (uint32_t)all;
    st->found = found;
    return ORL_OK;
}

orl_err complete_planes(const world *w, stereo *st, const grid *hull, int threads)
{
    job j = { .w = w, .st = st, .hull = hull };
    size_t lattice = 1, blocks = 1, photos = (size_t)w->nphotos;
    for (int a = 0; a < 3; a++) {
        lattice *= (size_t)(j.nv[a] = w->frame.dims[a] / VOXEL + 1);
        blocks *= (size_t)(j.nb[a] = w->frame.dims[a] / BLOCK + 1);
    }
    j.step = world_ray_step(w);
    j.at = calloc(lattice, sizeof *j.at);
    j.b = calloc(blocks, sizeof *j.b);
    j.more = calloc(photos, sizeof *j.more);
    j.nmore = calloc(photos, sizeof *j.nmore);
    orl_err e = j.at && j.b && j.more && j.nmore ? voxels_make(&j) : orl_fail(ORL_E_MEMORY, "planes: no memory for %zu voxels", lattice);
    for (j.emit = 0; !e && j.emit < 2; j.emit++) {
        orl_parallel(threads, w->nphotos, 1, photo_range, &j);
        if (!j.failed && !j.emit) orl_parallel(threads, (int)blocks, 64, block_range, &j);
        if (j.failed) e = orl_fail(ORL_E_MEMORY, "planes: no memory");
    }
    if (!e) e = append(&j, st);
    for (size_t k = 0; j.more && k < photos; k++) free(j.more[k]);
    free(j.more);
    free(j.nmore);
    free(j.at);
    free(j.v);
    free(j.b);
    return e;
}
