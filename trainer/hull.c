/* First SDF: a vote of the photos at every voxel, then the distance to where it changes sign.
 * A stereo point says how far the voxel lies before or behind its plane; sky behind a voxel says free; where a pixel has no stereo point, depth carried over from its neighbours says free
 * with little weight; what lies behind every surface is solid if nobody objects, and so is the ground. No fog behind surfaces, no shell in the sky; volume rendering refines it. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "oriel/parallel.h"
#include "trainer/order.h"
#include "trainer/stereo.h"

enum { DW = 128, DH = 128, LEVELS = 8, MOST_VOTERS = 256 };     /* depth maps over each photo that votes */
#define NOWHERE 1e9f
#define EDGE 0.05f              /* steps that a grey value's difference, summed over the channels, is worth */
typedef struct { float inv[DH][DW]; uint8_t level[DH][DW]; } depth_map;

static void depth_add(const world_photo *p, const float x[3], float weight, float *sum, float *wt)
{
    double uv[2], z;
    if (!world_sees(p, x, uv, &z) || z < 1) return;
    int u = (int)(uv[0] * DW / p->w), v = (int)(uv[1] * DH / p->h);
    sum[v * DW + u] += weight / (float)z;
    wt[v * DW + u] += weight;
}

/* Inverse depth of SfM and stereo points; a hole takes it from where the way along the photo is short and crosses few edges (geodesic distance, after Revaud et al., EpicFlow, 2015): what shows
 * between two columns is what shows between the next two, not the columns. level tells from how far. */
static void depth_interpolate(const world *w, const stereo *st, int k, depth_map *out)
{
    enum { N = DW * DH, SWEEPS = 6 };
    static const int DX[4] = { -1, -1, 0, 1 }, DY[4] = { 0, -1, -1, -1 };
    const world_photo *p = &w->photos[k];
    float *sum = calloc((size_t)N * 6, sizeof *sum), *wt = sum + N, *away = wt + N, (*rgb)[3] = (float (*)[3])(away + N);
    int *from = calloc(N, sizeof *from);
    memset(out->inv, 0, sizeof out->inv);
    memset(out->level, 255, sizeof out->level);
    if (!sum || !from) goto done;
    for (uint32_t i = 0; i < p->obs_count; i++) {
        const world_point *q = &w->points[w->obs[p->obs_begin + i].point];
        depth_add(p, q->x, q->weight, sum, wt);
    }
    for (uint32_t i = st ? st->begin[k] : 0, end = st ? st->begin[k + 1] : 0; i < end; i++) depth_add(p, st->points[i].x, st->points[i].weight, sum, wt);
    for (int i = 0; i < N; i++) {
        for (int b = 0; b < 4; b++) {
            uint8_t c[3];
            world_rgb(p, (int)((i % DW + 0.25 + 0.5 * (b & 1)) * p->w / DW), (int)((i / DW + 0.25 + 0.5 * (b >> 1)) * p->h / DH), c);
            for (int a = 0; a < 3; a++) rgb[i][a] += 0.25f * c[a];
        }
        away[i] = wt[i] >= 0.05f ? 0 : NOWHERE;
        from[i] = i;
    }
    for (int sweep = 0; sweep < SWEEPS; sweep++)
        for (int n = 0; n < N; n++) {
            int i = sweep & 1 ? N - 1 - n : n, sign = sweep & 1 ? -1 : 1;
            for (int q = 0; q < 4; q++) {
                int x = i % DW + sign * DX[q], y = i / DW + sign * DY[q], o = y * DW + x;
                if (x < 0 || y < 0 || x >= DW || y >= DH) continue;
                float edge = fabsf(rgb[i][0] - rgb[o][0]) + fabsf(rgb[i][1] - rgb[o][1]) + fabsf(rgb[i][2] - rgb[o][2]);
                float there = away[o] + (DX[q] && DY[q] ? 1.4f : 1.0f) * (1 + EDGE * edge);
                if (there >= away[i]) continue;
                away[i] = there;
                from[i] = from[o];
            }
        }
    for (int i = 0; i < N; i++) {
        int l = 0;
        if (away[i] >= NOWHERE) continue;
        while (l < LEVELS - 1 && away[i] > (float)(1 << l) - 0.5f) l++;
        out->inv[i / DW][i % DW] = sum[from[i]] / wt[from[i]];
        out->level[i / DW][i % DW] = (uint8_t)l;
    }
done:
    free(sum);
    free(from);
}

