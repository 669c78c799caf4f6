/* Multi-view stereo after PatchMatch (Bleyer et al. 2011; Galliani et al. 2015; Schoenberger et al. 2016): every pixel holds a plane; planes spread to neighbours on a checkerboard and are
 * perturbed; a plane's cost is the weighted normalised cross-correlation of the patch that it induces in the best few of the photo's companions. The correlation does not see gain and offset,
 * so photos of any light and filter take part. Coarse to fine; a last pass asks that the companions' planes agree; what is not confirmed is dropped.
 *
 * Patches are 61 samples (the black fields of 11 x 11), weighted by likeness of grey to the centre; a companion's picture is stored as its four bilinear corners in one word, so that a sample is one gather.
 * Red pixels read black ones only and companions' maps are frozen during a pass: results do not depend on threads. */
#include "trainer/stereo.h"
#include <malloc.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "oriel/parallel.h"
#include "trainer/facing.h"
#include "trainer/order.h"
#include "trainer/ranks.h"
#include "trainer/grid.h"

enum { LEVELS = 3, COMPANIONS = 16, TRUSTED = 6, BEST = 2, GEOMETRIC = 2, FAR_TRIES = 2, RADIUS = 5, PADDED = 64, MOST_POINTS = 8000000 };     /* MOST_POINTS: some for each cell of a surface are enough */
#define MOST_PIXELS ((size_t)32 << 20)  /* of all pictures at level 0, 46 bytes each: beyond, large photos are halved and a choice of them takes part */
#define HALVE_PIXELS ((size_t)400000)
#define COST_MAX 2.0f           /* 1 - correlation */
#define COST_KEEP 0.6f
#define GEOMETRY 0.15f          /* cost of a pixel of disagreement, 3 pixels at most */
#define NOISE 3.0f              /* variance of grey that is no texture */
#define DEPTH_AGREES 0.012f

/* One photo at one level: undistorted, pinhole. */
typedef struct {
    int w, h;
    float fx, fy, cx, cy;
    uint8_t *grey;
    uint32_t *corners;
} picture;

typedef struct { float z, n[3]; } plane;        /* depth along the optical axis in fine cells, normal in camera axes; z = 0: none */

typedef struct {
    picture level[LEVELS];
    plane *map, *frozen;            /* of the level at hand; as they were before this round */
    float *cost;
    uint8_t *sky;                   /* at level 0: 1 surely sky */
    float R[9], c[3];               /* grid -> camera rotation, centre */
    float z_min, z_max;
    int companion[COMPANIONS], ncompanions;
} shot;

typedef struct { float A[9], b[3]; const picture *to; const shot *shot; float Rrel[9], t[3]; } pair;   /* pixel of ref -> pixel of companion: A + b m^T */

/* unit counts photos done: round 0 coarse to fine by correlation alone, then GEOMETRIC rounds with the companions' agreement. */
struct stereo_work {
    const world *w;
    shot *shots;
    uint64_t seed;
    int threads, unit;
    int k, level, pass, colour, geometry;       /* of the photo at hand */
    pair pairs[COMPANIONS];
    pair (*all)[COMPANIONS];                    /* of every photo at full size, for stereo_slope */
};
typedef struct stereo_work job;

/* ---- pictures ---- */

static void pack_corners(picture *p)
{
    for (int y = 0; y < p->h; y++)
        for (int x = 0; x < p->w; x++) {
            int x1 = x + 1 < p->w ? x + 1 : x, y1 = y + 1 < p->h ? y + 1 : y;
            p->corners[y * p->w + x] = (uint32_t)p->grey[y * p->w + x] | (uint32_t)p->grey[y * p->w + x1] << 8 | (uint32_t)p->grey[y1 * p->w + x] << 16 | (uint32_t)p->grey[y1 * p->w + x1] << 24;
        }
}

static int picture_alloc(picture *p, int w, int h)
{
    p->w = w;
    p->h = h;
    p->grey = malloc((size_t)w * (size_t)h);
    p->corners = malloc((size_t)w * (size_t)h * sizeof *p->corners);
    return p->grey && p->corners;
}

static void shot_place(const world_photo *p, shot *s)
{
    for (int i = 0; i < 3; i++) {
        s->c[i] = (float)p->centre[i];
        for (int j = 0; j < 3; j++) s->R[3 * i + j] = (float)p->axes[3 * j + i];
    }
}

