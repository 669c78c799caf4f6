/* Trainable grids: dense in address, sparse in memory.
 *
 * A grid holds c floats at each vertex of a regular lattice whose cell is `cell` fine cells wide. Vertices are stored in tiles of 4^3, so that a vertex's address is a sum of three table
 * entries (one per axis) and no index structure is needed. Arrays are mapped without reservation: tiles that nothing ever wrote cost nothing and read as zero. Nested grids add up
 * (coarse to fine); since each level's vertices contain the next coarser level's and interpolation is trilinear, the sum is exactly one trilinear grid at the finest level.
 *
 * Gradients are per thread and summed in thread order, so a run repeats for a given thread count. The optimiser visits only tiles that a batch touched. */
#ifndef TRAINER_GRID_H
#define TRAINER_GRID_H
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include "oriel/error.h"

#define GRID_THREADS 16
#define GRID_TILE 64                /* vertices in a tile */

typedef struct {
    int n[3];                       /* vertices per axis, multiple of a page's side (grid.c) */
    int c;                          /* floats per vertex */
    float cell, inv_cell;           /* in fine cells */
    float top[3];                   /* in vertices: what lies beyond is taken to here */
    uint32_t *ax, *ay, *az;         /* address tables */
    size_t nverts, ntiles;
    float *p, *m, *v;               /* parameters, Adam moments (m, v NULL if not trained) */
    float *g[GRID_THREADS];
    uint8_t *dirty[GRID_THREADS];   /* per tile */
    uint8_t *live;                  /* per tile: ever written */
    int threads;
} grid;

typedef struct { uint32_t i[8]; float fx, fy, fz; } grid_cell;

/* dims in fine cells (each a multiple of cell). threads = 0: not trained. */
orl_err grid_init(grid *g, const int dims[3], int cell, int c, int threads);
void grid_free(grid *g);
/* Sums gradients over all threads of all ranks, in that order; 0 if one is no number, or too large to be squared. Before any grid of a step is changed: then grid_adam for all of them, or grid_drop. */
int grid_sum(grid *g, int threads);
/* Adam with beta1 0.9, beta2 0.99 on touched vertices (no bias correction needed: the first step is lr by construction). Clears gradients. */
void grid_adam(grid *g, float lr, int threads);
/* Forgets the gradients. Parameters and moments that are no numbers become 0. */
void grid_drop(grid *g);
/* Between steps: gives the memory of gradients, which are zero, back. */
void grid_trim(grid *g);
/* Trained no more: values stay. */
void grid_freeze(grid *g);
orl_err grid_save(const grid *g, FILE *f, int moments);
orl_err grid_load(grid *g, FILE *f, int moments, const char *path);

static inline size_t grid_at(const grid *g, int x, int y, int z) { return (size_t)g->ax[x] + g->ay[y] + g->az[z]; }
static inline void grid_mark(grid *g, size_t vertex) { g->live[vertex / GRID_TILE] = 1; }

/* Cell of a point in fine-cell coordinates, clamped into the grid. */
static inline void grid_find(const grid *g, const float x[3], grid_cell *c)
{
    float q[3];
    int i[3];
    for (int a = 0; a < 3; a++) {
        float t = x[a] * g->inv_cell;
        t = t > 0 ? (t < g->top[a] ? t : g->top[a]) : 0;
        i[a] = (int)t;
        q[a] = t - (float)i[a];
    }
    uint32_t x0 = g->ax[i[0]], x1 = g->ax[i[0] + 1], y0 = g->ay[i[1]], y1 = g->ay[i[1] + 1], z0 = g->az[i[2]], z1 = g->az[i[2] + 1];
    c->i[0] = x0 + y0 + z0; c->i[1] = x1 + y0 + z0; c->i[2] = x0 + y1 + z0; c->i[3] = x1 + y1 + z0;
    c->i[4] = x0 + y0 + z1; c->i[5] = x1 + y0 + z1; c->i[6] = x0 + y1 + z1; c->i[7] = x1 + y1 + z1;
    c->fx = q[0]; c->fy = q[1]; c->fz = q[2];
}

static inline void grid_weights(const grid_cell *c, float w[8])
{
    float x1 = c->fx, x0 = 1 - x1, y1 = c->fy, y0 = 1 - y1, z1 = c->fz, z0 = 1 - z1;
    w[0] = x0 * y0 * z0; w[1] = x1 * y0 * z0; w[2] = x0 * y1 * z0; w[3] = x1 * y1 * z0;
    w[4] = x0 * y0 * z1; w[5] = x1 * y0 * z1; w[6] = x0 * y1 * z1; w[7] = x1 * y1 * z1;
}

/* Scalar grid: value at a point, gradient added to grad (per fine cell) where it is not NULL. */
static inline float grid_value(const grid *g, const grid_cell *c, float *grad)
{
    const float *p = g->p;
    float v0 = p[c->i[0]], v1 = p[c->i[1]], v2 = p[c->i[2]], v3 = p[c->i[3]], v4 = p[c->i[4]], v5 = p[c->i[5]], v6 = p[c->i[6]], v7 = p[c->i[7]];
    float d0 = v1 - v0, d1 = v3 - v2, d2 = v5 - v4, d3 = v7 - v6;
    float a0 = v0 + c->fx * d0, a1 = v2 + c->fx * d1, a2 = v4 + c->fx * d2, a3 = v6 + c->fx * d3;
    float e0 = a1 - a0, e1 = a3 - a2;
    float b0 = a0 + c->fy * e0, b1 = a2 + c->fy * e1;
    if (grad) {
        float s0 = d0 + c->fy * (d1 - d0), s1 = d2 + c->fy * (d3 - d2);
        grad[0] += (s0 + c->fz * (s1 - s0)) * g->inv_cell;
        grad[1] += (e0 + c->fz * (e1 - e0)) * g->inv_cell;
        grad[2] += (b1 - b0) * g->inv_cell;
    }
    return b0 + c->fz * (b1 - b0);
}

