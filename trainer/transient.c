/* Transients (transient.h). A pixel's evidence is how far its colour lies from what the scene can look like there: from the line between the surface in shadow and in the sun under the photo's
 * own light, corrected by what the other photos of the point have in common beyond the model (their median residual: detail, errors of base colour), the best in a small window (edges may be
 * a little off), over how far the other photos lie off themselves. Ground that too few others see has drunk the colours of who stands on it: there the scene's common ground is
 * expected instead. Points that SfM found in other photos speak against, some pixels around. The evidence then flows along the photo and stops at its edges:
 *   minimise sum lambda (x_i - u_i)^2 + sum w_ij (x_i - x_j)^2,   w_ij = 1 / (1 + (|c_i - c_j| / s)^4).
 * Constants are the same for every photo and scene; they were chosen on one collection (basilica), so figures on it flatter them. */
#include "trainer/transient.h"
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "oriel/parallel.h"
#include "trainer/order.h"

enum { SATURATED = 250, COMPANIONS = 48, FEW = 2, REACH = 3, SFM_REACH = 2, SWEEPS = 100 };
#define FLOOR 0.03f             /* of a residual's noise */
#define UNSEEN 0.08f            /* noise where too few others look */
#define EVEN 1.7f               /* evidence that speaks neither way, in noises */
#define FOUND 5.0f              /* what an SfM point takes off the evidence */
#define LAMBDA 0.0015f
#define EDGE 0.048f             /* colour step that halves the flow */
#define CUT -0.28f
#define USUAL 0.028f            /* the photo's own median residual counts beyond this */
#define PLAIN 0.75f             /* of the ground's usual distance from common ground: what counts as ground */
#define OVER 8.0f               /* light may be stronger than the model's by so many steps from shadow to sun: where little of a photo is lit, its sun is found too weak */

typedef uint8_t colour[3];
/* t: along the ray, 0 = nothing met; the photo; the model as fitted, in full sun, in shadow; how far the photo is from common ground there. */
typedef struct { int w, h; float *t; colour *rgb, *fit, *lit, *shade; uint8_t *bare; } plane;
typedef struct { const world *w; const stage2 *s2; plane *p; uint8_t **out; int failed; } job;

static float middle(float *v, int n)
{
    if (n > COMPANIONS) order_floats(v, (size_t)n);
    else for (int i = 1; i < n; i++) {
        float x = v[i];
        int j = i;
        for (; j && v[j - 1] > x; j--) v[j] = v[j - 1];
        v[j] = x;
    }
    return v[n / 2];
}

static void put_colour(const float rgb[3], colour out) { for (int a = 0; a < 3; a++) out[a] = (uint8_t)(fminf(fmaxf(rgb[a], 0), 1) * 255 + 0.5f); }

/* Distance of c from the line from a to b, and OVER of it beyond b, moved by off; all in 0..1. */
static float off_line(const colour c, const colour a, const colour b, const float off[3])
{
    float d[3], e[3], dd = 0, de = 0, r = 0;
    for (int k = 0; k < 3; k++) {
        d[k] = (float)(b[k] - a[k]) / 255;
        e[k] = (float)(c[k] - a[k]) / 255 - off[k];
        dd += d[k] * d[k];
        de += d[k] * e[k];
    }
    float t = dd > 1e-8f ? fminf(fmaxf(de / dd, 0), 1 + OVER) : 0;
    for (int k = 0; k < 3; k++) {
        float v = e[k] - t * d[k];
        if (c[k] < SATURATED || v < 0) r += v * v;      /* saturated: any stronger light is as good */
    }
    return sqrtf(r);
}

static const float NOWHERE[3] = { 0 };

static void sun_and_shade(const orl_light *l, orl_sample *s, colour lit, colour shade)
{
    float rgb[3];
    s->fix = 0;
    for (int k = 0; k < 2; k++) {
        for (int a = 0; a < ORL_HORIZON; a++) s->horizon[a] = k ? 1.5707963f : 0;
        orl_light_shade(l, s, rgb);
        put_colour(rgb, k ? shade : lit);
    }
}

