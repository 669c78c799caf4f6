/* Photo -> wide picture (include/oriel/widen.h): observe, adapt, re-light, shade, blend. */
#include "oriel/widen.h"
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include "oriel/image.h"
#include "oriel/parallel.h"
#include "runtime/arena.h"

enum { SMALL_SIDE = 200, SAMPLES = 1500, CANDIDATES = 2, TRACES = 2, BANDS = 32 };    /* TRACES: of a sun that was just found, each followed by a better one; BANDS: frames that a creeping sun's trace takes */
enum { SUNS = 24, RIVALS = 2, ROUNDS = 6, SHARE = 4 };     /* other suns; of these, tried a frame; rounds of them over a first photo; samples of which a rival sees one */
enum { MEET = 2, CANDIDATE = 4, PROVE = 4 };                /* steps of a rival on its share, of a training photo's light, and of a winner on all samples */
enum { SETTLES = 4, WATCHES = SETTLES + SUNS / RIVALS };    /* frames of a light that stands in which codes still move; in which other suns are still tried */
enum { RUN = 16 };
#define STILL (1 / 255.0f)              /* change of the samples below which light stands, */
#define JUMP (12 / 255.0f)              /* above which it is another photo, */
#define PASSER (16 / 255.0f)            /* each counted up to here: who passes is no light */
#define ENOUGH 1e-3f                    /* a step that gains less of the cost is the last */
#define BETTER 0.997f                   /* what a rival must bring the cost down to */
#define SUN_CREEPS 0.99996f             /* cosine of half a degree: less is no move */
#define SUN_JUMPS 0.9986f               /* of 3 degrees */

/* In large pages where there are some: thousands of small ones are touched for the first time in a new pose. */
void *orl_widen_block(size_t bytes)
{
    const size_t large = (size_t)2 << 20;
    if (bytes < large) return aligned_alloc(64, orl_align64(bytes));
    size_t n = (bytes + large - 1) / large * large;
    void *p = n < bytes ? NULL : aligned_alloc(large, n);
    if (p) madvise(p, n, MADV_HUGEPAGE);
    return p;
}

orl_camera orl_widen_small(const orl_camera *photo)
{
    int w, h;
    orl_size_long_side(photo->w, photo->h, SMALL_SIDE, &w, &h);
    return orl_camera_resized(photo, w, h);
}

/* Adaptation looks at one pixel in each cell of a square lattice, its place a hash of the cell. */
static int pick(int w, int h, int *spot)
{
    int cell = 1, n = 0;
    while ((long)w * h > (long)SAMPLES * cell * cell) cell++;
    for (int y = 0; y < h; y += cell)
        for (int x = 0; x < w; x += cell) {
            uint32_t k = (uint32_t)(y * 65537 + x) * 2654435761u;
            k = (k ^ (k >> 15)) * 2246822519u;
            int sx = x + (int)((k >> 8) % (unsigned)cell), sy = y + (int)((k >> 20) % (unsigned)cell);
            if (sx >= w || sy >= h) continue;
            if (spot) spot[n] = sy * w + sx;
            n++;
        }
    return n;
}

typedef struct { void *small, *wide, *blend; uint8_t *wanted; } blocks;

