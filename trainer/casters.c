/* Casters (casters.h). Space carving with suns instead of cameras: a ray to the sun that arrives clears its way, one that does not asks for something on it. Suns are few and only roughly known, so
 * what is carved is not a volume but a handful of boxes, each found by itself:
 *   score = min(sum_k f(g_k), ALONE (sum_k f(g_k) - max_k f(g_k))) - LEAN (height + half sizes) / size,   f(g) = ENOUGH (1 - exp(-g / ENOUGH)) for g > 0, g otherwise,
 * g_k what photo k gains by the box: evidence of hidden sun minus evidence of open sun among the rays that it stops and no earlier box did. f lets no photo with a wrong sun outvote the others, and a box
 * that one photo alone asks for is not built. Proposals stand on rays without sun; the best climb by random steps.
 * Evidence is clipped and weighed by the photo's own shadows: where the surface hides the sun, a photo whose sun is right is dark.
 * A photo that is mostly dark where its sun should arrive has a wrong sun and no say, even if a true caster does it: the box would get the sun's error in height.
 * Constants were chosen on one collection (basilica), so figures on it flatter them. */
#include "trainer/casters.h"
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "oriel/parallel.h"

enum { SAMPLES = 1600, SIGHTS = 400, PROPOSALS = 6000, KEPT = 40, CLIMB = 400, STRAY = 2000 };       /* SAMPLES, SIGHTS: of a photo's pixels; one sight in STRAY may be wrong */
#define NOISE 0.1f              /* of colours, sRGB */
#define SURE 3.0f               /* log odds */
#define OWN_LEAST 0.003f        /* of a photo in its own shadow: less tells nothing */
#define ENOUGH 0.035f           /* of a photo */
#define LEAST 0.012f            /* that the photos besides the keenest must gain */
#define ALONE 3
#define LEAN 0.006f
#define WIDE 0.3f               /* how much width counts beside height */
#define SLIM 0.4f              /* least width over length: a building, not a wall */
#define DOUBT 0.5f             /* share of the evidence against the sun where the surface lets it in, at which the sun itself is taken for wrong */
#define FAITH 0.2f              /* below that by so much: taken for right */
#define STEEP 0.05f             /* cosine at which light grazes too much to tell */

typedef struct { const caster_ray *ray; int nrays; const caster_sight *sight; int nsights; float ground, size; uint64_t seed; int turn; float hidden; orl_caster *box; float *score; float rest; } search;

static float score(const search *s, const orl_caster *b, float *others)
{
    orl_casters one = { 1, { *b } };
    float g[CASTER_PHOTOS] = { 0 }, sum = 0, most = 0;
    int stray = s->nsights / STRAY;
    for (int i = 0; i < s->nsights; i++) if (orl_casters_hide(&one, s->sight[i].o, s->sight[i].d, s->sight[i].far) && --stray < 0) return -1e9f;
    for (int i = 0; i < s->nrays; i++) if (orl_casters_hide(&one, s->ray[i].o, s->ray[i].d, ORL_CASTER_FAR)) g[s->ray[i].photo] -= s->ray[i].open;
    for (int k = 0; k < CASTER_PHOTOS; k++) {
        if (g[k] > 0) g[k] = ENOUGH * (1 - expf(-g[k] / ENOUGH));
        sum += g[k];
        most = fmaxf(most, g[k]);
    }
    *others = sum - most;
    return fminf(sum, ALONE * *others) - LEAN * (fmaxf(b->top - s->ground, 0) + WIDE * (b->half[0] + b->half[1])) / s->size;
}

static void turn_axis(orl_caster *b, float angle)
{
    float c = cosf(angle), n = sinf(angle), u = b->axis[0], v = b->axis[1];
    b->axis[0] = c * u - n * v;
    b->axis[1] = n * u + c * v;
    float len = 1 / sqrtf(b->axis[0] * b->axis[0] + b->axis[1] * b->axis[1]);
    for (int a = 0; a < 2; a++) b->axis[a] *= len;
}