static void render_range(void *user, int begin, int end)
{
    job *j = user;
    for (int k = begin; k < end; k++) {
        const world_photo *p = &j->w->photos[k];
        plane *q = &j->p[k];
        *q = (plane){ .w = p->w / TRANSIENT_HALF, .h = p->h / TRANSIENT_HALF };
        size_t n = (size_t)q->w * (size_t)q->h;
        q->t = calloc(n + 1, sizeof *q->t);
        q->rgb = malloc(4 * n * sizeof *q->rgb + n + 1);
        orl_light *l = malloc(sizeof *l);
        if (!q->t || !q->rgb || !l) { free(l); __atomic_store_n(&j->failed, 1, __ATOMIC_RELAXED); continue; }
        q->fit = q->rgb + n;
        q->lit = q->fit + n;
        q->shade = q->lit + n;
        q->bare = (uint8_t *)(q->shade + n);
        orl_light_decode(&j->s2->light, j->s2->codes[k], l);
        float o[3] = { (float)p->centre[0], (float)p->centre[1], (float)p->centre[2] };
        for (size_t i = 0; i < n; i++) {
            int x = (int)(i % (size_t)q->w) * TRANSIENT_HALF, y = (int)(i / (size_t)q->w) * TRANSIENT_HALF, sum[3] = { 0 };
            float d[3], rgb[3];
            surface_hit h;
            orl_sample s;
            for (int b = 0; b < TRANSIENT_HALF * TRANSIENT_HALF; b++) {
                uint8_t c[3];
                world_rgb(p, x + b % TRANSIENT_HALF, y + b / TRANSIENT_HALF, c);
                for (int a = 0; a < 3; a++) sum[a] += c[a];
            }
            for (int a = 0; a < 3; a++) q->rgb[i][a] = (uint8_t)((sum[a] + 2) / (TRANSIENT_HALF * TRANSIENT_HALF));
            world_ray(p, x + 0.5 * TRANSIENT_HALF, y + 0.5 * TRANSIENT_HALF, d);
            memset(&s, 0, sizeof s);
            int met = surface_meet(j->s2->surf, o, d, SURFACE_NO_BACKDROP, &h);
            if (met == MET_GROUND && world_label(p, x + TRANSIENT_HALF / 2, y + TRANSIENT_HALF / 2) == WORLD_SKY) met = MET_NOTHING;
            if (met == MET_SURFACE) stage2_surface_sample(j->s2, &h, &s);
            else if (met == MET_GROUND) stage2_ground_sample(j->s2, h.x, &s);
            if (met) q->t[i] = fmaxf(h.t, 1e-3f);
            if (met) s.fix = stage2_fix(j->s2, l, h.x, h.n, &s);
            memcpy(s.dir, d, sizeof d);
            orl_light_shade(l, &s, rgb);
            put_colour(rgb, q->fit[i]);
            sun_and_shade(l, &s, q->lit[i], q->shade[i]);
            orl_sample g = { .normal = { 0, 0, 1 }, .open = 0.9f, .cov = 1 };
            colour lit, shade;
            memcpy(g.albedo, j->s2->common, sizeof g.albedo);
            memcpy(g.phi, s.phi, sizeof g.phi);
            sun_and_shade(l, &g, lit, shade);
            q->bare[i] = (uint8_t)(fminf(off_line(q->rgb[i], shade, lit, NOWHERE), 1) * 255 + 0.5f);
        }
        free(l);
    }
}

static void point_of(const world_photo *p, int W, int i, float t, float x[3])
{
    float d[3];
    world_ray(p, (i % W + 0.5) * TRANSIENT_HALF, (i / W + 0.5) * TRANSIENT_HALF, d);
    for (int a = 0; a < 3; a++) x[a] = (float)p->centre[a] + t * d[a];
}

/* Where photo k sees point x, as an index into its plane; -1: not. */
static int seen_at(const job *j, int k, const float x[3])
{
    const world_photo *p = &j->w->photos[k];
    const plane *q = &j->p[k];
    double uv[2];
    float dist = 0;
    if (!world_project(p, x, uv, NULL) || !(uv[0] >= 0 && uv[1] >= 0 && uv[0] < q->w * TRANSIENT_HALF && uv[1] < q->h * TRANSIENT_HALF)) return -1;
    int i = (int)(uv[1] / TRANSIENT_HALF) * q->w + (int)(uv[0] / TRANSIENT_HALF);
    for (int a = 0; a < 3; a++) dist += (x[a] - (float)p->centre[a]) * (x[a] - (float)p->centre[a]);
    dist = sqrtf(dist);
    return q->t[i] > 0 && fabsf(q->t[i] - dist) <= 2.0f + 0.01f * dist ? i : -1;
}