static void lay_out(orl_arena *a, const orl_widen_config *c, orl_widen *w, blocks *b)
{
    orl_camera s = c->baked ? c->baked[0].cam : orl_widen_small(&c->photo);
    w->nsamples = pick(s.w, s.h, NULL);
    w->light = orl_arena_take(a, sizeof *w->light);
    w->samples = orl_arena_take(a, (size_t)w->nsamples * sizeof *w->samples);
    w->rival = orl_arena_take(a, (size_t)w->nsamples * sizeof *w->rival);
    w->seen = orl_arena_take(a, (size_t)w->nsamples * sizeof *w->seen);
    w->spot = orl_arena_take(a, (size_t)w->nsamples * sizeof *w->spot);
    w->unmasked = orl_arena_take(a, (size_t)s.w * (size_t)s.h);
    w->adapt_work = orl_arena_take(a, orl_adapt_need());
    w->light_block = orl_arena_take(a, orl_view_light_need());
    w->last_light = orl_arena_take(a, orl_view_light_need());
    w->kept = c->no_skip & ORL_SKIP_SAME ? NULL : orl_arena_take(a, (size_t)c->wide.w * (size_t)c->wide.h * 3);
    b->small = orl_arena_take(a, c->baked ? orl_view_attach_need(s.w, s.h) : orl_view_need(s.w, s.h));
    b->wide = orl_arena_take(a, c->baked ? orl_view_attach_need(c->wide.w, c->wide.h) : orl_view_need(c->wide.w, c->wide.h));
    b->blend = c->blend ? orl_arena_take(a, orl_blend_need(c->wide.w, c->wide.h)) : NULL;
    size_t n = (size_t)s.w * (size_t)s.h, m = (size_t)c->wide.w * (size_t)c->wide.h;
    b->wanted = c->baked ? NULL : orl_arena_take(a, n > m ? n : m);
}

size_t orl_widen_need(const orl_widen_config *c)
{
    orl_arena a = { 0 };
    orl_widen w;
    blocks b;
    lay_out(&a, c, &w, &b);
    return a.used;
}

/* Weighted sums of a photo channel's pixels over a small pixel: exact, each photo pixel cut at the small pixel's borders. */
static void average(const orl_camera *photo, int sw, int sh, int sx, int sy, const uint8_t *px, int channels, uint64_t *sum)
{
    long w = photo->w, h = photo->h, left = sx * w, right = left + w, top = sy * h, bottom = top + h;     /* in 1/sw, 1/sh of a photo pixel */
    for (int c = 0; c < channels; c++) sum[c] = 0;
    for (long y = top / sh; y * sh < bottom; y++) {
        long wy = ((y + 1) * sh < bottom ? (y + 1) * sh : bottom) - (y * sh > top ? y * sh : top);
        for (long x = left / sw; x * sw < right; x++) {
            long wx = ((x + 1) * sw < right ? (x + 1) * sw : right) - (x * sw > left ? x * sw : left);
            const uint8_t *p = px + (size_t)(y * w + x) * (size_t)channels;
            for (int c = 0; c < channels; c++) sum[c] += (uint64_t)(wx * wy) * p[c];
        }
    }
}

/* The sun of a light to n samples: every step-th pixel, from the first-th on. */
static void face_sun(const orl_widen *w, const orl_light *l, int first, int step, orl_sample *s, int n)
{
    orl_view_sample_sun(&w->small, l, w->spot + first, step, s, n);
}

/* ---- the light of a photo ---- */

static void observe(orl_widen *w, const uint8_t *photo)
{
    const orl_camera *cam = &w->config.photo;
    double full = 255.0 * cam->w * cam->h;
    for (int i = 0; i < w->nsamples; i++) {
        uint64_t sum[3];
        int at = w->spot[i];
        average(cam, w->small.w, w->small.h, at % w->small.w, at / w->small.w, photo, 3, sum);
        for (int c = 0; c < 3; c++) w->samples[i].rgb[c] = (float)((double)sum[c] / full);
        w->samples[i].weight = w->unmasked[at];
    }
}

/* Mean of the robust residual r^2 / (r^2 + knee^2) under a code, over every step-th sample. */
static float misfit(orl_widen *w, const float *code, int step)
{
    const float knee = 0.1f * 0.1f;
    float sum = 0, n = 0;
    orl_light_decode(&w->config.scene->light, code, w->light);
    for (int i = 0; i < w->nsamples; i += step) {
        const orl_sample *s = &w->samples[i];
        float rgb[3], r = 0;
        if (s->weight == 0) continue;
        orl_light_shade(w->light, s, rgb);
        for (int c = 0; c < 3; c++) r += (rgb[c] - s->rgb[c]) * (rgb[c] - s->rgb[c]);
        sum += r / (r + knee);
        n++;
    }
    return n > 0 ? sum / n : 1;
}