/* Level 0 has the photo's size halved `halve` times. */
static orl_err shot_load(const world_photo *p, int halve, shot *s)
{
    picture *q = &s->level[0];
    int w = p->w >> halve, h = p->h >> halve, side = 1 << halve;
    size_t n = (size_t)w * (size_t)h, full = (size_t)p->w * (size_t)p->h;
    int ok = picture_alloc(q, w, h);
    s->sky = malloc(n);
    s->map = calloc(n, sizeof *s->map);
    s->frozen = calloc(n, sizeof *s->frozen);
    s->cost = malloc(n * sizeof *s->cost);
    float *grey = malloc(full * sizeof *grey), *sum = calloc((size_t)w, sizeof *sum);
    orl_err e = ok && s->sky && s->map && s->frozen && s->cost && grey && sum ? ORL_OK : orl_fail(ORL_E_MEMORY, "stereo: no memory");
    if (e) goto done;
    for (int y = 0; y < p->h; y++)
        for (int x = 0; x < p->w; x++) {
            uint8_t rgb[3];
            world_rgb(p, x, y, rgb);
            grey[(size_t)y * (size_t)p->w + (size_t)x] = 0.299f * rgb[0] + 0.587f * rgb[1] + 0.114f * rgb[2];
        }
    orl_camera pin = p->cam;
    pin.model = ORL_CAM_PINHOLE;
    pin.k1 = pin.k2 = pin.p1 = pin.p2 = 0;
    q->fx = (float)(pin.fx / side); q->fy = (float)(pin.fy / side); q->cx = (float)(pin.cx / side); q->cy = (float)(pin.cy / side);
    for (int y = 0; y < h * side; y++)
        for (int x = 0; x < w * side; x++) {
            double d[3], uv[2] = { 0, 0 };
            orl_camera_unproject(&pin, x + 0.5, y + 0.5, d);
            orl_camera_project(&p->cam, d, uv);
            float u = fminf(fmaxf((float)uv[0] - 0.5f, 0), (float)(p->w - 1)), v = fminf(fmaxf((float)uv[1] - 0.5f, 0), (float)(p->h - 1));
            int x0 = (int)u, y0 = (int)v, x1 = x0 + (x0 < p->w - 1), y1 = y0 + (y0 < p->h - 1);
            const float *g0 = grey + (size_t)y0 * (size_t)p->w, *g1 = grey + (size_t)y1 * (size_t)p->w;
            float a = g0[x0] + (u - (float)x0) * (g0[x1] - g0[x0]), b = g1[x0] + (u - (float)x0) * (g1[x1] - g1[x0]);
            int at = (y >> halve) * w + (x >> halve);
            sum[x >> halve] += a + (v - (float)y0) * (b - a);
            if (((x + 1) | (y + 1)) & (side - 1)) continue;     /* last of its square */
            q->grey[at] = (uint8_t)(sum[x >> halve] / (float)(side * side) + 0.5f);
            sum[x >> halve] = 0;
            s->sky[at] = world_label(p, x0, y0) == WORLD_SKY;
        }
    for (int l = 1; l < LEVELS; l++) {
        picture *r = &s->level[l], *f = &s->level[l - 1];
        if (!picture_alloc(r, f->w / 2, f->h / 2)) { e = orl_fail(ORL_E_MEMORY, "stereo: no memory"); goto done; }
        r->fx = f->fx * 0.5f; r->fy = f->fy * 0.5f; r->cx = f->cx * 0.5f; r->cy = f->cy * 0.5f;
        for (int y = 0; y < r->h; y++)
            for (int x = 0; x < r->w; x++) {
                const uint8_t *g = f->grey + (size_t)(2 * y) * (size_t)f->w + 2 * x;
                r->grey[y * r->w + x] = (uint8_t)((g[0] + g[1] + g[f->w] + g[f->w + 1] + 2) >> 2);
            }
    }
    for (int l = 0; l < LEVELS; l++) pack_corners(&s->level[l]);
    shot_place(p, s);
done:
    free(grey);
    free(sum);
    return e;
}

static void shot_free(shot *s)
{
    for (int l = 0; l < LEVELS; l++) { free(s->level[l].grey); free(s->level[l].corners); }
    free(s->map);
    free(s->frozen);
    free(s->cost);
    free(s->sky);
}

/* ---- companions and depth range ---- */

typedef struct { double score; int photo; } rank;

static int by_score(const void *a, const void *b)
{
    const rank *x = a, *y = b;
    return x->score < y->score ? 1 : x->score > y->score ? -1 : x->photo - y->photo;
}

/* Photos that share many SfM points, each worth most where its rays meet at 5 to 20 degrees and its scales are alike. */
static void choose_companions(const world *w, shot *shots, int k, rank *order, uint8_t *seen, float *depth)
{
    shot *s = &shots[k];
    const world_photo *p = &w->photos[k];
    int n = 0;
    memset(seen, 0, w->npoints);
    for (uint32_t i = 0; i < p->obs_count; i++) {
        const world_obs *o = &w->obs[p->obs_begin + i];
        double uv[2], z;
        if (!world_project(p, w->points[o->point].x, uv, &z) || z < 1) continue;
        seen[o->point] = 1;
        depth[n++] = (float)z;
    }
    order_floats(depth, (size_t)n);
    s->z_min = n ? fmaxf(0.12f * depth[n / 50], 1) : 1;
    s->z_max = n ? 2.0f * depth[n - 1 - n / 50] : 1e4f;
    for (int j = 0; j < w->nphotos; j++) {
        const world_photo *q = &w->photos[j];
        order[j] = (rank){ 0, j };
        if (j == k || !shots[j].map) continue;
        for (uint32_t i = 0; i < q->obs_count; i++) {
            const world_point *x = &w->points[w->obs[q->obs_begin + i].point];
            if (!seen[w->obs[q->obs_begin + i].point]) continue;
            double a[3], b[3], aa = 0, bb = 0, ab = 0;
            for (int c = 0; c < 3; c++) {
                a[c] = x->x[c] - p->centre[c];
                b[c] = x->x[c] - q->centre[c];
                aa += a[c] * a[c]; bb += b[c] * b[c]; ab += a[c] * b[c];
            }
            double angle = acos(fmin(ab / sqrt(aa * bb + 1e-12), 1)) * 180 / 3.14159265, scale = p->cam.fx / sqrt(aa + 1e-9) / (q->cam.fx / sqrt(bb + 1e-9));
            double good = angle < 5 ? angle / 5 : angle < 20 ? 1 : exp(-(angle - 20) * (angle - 20) / 450);
            if (scale > 1) scale = 1 / scale;
            order[j].score += good * fmin(1, 1.5 * scale);
        }
    }
    qsort(order, (size_t)w->nphotos, sizeof *order, by_score);
    s->ncompanions = 0;
    for (int j = 0; j < w->nphotos && s->ncompanions < COMPANIONS; j++) if (order[j].score > 2) s->companion[s->ncompanions++] = order[j].photo;
}

