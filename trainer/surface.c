/* Surface bricks (surface.h): collapse, march, visibility. */
#include "trainer/surface.h"
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "oriel/parallel.h"

#define MARCH_STEP 0.25f        /* fine cells, the least */
#define SURFACE_CUT 0.03125f    /* fine cells: as deep in the solid as no surface on a brick's border can be */

static size_t brick_count(const surface *s) { return (size_t)s->nb[0] * (size_t)s->nb[1] * (size_t)s->nb[2]; }

/* Empty bricks get minus their Chebyshev distance to the nearest brick (two passes a axis suffice: the metric is separable). */
static void distance_map(surface *s)
{
    size_t step[3] = { 1, (size_t)s->nb[0], (size_t)s->nb[0] * (size_t)s->nb[1] };
    size_t total = brick_count(s);
    uint8_t *d = malloc(total), *e = malloc(total);
    for (size_t i = 0; d && i < total; i++) d[i] = s->bmap[i] >= 0 ? 0 : 127;
    /* d' = min over k of max(d_k, |i - k|) along each axis in turn */
    for (int a = 0; d && e && a < 3; a++) {
        for (size_t i = 0; i < total; i++) {
            int q = (int)(i / step[a]) % s->nb[a], best = d[i];
            for (int k = 1; k < best; k++) {
                int lo = q - k >= 0 ? d[i - (size_t)k * step[a]] : 127, hi = q + k < s->nb[a] ? d[i + (size_t)k * step[a]] : 127;
                int m = lo < hi ? lo : hi;
                m = m > k ? m : k;
                if (m < best) best = m;
            }
            e[i] = (uint8_t)best;
        }
        uint8_t *t = d; d = e; e = t;
    }
    for (size_t i = 0; i < total; i++) if (s->bmap[i] < 0) s->bmap[i] = d ? -(int32_t)d[i] : -1;
    free(d);
    free(e);
}

orl_err surface_build(const stage1 *st, surface *out)
{
    surface s = { .f = st->w->frame, .facings = st->square };
    for (int a = 0; a < 3; a++) s.nb[a] = s.f.dims[a] / ORL_BRICK;
    size_t total = brick_count(&s);
    s.bmap = malloc(total * sizeof *s.bmap);
    size_t cap = 1024;
    s.sdf = malloc(cap * ORL_BRICK_VERTS * sizeof *s.sdf);
    if (!s.bmap || !s.sdf) { surface_free(&s); return orl_fail(ORL_E_MEMORY, "surface: no memory"); }
    for (size_t b = 0; b < total; b++) {
        int bx = (int)(b % (size_t)s.nb[0]), by = (int)(b / (size_t)s.nb[0]) % s.nb[1], bz = (int)(b / ((size_t)s.nb[0] * (size_t)s.nb[1]));
        s.bmap[b] = -1;
        float c[3] = { bx * 8 + 4.0f, by * 8 + 4.0f, bz * 8 + 4.0f };
        int edge = !bx || !by || !bz || bx == s.nb[0] - 1 || by == s.nb[1] - 1 || bz == s.nb[2] - 1;
        if (!edge && fabsf(stage1_sdf(st, c, NULL)) > 24) continue;
        if (s.nbricks == cap) {
            float *p = realloc(s.sdf, 2 * cap * ORL_BRICK_VERTS * sizeof *p);
            if (!p) { surface_free(&s); return orl_fail(ORL_E_MEMORY, "surface: no memory for %zu bricks", 2 * cap); }
            s.sdf = p;
            cap *= 2;
        }
        float *v = s.sdf + (size_t)s.nbricks * ORL_BRICK_VERTS, lo = 1e9f, hi = -1e9f;
        for (int i = 0; i < ORL_BRICK_VERTS; i++) {
            float x[3] = { (float)(bx * 8 + i % 9), (float)(by * 8 + i / 9 % 9), (float)(bz * 8 + i / 81) };
            v[i] = stage1_sdf(st, x, NULL);
            float border = 1e9f;                /* solids end just inside the box, so that a ray from outside meets a surface */
            for (int a = 0; a < 3; a++) border = fminf(border, fminf(x[a], (float)s.f.dims[a] - x[a]));
            v[i] = fmaxf(v[i], 1.5f - border);
            lo = fminf(lo, v[i]);
            hi = fmaxf(hi, v[i]);
        }
        if (lo <= 0 && hi > -MARCH_STEP) s.bmap[b] = (int32_t)s.nbricks++;      /* a step may end behind a surface that lies just before the brick's face */
    }
    distance_map(&s);
    *out = s;
    return ORL_OK;
}

