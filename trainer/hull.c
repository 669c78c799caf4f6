/* First SDF by space carving: a voxel is free where photos see sky through it, or where it lies before the depth that SfM points of a photo suggest (push-pull interpolated).
 * What lies behind that depth in the photos that see it stays solid, and so does the ground, so the hull has no fog behind surfaces and no shell in the sky; volume rendering refines it. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "oriel/parallel.h"
#include "trainer/world.h"

enum { DW = 64, DH = 64, LEVELS = 7 };   /* depth maps of 64 x 64 over each photo */
typedef struct { float inv[DH][DW]; uint8_t level[DH][DW]; } depth_map;

/* Inverse depth of SfM points, holes filled from coarser levels; level tells from how far. */
static void depth_interpolate(const world *w, const world_photo *p, depth_map *out)
{
    static const int SIZE[LEVELS] = { 64, 32, 16, 8, 4, 2, 1 };
    float *sum[LEVELS], *wt[LEVELS];
    float *block = calloc(2 * (size_t)LEVELS * DW * DH, sizeof *block);
    if (!block) { memset(out, 0, sizeof *out); memset(out->level, 255, sizeof out->level); return; }
    for (int l = 0; l < LEVELS; l++) { sum[l] = block + (size_t)l * 2 * DW * DH; wt[l] = sum[l] + DW * DH; }
    for (uint32_t i = 0; i < p->obs_count; i++) {
        const world_obs *o = &w->obs[p->obs_begin + i];
        const world_point *q = &w->points[o->point];
        double uv[2], z;
        if (!world_project(p, q->x, uv, &z) || z < 1) continue;
        int x = (int)(o->u * DW / (float)p->w), y = (int)(o->v * DH / (float)p->h);
        if (x < 0 || y < 0 || x >= DW || y >= DH) continue;
        sum[0][y * DW + x] += q->weight / (float)z;
        wt[0][y * DW + x] += q->weight;
    }
    for (int l = 1; l < LEVELS; l++)
        for (int y = 0; y < SIZE[l]; y++)
            for (int x = 0; x < SIZE[l]; x++)
                for (int k = 0; k < 4; k++) {
                    int j = (2 * y + (k >> 1)) * SIZE[l - 1] + 2 * x + (k & 1);
                    float c = wt[l - 1][j] > 0 ? fminf(1, wt[l - 1][j]) / wt[l - 1][j] : 0;   /* dense spots do not drown their neighbours */
                    sum[l][y * SIZE[l] + x] += sum[l - 1][j] * c;
                    wt[l][y * SIZE[l] + x] += wt[l - 1][j] * c;
                }
    for (int y = 0; y < DH; y++)
        for (int x = 0; x < DW; x++) {
            int l = 0;
            while (l < LEVELS - 1 && wt[l][(y >> l) * SIZE[l] + (x >> l)] < 0.05f) l++;
            float s = 0, t = 0;
            for (int dy = -1; dy <= 1; dy++)
                for (int dx = -1; dx <= 1; dx++) {
                    int yy = (y >> l) + dy, xx = (x >> l) + dx;
                    if (yy < 0 || xx < 0 || yy >= SIZE[l] || xx >= SIZE[l]) continue;
                    float c = (dx || dy) ? 0.3f : 1.0f;
                    s += c * sum[l][yy * SIZE[l] + xx];
                    t += c * wt[l][yy * SIZE[l] + xx];
                }
            out->inv[y][x] = t > 0 ? s / t : 0;
            out->level[y][x] = (uint8_t)l;
        }
    free(block);
}

typedef struct { const world *w; const depth_map *maps; int cell, n[3]; uint8_t *solid; } carve_job;