static orl_err fit(orl_widen *w, const float *init, orl_adapt_result *out)
{
    orl_adapt_options opt = orl_adapt_defaults();
    opt.threads = w->config.threads;
    opt.enough = ENOUGH;
    w->starts++;
    return orl_adapt(&w->config.scene->light, w->samples, (size_t)w->nsamples, init, &opt, w->adapt_work, orl_adapt_need(), out);
}

/* ---- rivals */

/* A sun's true place shows by shadows, and shadows make many local minima: descents from the last codes would stay behind a sun that wanders. So a few other suns are tried in every frame, each in the shadows that it
 * casts itself, on a share of the samples; the best one meets the light found on another share in the next frame, and takes its place if it still explains the photo better, now on all samples. */

static float wrapped(float a)
{
    const float pi = 3.14159265f;
    return a > pi ? a - 2 * pi : a < -pi ? a + 2 * pi : a;
}

/* Suns 0..7 stand 6 degrees from that of the code, 8..15 18 degrees, the others around the sky. */
static void move_sun(int sun, float *code)
{
    static const float WAY[8][2] = { { 1, 0 }, { -1, 0 }, { 0, 1 }, { 0, -1 }, { 0.7f, 0.7f }, { -0.7f, -0.7f }, { -0.7f, 0.7f }, { 0.7f, -0.7f } };
    float *az = &code[ORL_C_SUN_AZ], *el = &code[ORL_C_SUN_EL], far = sun < 8 ? 0.105f : 0.314f;
    if (sun < 16) {
        *az = wrapped(*az + far * WAY[sun % 8][0] / fmaxf(0.3f, 1 - 0.4f * *el * *el));
        *el = fminf(fabsf(*el + far * WAY[sun % 8][1]), 1.5f);
    } else {
        *az = wrapped((float)(sun - 20) * 0.785398f + 0.3f);
        *el = sun & 1 ? 0.45f : 1;
    }
}

/* Some of the samples, into w->rival: their number. */
static int draw(orl_widen *w, int share)
{
    int n = 0;
    for (int i = w->round % share; i < w->nsamples; i += share) w->rival[n++] = w->samples[i];
    return n;
}

/* A few steps from a code on, in the shadows of its own sun. */
static orl_err race(orl_widen *w, const float *code, int share, int steps, orl_adapt_result *out)
{
    const orl_light_model *m = &w->config.scene->light;
    orl_adapt_options opt = orl_adapt_defaults();
    int n = draw(w, share);
    orl_light_decode(m, code, w->light);
    face_sun(w, w->light, w->round % share, share, w->rival, n);
    w->starts++;
    opt.max_iterations = steps;
    opt.enough = ENOUGH;
    orl_err e = orl_adapt(m, w->rival, (size_t)n, code, &opt, w->adapt_work, orl_adapt_need(), out);
    if (!e && out->status == ORL_ADAPT_DEGENERATE) out->cost = INFINITY;
    return e;
}

/* The cost of a code on a share of the samples, in the shadows that they have. */
static orl_err cost_on_share(orl_widen *w, const float *code, float *cost)
{
    int n = draw(w, SHARE);
    return orl_adapt_cost(&w->config.scene->light, w->rival, (size_t)n, code, NULL, w->adapt_work, orl_adapt_need(), cost);
}

/* A code against the light found, r, that costs `here` on the share. */
static orl_err duel(orl_widen *w, const float *code, int steps, float here, orl_adapt_result *r, int *beaten)
{
    orl_adapt_result there;
    orl_err e = race(w, code, SHARE, steps, &there);
    if (e || !(there.cost < BETTER * here)) return e;
    e = race(w, there.code, 1, PROVE, &there);
    if (e || !(there.cost < BETTER * r->cost)) return e;
    orl_sample *swap = w->samples;
    w->samples = w->rival;
    w->rival = swap;
    *r = there;
    *beaten = 1;
    return ORL_OK;
}