void surface_free(surface *s)
{
    free(s->bmap);
    free(s->sdf);
    free(s->opacity);
    grid_free(&s->lite);
    memset(s, 0, sizeof *s);
}

static float brick_value(const float *v, const float q[3])
{
    int i[3];
    float f[3];
    for (int a = 0; a < 3; a++) {
        float t = q[a] > 0 ? (q[a] < 7.9999f ? q[a] : 7.9999f) : 0;
        i[a] = (int)t;
        f[a] = t - (float)i[a];
        if (q[a] >= 8) f[a] = 1;
    }
    const float *p = v + i[0] + 9 * (i[1] + 9 * i[2]);
    float a0 = p[0] + f[0] * (p[1] - p[0]), a1 = p[9] + f[0] * (p[10] - p[9]);
    float a2 = p[81] + f[0] * (p[82] - p[81]), a3 = p[90] + f[0] * (p[91] - p[90]);
    float b0 = a0 + f[1] * (a1 - a0), b1 = a2 + f[1] * (a3 - a2);
    return b0 + f[2] * (b1 - b0);
}

static size_t brick_index(const surface *s, const int b[3]) { return ((size_t)b[2] * (size_t)s->nb[1] + (size_t)b[1]) * (size_t)s->nb[0] + (size_t)b[0]; }

static const float *brick_at(const surface *s, const float x[3], int b[3], int *skip)
{
    for (int a = 0; a < 3; a++) {
        b[a] = (int)floorf(x[a] * 0.125f);
        if (b[a] < 0) b[a] = 0;
        if (b[a] >= s->nb[a]) b[a] = s->nb[a] - 1;
    }
    int32_t m = s->bmap[brick_index(s, b)];
    if (m < 0) { *skip = -m; return NULL; }
    return s->sdf + (size_t)m * ORL_BRICK_VERTS;
}

float surface_value(const surface *s, const float x[3])
{
    int b[3], skip;
    const float *v = brick_at(s, x, b, &skip);
    if (!v) return 8;
    float q[3] = { x[0] - 8.0f * b[0], x[1] - 8.0f * b[1], x[2] - 8.0f * b[2] };
    return brick_value(v, q);
}

int32_t surface_brick(const surface *s, const float x[3], int b[3])
{
    int skip;
    const float *v = brick_at(s, x, b, &skip);
    return v ? (int32_t)((size_t)(v - s->sdf) / ORL_BRICK_VERTS) : -1;
}

/* A neighbour that has no brick is replaced by the nearest point of the brick `own`, at b, that holds x (maybe on its border). */
static void gradient(const surface *s, const float x[3], const float *own, const int b[3], float grad[3])
{
    int skip;
    for (int a = 0; a < 3; a++) {
        float f[2];
        for (int k = 0; k < 2; k++) {
            float y[3] = { x[0], x[1], x[2] };
            y[a] += k ? 2.0f : -2.0f;
            int c[3];
            const float *v = brick_at(s, y, c, &skip);
            const int *use = c;
            if (!v) { v = own; use = b; }
            float q[3] = { y[0] - 8.0f * use[0], y[1] - 8.0f * use[1], y[2] - 8.0f * use[2] };
            f[k] = v ? brick_value(v, q) : 0;
        }
        grad[a] = f[1] - f[0];
    }
}

void surface_gradient(const surface *s, const float x[3], const int b[3], float grad[3])
{
    int32_t m = s->bmap[brick_index(s, b)];
    gradient(s, x, m < 0 ? NULL : s->sdf + (size_t)m * ORL_BRICK_VERTS, b, grad);
}

/* The gradient, made unit and turned towards what walls face. */
static void normal_of(const surface *s, const float grad[3], float n[3])
{
    float len = grad[0] * grad[0] + grad[1] * grad[1] + grad[2] * grad[2];
    if (len < 1e-12f) { n[0] = n[1] = 0; n[2] = 1; return; }
    len = 1.0f / sqrtf(len);
    for (int a = 0; a < 3; a++) n[a] = grad[a] * len;
    orl_facing_turn(&s->facings, n);
}