/* Scalar grid, reverse: d loss / d value and d loss / d gradient (NULL: none). */
static inline void grid_value_back(grid *g, int thread, const grid_cell *c, float dv, const float *dgrad)
{
    float w[8];
    grid_weights(c, w);
    float *o = g->g[thread];
    uint8_t *dirty = g->dirty[thread];
    for (int k = 0; k < 8; k++) w[k] *= dv;
    if (dgrad) {
        float x1 = c->fx, x0 = 1 - x1, y1 = c->fy, y0 = 1 - y1, z1 = c->fz, z0 = 1 - z1;
        float gx = dgrad[0] * g->inv_cell, gy = dgrad[1] * g->inv_cell, gz = dgrad[2] * g->inv_cell;
        float yz0 = gx * y0 * z0, yz1 = gx * y1 * z0, yz2 = gx * y0 * z1, yz3 = gx * y1 * z1;
        w[0] -= yz0; w[1] += yz0; w[2] -= yz1; w[3] += yz1; w[4] -= yz2; w[5] += yz2; w[6] -= yz3; w[7] += yz3;
        float xz0 = gy * x0 * z0, xz1 = gy * x1 * z0, xz2 = gy * x0 * z1, xz3 = gy * x1 * z1;
        w[0] -= xz0; w[2] += xz0; w[1] -= xz1; w[3] += xz1; w[4] -= xz2; w[6] += xz2; w[5] -= xz3; w[7] += xz3;
        float xy0 = gz * x0 * y0, xy1 = gz * x1 * y0, xy2 = gz * x0 * y1, xy3 = gz * x1 * y1;
        w[0] -= xy0; w[4] += xy0; w[1] -= xy1; w[5] += xy1; w[2] -= xy2; w[6] += xy2; w[3] -= xy3; w[7] += xy3;
    }
    for (int k = 0; k < 8; k++) {
        o[c->i[k]] += w[k];
        dirty[c->i[k] / GRID_TILE] = 1;
    }
}

typedef float v8 __attribute__((vector_size(32)));
typedef float v8u __attribute__((vector_size(32), aligned(4)));

/* Grid with c = 8 * nv floats a vertex: adds the interpolated vector to out. */
static inline void grid_vector(const grid *g, const grid_cell *c, int nv, v8 *out)
{
    float w[8];
    grid_weights(c, w);
    for (int k = 0; k < 8; k++) {
        const v8 *p = (const v8 *)(g->p + (size_t)c->i[k] * (size_t)(8 * nv));
        for (int j = 0; j < nv; j++) out[j] += w[k] * p[j];
    }
}

static inline void grid_vector_back(grid *g, int thread, const grid_cell *c, int nv, const v8 *d)
{
    float w[8];
    grid_weights(c, w);
    for (int k = 0; k < 8; k++) {
        v8 *o = (v8 *)(g->g[thread] + (size_t)c->i[k] * (size_t)(8 * nv));
        for (int j = 0; j < nv; j++) o[j] += w[k] * d[j];
        g->dirty[thread][c->i[k] / GRID_TILE] = 1;
    }
}

typedef float v4 __attribute__((vector_size(16)));

/* Grid with c = 4. */
static inline void grid_vector4(const grid *g, const grid_cell *c, v4 *out)
{
    float w[8];
    grid_weights(c, w);
    for (int k = 0; k < 8; k++) *out += w[k] * *(const v4 *)(g->p + (size_t)c->i[k] * 4);
}

static inline void grid_vector4_back(grid *g, int thread, const grid_cell *c, v4 d)
{
    float w[8];
    grid_weights(c, w);
    for (int k = 0; k < 8; k++) {
        *(v4 *)(g->g[thread] + (size_t)c->i[k] * 4) += w[k] * d;
        g->dirty[thread][c->i[k] / GRID_TILE] = 1;
    }
}

/* xorshift64* seeded by splitmix64: one stream per (seed, step, thread), so a run can resume at any step. */
typedef struct { uint64_t s; } rng;
static inline rng rng_make(uint64_t seed, uint64_t a, uint64_t b)
{
    uint64_t z = seed + 0x9e3779b97f4a7c15ull * (a + 1) + 0xd1342543de82ef95ull * (b + 1);
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9ull;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebull;
    rng r = { (z ^ (z >> 31)) | 1 };
    return r;
}
static inline uint32_t rng_u32(rng *r)
{
    r->s ^= r->s >> 12; r->s ^= r->s << 25; r->s ^= r->s >> 27;
    return (uint32_t)((r->s * 0x2545f4914f6cdd1dull) >> 32);
}
static inline float rng_f(rng *r) { return (float)(rng_u32(r) >> 8) * (1.0f / 16777216.0f); }
static inline uint32_t rng_below(rng *r, uint32_t n) { return (uint32_t)(((uint64_t)rng_u32(r) * n) >> 32); }
static inline float rng_normal(rng *r)
{
    float s = 0;
    for (int i = 0; i < 6; i++) s += rng_f(r);
    return (s - 3.0f) * 1.41421356f;
}
#endif