static void propose_range(void *user, int begin, int end)
{
    search *s = user;
    for (int p = begin; p < end; p++) {
        rng r = rng_make(s->seed, 0xca57 + (uint64_t)s->turn, (uint64_t)p);
        float at = rng_f(&r) * s->hidden, t = 0.04f * s->size * expf(rng_f(&r) * 4.3f), others;
        int i = 0;
        for (; i < s->nrays - 1 && at >= 0; i++) at += fminf(s->ray[i].open, 0);
        const caster_ray *q = &s->ray[i];
        orl_caster b = { .axis = { 1, 0 } };
        for (int a = 0; a < 2; a++) {
            b.centre[a] = (float)(q->o[a] + (double)t * q->d[a]);
            b.half[a] = 0.03f * s->size * expf(rng_f(&r) * 2.7f);
        }
        for (int a = 0; a < 2; a++) b.half[a] = fmaxf(b.half[a], SLIM * b.half[!a]);
        b.top = (float)(q->o[2] + (double)t * q->d[2]) + rng_f(&r) * 0.16f * s->size;
        turn_axis(&b, rng_f(&r) * 1.5707963f);
        s->box[p] = b;
        s->score[p] = score(s, &b, &others);
    }
}

/* A step changes one of a box's numbers, or moves one side and leaves the opposite one. */
static orl_caster stepped(const orl_caster *from, float step, float size, rng *r)
{
    orl_caster b = *from;
    float z = step * rng_normal(r), least = 0.008f * size;
    int what = (int)rng_below(r, 8);
    if (what < 2) b.centre[what] += 0.08f * size * z;
    else if (what < 4) b.half[what - 2] = fmaxf(b.half[what - 2] * expf(0.4f * z), least);
    else if (what == 4) b.top += 0.06f * size * z;
    else if (what == 5) turn_axis(&b, 0.2f * z);
    else {
        float was = b.half[what - 6], side = rng_u32(r) & 1 ? 1.0f : -1.0f, *h = &b.half[what - 6];
        *h = fmaxf(*h + 0.04f * size * z, least);
        side *= *h - was;
        b.centre[0] += side * (what == 6 ? b.axis[0] : -b.axis[1]);
        b.centre[1] += side * (what == 6 ? b.axis[1] : b.axis[0]);
    }
    for (int a = 0; a < 2; a++) b.half[a] = fmaxf(b.half[a], SLIM * b.half[!a]);
    return b;
}

static void climb_range(void *user, int begin, int end)
{
    search *s = user;
    for (int k = begin; k < end; k++) {
        rng r = rng_make(s->seed, 0xc11b + (uint64_t)s->turn, (uint64_t)k);
        float step = 1, others;
        for (int i = 0; i < CLIMB && s->score[k] > -1e8f; i++) {
            orl_caster b = stepped(&s->box[k], step, s->size, &r);
            float v = score(s, &b, &others);
            if (v > s->score[k]) {
                s->box[k] = b;
                s->score[k] = v;
                step = fminf(1.3f * step, 1.5f);
            } else step = fmaxf(0.985f * step, 0.03f);
        }
    }
}

/* The best of n to the front, in order. */
static void best_first(search *s, int n, int best)
{
    for (int i = 0; i < best && i < n; i++) {
        int top = i;
        for (int k = i + 1; k < n; k++) if (s->score[k] > s->score[top]) top = k;
        orl_caster b = s->box[i];
        float v = s->score[i];
        s->box[i] = s->box[top];
        s->score[i] = s->score[top];
        s->box[top] = b;
        s->score[top] = v;
    }
}