int surface_march(const surface *s, const float o[3], const float d[3], surface_hit *hit)
{
    float t, t1, prev = 1, prev_t = 0;
    int inside = 0, entered = 0;                /* inside: started in the solid, waits for free space first. entered: came out of empty bricks */
    if (!box_clip(s->f.dims, o, d, &t, &t1)) return 0;
    float start = t;
    float inv[3];
    for (int a = 0; a < 3; a++) inv[a] = fabsf(d[a]) > 1e-9f ? 1.0f / d[a] : 1e9f;
    for (int k = 0; k < 4096 && t < t1; k++) {
        float x[3] = { o[0] + t * d[0], o[1] + t * d[1], o[2] + t * d[2] };
        int b[3], skip;
        const float *v = brick_at(s, x, b, &skip);
        if (!v) {                               /* leave the cube of empty bricks around this one */
            float exit = 1e9f;
            for (int a = 0; a < 3; a++) {
                float face = 8.0f * (float)(d[a] > 0 ? b[a] + skip : b[a] - skip + 1);
                float e = (face - o[a]) * inv[a];
                if (fabsf(d[a]) > 1e-9f && e < exit) exit = e;
            }
            t = fmaxf(exit, t) + 0.02f;
            prev = 1;
            prev_t = t;
            inside = 0;
            entered = 1;
            continue;
        }
        float q[3] = { x[0] - 8.0f * b[0], x[1] - 8.0f * b[1], x[2] - 8.0f * b[2] };
        float f = brick_value(v, q);
        if (f <= 0 && !inside) {
            if (k == 0 && start <= 0) { inside = 1; t += 0.5f; continue; }
            float lo = prev_t, hi = t, flo = prev, fhi = f, r = t;
            for (int i = 0; i < 4 && hi > lo; i++) {
                r = lo + (hi - lo) * flo / (flo - fhi);
                float y[3] = { o[0] + r * d[0], o[1] + r * d[1], o[2] + r * d[2] };
                float fr = surface_value(s, y);
                if (fr > 0) { lo = r; flo = fr; } else { hi = r; fhi = fr; }
            }
            hit->t = r;
            hit->cut = entered && f < -SURFACE_CUT;
            for (int a = 0; a < 3; a++) hit->x[a] = o[a] + r * d[a];
            v = brick_at(s, hit->x, b, &skip);
            gradient(s, hit->x, v, b, hit->grad);
            normal_of(s, hit->grad, hit->n);
            return 1;
        }
        if (f > 0) inside = 0;
        entered = 0;
        prev = fmaxf(f, 1e-3f);
        prev_t = t;
        t += inside ? 0.5f : fminf(fmaxf(0.9f * f, MARCH_STEP), 3.5f);
    }
    return 0;
}

int surface_sunlit(const surface *s, const float x[3], const float n[3], const float d[3])
{
    float o[3];
    surface_hit h;
    for (int a = 0; a < 3; a++) o[a] = x[a] + ORL_SUN_LIFT * n[a];
    return n[0] * d[0] + n[1] * d[1] + n[2] * d[2] > 0 && !surface_march(s, o, d, &h);
}

static void middle_of(const surface *s, double middle[2]) { for (int a = 0; a < 2; a++) middle[a] = 0.5 * s->f.dims[a]; }

void surface_backdrop_place(const surface *s, const float x[3], double uv[2])
{
    double middle[2], at[3] = { x[0], x[1], x[2] };
    middle_of(s, middle);
    uv[0] = uv[1] = 0;
    orl_backdrop_place(&s->back, middle, s->f.ground, at, uv);
}

/* The backdrop nearer than t, where it is opaque enough. */
static int meet_backdrop(const surface *s, const float o[3], const float d[3], float opaque, float t, surface_hit *hit)
{
    double middle[2], from[3] = { o[0], o[1], o[2] }, along[3] = { d[0], d[1], d[2] }, far, uv[2];
    uint32_t first, share[4], a = 128;
    middle_of(s, middle);
    if (!s->opacity || opaque >= SURFACE_NO_BACKDROP || !orl_backdrop_meet(&s->back, middle, s->f.ground, from, along, &far, uv) || far > (double)t) return 0;
    orl_backdrop_texels(uv, &first, share);
    for (int k = 0; k < 4; k++) a += share[k] * s->opacity[first + (k & 1 ? 1 : 0) + (k & 2 ? ORL_BACK_COLS : 0)];
    if ((float)(a >> 8) < opaque) return 0;
    hit->t = (float)far;
    for (int k = 0; k < 3; k++) hit->x[k] = o[k] + hit->t * d[k];
    orl_backdrop_normal(uv[0], hit->n);
    return 1;
}