/* A frame's round: w->light is left in disorder. */
static orl_err challenge(orl_widen *w, orl_adapt_result *r, int *beaten)
{
    float here, code[ORL_CODE];
    orl_adapt_result there;
    *beaten = 0;
    orl_err e = cost_on_share(w, r->code, &here);
    if (!e && w->rival_stands) e = duel(w, w->rival_code, MEET, here, r, beaten);
    w->rival_stands = 0;
    float least = BETTER * here;
    for (int k = 0; !e && !*beaten && k < RIVALS; k++, w->sun = (w->sun + 1) % SUNS) {
        memcpy(code, r->code, sizeof code);
        move_sun(w->sun, code);
        e = race(w, code, SHARE, MEET, &there);
        if (e || !(there.cost < least)) continue;
        least = there.cost;
        w->rival_stands = 1;
        memcpy(w->rival_code, there.code, sizeof code);
    }
    w->round = (w->round + 1) % SHARE;
    return e;
}

/* ---- the sun's way ---- */

/* Brings the wide view up to the light found last: w->light. */
static void follow_sun(orl_widen *w)
{
    orl_view *v = &w->wide;
    orl_sun_trace *s = &w->wide_sun;
    const float *now = w->light->sun_dir;
    float c = s->dir[0] * now[0] + s->dir[1] * now[1] + s->dir[2] * now[2];
    if (!s->traced || !(c > SUN_JUMPS)) {
        *s = (orl_sun_trace){ { now[0], now[1], now[2] }, v->h, 1 };
        orl_view_trace_sun(v, w->light, 0, v->h, w->config.cpu, w->config.threads);
        return;
    }
    if (s->row == v->h && !(c > SUN_CREEPS)) *s = (orl_sun_trace){ { now[0], now[1], now[2] }, 0, 1 };
    if (s->row == v->h) return;
    int end = s->row + (v->h + BANDS - 1) / BANDS;
    if (end > v->h) end = v->h;
    orl_view_trace_sun(v, w->light, s->row, end, w->config.cpu, w->config.threads);
    s->row = end;
}

/* ---- the light ---- */

/* The training photos whose light comes nearest; their number. */
static int candidates(orl_widen *w, const float *best[CANDIDATES])
{
    const orl_scene *s = w->config.scene;
    float score[CANDIDATES];
    int n = 0;
    for (uint32_t i = 0; i < s->ncodes; i++) {
        const float *code = s->codes + (size_t)i * ORL_CODE;
        float m = misfit(w, code, 8);
        for (int k = 0; k < CANDIDATES; k++)
            if (k == n || m < score[k]) {
                n += n < CANDIDATES;
                for (int j = n - 1; j > k; j--) {
                    best[j] = best[j - 1];
                    score[j] = score[j - 1];
                }
                best[k] = code;
                score[k] = m;
                break;
            }
    }
    return n;
}

/* From the prior's starts by horizons alone; then in the shadows that the sun found casts; then against the training photos' lights and a first few rounds of other suns. */
static orl_err fit_cold(orl_widen *w)
{
    const float *best[CANDIDATES];
    orl_adapt_result r;
    float here;
    int beaten;
    orl_err e = fit(w, NULL, &w->fit);
    if (e || w->fit.status == ORL_ADAPT_DEGENERATE) return e;
    for (int k = 0; !e && k < TRACES; k++) {
        orl_light_decode(&w->config.scene->light, w->fit.code, w->light);
        face_sun(w, w->light, 0, 1, w->samples, w->nsamples);
        e = fit(w, w->fit.code, &r);
        if (!e && r.status != ORL_ADAPT_DEGENERATE) w->fit = r;
    }
    for (int k = 0, n = candidates(w, best); !e && k < n; k++)
        if (!(e = cost_on_share(w, w->fit.code, &here))) e = duel(w, best[k], CANDIDATE, here, &w->fit, &beaten);
    for (int k = 0; !e && k < ROUNDS; k++) e = challenge(w, &w->fit, &beaten);
    return e;
}