/* The photos that see most of what photo k sees. */
static int companions(const job *j, int k, int out[COMPANIONS])
{
    const plane *q = &j->p[k];
    int score[COMPANIONS], n = 0;
    for (int o = 0; o < j->w->nphotos; o++) {
        int s = 0, at;
        if (o == k) continue;
        for (int i = 5 * q->w + 5; i < q->w * q->h; i += 149) {
            float x[3];
            if (!(q->t[i] > 0)) continue;
            point_of(&j->w->photos[k], q->w, i, q->t[i], x);
            s += seen_at(j, o, x) >= 0;
        }
        if (!s || (n == COMPANIONS && score[n - 1] >= s)) continue;
        for (at = n < COMPANIONS ? n++ : n - 1; at && score[at - 1] < s; at--) { score[at] = score[at - 1]; out[at] = out[at - 1]; }
        score[at] = s;
        out[at] = o;
    }
    return n;
}

typedef struct { float *off, *noise, *e, *u, *wx, *wy, *order; uint8_t *others, *ground, *sfm; } scratch;

/* What the others say of each pixel: their median residual, and their distance from their own lines after it. */
static void ask_others(const job *j, int k, scratch *s)
{
    const plane *q = &j->p[k];
    int who[COMPANIONS], n = companions(j, k, who);
    for (int i = 0; i < q->w * q->h; i++) {
        float x[3], v[3][COMPANIONS], *off = s->off + 3 * i;
        int at[COMPANIONS], of[COMPANIONS], m = 0;
        s->noise[i] = UNSEEN;
        if (!(q->t[i] > 0)) continue;
        point_of(&j->w->photos[k], q->w, i, q->t[i], x);
        s->ground[i] = fabsf(x[2] - frame_ground_height(&j->s2->surf->f, x)) < 0.03f * (float)j->w->frame.dims[0];
        for (int c = 0; c < n; c++) {
            if ((at[m] = seen_at(j, who[c], x)) < 0) continue;
            const plane *o = &j->p[of[m] = who[c]];
            for (int a = 0; a < 3; a++) v[a][m] = (float)(o->rgb[at[m]][a] - o->fit[at[m]][a]) / 255;
            m++;
        }
        s->others[i] = (uint8_t)m;
        if (m < FEW) continue;
        for (int a = 0; a < 3; a++) off[a] = middle(v[a], m);
        for (int c = 0; c < m; c++) {
            const plane *o = &j->p[of[c]];
            v[0][c] = off_line(o->rgb[at[c]], o->shade[at[c]], o->lit[at[c]], off);
        }
        s->noise[i] = middle(v[0], m);
    }
}

static float median_where(scratch *s, int n, const float *v, const uint8_t *where, int least)
{
    int m = 0;
    for (int i = 0; i < n; i++) if (where[i] >= least) s->order[m++] = v[i];
    return m > 100 ? middle(s->order, m) : 0;
}

static void evidence(const job *j, int k, scratch *s)
{
    const plane *q = &j->p[k];
    const world_photo *p = &j->w->photos[k];
    int n = q->w * q->h;
    float *bare = s->u;                         /* not in use yet */
    for (int i = 0; i < n; i++) {
        int x = i % q->w, y = i / q->w;
        s->e[i] = 9;
        for (int b = y - REACH; b <= y + REACH; b++)
            for (int a = x - REACH; a <= x + REACH; a++) {
                if (a < 0 || b < 0 || a >= q->w || b >= q->h) continue;
                int o = b * q->w + a;
                s->e[i] = fminf(s->e[i], off_line(q->rgb[i], q->shade[o], q->lit[o], s->off + 3 * o));
            }
        bare[i] = (float)q->bare[i] / 255;
    }
    float usual = median_where(s, n, s->e, s->others, FEW) - USUAL, plain = PLAIN * median_where(s, n, bare, s->ground, 1);
    memset(s->sfm, 0, (size_t)n);
    for (uint32_t i = 0; i < p->obs_count; i++) {
        const world_obs *o = &j->w->obs[p->obs_begin + i];
        int x = (int)(o->u / TRANSIENT_HALF), y = (int)(o->v / TRANSIENT_HALF);
        for (int b = y - SFM_REACH; b <= y + SFM_REACH; b++)
            for (int a = x - SFM_REACH; a <= x + SFM_REACH; a++)
                if (a >= 0 && b >= 0 && a < q->w && b < q->h && (a - x) * (a - x) + (b - y) * (b - y) < (SFM_REACH + 0.5f) * (SFM_REACH + 0.5f)) s->sfm[b * q->w + a] = 1;
    }
    for (int i = 0; i < n; i++) {
        float e = s->others[i] >= FEW || !(q->t[i] > 0) ? s->e[i] / (FLOOR + s->noise[i] + usual) : (s->ground[i] ? fmaxf(bare[i] - plain, 0) : s->e[i]) / (FLOOR + UNSEEN);
        if (world_label(p, i % q->w * TRANSIENT_HALF + TRANSIENT_HALF / 2, i / q->w * TRANSIENT_HALF + TRANSIENT_HALF / 2) == WORLD_SKY) { s->e[i] = -2; continue; }
        e = fminf(fmaxf((e - EVEN) / EVEN, -0.5f), 2.1f);
        if (s->sfm[i]) e -= FOUND;
        s->e[i] = e;
    }
}