/* Share of cameras over the ground. */
static float cameras_over(const world *w, const frame *g)
{
    int n = 0;
    for (int k = 0; k < w->nphotos; k++) {
        float c[3] = { (float)w->photos[k].centre[0], (float)w->photos[k].centre[1], (float)w->photos[k].centre[2] };
        n += c[2] > frame_ground_height(g, c);
    }
    return (float)n / (float)w->nphotos;
}

/* The frame with its ground found. Most photographers stand on the ground: it is the level below their heads where most stereo points look up, then a plane through those around it (steps left out: its tilt is held
 * small). Without such points, a little below the lower photographers. */
static frame ground_find(const world *w, const stereo *st)
{
    enum { BINS = 160, ROUNDS = 12 };
    const int *dims = w->frame.dims;
    float share[BINS + 1] = { 0 }, most = 0, bin = (float)dims[2] / BINS, heads = w->frame.ground[0];
    float *z = malloc((size_t)w->nphotos * sizeof *z);
    for (int k = 0; z && k < w->nphotos; k++) z[k] = (float)w->photos[k].centre[2];
    if (z) {
        order_floats(z, (size_t)w->nphotos);
        heads = z[w->nphotos * 3 / 10];
    }
    free(z);
    frame guess = w->frame, g = w->frame;
    guess.ground[0] = fminf(guess.ground[0], heads - 0.015f * (float)dims[0]);
    guess.ground[1] = guess.ground[2] = 0;
    for (uint32_t i = 0; st && i < st->npoints; i++) {
        const stereo_point *q = &st->points[i];
        int b = (int)floorf(q->x[2] / bin);
        if (q->n[2] < 0.85f || b < 0 || b >= BINS || q->x[2] > heads) continue;
        share[b] += q->weight;
        share[b + 1] += q->weight;
    }
    int level = 0;
    for (int b = 0; b < BINS; b++) if (share[b] > most) most = share[level = b];
    if (most < 200) return guess;
    g.ground[0] = (float)level * bin;
    g.ground[1] = g.ground[2] = 0;
    for (int round = 0; round < ROUNDS; round++) {   /* least squares, reweighted ever more narrowly: steps and kerbs must not tilt it */
        double a = 0, b = 0, c = 0, d = 0, e = 0, f = 0, r0 = 0, r1 = 0, r2 = 0, mx = 0.5 * dims[0], my = 0.5 * dims[1], tilt = 0.02 * dims[0] * 0.02 * dims[0], scale = bin / (1 + 3.0 * round / (ROUNDS - 1));
        for (uint32_t i = 0; i < st->npoints; i++) {
            const stereo_point *q = &st->points[i];
            double r = (q->x[2] - frame_ground_height(&g, q->x)) / scale, k = q->weight / ((1 + r * r) * (1 + r * r)), x = q->x[0] - mx, y = q->x[1] - my;
            if (q->n[2] < 0.85f || r * r > 4) continue;
            a += k; b += k * x; c += k * y; d += k * (x * x + tilt); e += k * x * y; f += k * (y * y + tilt);
            r0 += k * q->x[2]; r1 += k * x * q->x[2]; r2 += k * y * q->x[2];
        }
        double det = a * (d * f - e * e) - b * (b * f - c * e) + c * (b * e - c * d);
        if (!(fabs(det) > 1e-9)) break;
        double z0 = (r0 * (d * f - e * e) - b * (r1 * f - r2 * e) + c * (r1 * e - r2 * d)) / det;
        double sx = (a * (r1 * f - r2 * e) - r0 * (b * f - c * e) + c * (b * r2 - c * r1)) / det;
        double sy = (a * (d * r2 - e * r1) - b * (b * r2 - c * r1) + r0 * (b * e - c * d)) / det;
        if (!(fabs(sx) < 0.1) || !(fabs(sy) < 0.1)) break;
        g.ground[0] = (float)(z0 - sx * mx - sy * my);
        g.ground[1] = (float)sx;
        g.ground[2] = (float)sy;
    }
    return cameras_over(w, &g) > 0.7f ? g : guess;
}