static void make_pairs(job *j)
{
    const shot *s = &j->shots[j->k];
    const picture *p = &s->level[j->level];
    for (int i = 0; i < s->ncompanions; i++) {
        const shot *o = &j->shots[s->companion[i]];
        pair *q = &j->pairs[i];
        q->shot = o;
        q->to = &o->level[j->level];
        float M[9];
        for (int a = 0; a < 3; a++) {
            q->t[a] = 0;
            for (int b = 0; b < 3; b++) {
                q->Rrel[3 * a + b] = o->R[3 * a] * s->R[3 * b] + o->R[3 * a + 1] * s->R[3 * b + 1] + o->R[3 * a + 2] * s->R[3 * b + 2];
                q->t[a] += o->R[3 * a + b] * (s->c[b] - o->c[b]);
            }
        }
        for (int a = 0; a < 3; a++) {           /* Rrel K^-1 */
            float r0 = q->Rrel[3 * a] / p->fx, r1 = q->Rrel[3 * a + 1] / p->fy;
            M[3 * a] = r0; M[3 * a + 1] = r1; M[3 * a + 2] = q->Rrel[3 * a + 2] - r0 * p->cx - r1 * p->cy;
        }
        const picture *t = q->to;
        for (int b = 0; b < 3; b++) {
            q->A[b] = t->fx * M[b] + t->cx * M[6 + b];
            q->A[3 + b] = t->fy * M[3 + b] + t->cy * M[6 + b];
            q->A[6 + b] = M[6 + b];
        }
        q->b[0] = t->fx * q->t[0] + t->cx * q->t[2];
        q->b[1] = t->fy * q->t[1] + t->cy * q->t[2];
        q->b[2] = q->t[2];
    }
}

/* ---- cost ---- */

typedef float v16 __attribute__((vector_size(64)));

/* The reference patch: weights sum to 1, grey with its weighted mean taken off. */
typedef struct { float w[PADDED], g[PADDED]; float var; const struct window *in; } patch __attribute__((aligned(64)));

static struct window { float x[PADDED], y[PADDED], near[PADDED]; int n; } __attribute__((aligned(64))) WIDE, DENSE;     /* the black fields of 11 x 11; all of 7 x 7 */
static float LIKENESS[256];

/* Every step-th field of a square; what lies `fade` pixels from its middle still counts exp(-1/2). */
static void window_make(struct window *w, int side, int step, float fade)
{
    memset(w, 0, sizeof *w);
    for (int i = 0; i < side * side; i += step) {
        float x = w->x[w->n] = (float)(i % side - side / 2), y = w->y[w->n] = (float)(i / side - side / 2);
        w->near[w->n++] = expf(-(x * x + y * y) / (2 * fade * fade));
    }
}

static void tables_make(void)
{
    window_make(&WIDE, 2 * RADIUS + 1, 2, RADIUS);
    window_make(&DENSE, 7, 1, 3);
    for (int i = 0; i < 256; i++) LIKENESS[i] = i < 160 ? expf(-(float)i / 20.0f) : 0;
}

static void patch_make(const picture *p, const struct window *in, int x, int y, patch *out)
{
    float sum = 0, mean = 0;
    int centre = p->grey[y * p->w + x];
    memset(out, 0, sizeof *out);
    out->in = in;
    for (int i = 0; i < in->n; i++) {
        int u = x + (int)in->x[i], v = y + (int)in->y[i];
        if (u < 0 || v < 0 || u >= p->w || v >= p->h) continue;
        int g = p->grey[v * p->w + u], d = g > centre ? g - centre : centre - g;
        out->w[i] = LIKENESS[d] * in->near[i];
        out->g[i] = (float)g;
        sum += out->w[i];
        mean += out->w[i] * (float)g;
    }
    mean /= sum;
    out->var = 0;
    for (int i = 0; i < PADDED; i++) {
        out->w[i] /= sum;
        out->g[i] -= mean;
        out->var += out->w[i] * out->g[i] * out->g[i];
    }
}

static float sum16(v16 v)
{
    v8 a = __builtin_shufflevector(v, v, 0, 1, 2, 3, 4, 5, 6, 7) + __builtin_shufflevector(v, v, 8, 9, 10, 11, 12, 13, 14, 15);
    v4 b = __builtin_shufflevector(a, a, 0, 1, 2, 3) + __builtin_shufflevector(a, a, 4, 5, 6, 7);
    return (b[0] + b[2]) + (b[1] + b[3]);
}

/* 1 - correlation of the patch around (x, y) with its image under the plane's homography; COST_MAX if that leaves the companion's picture. */
static float correlate(const patch *p, const pair *q, const float m[3], float x, float y)
{
    float H[9];
    for (int r = 0; r < 3; r++) for (int c = 0; c < 3; c++) H[3 * r + c] = q->A[3 * r + c] + q->b[r] * m[c];
    float X = H[0] * x + H[1] * y + H[2], Y = H[3] * x + H[4] * y + H[5], Z = H[6] * x + H[7] * y + H[8];
    const picture *t = q->to;
    float right = (float)t->w - 1.001f, low = (float)t->h - 1.001f;
    if (!(Z > 1e-6f) || X < Z || Y < Z || X > (right) * Z || Y > (low) * Z) return COST_MAX;
    float value[PADDED] __attribute__((aligned(64)));
    const float *ox = p->in->x, *oy = p->in->y;
    const uint32_t *corners = t->corners;
    int stride = t->w;
    for (int i = 0; i < PADDED; i++) {
        float z = Z + H[6] * ox[i] + H[7] * oy[i], iz = 1.0f / (z > 1e-6f ? z : 1e-6f);
        float u = (X + H[0] * ox[i] + H[1] * oy[i]) * iz - 0.5f, v = (Y + H[3] * ox[i] + H[4] * oy[i]) * iz - 0.5f;
        u = u > 0 ? u : 0; u = u < right ? u : right;
        v = v > 0 ? v : 0; v = v < low ? v : low;
        int iu = (int)u, iv = (int)v;
        float fu = u - (float)iu, fv = v - (float)iv;
        uint32_t c = corners[iv * stride + iu];
        float g0 = (float)(int)(c & 255), g1 = (float)(int)(c >> 8 & 255), g2 = (float)(int)(c >> 16 & 255), g3 = (float)(int)(c >> 24);
        float a = g0 + fu * (g1 - g0), b = g2 + fu * (g3 - g2);
        value[i] = a + fv * (b - a);
    }
    const v16 *v = (const v16 *)value, *w = (const v16 *)p->w, *g = (const v16 *)p->g;
    v16 s0 = { 0 }, s1 = { 0 }, s2 = { 0 };
    for (int i = 0; i < PADDED / 16; i++) {
        v16 wv = w[i] * v[i];
        s0 += wv;
        s1 += wv * v[i];
        s2 += wv * g[i];
    }
    float mean = sum16(s0), var = sum16(s1) - mean * mean, cov = sum16(s2);
    float cost = 1 - cov / sqrtf((p->var + NOISE) * (fmaxf(var, 0) + NOISE));
    return cost < 0 ? 0 : cost;
}