static float flow(const colour a, const colour b)
{
    float d = 0;
    for (int k = 0; k < 3; k++) d += (float)((a[k] - b[k]) * (a[k] - b[k])) / (255.0f * 255.0f * EDGE * EDGE);
    return 1 / (1 + d * d);
}

static void spread(const plane *q, scratch *s)
{
    int W = q->w, H = q->h;
    for (int i = 0; i < W * H; i++) {
        s->wx[i] = i % W < W - 1 ? flow(q->rgb[i], q->rgb[i + 1]) : 0;
        s->wy[i] = i / W < H - 1 ? flow(q->rgb[i], q->rgb[i + W]) : 0;
        s->u[i] = s->e[i];
    }
    for (int t = 0; t < 2 * SWEEPS; t++)        /* red and black in turn, over-relaxed */
        for (int y = 0; y < H; y++)
            for (int x = (y + t) & 1; x < W; x += 2) {
                int i = y * W + x;
                float sum = LAMBDA * s->e[i], weight = LAMBDA;
                if (x) { sum += s->wx[i - 1] * s->u[i - 1]; weight += s->wx[i - 1]; }
                if (x < W - 1) { sum += s->wx[i] * s->u[i + 1]; weight += s->wx[i]; }
                if (y) { sum += s->wy[i - W] * s->u[i - W]; weight += s->wy[i - W]; }
                if (y < H - 1) { sum += s->wy[i] * s->u[i + W]; weight += s->wy[i]; }
                s->u[i] += 1.7f * (sum / weight - s->u[i]);
            }
}

static void find_range(void *user, int begin, int end)
{
    job *j = user;
    for (int k = begin; k < end; k++) {
        const plane *q = &j->p[k];
        size_t n = (size_t)q->w * (size_t)q->h, room = n + 1;
        float *f = calloc(9 * room, sizeof *f);
        uint8_t *b = calloc(3 * n + 1, 1);
        j->out[k] = malloc(n + 1);
        if (f && b && j->out[k]) {
            scratch s = { f, f + 3 * room, f + 4 * room, f + 5 * room, f + 6 * room, f + 7 * room, f + 8 * room, b, b + n, b + 2 * n };
            ask_others(j, k, &s);
            evidence(j, k, &s);
            spread(q, &s);
            for (size_t i = 0; i < n; i++) j->out[k][i] = s.u[i] > CUT ? 255 : 0;
        } else {
            __atomic_store_n(&j->failed, 1, __ATOMIC_RELAXED);
        }
        free(f);
        free(b);
    }
}

orl_err transient_masks(const world *w, const stage2 *s2, int threads, uint8_t **out)
{
    size_t n = (size_t)w->nphotos;
    job j = { .w = w, .s2 = s2, .p = calloc(n, sizeof *j.p), .out = out };
    memset(out, 0, n * sizeof *out);
    j.failed = !j.p;
    if (!j.failed) orl_parallel(threads, w->nphotos, 1, render_range, &j);
    if (!j.failed) orl_parallel(threads, w->nphotos, 1, find_range, &j);
    for (size_t k = 0; k < n; k++) {
        if (j.p) { free(j.p[k].t); free(j.p[k].rgb); }
        if (j.failed) { free(out[k]); out[k] = NULL; }
    }
    free(j.p);
    return j.failed ? orl_fail(ORL_E_MEMORY, "transients: no memory for %zu photos", n) : ORL_OK;
}