orl_err casters_fit(const caster_ray *ray, int nrays, const caster_sight *sight, int nsights, float ground, float size, uint64_t seed, int threads, orl_casters *out)
{
    search s = { .nrays = nrays, .sight = sight, .nsights = nsights, .ground = ground, .size = size, .seed = seed };
    caster_ray *left = malloc(((size_t)nrays + 1) * sizeof *left);
    s.box = malloc(PROPOSALS * sizeof *s.box);
    s.score = malloc(PROPOSALS * sizeof *s.score);
    s.ray = left;
    out->n = 0;
    if (!left || !s.box || !s.score) { free(left); free(s.box); free(s.score); return orl_fail(ORL_E_MEMORY, "casters: no memory for %d rays", nrays); }
    memcpy(left, ray, (size_t)nrays * sizeof *left);
    for (; out->n < ORL_CASTERS; s.turn++) {
        float others;
        s.hidden = 0;
        for (int i = 0; i < s.nrays; i++) s.hidden -= fminf(left[i].open, 0);
        if (!(s.hidden > LEAST)) break;
        orl_parallel(threads, PROPOSALS, 64, propose_range, &s);
        best_first(&s, PROPOSALS, KEPT);
        orl_parallel(threads, KEPT, 1, climb_range, &s);
        best_first(&s, KEPT, 1);
        orl_casters one = { 1, { s.box[0] } };
        if (!(score(&s, &s.box[0], &others) > 0) || others < LEAST) break;
        int n = 0;
        for (int i = 0; i < s.nrays; i++) if (!orl_casters_hide(&one, left[i].o, left[i].d, ORL_CASTER_FAR)) left[n++] = left[i];
        s.nrays = n;
        out->box[out->n++] = s.box[0];
    }
    free(left);
    free(s.box);
    free(s.score);
    return ORL_OK;
}

/* ---- from stage 2 */

typedef struct { const stage2 *s; const surface *bare; int photos, samples; caster_ray *ray; caster_sight *sight; int *rays, *sights; } find_job;

static int ask_pixel(const find_job *j, const stage2_pixel *q, const orl_light *l, double *own_dark, double *own_lit, caster_ray *out)
{
    float cosine = 0, lit[3], dark[3], off = 0;
    orl_sample o = { 0 };
    for (int a = 0; a < 3; a++) cosine += q->n[a] * l->sun_dir[a];
    if (cosine < STEEP || q->weight < 255 || q->surface == MET_BACKDROP) return 0;
    if (q->surface == MET_GROUND) stage2_ground_sample(j->s, q->x, &o);
    else {
        surface_hit h = { .cut = 0 };
        memcpy(h.x, q->x, sizeof h.x);
        memcpy(h.n, q->n, sizeof h.n);
        stage2_surface_sample(j->s, &h, &o);
    }
    memset(o.phi, 0, sizeof o.phi);             /* what was learned of shadows is what casters are to take over */
    o.fix = 1;
    orl_light_shade(l, &o, lit);
    o.fix = -1;
    orl_light_shade(l, &o, dark);
    for (int a = 0; a < 3; a++) {
        float c = (float)q->rgb[a] / 255, d = c - dark[a], e = c - lit[a];
        off += d * d - e * e;
    }
    off = fminf(fmaxf(off / (2 * NOISE * NOISE * SURE), -1), 1);
    if (!surface_sunlit(j->bare, q->x, q->n, l->sun_dir)) {
        *(off > 0 ? own_lit : own_dark) += fabsf(off);
        return 0;
    }
    for (int a = 0; a < 3; a++) {
        out->o[a] = (double)q->x[a];
        out->d[a] = (double)l->sun_dir[a];
    }
    out->open = off;
    return 1;
}

static void add_sight(const double eye[3], const stage2_pixel *q, caster_sight *out)
{
    *out = (caster_sight){ .far = q->surface ? 1 : ORL_CASTER_FAR };
    for (int a = 0; a < 3; a++) {
        out->o[a] = eye[a];
        out->d[a] = q->surface ? q->x[a] - eye[a] : (double)q->x[a];
    }
    if (out->d[2] >= 0) return;
    if (!q->surface) out->d[2] = 0;             /* sky under the horizon: seen from a height */
    else for (int a = 0; a < 3; a++) {          /* the other way round */
        out->o[a] = q->x[a];
        out->d[a] = -out->d[a];
    }
}