static void ray_of(const picture *p, float x, float y, float d[3])
{
    d[0] = (x - p->cx) / p->fx;
    d[1] = (y - p->cy) / p->fy;
    d[2] = 1;
}

/* Pixels between (x, y) and where the companion's own plane at its image of the point comes back to; 3 at most. agree (may be NULL): that point, in the reference camera's axes. */
static float disagreement(const picture *p, const pair *q, float x, float y, float z, const plane *map, float point[3])
{
    float d[3], c[3];
    ray_of(p, x, y, d);
    for (int a = 0; a < 3; a++) c[a] = z * (q->Rrel[3 * a] * d[0] + q->Rrel[3 * a + 1] * d[1] + q->Rrel[3 * a + 2] * d[2]) + q->t[a];
    if (!(c[2] > 1e-6f)) return 3;
    const picture *t = q->to;
    float u = t->fx * c[0] / c[2] + t->cx, v = t->fy * c[1] / c[2] + t->cy;
    if (!(u >= 0) || !(v >= 0) || u >= (float)t->w || v >= (float)t->h) return 3;
    const plane *o = &map[(int)v * t->w + (int)u];
    if (!(o->z > 0)) return 3;
    float od[3], centre[3], num = 0, den = 0;
    ray_of(t, (float)(int)u + 0.5f, (float)(int)v + 0.5f, centre);
    ray_of(t, u, v, od);
    for (int a = 0; a < 3; a++) { num += o->n[a] * centre[a]; den += o->n[a] * od[a]; }
    float oz = den < -1e-3f ? o->z * num / den : o->z, back[3];
    if (!(fabsf(oz / o->z - 1) < 0.05f)) oz = o->z;
    for (int a = 0; a < 3; a++) {
        back[a] = 0;
        for (int b = 0; b < 3; b++) back[a] += q->Rrel[3 * b + a] * (oz * od[b] - q->t[b]);
    }
    if (!(back[2] > 1e-6f)) return 3;
    float dx = p->fx * back[0] / back[2] + p->cx - x, dy = p->fy * back[1] / back[2] + p->cy - y, e = sqrtf(dx * dx + dy * dy);
    if (point) memcpy(point, back, sizeof back);
    return e < 3 ? e : 3;
}

/* Companions that a pixel asks, and after all were asked the few that answered best. */
typedef struct { int n, at[COMPANIONS]; float cost[COMPANIONS]; } jury;

/* The plane through pixel (x, y) at depth z with normal n as a linear form of the picture: 1 / depth, but for the sign, is m . (u, v, 1). 0: seen from behind. */
static int plane_form(const picture *p, float x, float y, float z, const float n[3], float m[3])
{
    float d[3], dist = 0;
    ray_of(p, x, y, d);
    for (int a = 0; a < 3; a++) dist += n[a] * d[a];
    dist *= z;
    if (!(dist < -1e-6f)) return 0;
    m[0] = n[0] / p->fx / dist;
    m[1] = n[1] / p->fy / dist;
    m[2] = n[2] / dist - m[0] * p->cx - m[1] * p->cy;
    return 1;
}

/* Mean cost of the BEST companions of the jury. all: note each one's cost (for jury_trust). */
static float plane_cost(const job *j, const patch *pt, float x, float y, const plane *pl, jury *ask, int all)
{
    const shot *s = &j->shots[j->k];
    const picture *p = &s->level[j->level];
    float m[3], best[BEST];
    if (!plane_form(p, x, y, pl->z, pl->n, m)) return COST_MAX;
    for (int k = 0; k < BEST; k++) best[k] = COST_MAX;
    for (int i = 0; i < ask->n; i++) {
        const pair *q = &j->pairs[ask->at[i]];
        float c = correlate(pt, q, m, x, y);
        if (j->geometry && (all || c < best[BEST - 1])) c += GEOMETRY * disagreement(p, q, x, y, pl->z, q->shot->frozen, NULL);
        if (all) ask->cost[i] = c;
        if (c >= best[BEST - 1]) continue;
        int at = BEST - 1;
        for (; at > 0 && best[at - 1] > c; at--) best[at] = best[at - 1];
        best[at] = c;
    }
    int use = ask->n < BEST ? ask->n : BEST;
    float sum = 0;
    for (int k = 0; k < use; k++) sum += best[k];
    return use ? sum / (float)use : COST_MAX;
}

static void jury_trust(jury *ask)
{
    for (int i = 1; i < ask->n; i++) {
        float c = ask->cost[i];
        int who = ask->at[i], k = i;
        for (; k > 0 && ask->cost[k - 1] > c; k--) { ask->cost[k] = ask->cost[k - 1]; ask->at[k] = ask->at[k - 1]; }
        ask->cost[k] = c;
        ask->at[k] = who;
    }
    if (ask->n > TRUSTED) ask->n = TRUSTED;
}

/* ---- propagation ---- */

static void random_normal(rng *r, const float d[3], float n[3])
{
    float len, dot = 0;
    do {
        len = 0;
        for (int a = 0; a < 3; a++) { n[a] = 2 * rng_f(r) - 1; len += n[a] * n[a]; }
    } while (len > 1 || len < 1e-3f);
    len = 1 / sqrtf(len);
    for (int a = 0; a < 3; a++) { n[a] *= len; dot += n[a] * d[a]; }
    if (dot > 0) for (int a = 0; a < 3; a++) n[a] = -n[a];
}

static void tilt(rng *r, const float d[3], float by, float n[3])
{
    float m[3], len = 0, dot = 0;
    for (int a = 0; a < 3; a++) { m[a] = n[a] + by * rng_normal(r); len += m[a] * m[a]; }
    len = 1 / sqrtf(len + 1e-12f);
    for (int a = 0; a < 3; a++) { m[a] *= len; dot += m[a] * d[a]; }
    if (dot < -0.02f) memcpy(n, m, sizeof m);
}