int surface_meet(const surface *s, const float o[3], const float d[3], float opaque, surface_hit *hit)
{
    float t = 0, gone = 0, from[3] = { o[0], o[1], o[2] };
    int met = 0, falls = frame_ground_hit(&s->f, o, d, &t);
    for (int k = 0; !met && k < ORL_CUTS && surface_march(s, from, d, hit); k++) {
        hit->t = gone += hit->t;
        memcpy(from, hit->x, sizeof from);
        met = !hit->cut || from[2] - frame_ground_height(&s->f, from) <= ORL_GROUND_CUT * (float)s->f.dims[0];
    }
    if (!met && !falls) return meet_backdrop(s, o, d, opaque, 1e12f, hit) ? MET_BACKDROP : MET_NOTHING;
    if (met) {
        float x = o[0] + t * d[0], y = o[1] + t * d[1];
        int before = falls && t < hit->t, beside = x < 0 || y < 0 || x > (float)s->f.dims[0] || y > (float)s->f.dims[1];
        if (!(before && beside) && !hit->cut) return MET_SURFACE;
        if (!before) t = hit->t;
    }
    if (meet_backdrop(s, o, d, opaque, t, hit)) return MET_BACKDROP;
    for (int a = 0; a < 3; a++) hit->x[a] = o[a] + t * d[a];
    hit->t = t;
    for (int a = 0; a < 3; a++) hit->n[a] = hit->grad[a] = a == 2;
    return MET_GROUND;
}

enum { GUESSED = 1, SEEN = 2 };             /* bits of a brick: hit by a pixel labelled scene (SEEN), or by another one */
typedef struct { const surface *s; const world *w; uint8_t *seen; int step; } prune_job;    /* seen: of each brick; step: pixels between two rays */

static void prune_range(void *user, int begin, int end)
{
    prune_job *j = user;
    for (int k = begin; k < end; k++) {
        const world_photo *p = &j->w->photos[k];
        float o[3] = { (float)p->centre[0], (float)p->centre[1], (float)p->centre[2] }, d[3];
        for (int y = 0; y < p->h; y += j->step)
            for (int x = 0; x < p->w; x += j->step) {
                surface_hit hit;
                world_ray(p, x + 0.5, y + 0.5, d);
                if (!surface_march(j->s, o, d, &hit)) continue;
                int b[3], skip;
                const float *v = brick_at(j->s, hit.x, b, &skip);
                if (v) __atomic_fetch_or(&j->seen[(size_t)(v - j->s->sdf) / ORL_BRICK_VERTS], world_label(p, x, y) == WORLD_SCENE ? SEEN : GUESSED, __ATOMIC_RELAXED);
            }
    }
}

orl_err surface_prune(surface *s, const world *w, int threads)
{
    uint8_t *seen = calloc(s->nbricks + 1, 1), *keep = calloc(s->nbricks + 1, 1);
    if (!seen || !keep) { free(seen); free(keep); return orl_fail(ORL_E_MEMORY, "surface: no memory"); }
    prune_job j = { s, w, seen, world_ray_step(w) };
    orl_parallel(threads, w->nphotos, 1, prune_range, &j);
    size_t step[3] = { 1, (size_t)s->nb[0], (size_t)s->nb[0] * (size_t)s->nb[1] }, total = brick_count(s);
    for (size_t i = 0; i < total; i++) {
        if (s->bmap[i] < 0 || !(seen[s->bmap[i]] & SEEN)) continue;
        for (int dz = -1; dz <= 1; dz++)
            for (int dy = -1; dy <= 1; dy++)
                for (int dx = -1; dx <= 1; dx++) {
                    int q[3] = { (int)(i % step[1]) + dx, (int)(i / step[1]) % s->nb[1] + dy, (int)(i / step[2]) + dz };
                    if (q[0] < 0 || q[1] < 0 || q[2] < 0 || q[0] >= s->nb[0] || q[1] >= s->nb[1] || q[2] >= s->nb[2]) continue;
                    int32_t m = s->bmap[(size_t)q[0] + (size_t)q[1] * step[1] + (size_t)q[2] * step[2]];
                    if (m >= 0 && seen[m] != GUESSED) keep[m] = 1;
                }
    }
    uint32_t n = 0;
    for (size_t i = 0; i < total; i++) {        /* brick indices rise with i, so bricks move down in place */
        int32_t m = s->bmap[i];
        if (m < 0) continue;
        if (!keep[m]) { s->bmap[i] = -1; continue; }
        memmove(s->sdf + (size_t)n * ORL_BRICK_VERTS, s->sdf + (size_t)m * ORL_BRICK_VERTS, ORL_BRICK_VERTS * sizeof *s->sdf);
        s->bmap[i] = (int32_t)n++;
    }
    s->nbricks = n;
    free(seen);
    free(keep);
    distance_map(s);
    return ORL_OK;
}