static void photo_range(void *user, int begin, int end)
{
    const find_job *j = user;
    const stage2 *s = j->s;
    for (int i = begin; i < end; i++) {
        int k = s->order[i];
        uint32_t n = s->begin[k + 1] - s->begin[k], step = n / (uint32_t)j->samples + 1, some = n / SIGHTS + 1, asked = 0;
        caster_ray *ray = j->ray + (size_t)i * SAMPLES;
        double dark = 0, lit = 0, shut = 0, all = 0;
        orl_light *l = malloc(sizeof *l);
        if (!l) continue;
        orl_light_decode(&s->light, s->codes[k], l);
        for (uint32_t p = 0; p < n; p += step, asked++) {
            const stage2_pixel *q = &s->px[s->begin[k] + p];
            if (q->surface && stage2_traces(s, l)) j->rays[i] += ask_pixel(j, q, l, &dark, &lit, ray + j->rays[i]);
        }
        for (uint32_t p = 0; p < n; p += some) {
            const stage2_pixel *q = &s->px[s->begin[k] + p];
            if (q->surface || q->weight == 255) add_sight(s->w->photos[k].centre, q, &j->sight[(size_t)i * SIGHTS + (size_t)j->sights[i]++]);
        }
        float sound = dark + lit > OWN_LEAST * asked ? (float)((dark - lit) / (dark + lit)) : 0;
        for (int p = 0; p < j->rays[i]; p++) {
            all += fabsf(ray[p].open);
            shut -= fminf(ray[p].open, 0);
        }
        sound *= fminf(fmaxf((float)(DOUBT * all - shut), 0) / (FAITH * (float)all + 1e-9f), 1);
        if (!(sound > 0)) j->rays[i] = 0;
        for (int p = 0; p < j->rays[i]; p++) {
            ray[p].open *= sound / (float)asked;
            ray[p].photo = i;
        }
        free(l);
    }
}

orl_err casters_find(const stage2 *s, orl_casters *out)
{
    surface bare = *s->surf;
    bare.casters.n = 0;
    int visited = stage2_visited(s), photos = visited < CASTER_PHOTOS ? visited : CASTER_PHOTOS, most = photos ? 48 * SAMPLES / photos : 0;
    size_t n = (size_t)photos + 1;
    find_job j = { s, &bare, photos, most < SAMPLES ? most : SAMPLES, malloc(n * SAMPLES * sizeof *j.ray), malloc(n * SIGHTS * sizeof *j.sight), calloc(n, sizeof *j.rays), calloc(n, sizeof *j.sights) };
    orl_err e = j.ray && j.sight && j.rays && j.sights ? ORL_OK : orl_fail(ORL_E_MEMORY, "casters: no memory for %d photos", photos);
    if (!e) {
        int rays = 0, sights = 0;
        orl_parallel(s->opt.threads, photos, 1, photo_range, &j);
        for (int i = 0; i < photos; i++) {
            memmove(j.ray + rays, j.ray + (size_t)i * SAMPLES, (size_t)j.rays[i] * sizeof *j.ray);
            memmove(j.sight + sights, j.sight + (size_t)i * SIGHTS, (size_t)j.sights[i] * sizeof *j.sight);
            rays += j.rays[i];
            sights += j.sights[i];
        }
        const frame *f = &s->surf->f;
        float middle[3] = { 0.5f * (float)f->dims[0], 0.5f * (float)f->dims[1], 0 };
        e = casters_fit(j.ray, rays, j.sight, sights, frame_ground_height(f, middle), (float)f->dims[0], s->opt.seed, s->opt.threads, out);
    }
    free(j.ray);
    free(j.sight);
    free(j.rays);
    free(j.sights);
    return e;
}