static void spread_rows(void *user, int begin, int end)
{
    const job *j = user;
    const shot *s = &j->shots[j->k];
    const picture *p = &s->level[j->level];
    static const int NEAR[8][2] = { { 1, 0 }, { -1, 0 }, { 0, 1 }, { 0, -1 }, { 5, 0 }, { -5, 0 }, { 0, 5 }, { 0, -5 } };
    for (int y = begin; y < end; y++)
        for (int x = (y + j->colour) & 1; x < p->w; x += 2) {
            int at = y * p->w + x;
            plane *best = &s->map[at];
            if (best->z <= 0) continue;
            rng r = rng_make(j->seed, (uint64_t)j->k << 16 | (uint64_t)(j->level * 32 + j->pass), (uint64_t)at);
            float fx = (float)x + 0.5f, fy = (float)y + 0.5f, d[3];
            patch pt;
            ray_of(p, fx, fy, d);
            patch_make(p, &WIDE, x, y, &pt);
            jury ask = { .n = s->ncompanions };
            for (int i = 0; i < ask.n; i++) ask.at[i] = i;
            int coarse = j->level == LEVELS - 1;            /* planes are still wild: ask everyone, look far */
            float cost = j->pass == 0 || !coarse ? plane_cost(j, &pt, fx, fy, best, &ask, !coarse) : s->cost[at];
            if (!coarse) jury_trust(&ask);
            for (int k = 0; k < (coarse ? 8 : 4 + FAR_TRIES); k++) {
                int u = x + NEAR[k][0], v = y + NEAR[k][1];
                if (!coarse && k >= 4) {        /* a plane that shows between columns shows again between the next two */
                    int reach = p->w / 10;
                    u = x + (int)rng_below(&r, (uint32_t)(2 * reach + 1)) - reach;
                    v = y + (int)rng_below(&r, (uint32_t)(2 * reach + 1)) - reach;
                    if (((u ^ v ^ x ^ y) & 1) == 0) v++;    /* the other colour */
                }
                if (u < 0 || v < 0 || u >= p->w || v >= p->h) continue;
                const plane *o = &s->map[v * p->w + u];
                if (o->z <= 0) continue;
                float od[3], num = 0, den = 0;
                ray_of(p, (float)u + 0.5f, (float)v + 0.5f, od);
                for (int a = 0; a < 3; a++) { num += o->n[a] * od[a]; den += o->n[a] * d[a]; }
                plane t = *o;
                t.z = o->z * num / den;
                if (!(den < -1e-3f) || !(t.z > s->z_min) || t.z > s->z_max) continue;
                float c = plane_cost(j, &pt, fx, fy, &t, &ask, 0);
                if (c < cost) { cost = c; *best = t; }
            }
            float wide = 0.5f;
            for (int k = 0; k < j->pass && k < 6; k++) wide *= 0.55f;
            for (int k = 0; k < 4; k++) {
                plane t = *best;
                if (k == 0) t.z *= expf(0.2f * wide * rng_normal(&r));
                if (k == 1) tilt(&r, d, wide, t.n);
                if (k == 2) { t.z *= expf(0.05f * wide * rng_normal(&r)); tilt(&r, d, 0.5f * wide, t.n); }
                if (k == 3) {
                    if (j->geometry || cost < 0.15f) break;
                    t.z = 1 / (1 / s->z_max + (1 / s->z_min - 1 / s->z_max) * rng_f(&r));
                    random_normal(&r, d, t.n);
                }
                if (!(t.z > s->z_min) || t.z > s->z_max) continue;
                float c = plane_cost(j, &pt, fx, fy, &t, &ask, 0);
                if (c < cost) { cost = c; *best = t; }
            }
            s->cost[at] = cost;
        }
}

static void spread(job *j, int passes)
{
    make_pairs(j);
    for (j->pass = 0; j->pass < passes; j->pass++)
        for (j->colour = 0; j->colour < 2; j->colour++) orl_parallel(j->threads, j->shots[j->k].level[j->level].h, 4, spread_rows, j);
}

/* First planes: inverse depths of SfM points carried to each pixel from the nearest ones, half of them scattered. */
static void start(job *j)
{
    const world *w = j->w;
    shot *s = &j->shots[j->k];
    const world_photo *ph = &w->photos[j->k];
    const picture *p = &s->level[LEVELS - 1];
    int n = p->w * p->h;
    float *sum = calloc((size_t)n * 2, sizeof *sum), *wt = sum + n;
    for (uint32_t i = 0; sum && i < ph->obs_count; i++) {
        const world_point *q = &w->points[w->obs[ph->obs_begin + i].point];
        double uv[2], z;
        if (!world_sees(ph, q->x, uv, &z) || z < 1) continue;
        int x = (int)(uv[0] * p->w / ph->w), y = (int)(uv[1] * p->h / ph->h);
        if (x >= p->w || y >= p->h) continue;
        sum[y * p->w + x] += q->weight / (float)z;
        wt[y * p->w + x] += q->weight;
    }
    for (int y = 0; y < p->h; y++)
        for (int x = 0; x < p->w; x++) {
            rng r = rng_make(j->seed, 0x57a7 + (uint64_t)j->k, (uint64_t)(y * p->w + x));
            plane *o = &s->map[y * p->w + x];
            float d[3], a = 0, b = 0;
            ray_of(p, (float)x + 0.5f, (float)y + 0.5f, d);
            random_normal(&r, d, o->n);
            for (int reach = 2; sum && b == 0 && reach < p->w; reach *= 2)
                for (int v = y - reach < 0 ? 0 : y - reach; v <= y + reach && v < p->h; v++)
                    for (int u = x - reach < 0 ? 0 : x - reach; u <= x + reach && u < p->w; u++) { a += sum[v * p->w + u]; b += wt[v * p->w + u]; }
            float lo = 1 / s->z_max, hi = 1 / s->z_min, inv = b > 0 && rng_f(&r) < 0.7f ? a / b * expf(0.08f * rng_normal(&r)) : lo + (hi - lo) * rng_f(&r);
            o->z = 1 / fminf(fmaxf(inv, lo * 1.001f), hi * 0.999f);
            if (s->sky[(4 * y + 2) * s->level[0].w + 4 * x + 2]) o->z = 0;
        }
    free(sum);
}