enum { ELEVATIONS = 12 };
typedef struct { int x[3], brick[3]; } light_vert;      /* in cells of 4; the place of a brick that holds it: beyond that brick's border there may be none */
typedef struct { surface *s; const light_vert *verts; } light_job;

static void light_range(void *user, int begin, int end)
{
    light_job *j = user;
    surface *s = j->s;
    for (int i = begin; i < end; i++) {
        const light_vert *q = &j->verts[i];
        const float *v = s->sdf + (size_t)s->bmap[brick_index(s, q->brick)] * ORL_BRICK_VERTS;
        float x[3], in[3], n[3];
        for (int a = 0; a < 3; a++) {
            x[a] = 4.0f * (float)q->x[a];
            in[a] = x[a] - 8.0f * (float)q->brick[a];
        }
        gradient(s, x, v, q->brick, n);
        normal_of(s, n, n);
        float lift = 2.0f - brick_value(v, in);
        for (int a = 0; a < 3; a++) x[a] += n[a] * fmaxf(lift, 0);
        size_t at = grid_at(&s->lite, q->x[0], q->x[1], q->x[2]);
        float *o = s->lite.p + at * 24;
        float open = 0, all = 0;
        for (int az = 0; az < ORL_HORIZON; az++) {
            float phi = (float)az * (6.2831853f / ORL_HORIZON);
            int blocked[ELEVATIONS], below[ELEVATIONS + 1] = { 0 };
            for (int k = 0; k < ELEVATIONS; k++) {
                float el = ((float)k + 0.5f) * (1.5707963f / ELEVATIONS);
                float d[3] = { cosf(el) * cosf(phi), cosf(el) * sinf(phi), sinf(el) };
                surface_hit h;
                blocked[k] = surface_march(s, x, d, &h);
                float c = fmaxf(0, n[0] * d[0] + n[1] * d[1] + n[2] * d[2]) * cosf(el);
                all += c;
                open += blocked[k] ? 0 : c;
            }
            /* The one threshold that misjudges the fewest elevations (an overhang has two; this is the best single one). */
            int best = 0, best_err = 1 << 20;
            for (int h = 0; h <= ELEVATIONS; h++) {
                for (int k = 0; k < ELEVATIONS; k++) below[h] += k < h ? !blocked[k] : blocked[k];
                if (below[h] < best_err) { best_err = below[h]; best = h; }
            }
            o[1 + az] = (float)best * (1.5707963f / ELEVATIONS);
        }
        o[0] = all > 0 ? open / all : 0;
        grid_mark(&s->lite, at);
    }
}

orl_err surface_light(surface *s, int threads)
{
    orl_err e = s->lite.p ? ORL_OK : grid_init(&s->lite, s->f.dims, 4, 24, 0);
    if (e) return e;
    size_t cap = (size_t)s->nbricks * ORL_LITE_VERTS + 1, n = 0;
    light_vert *verts = malloc(cap * sizeof *verts);
    uint8_t *mark = calloc(s->lite.nverts, 1);
    if (!verts || !mark) { free(verts); free(mark); return orl_fail(ORL_E_MEMORY, "surface: no memory for light vertices"); }
    for (size_t b = 0; b < brick_count(s); b++) {
        if (s->bmap[b] < 0) continue;
        int o[3] = { (int)(b % (size_t)s->nb[0]), (int)(b / (size_t)s->nb[0] % (size_t)s->nb[1]), (int)(b / ((size_t)s->nb[0] * (size_t)s->nb[1])) };
        for (int k = 0; k < ORL_LITE_VERTS; k++) {
            light_vert v = { { 2 * o[0] + k % 3, 2 * o[1] + k / 3 % 3, 2 * o[2] + k / 9 }, { o[0], o[1], o[2] } };
            size_t at = grid_at(&s->lite, v.x[0], v.x[1], v.x[2]);
            if (mark[at]) continue;
            mark[at] = 1;
            verts[n++] = v;
        }
    }
    light_job j = { s, verts };
    orl_parallel(threads, (int)n, 64, light_range, &j);
    free(verts);
    free(mark);
    return ORL_OK;
}