/* Lengths in fine cells, up to 512 along the place; with more, as much of the place (carve_job.unit). */
#define SPAN 6.0f               /* what is nearer to a stereo point's plane is measured, what is farther before it is free */
#define THICK 4.0f              /* behind a stereo point it is solid, less and less surely: a column hides more than it fills */
#define SAY_MEASURED 1.5f       /* times the point's weight */
#define SAY_SKY 0.7f
#define SAY_BEHIND 0.004f
#define SAY_GROUND 0.5f

typedef struct { const world *w; const stereo *st; const int *voter; int voters; const depth_map *maps; uint32_t **hits; int cell, n[3]; float unit, *field; } carve_job;     /* maps and hits: of each voter; unit: fine cells */

/* Votes by distance, in half cells. Their weighted median and not their mean decides: a photo that sees past a voxel says SPAN, one that measured a thin thing in it little less than nothing, and a mean would leave
 * nothing standing before a far wall. */
enum { TALLY_MID = 2 * (int)SPAN, TALLY = 2 * TALLY_MID + 1 };

static void say(float weight, float distance, float tally[TALLY])
{
    tally[(int)((fminf(fmaxf(distance, -SPAN), SPAN) + SPAN) * 2 + 0.5f)] += weight;
}

static float verdict(const float tally[TALLY])
{
    float half = 0, below = 0;
    int b = 0;
    for (int i = 0; i < TALLY; i++) half += 0.5f * tally[i];
    if (!(half > 0)) return SPAN;
    while (b < TALLY - 1 && below + tally[b] < half) below += tally[b++];
    return 0.5f * ((float)(b - TALLY_MID) - 0.5f + fminf((half - below) / fmaxf(tally[b], 1e-9f), 1));
}

/* What a voter says of a voxel: a distance, positive for free, and its weight. measured: guesses from neighbouring pixels do not count. */
static void vote(const carve_job *j, int k, const float g[3], int measured, float tally[TALLY])
{
    const world_photo *p = &j->w->photos[j->voter[k]];
    double uv[2], depth;
    float away2 = 0;
    for (int a = 0; a < 3; a++) away2 += (g[a] - (float)p->centre[a]) * (g[a] - (float)p->centre[a]);
    if (away2 < 4.0f * (float)(j->cell * j->cell)) { say(100, SPAN, tally); return; }
    if (!world_sees(p, g, uv, &depth)) return;
    if (world_label(p, (int)uv[0], (int)uv[1]) == WORLD_SKY) { say(SAY_SKY, SPAN, tally); return; }
    uint32_t hit = j->hits[k] ? j->hits[k][(int)uv[1] / 2 * (p->w / 2 + 1) + (int)uv[0] / 2] : 0;
    if (hit) {
        const stereo_point *q = &j->st->points[hit - 1];
        float f = 0, before2 = 0, d[3];
        for (int a = 0; a < 3; a++) {
            f += q->n[a] * (g[a] - q->x[a]);
            d[a] = q->x[a] - (float)p->centre[a];
            before2 += d[a] * d[a];
        }
        float behind = (sqrtf(away2) - sqrtf(before2)) / j->unit;
        if (behind > THICK) say(SAY_BEHIND, -SPAN, tally);
        else say(SAY_MEASURED * q->weight * fminf(1, 2 - 2 * behind / THICK), behind < -2 * SPAN ? SPAN : f / j->unit, tally);
        return;
    }
    const depth_map *m = &j->maps[k];
    int mx = (int)(uv[0] * DW / p->w), my = (int)(uv[1] * DH / p->h), level = m->level[my][mx];
    if (measured || m->inv[my][mx] <= 0) return;
    /* Carried depth says what is free, not what is solid: the farther it came, the less it says and the farther from it a voxel must be. */
    static const float SAY[LEVELS] = { 0.3f, 0.2f, 0.1f, 0.06f, 0.04f, 0.03f, 0.02f, 0.02f }, NEAR[LEVELS] = { 0.985f, 0.985f, 0.98f, 0.97f, 0.93f, 0.88f, 0.8f, 0.8f };
    if ((float)depth < NEAR[level] / m->inv[my][mx] - (float)j->cell) say(SAY[level], SPAN, tally);
    else say(SAY_BEHIND, -SPAN, tally);
}