/* The map at twice the size: each pixel takes its parent's plane. */
static void refine_map(shot *s, int level)
{
    const picture *p = &s->level[level], *up = &s->level[level + 1];
    memcpy(s->frozen, s->map, (size_t)(up->w * up->h) * sizeof *s->map);
    for (int y = 0; y < p->h; y++)
        for (int x = 0; x < p->w; x++) {
            int px = x / 2 < up->w ? x / 2 : up->w - 1, py = y / 2 < up->h ? y / 2 : up->h - 1;
            const plane *o = &s->frozen[py * up->w + px];
            plane *t = &s->map[y * p->w + x];
            *t = *o;
            if (o->z > 0) {
                float od[3], d[3], num = 0, den = 0;
                ray_of(up, (float)px + 0.5f, (float)py + 0.5f, od);
                ray_of(p, (float)x + 0.5f, (float)y + 0.5f, d);
                for (int a = 0; a < 3; a++) { num += o->n[a] * od[a]; den += o->n[a] * d[a]; }
                if (den < -1e-3f) t->z = fminf(fmaxf(o->z * num / den, s->z_min), s->z_max);
            } else if (px > 0 && s->frozen[py * up->w + px - 1].z > 0) *t = s->frozen[py * up->w + px - 1];     /* sky's rim: let the finer level decide */
            else if (px + 1 < up->w && s->frozen[py * up->w + px + 1].z > 0) *t = s->frozen[py * up->w + px + 1];
            if (level == 0 && s->sky[y * p->w + x]) t->z = 0;
        }
}

/* ---- what is confirmed ---- */

static uint32_t confirm(const job *work, int k, stereo_point *out)
{
    job here = *work, *j = &here;
    const shot *s = &j->shots[k];
    const picture *p = &s->level[0];
    uint32_t n = 0;
    j->k = k;
    j->level = 0;
    int need = s->ncompanions > 3 ? 2 : 1;
    make_pairs(j);
    for (int y = 2; y < p->h - 2; y++)
        for (int x = 2; x < p->w - 2; x++) {
            const plane *o = &s->map[y * p->w + x];
            if (!(o->z > 0) || s->cost[y * p->w + x] > COST_KEEP) continue;
            float fx = (float)x + 0.5f, fy = (float)y + 0.5f, d[3], z = o->z;
            int agree = 0;
            for (int i = 0; i < s->ncompanions; i++) {
                float point[3];
                if (disagreement(p, &j->pairs[i], fx, fy, o->z, j->pairs[i].shot->map, point) > 1.2f || fabsf(point[2] / o->z - 1) > DEPTH_AGREES) continue;
                z += point[2];
                agree++;
            }
            if (agree < need) continue;
            z /= (float)(agree + 1);
            ray_of(p, fx, fy, d);
            stereo_point *q = &out[n++];
            for (int a = 0; a < 3; a++) {
                q->x[a] = s->c[a] + z * (s->R[a] * d[0] + s->R[3 + a] * d[1] + s->R[6 + a] * d[2]);
                q->n[a] = s->R[a] * o->n[0] + s->R[3 + a] * o->n[1] + s->R[6 + a] * o->n[2];
            }
            q->photo = (uint32_t)k;
            q->weight = fminf(1, (float)agree / 4) * (1 - s->cost[y * p->w + x] / COST_KEEP * 0.7f);
        }
    return n;
}

static size_t map_size(const shot *s) { return (size_t)s->level[0].w * (size_t)s->level[0].h; }

orl_err stereo_begin(const world *w, uint64_t seed, int threads, stereo_work **out)
{
    size_t photos = (size_t)w->nphotos;
    job *j = calloc(1, sizeof *j);
    rank *order = malloc(photos * sizeof *order);
    uint8_t *seen = malloc((size_t)w->npoints + 1);
    float *depth = malloc(((size_t)w->nobs + 1) * sizeof *depth);
    orl_err e = j && order && seen && depth ? ORL_OK : orl_fail(ORL_E_MEMORY, "stereo: no memory");
    tables_make();
    if (!e) {
        j->w = w;
        j->seed = seed;
        j->threads = threads;
        j->shots = calloc(photos, sizeof *j->shots);
        if (!j->shots) e = orl_fail(ORL_E_MEMORY, "stereo: no memory");
    }
    size_t pixels = 0;
    for (int k = 0; k < w->nphotos; k++) pixels += (size_t)w->photos[k].w * (size_t)w->photos[k].h;
    int halve = pixels > MOST_PIXELS && pixels / photos > HALVE_PIXELS;
    uint8_t *use = e ? NULL : world_cover(w, w->nphotos, MOST_PIXELS << 2 * halve);
    if (!e && !use) e = orl_fail(ORL_E_MEMORY, "stereo: no memory");
    for (int k = 0; !e && k < w->nphotos; k++) if (use[k]) e = shot_load(&w->photos[k], halve, &j->shots[k]);
    for (int k = 0; !e && k < w->nphotos; k++) {
        if (!use[k]) continue;
        choose_companions(w, j->shots, k, order, seen, depth);
        const picture *least = &j->shots[k].level[LEVELS - 1];
        if (least->w < 8 || least->h < 8) j->shots[k].ncompanions = 0;
    }
    free(order);
    free(seen);
    free(depth);
    free(use);
    if (e) stereo_end(j);
    else *out = j;
    return e;
}