/* From the last codes. Where they still explained the photo nearly as well, the step is noise and passers-by for the most part: take half of it, so that the light does not flicker. */
static orl_err fit_warm(orl_widen *w)
{
    orl_adapt_result r;
    float old[ORL_CODE];
    memcpy(old, w->fit.code, sizeof old);
    orl_err e = fit(w, old, &r);
    if (e) return e;
    int beaten = 0;
    if (r.status != ORL_ADAPT_DEGENERATE && (e = challenge(w, &r, &beaten))) return e;
    if (r.status == ORL_ADAPT_DEGENERATE) {
        memcpy(r.code, old, sizeof old);
    } else if (!beaten && misfit(w, old, 1) < 1.1f * misfit(w, r.code, 1) + 1e-4f) {
        for (int k = 0; k < ORL_CODE; k++) {
            float step = r.code[k] - old[k];
            r.code[k] = old[k] + 0.5f * (k == ORL_C_SUN_AZ ? wrapped(step) : step);
        }
    }
    r.code[ORL_C_SUN_AZ] = wrapped(r.code[ORL_C_SUN_AZ]);
    w->fit = r;
    return ORL_OK;
}

/* Mean change of the samples' colours since the light last changed, by runs of RUN neighbours: noise is gone in their means, light is not. */
static float change(const orl_widen *w)
{
    float sum = 0, runs = 0;
    for (int i = 0; i < w->nsamples; i += RUN, runs++) {
        float most = 0;
        for (int c = 0; c < 3; c++) {
            float d = 0, n = 0;
            for (int k = i; k < i + RUN && k < w->nsamples; k++) {
                const orl_sample *s = &w->samples[k];
                d += s->weight * fminf(fmaxf(s->rgb[c] - w->seen[k][c], -PASSER), PASSER);
                n += s->weight;
            }
            most = n > 0 ? fmaxf(most, fabsf(d) / n) : most;
        }
        sum += most;
    }
    return sum / runs;
}

/* Has the photo little to do with that which samples were seen in last? */
static int another(const orl_widen *w)
{
    float sum = 0, n = 0;
    for (int i = 0; i < w->nsamples; i++)
        for (int c = 0; c < 3; c++) {
            sum += w->samples[i].weight * fminf(fabsf(w->samples[i].rgb[c] - w->seen[i][c]), PASSER);
            n += w->samples[i].weight;
        }
    return sum > JUMP * n;
}

/* Such a photo: its light might be found sooner from nothing than from a light that was another's, or a broken picture's. */
static orl_err look_again(orl_widen *w)
{
    const orl_adapt_result was = w->fit;
    float cost = INFINITY;
    orl_err e = ORL_OK;
    if (was.status != ORL_ADAPT_DEGENERATE) {
        orl_light_decode(&w->config.scene->light, was.code, w->light);
        face_sun(w, w->light, 0, 1, w->samples, w->nsamples);
        e = orl_adapt_cost(&w->config.scene->light, w->samples, (size_t)w->nsamples, was.code, NULL, w->adapt_work, orl_adapt_need(), &cost);
    }
    for (int i = 0; i < w->nsamples; i++) {         /* as a first photo finds them: no sun traced */
        orl_sample *s = &w->samples[i], seen = *s;
        orl_view_sample(&w->small, w->spot[i] % w->small.w, w->spot[i] / w->small.w, s);
        memcpy(s->rgb, seen.rgb, sizeof s->rgb);
        s->weight = seen.weight;
    }
    if (!e) e = fit_cold(w);
    if (w->fit.status == ORL_ADAPT_DEGENERATE || !(w->fit.cost < BETTER * cost)) w->fit = was;
    return e;
}

/* Frames since the light last changed: 0 if it does now. Slow change adds up, for frames are held against the first of them. */
static int still(orl_widen *w)
{
    if (w->adapted && change(w) < STILL) return w->still < WATCHES ? w->still + 1 : w->still;
    for (int i = 0; i < w->nsamples; i++) memcpy(w->seen[i], w->samples[i].rgb, sizeof *w->seen);
    return 0;
}