static void carve_range(void *user, int begin, int end)
{
    carve_job *j = user;
    for (int z = begin; z < end; z++)
        for (int y = 0; y < j->n[1]; y++)
            for (int x = 0; x < j->n[0]; x++) {
                float g[3] = { (float)(x * j->cell), (float)(y * j->cell), (float)(z * j->cell) };
                float over = (g[2] - frame_ground_height(&j->w->frame, g)) / j->unit, tally[TALLY] = { 0 };
                if (over < SPAN) say(SAY_GROUND, over, tally);
                for (int k = 0; k < j->voters; k++) vote(j, k, g, over < 0, tally);
                j->field[((size_t)z * (size_t)j->n[1] + (size_t)y) * (size_t)j->n[0] + (size_t)x] = verdict(tally) * j->unit;
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

orl_err hull_build(world *w, const stereo *st, int cell, int threads, float **sdf)
{
    carve_job j = { .w = w, .st = st, .cell = cell, .unit = fmaxf(1, (float)w->longest / 512) };
    w->frame = ground_find(w, st);
    for (int a = 0; a < 3; a++) j.n[a] = w->frame.dims[a] / cell + 1;
    size_t total = (size_t)j.n[0] * (size_t)j.n[1] * (size_t)j.n[2];
    uint8_t *use = world_cover(w, MOST_VOTERS, SIZE_MAX);
    int *voter = malloc((size_t)w->nphotos * sizeof *voter);
    for (int k = 0; use && voter && k < w->nphotos; k++) if (use[k]) voter[j.voters++] = k;
    depth_map *maps = malloc(((size_t)j.voters + 1) * sizeof *maps);
    float *in = malloc(total * sizeof *in), *out = malloc(total * sizeof *out);
    j.field = malloc(total * sizeof *j.field);
    j.hits = calloc((size_t)w->nphotos, sizeof *j.hits);
    orl_err e = ORL_OK;
    if (!use || !voter || !maps || !in || !out || !j.field || !j.hits) { e = orl_fail(ORL_E_MEMORY, "hull: no memory for %zu voxels", total); goto done; }
    for (int k = 0; k < j.voters; k++) {
        depth_interpolate(w, st, voter[k], &maps[k]);
        if (st && st->begin[voter[k] + 1] > st->begin[voter[k]]) j.hits[k] = stereo_hits(st, w, voter[k], 2);
    }
    j.maps = maps;
    j.voter = voter;
    orl_parallel(threads, j.n[2], 1, carve_range, &j);
    for (size_t i = 0; i < total; i++) {
        out[i] = j.field[i] < 0 ? 0.0f : 1e12f;
        in[i] = j.field[i] < 0 ? 1e12f : 0.0f;
    }
    if ((e = edt(out, j.n)) || (e = edt(in, j.n))) goto done;
    for (size_t i = 0; i < total; i++) {
        float a = fminf(sqrtf(out[i]), 64.0f), b = fminf(sqrtf(in[i]), 64.0f), d = (j.field[i] < 0 ? 0.5f - b : a - 0.5f) * (float)cell, f = j.field[i];
        float near = fminf(fmaxf(1.5f - 0.5f * fabsf(d) / (float)cell, 0), 1) * fminf(fmaxf(3 - 4 * fabsf(f) / (SPAN * j.unit), 0), 1);   /* the vote itself is finer than the lattice */
        out[i] = d + near * (f - d);
    }
    for (int round = 0; round < 2; round++) smooth(out, in, j.n);
    *sdf = out;
    out = NULL;
done:
    free(use);
    free(voter);
    free(maps);
    free(in);
    free(out);
    free(j.field);
    for (int k = 0; j.hits && k < w->nphotos; k++) free(j.hits[k]);
    free(j.hits);
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
        int side = (p->w > p->h ? p->w : p->h) < 1024 ? 2 : 4;
        float o[3] = { (float)p->centre[0], (float)p->centre[1], (float)p->centre[2] }, d[3];
        for (int y = 0; y < p->h; y += side)
            for (int x = 0; x < p->w; x += side) {
                world_ray(p, x + side / 2, y + side / 2, d);
                if (hull_hit(j, o, d)) continue;
                for (int b = 0; b < side * side; b++) {
                    int xx = x + b % side, yy = y + b / side;
                    if (xx < p->w && yy < p->h && world_label(p, xx, yy) == WORLD_SCENE) world_set_label(p, xx, yy, WORLD_BEYOND);
                }
            }
    }
}

void hull_relabel(world *w, const float *sdf, int cell, int threads)
{
    relabel_job j = { w, sdf, cell, { w->frame.dims[0] / cell + 1, w->frame.dims[1] / cell + 1, w->frame.dims[2] / cell + 1 } };
    orl_parallel(threads, w->nphotos, 1, relabel_range, &j);
}

/* Points of other photos on a photo's sky, in cells of a 128th of it and 4 pixels at least. */
enum { UNSKY_CELLS = 128, UNSKY_LEAST = 4, UNSKY_PHOTOS = 3, UNSKY_REACH = 2, UNSKY_FULL = 21, UNSKY_STEP = 4, UNSKY_SHARE = 20 };
#define UNSKY_WEIGHT 0.4f
typedef struct { world *w; const stereo *st; int failed; } unsky_job;

static void unsky_range(void *user, int begin, int end)
{
    unsky_job *j = user;
    for (int k = begin; k < end; k++) {
        world_photo *p = &j->w->photos[k];
        int side = ((p->w > p->h ? p->w : p->h) + UNSKY_CELLS - 1) / UNSKY_CELLS;
        side = side > UNSKY_LEAST ? side : UNSKY_LEAST;
        int cw = p->w / side + 1, ch = p->h / side + 1;
        struct { uint32_t last, photos, stone; } *cell = calloc((size_t)cw * (size_t)ch, sizeof *cell);     /* last: the last photo counted, + 1 */
        if (!cell) { __atomic_store_n(&j->failed, 1, __ATOMIC_RELAXED); continue; }
        for (uint32_t i = 0; i < j->st->npoints; i += UNSKY_STEP) {
            const stereo_point *q = &j->st->points[i];
            double uv[2];
            if (q->photo == (uint32_t)k || q->weight < UNSKY_WEIGHT || !world_sees(p, q->x, uv, NULL)) continue;
            size_t at = (size_t)((int)uv[1] / side) * (size_t)cw + (size_t)((int)uv[0] / side);
            cell[at].photos += cell[at].last != q->photo + 1;
            cell[at].last = q->photo + 1;
        }
        for (int y = 0; y < ch; y++)
            for (int x = 0; x < cw; x++) {
                int full = 0;
                for (int v = y - UNSKY_REACH; v <= y + UNSKY_REACH; v++)
                    for (int u = x - UNSKY_REACH; u <= x + UNSKY_REACH; u++) full += u >= 0 && v >= 0 && u < cw && v < ch && cell[(size_t)v * (size_t)cw + (size_t)u].photos >= UNSKY_PHOTOS;
                cell[(size_t)y * (size_t)cw + (size_t)x].stone = full >= UNSKY_FULL;
            }
        /* A silhouette's rim meets points too: only a mask that is wrong over a share of its sky is touched. */
        size_t sky = 0, stone = 0;
        for (int i = 0; i < p->w * p->h; i++) {
            int x = i % p->w, y = i / p->w;
            if (world_label(p, x, y) != WORLD_SKY) continue;
            sky++;
            stone += cell[(size_t)(y / side) * (size_t)cw + (size_t)(x / side)].stone;
        }
        for (int i = 0; i < p->w * p->h && stone * UNSKY_SHARE >= sky; i++) {
            int x = i % p->w, y = i / p->w;
            if (world_label(p, x, y) == WORLD_SKY && cell[(size_t)(y / side) * (size_t)cw + (size_t)(x / side)].stone) world_set_label(p, x, y, WORLD_UNKNOWN);
        }
        free(cell);
    }
}

orl_err hull_unsky(world *w, const stereo *st, int threads)
{
    unsky_job j = { w, st, 0 };
    if (st) orl_parallel(threads, w->nphotos, 1, unsky_range, &j);
    return j.failed ? orl_fail(ORL_E_MEMORY, "sky masks: no memory") : ORL_OK;
}