int stereo_step(stereo_work *j)
{
    static const int PASSES[LEVELS] = { 3, 3, 6 };
    int n = j->w->nphotos, round = j->unit / n;
    if (round > GEOMETRIC) return 0;
    shot *s = &j->shots[j->k = j->unit % n];
    j->geometry = round > 0;
    if (j->geometry && j->k == 0) for (int k = 0; k < n; k++) memcpy(j->shots[k].frozen, j->shots[k].map, map_size(&j->shots[k]) * sizeof(plane));
    j->unit++;
    int ours = s->ncompanions && j->k % ranks_count() == ranks_mine();
    if (ours && j->geometry) {
        j->seed += (uint64_t)round;             /* other dice than in the first round */
        j->level = 0;
        spread(j, 1);
        j->seed -= (uint64_t)round;
    } else if (ours) {
        start(j);
        for (j->level = LEVELS - 1; j->level >= 0; j->level--) {
            if (j->level < LEVELS - 1) refine_map(s, j->level);
            spread(j, PASSES[j->level]);
        }
    }
    for (int k = 0; k < n && j->unit % n == 0; k++) {
        ranks_share(k % ranks_count(), j->shots[k].map, map_size(&j->shots[k]) * sizeof(plane));
        ranks_share(k % ranks_count(), j->shots[k].cost, map_size(&j->shots[k]) * sizeof(float));
    }
    return 1;
}

double stereo_progress(const stereo_work *j)
{
    double n = j->w->nphotos, first = j->unit < n ? j->unit : n, share = 0.15;  /* a geometric round's share of the whole */
    return (1 - GEOMETRIC * share) * first / n + share * (j->unit - first) / n;
}

void stereo_thin(stereo *st, int photos, uint32_t most)
{
    uint64_t n = st->npoints;
    uint32_t to = 0;
    if (n <= most) return;
    for (int k = 0; k < photos; k++) {
        uint32_t begin = to;
        for (uint64_t i = st->begin[k]; i < st->begin[k + 1]; i++) if ((i + 1) * most / n > i * most / n) st->points[to++] = st->points[i];
        st->begin[k] = begin;
    }
    st->begin[photos] = st->npoints = to;
}

orl_err stereo_finish(stereo_work *j, stereo *out)
{
    stereo st = { 0 };
    size_t cap = 0;
    for (int k = 0; k < j->w->nphotos; k++) {
        cap += map_size(&j->shots[k]);
        free(j->shots[k].frozen);               /* gives room for the points */
        j->shots[k].frozen = NULL;
    }
    st.points = malloc((cap + 1) * sizeof *st.points);
    st.begin = calloc((size_t)j->w->nphotos + 1, sizeof *st.begin);
    if (!st.points || !st.begin) { stereo_free(&st); return orl_fail(ORL_E_MEMORY, "stereo: no memory for %zu points", cap); }
    for (int k = 0; k < j->w->nphotos; k++) {
        if (j->shots[k].ncompanions) st.npoints += confirm(j, k, st.points + st.npoints);
        st.begin[k + 1] = st.npoints;
    }
    stereo_thin(&st, j->w->nphotos, MOST_POINTS);
    stereo_point *fit = realloc(st.points, ((size_t)st.npoints + 1) * sizeof *fit);
    if (fit) st.points = fit;
    facings_find(&st, &st.facings);
    facings_square(&st.facings, &st);
    *out = st;
    return ORL_OK;
}

void stereo_end(stereo_work *j)
{
    if (!j) return;
    for (int k = 0; j->shots && k < j->w->nphotos; k++) shot_free(&j->shots[k]);
    free(j->shots);
    free(j->all);
    free(j);
    malloc_trim(0);                             /* its arrays are most of the memory of a run, and too small for the C library to give back by itself */
}

/* ---- a surface against the photos ---- */

orl_err stereo_watch(stereo_work *j)
{
    free(j->all);
    j->all = calloc((size_t)j->w->nphotos, sizeof *j->all);
    if (!j->all) return orl_fail(ORL_E_MEMORY, "stereo: no memory");
    j->level = 0;
    for (int k = 0; k < j->w->nphotos; k++) shot_place(&j->w->photos[k], &j->shots[k]);
    for (j->k = 0; j->k < j->w->nphotos; j->k++) {
        shot *s = &j->shots[j->k];
        free(s->map); free(s->frozen); free(s->cost); free(s->sky);
        s->map = s->frozen = NULL;
        s->cost = NULL;
        s->sky = NULL;
        if (!s->ncompanions) continue;
        make_pairs(j);
        memcpy(j->all[j->k], j->pairs, sizeof j->pairs);
    }
    malloc_trim(0);                             /* as in stereo_end */
    return ORL_OK;
}

/* Of a few companions drawn by lot the JUDGES best ones judge: what does not see the point, or in a light of its own, falls out. */
float stereo_slope(const stereo_work *j, int photo, const float x[3], const float n[3], rng *r)
{
    enum { ASKED = 6, JUDGES = 2, EDGE = 3 };
    const float STEP = 0.5f, PLAIN = 4.0f, UNLIKE = 0.7f;      /* cells along the ray; variance of grey, and cost, that say nothing */
    const shot *s = &j->shots[photo];
    const picture *p = &s->level[0];
    float c[3] = { 0 }, nc[3] = { 0 }, m[3], cost[JUDGES] = { UNLIKE, UNLIKE };
    const pair *judge[JUDGES] = { 0 };
    patch pt;
    if (s->ncompanions < JUDGES) return 0;
    for (int a = 0; a < 3; a++) for (int b = 0; b < 3; b++) { c[a] += s->R[3 * a + b] * (x[b] - s->c[b]); nc[a] += s->R[3 * a + b] * n[b]; }
    if (!(c[2] > 1)) return 0;
    float u = p->fx * c[0] / c[2] + p->cx, v = p->fy * c[1] / c[2] + p->cy;
    if (!(u >= EDGE) || !(v >= EDGE) || u >= (float)(p->w - EDGE) || v >= (float)(p->h - EDGE)) return 0;
    patch_make(p, &DENSE, (int)u, (int)v, &pt);
    u = (float)(int)u + 0.5f;
    v = (float)(int)v + 0.5f;
    if (pt.var < PLAIN || !plane_form(p, u, v, c[2], nc, m)) return 0;
    for (int i = 0; i < ASKED; i++) {
        const pair *q = &j->all[photo][rng_below(r, (uint32_t)s->ncompanions)];
        if (q == judge[0] || q == judge[1]) continue;
        float here = correlate(&pt, q, m, u, v);
        if (here < cost[0]) { cost[1] = cost[0]; judge[1] = judge[0]; cost[0] = here; judge[0] = q; }
        else if (here < cost[1]) { cost[1] = here; judge[1] = q; }
    }
    if (!judge[1]) return 0;
    float dz = STEP * c[2] / sqrtf(c[0] * c[0] + c[1] * c[1] + c[2] * c[2]), slope = 0;
    for (int side = -1; side <= 1; side += 2) {
        if (!plane_form(p, u, v, c[2] + (float)side * dz, nc, m)) return 0;
        for (int i = 0; i < JUDGES; i++) slope += (float)side * correlate(&pt, judge[i], m, u, v);
    }
    return slope / (2 * STEP * JUDGES);
}