void surface_uncover(surface *s)
{
    for (size_t i = 0; i < s->lite.nverts; i++) {
        if (!s->lite.live[i / GRID_TILE]) continue;
        float *o = s->lite.p + i * 24;
        o[0] = 1;
        memset(o + 1, 0, ORL_HORIZON * sizeof *o);
    }
}

orl_err surface_save(const surface *s, FILE *f)
{
    int bad = fwrite(&s->f, sizeof s->f, 1, f) != 1 || fwrite(&s->facings, sizeof s->facings, 1, f) != 1 || fwrite(&s->nbricks, sizeof s->nbricks, 1, f) != 1 || fwrite(s->bmap, sizeof *s->bmap, brick_count(s), f) != brick_count(s)
        || fwrite(s->sdf, ORL_BRICK_VERTS * sizeof *s->sdf, s->nbricks, f) != s->nbricks;
    bad |= fwrite(&s->back, sizeof s->back, 1, f) != 1 || (s->back.height > 0 && fwrite(s->opacity, 1, ORL_BACK_TEXELS, f) != ORL_BACK_TEXELS);
    return bad ? orl_fail(ORL_E_IO, "checkpoint: write failed") : grid_save(&s->lite, f, 0);
}

static orl_err load_backdrop(surface *s, FILE *f, const char *path)
{
    if (fread(&s->back, sizeof s->back, 1, f) != 1) return orl_fail(ORL_E_FORMAT, "%s: backdrop is cut short", path);
    if (!(s->back.height > 0)) return ORL_OK;
    s->opacity = malloc(ORL_BACK_TEXELS);
    if (!s->opacity) return orl_fail(ORL_E_MEMORY, "%s: no memory", path);
    return fread(s->opacity, 1, ORL_BACK_TEXELS, f) == ORL_BACK_TEXELS ? ORL_OK : orl_fail(ORL_E_FORMAT, "%s: backdrop is cut short", path);
}

orl_err surface_load(surface *out, FILE *f, const char *path)
{
    surface s = { 0 };
    if (fread(&s.f, sizeof s.f, 1, f) != 1 || fread(&s.facings, sizeof s.facings, 1, f) != 1 || fread(&s.nbricks, sizeof s.nbricks, 1, f) != 1) return orl_fail(ORL_E_FORMAT, "%s: surface header is cut short", path);
    for (int a = 0; a < 3; a++) {
        if (s.f.dims[a] < 16 || s.f.dims[a] > 4096 || s.f.dims[a] % 16) return orl_fail(ORL_E_RANGE, "%s: surface dims[%d] = %d", path, a, s.f.dims[a]);
        s.nb[a] = s.f.dims[a] / ORL_BRICK;
    }
    if (s.facings.n < 0 || s.facings.n > ORL_FACINGS) return orl_fail(ORL_E_RANGE, "%s: surface has %d facings", path, s.facings.n);
    if (s.nbricks > brick_count(&s)) return orl_fail(ORL_E_RANGE, "%s: surface has %u bricks in %zu places", path, s.nbricks, brick_count(&s));
    s.bmap = malloc(brick_count(&s) * sizeof *s.bmap);
    s.sdf = malloc(((size_t)s.nbricks + 1) * ORL_BRICK_VERTS * sizeof *s.sdf);
    orl_err e = s.bmap && s.sdf ? grid_init(&s.lite, s.f.dims, 4, 24, 0) : orl_fail(ORL_E_MEMORY, "%s: no memory", path);
    if (!e && (fread(s.bmap, sizeof *s.bmap, brick_count(&s), f) != brick_count(&s) || fread(s.sdf, ORL_BRICK_VERTS * sizeof *s.sdf, s.nbricks, f) != s.nbricks))
        e = orl_fail(ORL_E_FORMAT, "%s: surface is cut short", path);
    for (size_t i = 0; !e && i < brick_count(&s); i++) if (s.bmap[i] >= (int32_t)s.nbricks || s.bmap[i] < -127) e = orl_fail(ORL_E_RANGE, "%s: surface brick map entry %zu", path, i);
    if (!e) e = load_backdrop(&s, f, path);
    if (!e) e = grid_load(&s.lite, f, 0, path);
    if (e) { surface_free(&s); return e; }
    *out = s;
    return ORL_OK;
}