static void carve_range(void *user, int begin, int end)
{
    carve_job *j = user;
    const world *w = j->w;
    for (int z = begin; z < end; z++)
        for (int y = 0; y < j->n[1]; y++)
            for (int x = 0; x < j->n[0]; x++) {
                float g[3] = { (float)(x * j->cell), (float)(y * j->cell), (float)(z * j->cell) };
                int seen = 0, sky = 0;
                float free_votes = 0, solid_votes = 0, behind_votes = 0;
                for (int k = 0; k < w->nphotos; k++) {
                    const world_photo *p = &w->photos[k];
                    double uv[2], depth;
                    double dx = g[0] - p->centre[0], dy = g[1] - p->centre[1], dz = g[2] - p->centre[2];
                    if (dx * dx + dy * dy + dz * dz < 4.0 * j->cell * j->cell) { free_votes += 100; continue; }
                    if (!world_project(p, g, uv, &depth)) continue;
                    if (uv[0] < 0 || uv[1] < 0 || uv[0] >= p->w || uv[1] >= p->h) continue;
                    seen++;
                    int label = p->sky[(int)uv[1] * p->w + (int)uv[0]];
                    if (label > 200) { sky++; continue; }
                    const depth_map *m = &j->maps[k];
                    int mx = (int)(uv[0] * DW / p->w), my = (int)(uv[1] * DH / p->h);
                    /* The farther the depth was carried, the less it says and the farther from it a voxel must be. */
                    static const float CONF[LEVELS] = { 1, 1, 0.7f, 0.5f, 0.35f, 0.25f, 0.25f }, NEAR[LEVELS] = { 0.985f, 0.985f, 0.97f, 0.93f, 0.88f, 0.8f, 0.8f };
                    int level = m->level[my][mx];
                    if (m->inv[my][mx] <= 0) continue;
                    float surface = 1.0f / m->inv[my][mx];
                    if ((float)depth < surface * NEAR[level] - (float)j->cell) free_votes += CONF[level];
                    else if (level <= 2 && (float)depth < surface * 1.03f + 2.0f * (float)j->cell) solid_votes += CONF[level];
                    else behind_votes += CONF[level];
                }
                int carved = sky >= 2 && sky * 8 >= seen;
                if (sky == 1 && seen <= 2) carved = 1;
                if (free_votes + solid_votes + behind_votes == 0) carved = 1;      /* nothing known: open, the ground apart */
                if (free_votes > 0.24f + 0.7f * solid_votes) carved = 1;
                if (g[2] < w->frame.ground - (float)j->cell) carved = 0;
                j->solid[((size_t)z * j->n[1] + y) * (size_t)j->n[0] + x] = !carved;
            }
}

/* Squared distance transform of a line (Felzenszwalb & Huttenlocher 2012). */
static void edt_line(const float *f, int n, int stride, float *out, int *v, float *zz)
{
    int k = 0;
    v[0] = 0;
    zz[0] = -1e20f;
    zz[1] = 1e20f;
    for (int q = 1; q < n; q++) {
        float fq = f[(size_t)q * (size_t)stride] + (float)q * (float)q, s;
        for (;; k--) {
            float r = (float)v[k];
            s = (fq - (f[(size_t)v[k] * (size_t)stride] + r * r)) / (2.0f * ((float)q - r));
            if (s > zz[k] || k == 0) break;
        }
        v[++k] = q;
        zz[k] = s;
        zz[k + 1] = 1e20f;
    }
    k = 0;
    for (int q = 0; q < n; q++) {
        while (zz[k + 1] < (float)q) k++;
        float d = (float)(q - v[k]);
        out[q] = d * d + f[(size_t)v[k] * (size_t)stride];
    }
}

static orl_err edt(float *f, const int n[3])
{
    int big = n[0] > n[1] ? n[0] : n[1];
    big = big > n[2] ? big : n[2];
    float *line = malloc((size_t)big * sizeof *line), *zz = malloc(((size_t)big + 2) * sizeof *zz);
    int *v = malloc(((size_t)big + 1) * sizeof *v);
    if (!line || !zz || !v) { free(line); free(zz); free(v); return orl_fail(ORL_E_MEMORY, "distance transform: no memory"); }
    size_t sy = (size_t)n[0], sz = sy * (size_t)n[1];
    for (int axis = 0; axis < 3; axis++) {
        int a = axis == 0 ? 1 : 0, b = axis == 2 ? 1 : 2;
        size_t step[3] = { 1, sy, sz };
        for (int i = 0; i < n[a]; i++)
            for (int j = 0; j < n[b]; j++) {
                float *base = f + (size_t)i * step[a] + (size_t)j * step[b];
                edt_line(base, n[axis], (int)step[axis], line, v, zz);
                for (int q = 0; q < n[axis]; q++) base[(size_t)q * step[axis]] = line[q];
            }
    }
    free(line);
    free(zz);
    free(v);
    return ORL_OK;
}