int stereo_can_save(const stereo_work *j) { return (j->unit <= j->w->nphotos && ranks_count() == 1) || j->unit % j->w->nphotos == 0; }

orl_err stereo_work_save(const stereo_work *j, FILE *f)
{
    int bad = fwrite(&j->unit, sizeof j->unit, 1, f) != 1;
    for (int k = 0; !bad && k < j->w->nphotos && k < j->unit; k++) {
        size_t n = map_size(&j->shots[k]);
        bad = fwrite(j->shots[k].map, sizeof(plane), n, f) != n || fwrite(j->shots[k].cost, sizeof(float), n, f) != n;
    }
    return bad ? orl_fail(ORL_E_IO, "checkpoint: write failed") : ORL_OK;
}

orl_err stereo_work_load(stereo_work *j, FILE *f, const char *path)
{
    int unit;
    if (fread(&unit, sizeof unit, 1, f) != 1) return orl_fail(ORL_E_FORMAT, "%s: stereo maps are cut short", path);
    if (unit < 0 || unit > (GEOMETRIC + 1) * j->w->nphotos) return orl_fail(ORL_E_RANGE, "%s: %d stereo maps of %d photos", path, unit, j->w->nphotos);
    for (int k = 0; k < j->w->nphotos && k < unit; k++) {
        shot *s = &j->shots[k];
        size_t n = map_size(s);
        if (fread(s->map, sizeof(plane), n, f) != n || fread(s->cost, sizeof(float), n, f) != n) return orl_fail(ORL_E_FORMAT, "%s: stereo map %d is cut short", path, k);
    }
    j->unit = unit;
    return ORL_OK;
}

static uint32_t own_points(const stereo *s, uint32_t k) { return s->found ? s->found[k] : s->begin[k + 1] - s->begin[k]; }

orl_err stereo_save(const stereo *s, FILE *f)
{
    uint32_t n = 0;
    for (uint32_t k = 0; s->begin[k] < s->npoints; k++) n += own_points(s, k);
    int bad = fwrite(&n, sizeof n, 1, f) != 1 || fwrite(&s->facings, sizeof s->facings, 1, f) != 1;
    for (uint32_t k = 0; !bad && s->begin[k] < s->npoints; k++) bad = fwrite(s->points + s->begin[k], sizeof *s->points, own_points(s, k), f) != own_points(s, k);
    return bad ? orl_fail(ORL_E_IO, "checkpoint: write failed") : ORL_OK;
}

orl_err stereo_load(stereo *out, const world *w, FILE *f, const char *path)
{
    stereo s = { 0 };
    uint64_t most = 0;
    orl_err e = ORL_OK;
    for (int k = 0; k < w->nphotos; k++) most += (uint64_t)w->photos[k].w * (uint64_t)w->photos[k].h;
    if (fread(&s.npoints, sizeof s.npoints, 1, f) != 1 || fread(&s.facings, sizeof s.facings, 1, f) != 1) return orl_fail(ORL_E_FORMAT, "%s: stereo points are cut short", path);
    if (s.facings.n < 0 || s.facings.n > ORL_FACINGS) return orl_fail(ORL_E_RANGE, "%s: stereo points with %d facings", path, s.facings.n);
    if (s.npoints > most) return orl_fail(ORL_E_RANGE, "%s: %u stereo points", path, s.npoints);
    s.points = malloc(((size_t)s.npoints + 1) * sizeof *s.points);
    s.begin = calloc((size_t)w->nphotos + 1, sizeof *s.begin);
    if (!s.points || !s.begin) e = orl_fail(ORL_E_MEMORY, "%s: no memory for %u stereo points", path, s.npoints);
    if (!e && fread(s.points, sizeof *s.points, s.npoints, f) != s.npoints) e = orl_fail(ORL_E_FORMAT, "%s: stereo points are cut short", path);
    for (uint32_t i = 0, k = 0; !e && i < s.npoints; i++) {
        if (s.points[i].photo < k || s.points[i].photo >= (uint32_t)w->nphotos) e = orl_fail(ORL_E_RANGE, "%s: stereo point %u is of photo %u", path, i, s.points[i].photo);
        else s.begin[(k = s.points[i].photo) + 1] = i + 1;
    }
    for (int k = 0; !e && k < w->nphotos; k++) if (s.begin[k + 1] < s.begin[k]) s.begin[k + 1] = s.begin[k];
    if (e) stereo_free(&s);
    else *out = s;
    return e;
}

uint32_t *stereo_hits(const stereo *s, const world *w, int k, int side)
{
    const world_photo *p = &w->photos[k];
    int hw = p->w / side + 1, hh = p->h / side + 1;
    uint32_t *hit = calloc((size_t)hw * (size_t)hh, sizeof *hit);
    for (uint32_t i = s->begin[k]; hit && i < s->begin[k + 1]; i++) {
        double uv[2];
        if (world_sees(p, s->points[i].x, uv, NULL)) hit[(int)uv[1] / side * hw + (int)uv[0] / side] = i + 1;
    }
    return hit;
}

void stereo_free(stereo *s)
{
    free(s->points);
    free(s->begin);
    free(s->found);
    memset(s, 0, sizeof *s);
}