/* The light of a photo. */
static orl_err find(orl_widen *w, const uint8_t *photo)
{
    int beaten = 0;
    orl_err e = ORL_OK;
    w->starts = 0;
    observe(w, photo);
    const int other = w->adapted && another(w);
    w->still = w->config.no_skip & ORL_SKIP_LIGHT ? 0 : still(w);
    if (!w->adapted) e = fit_cold(w);
    else if (w->still < SETTLES) {
        e = fit_warm(w);
        if (!e && other) e = look_again(w);
    }
    else if (w->still < WATCHES) e = challenge(w, &w->fit, &beaten);
    if (e) return e;
    int found = w->fit.status != ORL_ADAPT_DEGENERATE;
    w->adapted |= found;
    if (w->starts) orl_light_decode(&w->config.scene->light, w->fit.code, w->light);
    if (w->starts && found) face_sun(w, w->light, 0, 1, w->samples, w->nsamples);
    return ORL_OK;
}

/* And the wide view in it. */
static orl_err follow(orl_widen *w)
{
    const orl_sun_trace was = w->wide_sun;
    if (w->fit.status != ORL_ADAPT_DEGENERATE && !w->wide.ceiling) follow_sun(w);       /* a baked view's kernels look its sun up */
    if (w->starts) {
        if (w->tables) memcpy(w->last_light, w->tables, orl_view_light_need());
        else w->same = 0;
        w->tables = orl_view_light_make(&w->wide, w->light, w->light_block, orl_view_light_need());
        if (memcmp(w->last_light, w->light_block, orl_view_light_need())) w->same = 0;
    }
    if (memcmp(&was, &w->wide_sun, sizeof was)) w->same = 0;
    return w->tables ? ORL_OK : orl_fail(ORL_E_MEMORY, "widen: no room for the light's tables");
}

orl_err orl_widen_adapt(orl_widen *w, const uint8_t *photo)
{
    orl_err e = find(w, photo);
    return e ? e : follow(w);
}

/* ---- beginning ---- */

typedef struct { orl_widen *w; const uint8_t *photo; orl_err e; } first_light;
static void find_first(void *user)
{
    first_light *f = user;
    f->e = find(f->w, f->photo);
}

