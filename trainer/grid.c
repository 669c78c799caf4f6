/* Trainable grids (grid.h): memory, optimiser, checkpoint. */
#include "trainer/grid.h"
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include "oriel/parallel.h"
#include "trainer/ranks.h"

static void *map_zero(size_t bytes)
{
    void *p = mmap(NULL, bytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
    return p == MAP_FAILED ? NULL : p;
}

/* Tiles of 4^3 vertices lie in pages of 4 x 2 x 2, one of memory where a vertex is one float: a surface that crosses its longer side at right angles costs as little as the other ways. */
static const int PAGE[3] = { 4, 2, 2 };

static uint32_t *axis_table(int n, uint32_t vertex, uint32_t tile, int tiles, uint32_t block)
{
    uint32_t *t = malloc((size_t)n * sizeof *t);
    for (int i = 0; t && i < n; i++) t[i] = (uint32_t)(i & 3) * vertex + (uint32_t)(i / 4 % tiles) * tile + (uint32_t)(i / 4 / tiles) * block;
    return t;
}

orl_err grid_init(grid *g, const int dims[3], int cell, int c, int threads)
{
    memset(g, 0, sizeof *g);
    g->c = c;
    g->cell = (float)cell;
    g->inv_cell = 1.0f / (float)cell;
    g->threads = threads < GRID_THREADS ? threads : GRID_THREADS;
    for (int a = 0; a < 3; a++) g->n[a] = (dims[a] / cell + 4 * PAGE[a]) / (4 * PAGE[a]) * (4 * PAGE[a]);
    for (int a = 0; a < 3; a++) g->top[a] = (float)(dims[a] / cell > 0 ? dims[a] / cell - 1 : 0) + 0.9999f;
    g->nverts = (size_t)g->n[0] * (size_t)g->n[1] * (size_t)g->n[2];
    g->ntiles = g->nverts / GRID_TILE;
    if (g->nverts > UINT32_MAX) return orl_fail(ORL_E_RANGE, "grid of %d x %d x %d vertices is too large", g->n[0], g->n[1], g->n[2]);
    uint32_t step[3], tile = GRID_TILE;
    step[0] = GRID_TILE * (uint32_t)(PAGE[0] * PAGE[1] * PAGE[2]);
    for (int a = 1; a < 3; a++) step[a] = step[a - 1] * (uint32_t)(g->n[a - 1] / (4 * PAGE[a - 1]));
    g->ax = axis_table(g->n[0], 1, tile, PAGE[0], step[0]);
    g->ay = axis_table(g->n[1], 4, tile *= (uint32_t)PAGE[0], PAGE[1], step[1]);
    g->az = axis_table(g->n[2], 16, tile * (uint32_t)PAGE[1], PAGE[2], step[2]);
    size_t bytes = g->nverts * (size_t)c * sizeof(float);
    g->p = map_zero(bytes);
    g->live = map_zero(g->ntiles);
    int ok = g->ax && g->ay && g->az && g->p && g->live;
    if (ok && threads) {
        g->m = map_zero(bytes);
        g->v = map_zero(bytes);
        ok = g->m && g->v;
        for (int t = 0; ok && t < g->threads; t++) {
            g->g[t] = map_zero(bytes);
            g->dirty[t] = map_zero(g->ntiles + 8);
            ok = g->g[t] && g->dirty[t];
        }
    }
    if (ok) return ORL_OK;
    grid_free(g);
    return orl_fail(ORL_E_MEMORY, "no memory for a grid of %zu vertices", g->nverts);
}

static size_t grid_bytes(const grid *g) { return g->nverts * (size_t)g->c * sizeof(float); }

void grid_trim(grid *g)
{
    for (int t = 0; t < g->threads; t++) madvise(g->g[t], grid_bytes(g), MADV_DONTNEED);
}

void grid_freeze(grid *g)
{
    if (g->m) munmap(g->m, grid_bytes(g));
    if (g->v) munmap(g->v, grid_bytes(g));
    g->m = g->v = NULL;
    for (int t = 0; t < GRID_THREADS; t++) {
        if (g->g[t]) munmap(g->g[t], grid_bytes(g));
        if (g->dirty[t]) munmap(g->dirty[t], g->ntiles + 8);
        g->g[t] = NULL;
        g->dirty[t] = NULL;
    }
    g->threads = 0;
}

void grid_free(grid *g)
{
    grid_freeze(g);
    if (g->p) munmap(g->p, grid_bytes(g));
    if (g->live) munmap(g->live, g->ntiles);
    free(g->ax);
    free(g->ay);
    free(g->az);
    memset(g, 0, sizeof *g);
}

/* Tiles that a batch touched, ascending, with the sum of their gradients so far: goes from rank to rank. */
typedef struct { uint32_t n, cap; uint32_t *tile; float *sum; } tile_sums;

static void tile_sums_need(tile_sums *s, size_t n, size_t span)
{
    if (n <= s->cap) return;
    free(s->tile);
    free(s->sum);
    s->cap = (uint32_t)(n + n / 4);
    s->tile = malloc((size_t)s->cap * sizeof *s->tile);
    s->sum = malloc((size_t)s->cap * span * sizeof *s->sum);
    if (s->tile && s->sum) return;
    fprintf(stderr, "oriel-train: rank %d: no memory for gradients of %zu tiles\n", ranks_mine(), n);
    ranks_fail();
}

typedef struct { grid *g; const tile_sums *in, *out; const uint32_t *from; } fold_job;     /* from: in's entry of each of out's, or UINT32_MAX */

/* Adds this rank's threads to what the ranks before it found. */
static void fold_tiles(void *user, int begin, int end)
{
    const fold_job *job = user;
    grid *g = job->g;
    size_t span = (size_t)GRID_TILE * (size_t)g->c;
    for (int i = begin; i < end; i++) {
        size_t t = job->out->tile[i];
        float *sum = job->out->sum + (size_t)i * span;
        int any = job->from[i] != UINT32_MAX;
        if (any) memcpy(sum, job->in->sum + (size_t)job->from[i] * span, span * sizeof *sum);
        for (int k = 0; k < g->threads; k++) {
            float *gk = g->g[k] + t * span;
            if (!g->dirty[k][t]) continue;
            g->dirty[k][t] = 0;
            if (any) for (size_t q = 0; q < span; q++) sum[q] += gk[q];
            else memcpy(sum, gk, span * sizeof *sum);
            any = 1;
            memset(gk, 0, span * sizeof *gk);
        }
    }
}

/* A chain: each rank adds its threads' gradients to what it receives; the last one has them all and tells the others. Afterwards thread 0 holds the sum on every rank. */
static void sum_over_ranks(grid *g, int threads)
{
    static tile_sums in, out;
    static size_t span_was;
    size_t span = (size_t)GRID_TILE * (size_t)g->c, n = 0;
    int mine = ranks_mine(), last = ranks_count() - 1;
    if (span > span_was) { in.cap = out.cap = 0; span_was = span; }
    in.n = 0;
    if (mine > 0) {
        ranks_receive(mine - 1, &in.n, sizeof in.n);
        tile_sums_need(&in, in.n, span_was);
        ranks_receive(mine - 1, in.tile, in.n * sizeof *in.tile);
        ranks_receive(mine - 1, in.sum, in.n * span * sizeof *in.sum);
    }
    for (size_t t = 0; t < g->ntiles; t++) for (int k = 0; k < g->threads; k++) if (g->dirty[k][t]) { n++; break; }
    tile_sums_need(&out, n + in.n, span_was);
    uint32_t *from = malloc((n + in.n + 1) * sizeof *from), at = 0;
    out.n = 0;
    for (size_t t = 0; from && t < g->ntiles; t++) {
        int here = at < in.n && in.tile[at] == t, any = here;
        for (int k = 0; k < g->threads; k++) any |= g->dirty[k][t];
        if (!any) continue;
        from[out.n] = here ? at++ : UINT32_MAX;
        out.tile[out.n++] = (uint32_t)t;
    }
    if (!from) ranks_fail();
    orl_parallel(threads, (int)out.n, 64, fold_tiles, &(fold_job){ g, &in, &out, from });
    free(from);
    if (mine < last) {
        ranks_send(mine + 1, &out.n, sizeof out.n);
        ranks_send(mine + 1, out.tile, out.n * sizeof *out.tile);
        ranks_send(mine + 1, out.sum, out.n * span * sizeof *out.sum);
    }
    ranks_share(last, &out.n, sizeof out.n);
    tile_sums_need(&out, out.n, span_was);
    ranks_share(last, out.tile, out.n * sizeof *out.tile);
    ranks_share(last, out.sum, out.n * span * sizeof *out.sum);
    for (uint32_t i = 0; i < out.n; i++) {
        memcpy(g->g[0] + (size_t)out.tile[i] * span, out.sum + (size_t)i * span, span * sizeof *out.sum);
        g->dirty[0][out.tile[i]] = 1;
    }
}

/* The first tile from t on that a thread touched; eight are skipped at a time (dirty is padded). */
static int next_dirty(const grid *g, int t, int end)
{
    while (t < end) {
        uint64_t any = 0;
        for (int k = 0; k < g->threads; k++) {
            uint64_t eight;
            memcpy(&eight, g->dirty[k] + t, sizeof eight);
            any |= eight;
        }
        if (!any) { t += 8; continue; }
        int one = 0;
        for (int k = 0; k < g->threads; k++) one |= g->dirty[k][t];
        if (one) return t;
        t++;
    }
    return end;
}

typedef struct { grid *g; float lr; int bad; } tile_job;

static void sum_tiles(void *user, int begin, int end)
{
    tile_job *job = user;
    grid *g = job->g;
    size_t span = (size_t)GRID_TILE * (size_t)g->c;
    int sound = 1;
    for (int t = next_dirty(g, begin, end); t < end; t = next_dirty(g, t + 1, end)) {
        float *sum = NULL;
        for (int k = 0; k < g->threads; k++) {
            if (!g->dirty[k][t]) continue;
            float *gk = g->g[k] + (size_t)t * span;
            if (!sum) { sum = gk; continue; }
            g->dirty[k][t] = 0;
            for (size_t i = 0; i < span; i++) sum[i] += gk[i];
            memset(gk, 0, span * sizeof *gk);
        }
        for (size_t i = 0; i < span; i++) sound &= fabsf(sum[i]) < 1e15f;
    }
    if (!sound) __atomic_store_n(&job->bad, 1, __ATOMIC_RELAXED);
}

int grid_sum(grid *g, int threads)
{
    tile_job job = { .g = g };
    if (ranks_count() > 1) sum_over_ranks(g, threads);
    orl_parallel(threads, (int)g->ntiles, 512, sum_tiles, &job);
    return !job.bad;
}

enum { BLOCK = 16 };

static void adam_tiles(void *user, int begin, int end)
{
    tile_job *job = user;
    grid *g = job->g;
    size_t span = (size_t)GRID_TILE * (size_t)g->c;
    for (int t = next_dirty(g, begin, end); t < end; t = next_dirty(g, t + 1, end)) {
        g->live[t] = 1;
        int k = 0;
        while (!g->dirty[k][t]) k++;
        g->dirty[k][t] = 0;
        float *sum = g->g[k] + (size_t)t * span;
        float *p = g->p + (size_t)t * span, *m = g->m + (size_t)t * span, *v = g->v + (size_t)t * span;
        for (size_t at = 0; at < span; at += BLOCK) {
            int any = 0;
            for (size_t i = at; i < at + BLOCK; i++) any |= sum[i] != 0;
            if (!any) continue;                 /* parameters and moments of vertices that no ray touched are not even read */
            for (size_t i = at; i < at + BLOCK; i++) {
                float d = sum[i], touched = d != 0.0f ? 1.0f : 0.0f;
                float m1 = 0.9f * m[i] + 0.1f * d, v1 = 0.99f * v[i] + 0.01f * d * d;
                m[i] = touched != 0 ? m1 : m[i];
                v[i] = touched != 0 ? v1 : v[i];
                p[i] -= touched * job->lr * m1 / (sqrtf(v1) + 1e-12f);
            }
        }
        memset(sum, 0, span * sizeof *sum);
    }
}

void grid_adam(grid *g, float lr, int threads)
{
    tile_job job = { .g = g, .lr = lr };
    orl_parallel(threads, (int)g->ntiles, 512, adam_tiles, &job);
}

void grid_drop(grid *g)
{
    size_t span = (size_t)GRID_TILE * (size_t)g->c;
    for (size_t t = 0; t < g->ntiles; t++) {
        for (int k = 0; k < g->threads; k++) {
            if (g->dirty[k][t]) memset(g->g[k] + t * span, 0, span * sizeof(float));
            g->dirty[k][t] = 0;
        }
        float *all[3] = { g->p + t * span, g->m + t * span, g->v + t * span };
        for (int a = 0; g->live[t] && a < 3; a++) for (size_t i = 0; i < span; i++) if (!isfinite(all[a][i])) all[a][i] = 0;
    }
}

orl_err grid_save(const grid *g, FILE *f, int moments)
{
    size_t span = (size_t)GRID_TILE * (size_t)g->c;
    int bad = fwrite(g->n, sizeof g->n, 1, f) != 1 || fwrite(&g->c, sizeof g->c, 1, f) != 1 || fwrite(g->live, 1, g->ntiles, f) != g->ntiles;
    for (size_t t = 0; !bad && t < g->ntiles; t++) {
        if (!g->live[t]) continue;
        bad |= fwrite(g->p + t * span, sizeof(float), span, f) != span;
        if (moments) bad |= fwrite(g->m + t * span, sizeof(float), span, f) != span || fwrite(g->v + t * span, sizeof(float), span, f) != span;
    }
    return bad ? orl_fail(ORL_E_IO, "checkpoint: write failed") : ORL_OK;
}

orl_err grid_load(grid *g, FILE *f, int moments, const char *path)
{
    int n[3], c;
    size_t span = (size_t)GRID_TILE * (size_t)g->c;
    if (fread(n, sizeof n, 1, f) != 1 || fread(&c, sizeof c, 1, f) != 1) return orl_fail(ORL_E_FORMAT, "%s: grid header is cut short", path);
    if (memcmp(n, g->n, sizeof n) || c != g->c) return orl_fail(ORL_E_FORMAT, "%s: grid is %d x %d x %d x %d, expected %d x %d x %d x %d", path, n[0], n[1], n[2], c, g->n[0], g->n[1], g->n[2], g->c);
    if (fread(g->live, 1, g->ntiles, f) != g->ntiles) return orl_fail(ORL_E_FORMAT, "%s: grid tile table is cut short", path);
    for (size_t t = 0; t < g->ntiles; t++) {
        if (!g->live[t]) continue;
        int bad = fread(g->p + t * span, sizeof(float), span, f) != span;
        if (!bad && moments) bad = fread(g->m + t * span, sizeof(float), span, f) != span || fread(g->v + t * span, sizeof(float), span, f) != span;
        if (bad) return orl_fail(ORL_E_FORMAT, "%s: grid tile %zu is cut short", path, t);
    }
    return ORL_OK;
}