static void smooth(float *f, float *tmp, const int n[3])
{
    size_t step[3] = { 1, (size_t)n[0], (size_t)n[0] * (size_t)n[1] }, total = step[2] * (size_t)n[2];
    for (int axis = 0; axis < 3; axis++) {
        for (size_t i = 0; i < total; i++) {
            int q = (int)(i / step[axis]) % n[axis];
            float l = q > 0 ? f[i - step[axis]] : f[i], r = q < n[axis] - 1 ? f[i + step[axis]] : f[i];
            tmp[i] = 0.25f * l + 0.5f * f[i] + 0.25f * r;
        }
        memcpy(f, tmp, total * sizeof *f);
    }
}

orl_err hull_build(const world *w, int cell, int threads, float **sdf)
{
    carve_job j = { .w = w, .cell = cell };
    for (int a = 0; a < 3; a++) j.n[a] = w->frame.dims[a] / cell + 1;
    size_t total = (size_t)j.n[0] * (size_t)j.n[1] * (size_t)j.n[2];
    depth_map *maps = malloc((size_t)w->nphotos * sizeof *maps);
    float *in = malloc(total * sizeof *in), *out = malloc(total * sizeof *out);
    j.solid = malloc(total);
    orl_err e = ORL_OK;
    if (!maps || !in || !out || !j.solid) { e = orl_fail(ORL_E_MEMORY, "hull: no memory for %zu voxels", total); goto done; }
    for (int k = 0; k < w->nphotos; k++) depth_interpolate(w, &w->photos[k], &maps[k]);
    j.maps = maps;
    orl_parallel(threads, j.n[2], 1, carve_range, &j);
    for (size_t i = 0; i < total; i++) {
        out[i] = j.solid[i] ? 0.0f : 1e12f;
        in[i] = j.solid[i] ? 1e12f : 0.0f;
    }
    if ((e = edt(out, j.n)) || (e = edt(in, j.n))) goto done;
    for (size_t i = 0; i < total; i++) {
        float a = fminf(sqrtf(out[i]), 64.0f), b = fminf(sqrtf(in[i]), 64.0f);
        out[i] = (j.solid[i] ? 0.5f - b : a - 0.5f) * (float)cell;
    }
    smooth(out, in, j.n);
    *sdf = out;
    out = NULL;
done:
    free(maps);
    free(in);
    free(out);
    free(j.solid);
    return e;
}

typedef struct { world *w; const float *sdf; int cell, n[3]; } relabel_job;

static int hull_hit(const relabel_job *j, const float o[3], const float d[3])
{
    float t, t1;
    if (!box_clip(j->w->frame.dims, o, d, &t, &t1)) return 0;
    for (int k = 0; k < 256 && t < t1; k++) {
        int q[3];
        for (int a = 0; a < 3; a++) {
            q[a] = (int)((o[a] + t * d[a]) / (float)j->cell + 0.5f);
            q[a] = q[a] < 0 ? 0 : q[a] >= j->n[a] ? j->n[a] - 1 : q[a];
        }
        float f = j->sdf[((size_t)q[2] * (size_t)j->n[1] + (size_t)q[1]) * (size_t)j->n[0] + (size_t)q[0]];
        if (f < (float)j->cell) return 1;       /* a cell's margin: silhouettes stay scene */
        t += 0.8f * f;
    }
    return 0;
}

static void relabel_range(void *user, int begin, int end)
{
    relabel_job *j = user;
    for (int k = begin; k < end; k++) {
        world_photo *p = &j->w->photos[k];
        float o[3] = { (float)p->centre[0], (float)p->centre[1], (float)p->centre[2] }, d[3];
        for (int y = 0; y < p->h; y += 2)
            for (int x = 0; x < p->w; x += 2) {
                world_ray(p, x + 1, y + 1, d);
                if (hull_hit(j, o, d)) continue;
                for (int b = 0; b < 4; b++) {
                    int xx = x + (b & 1), yy = y + (b >> 1);
                    if (xx < p->w && yy < p->h && p->sky[yy * p->w + xx] < 55) p->sky[yy * p->w + xx] = 128;
                }
            }
    }
}

void hull_relabel(world *w, const float *sdf, int cell, int threads)
{
    relabel_job j = { w, sdf, cell, { w->frame.dims[0] / cell + 1, w->frame.dims[1] / cell + 1, w->frame.dims[2] / cell + 1 } };
    orl_parallel(threads, w->nphotos, 1, relabel_range, &j);
}