static orl_err begin(const orl_widen_config *c, const uint8_t *photo, void *block, size_t bytes, orl_widen *out)
{
    orl_arena a = { block, 0 };
    orl_widen w;
    blocks b;
    memset(&w, 0, sizeof w);
    w.config = *c;
    if (bytes < orl_widen_need(c)) return orl_fail(ORL_E_MEMORY, "widen: the block is too small");
    lay_out(&a, c, &w, &b);
    orl_camera s = c->baked ? c->baked[0].cam : orl_widen_small(&c->photo);
    orl_err e = ORL_OK;
    pick(s.w, s.h, w.spot);
    if (c->blend) e = orl_blend_init(&c->photo, &c->photo_pose, &c->wide, &c->wide_pose, c->mask, c->threads, b.blend, orl_blend_need(c->wide.w, c->wide.h), &w.blend);
    if (e) return e;
    const int rays = c->quick ? ORL_RAYS_CORNERS : ORL_RAYS_FOUR;
    if (c->baked) {
        e = orl_view_attach(&c->baked[0], b.small, orl_view_attach_need(s.w, s.h), &w.small);
    } else {
        memset(b.wanted, 0, (size_t)s.w * (size_t)s.h);
        for (int i = 0; i < w.nsamples; i++) b.wanted[w.spot[i]] = 1;
        e = orl_view_build_some(c->scene, &s, &c->photo_pose, rays, b.wanted, NULL, c->threads, b.small, orl_view_need(s.w, s.h), &w.small);
    }
    if (e) return e;
    for (int i = 0; i < s.w * s.h; i++) {
        uint64_t person = 0;
        if (c->mask) average(&c->photo, s.w, s.h, i % s.w, i / s.w, c->mask, 1, &person);
        w.unmasked[i] = !person;
    }
    memset(w.samples, 0, (size_t)w.nsamples * sizeof *w.samples);
    for (int i = 0; i < w.nsamples; i++) orl_view_sample(&w.small, w.spot[i] % s.w, w.spot[i] / s.w, &w.samples[i]);
    first_light first = { &w, photo, ORL_OK };
    if (c->baked) {
        e = orl_view_attach(&c->baked[1], b.wide, orl_view_attach_need(c->wide.w, c->wide.h), &w.wide);
        if (!e && photo) find_first(&first);
    } else {
        for (int y = 0, x0 = 0, x1 = 0; y < c->wide.h; y++) {
            uint8_t *row = b.wanted + (size_t)y * (size_t)c->wide.w;
            if (w.blend && !(c->no_skip & ORL_SKIP_PHOTO)) orl_blend_covered(w.blend, y, &x0, &x1);
            memset(row, 1, (size_t)c->wide.w);
            memset(row + x0, 0, (size_t)(x1 - x0));
        }
        e = orl_view_build_some(c->scene, &c->wide, &c->wide_pose, rays, b.wanted, photo ? &(orl_beside){ find_first, &first } : NULL, c->threads, b.wide, orl_view_need(c->wide.w, c->wide.h), &w.wide);
    }
    if (e) return e;
    if (first.e) return orl_fail(first.e, "widen: the first photo's light cannot be looked for");
    w.wide.no_skip = c->no_skip;
    if (w.blend) orl_blend_layers(w.blend, w.wide.cov, (size_t)w.wide.stride);
    if (photo && (e = follow(&w))) return e;
    *out = w;
    return ORL_OK;
}

orl_err orl_widen_init(const orl_widen_config *c, void *block, size_t bytes, orl_widen *out) { return begin(c, NULL, block, bytes, out); }
orl_err orl_widen_start(const orl_widen_config *c, const uint8_t *photo, void *block, size_t bytes, orl_widen *out) { return begin(c, photo, block, bytes, out); }

/* ---- the picture ---- */

typedef struct { orl_widen *w; uint8_t *to, *out; } shading;      /* to: shaded into, NULL: kept from the last picture; out: the picture, another than `to` where that is to be kept */

static void shade(void *user, int begin, int end)
{
    shading *s = user;
    orl_widen *w = s->w;
    const int width = w->wide.w;
    size_t row = (size_t)width * 3;
    for (int y = begin; y < end; y++) {
        int x0 = 0, x1 = 0;
        size_t at = (size_t)y * row;
        if (w->blend && !(w->config.no_skip & ORL_SKIP_PHOTO)) orl_blend_covered(w->blend, y, &x0, &x1);
        if (s->to) orl_view_shade_row(&w->wide, w->tables, w->config.cpu, y, x0, x1, s->to + at);
        if (s->to == s->out) continue;
        if (x0 >= x1) x0 = x1 = 0;
        memcpy(s->out + at, w->kept + at, 3 * (size_t)x0);
        memcpy(s->out + at + 3 * x1, w->kept + at + 3 * x1, 3 * (size_t)(width - x1));
    }
}

orl_err orl_widen_render(orl_widen *w, const uint8_t *photo, uint8_t *out)
{
    if (!w->tables) return orl_fail(ORL_E_DEGENERATE, "widen: no light yet");
    /* A light that changes with every picture costs no copy: what is kept is shaded when it stays for the first time. */
    shading s = { w, !w->kept || !w->same ? out : w->same == 1 ? w->kept : NULL, out };
    orl_parallel(w->config.threads, w->wide.h, 16, shade, &s);
    if (w->same < 2) w->same++;
    if (w->blend) orl_blend_apply(w->blend, photo, out, w->config.cpu, w->config.threads);
    return ORL_OK;
}
