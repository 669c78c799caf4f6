/* Base colour on the surface (skin.h). Texels are found by iteratively reweighted least squares on the samples' bilinear footprints: each iteration moves every texel by the weighted mean of what its samples lack
 * (Landweber's iteration, with the weights' sums for steps), robustly, in displayed colours. Bricks gather: a sample on a brick's border speaks for the texels that both sides have, in the same words. */
#include "trainer/skin.h"
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "oriel/parallel.h"

enum { SIDE = ORL_SKIN_SIDE, TEXELS = ORL_SKIN_TEXELS, AROUND = 27, ITERATIONS = 4 };
#define PRIOR 0.05f             /* weight of the coarse colour in each texel: that of a twentieth of a sure pixel in its midst */
#define ROBUST 0.3f             /* displayed colours farther off than this count for little */
#define FACE_SHARE 0.1f         /* of a brick's cells with surface: fewer look along another face's texture */
#define MARGIN 2.0f             /* cells beyond a brick from where samples speak for its texels, where the surface passes into the next layer */
#define LOOK_LEAST 0.3f         /* a sample speaks for textures besides its own whose face its gradient has at least this share of */

static void place_of(const surface *s, size_t i, int b[3])
{
    b[0] = (int)(i % (size_t)s->nb[0]);
    b[1] = (int)(i / (size_t)s->nb[0] % (size_t)s->nb[1]);
    b[2] = (int)(i / ((size_t)s->nb[0] * (size_t)s->nb[1]));
}

static int face_of(unsigned mask, const float grad[3])
{
    float top = fmaxf(fmaxf(fabsf(grad[0]), fabsf(grad[1])), fmaxf(fabsf(grad[2]), 1e-12f));
    int32_t g[3];
    for (int a = 0; a < 3; a++) g[a] = (int32_t)(grad[a] / top * 65536);
    return orl_skin_face(mask, g);
}

/* Faces that the surface in the brick at b looks at: of its cells with a change of sign, those that at least one in some look at. */
static unsigned faces_of(const surface *s, const float *v, const int b[3])
{
    int count[ORL_SKIN_FACES] = { 0 }, all = 0;
    float least = 1e9f, near[3] = { 4, 4, 4 };
    for (int i = 0; i < ORL_BRICK * ORL_BRICK * ORL_BRICK; i++) {
        int q[3] = { i % 8, i / 8 % 8, i / 64 }, solid = 0;
        float x[3], grad[3], sum = 0;
        for (int k = 0; k < 8; k++) {
            float f = v[q[0] + (k & 1) + 9 * (q[1] + (k >> 1 & 1)) + 81 * (q[2] + (k >> 2))];
            solid += f <= 0;
            sum += f / 8;
        }
        for (int a = 0; a < 3; a++) x[a] = (float)(8 * b[a] + q[a]) + 0.5f;
        if (fabsf(sum) < least) { least = fabsf(sum); memcpy(near, x, sizeof near); }
        if (!solid || solid == 8) continue;
        surface_gradient(s, x, b, grad);
        count[face_of(63, grad)]++;
        all++;
    }
    unsigned mask = 0;
    for (int f = 0; f < ORL_SKIN_FACES; f++) if (count[f] && (float)count[f] >= FACE_SHARE * (float)all) mask |= 1u << f;
    if (mask) return mask;
    float grad[3];
    surface_gradient(s, near, b, grad);
    return 1u << face_of(63, grad);
}

typedef struct {
    skin *s;
    const surface *surf;
    const size_t *place;            /* of each brick */
    const skin_sample *sample;
    const uint32_t *begin;
    skin_coarse *colour;
    const void *user;
    float (*coarse)[3], (*now)[3];
} fit_job;

static void mask_range(void *user, int begin, int end)
{
    const fit_job *j = user;
    for (int i = begin; i < end; i++) {
        int b[3];
        place_of(j->surf, j->place[i], b);
        j->s->index[i] = faces_of(j->surf, j->surf->sdf + (size_t)i * ORL_BRICK_VERTS, b);
    }
}

static size_t *places(const surface *s)
{
    size_t *p = malloc(((size_t)s->nbricks + 1) * sizeof *p), n = (size_t)s->nb[0] * (size_t)s->nb[1] * (size_t)s->nb[2];
    for (size_t i = 0; p && i < n; i++) if (s->bmap[i] >= 0) p[s->bmap[i]] = i;
    return p;
}

orl_err skin_init(skin *s, const surface *surf, int threads)
{
    size_t *place = places(surf);
    skin made = { .index = malloc(((size_t)surf->nbricks + 1) * sizeof *made.index) };
    if (place && made.index) orl_parallel(threads, (int)surf->nbricks, 64, mask_range, &(fit_job){ .s = &made, .surf = surf, .place = place });
    uint64_t n = 0;
    for (uint32_t i = 0; place && made.index && i < surf->nbricks; i++) {
        uint64_t first = n;
        n += (uint64_t)__builtin_popcount(made.index[i]);
        made.index[i] |= (uint32_t)first << 6;
    }
    int full = n > ORL_SKIN_MOST, none = !place || !made.index;
    made.n = (uint32_t)n;
    free(place);
    if (!full && !none) made.texel = calloc((size_t)n * TEXELS + 1, sizeof *made.texel);
    if (made.texel) { *s = made; return ORL_OK; }
    free(made.index);
    return full ? orl_fail(ORL_E_RANGE, "base colour: %llu textures, %d at most", (unsigned long long)n, ORL_SKIN_MOST) : orl_fail(ORL_E_MEMORY, "base colour: no memory for %llu textures", (unsigned long long)n);
}

void skin_free(skin *s)
{
    free(s->index);
    free(s->texel);
    memset(s, 0, sizeof *s);
}

/* Four texels around a place in a brick, and their shares. */
typedef struct { int at; float w[4]; } footprint;
static const int NEXT[4] = { 0, 1, SIDE, SIDE + 1 };

static footprint find(int face, const float in[3])
{
    footprint p = { 0 };
    float f[2];
    for (int k = 1; k >= 0; k--) {
        float t = fminf(fmaxf(in[((face >> 1) + 1 + k) % 3], 0), 8) * ORL_SKIN_PER_CELL;
        int i = t < SIDE - 2 ? (int)t : SIDE - 2;
        f[k] = t - (float)i;
        p.at = p.at * SIDE + i;
    }
    for (int k = 0; k < 4; k++) p.w[k] = (k & 1 ? f[0] : 1 - f[0]) * (k & 2 ? f[1] : 1 - f[1]);
    return p;
}

static void look(float (*const texel)[3], const footprint *p, float rgb[3])
{
    for (int c = 0; c < 3; c++) {
        rgb[c] = 0;
        for (int k = 0; k < 4; k++) rgb[c] += p->w[k] * texel[p->at + NEXT[k]][c];
    }
}

void skin_colour(const skin *s, uint32_t brick, const int b[3], const float x[3], const float grad[3], float rgb[3])
{
    uint32_t e = s->index[brick];
    int face = face_of(orl_skin_mask(e), grad);
    float in[3];
    for (int a = 0; a < 3; a++) in[a] = x[a] - 8 * (float)b[a];
    footprint p = find(face, in);
    look(s->texel + (size_t)orl_skin_texture(e, face) * TEXELS, &p, rgb);
}

void skin_say(skin_sample *out, const int b[3], const float x[3], const float grad[3], const float rgb[3], const float slope[3], float weight)
{
    float top = fmaxf(fmaxf(fabsf(grad[0]), fabsf(grad[1])), fabsf(grad[2]));
    memset(out, 0, sizeof *out);
    for (int a = 0; a < 3; a++) if (!(rgb[a] >= 0 && rgb[a] < 1.5f) || !(slope[a] > 0 && slope[a] < 30) || !(top > 1e-6f && top < 1e6f)) return;
    for (int a = 0; a < 3; a++) {
        out->at[a] = (uint16_t)(fminf(fmaxf(x[a] - 8 * (float)b[a], 0), 8) * 4096);
        out->rgb[a] = (uint16_t)(rgb[a] * 32768 + 0.5f);
        out->slope[a] = (uint16_t)(slope[a] * 2048 + 0.5f);
        out->grad[a] = (int8_t)lrintf(127 * grad[a] / top);
    }
    out->weight = (uint8_t)(fminf(fmaxf(weight, 0), 1) * 255 + 0.5f);
}

/* Where the surface meets the line through a texel, along the axis that its face looks along: the crossing into the solid that is nearest to the brick, within it and half a brick on either side. NAN: nowhere. */
static float height(const surface *s, const int b[3], int face, int texel)
{
    enum { FROM = -4, TO = 12 };
    int a = face >> 1, out = face & 1 ? -1 : 1;
    float x[3], best = NAN, far = 1e9f, before = -1;
    x[(a + 1) % 3] = 8.0f * (float)b[(a + 1) % 3] + (float)(texel % SIDE) / ORL_SKIN_PER_CELL;
    x[(a + 2) % 3] = 8.0f * (float)b[(a + 2) % 3] + (float)(texel / SIDE) / ORL_SKIN_PER_CELL;
    for (int k = FROM; k <= TO; k++) {          /* from outside inwards */
        float h = (float)(out > 0 ? 8 - k : k);
        x[a] = 8.0f * (float)b[a] + h;
        float f = surface_value(s, x);
        if (f <= 0 && before > 0) {
            float at = h + (float)out * f / (f - before), off = fmaxf(fmaxf(-at, at - 8), 0);
            if (off < far) { far = off; best = at; }
        }
        before = f;
    }
    return best;
}

/* What no line meets takes the height of its neighbours, from one ring to the next. */
static void fill_heights(float h[TEXELS])
{
    float next[TEXELS];
    for (int round = 0, left = 1; left && round < SIDE; round++) {
        left = 0;
        memcpy(next, h, sizeof next);
        for (int i = 0; i < TEXELS; i++) {
            if (!isnan(h[i])) continue;
            float sum = 0, n = 0;
            for (int k = 0; k < 9; k++) {
                int u = i % SIDE + k % 3 - 1, v = i / SIDE + k / 3 - 1;
                if (u < 0 || v < 0 || u >= SIDE || v >= SIDE || isnan(h[v * SIDE + u])) continue;
                sum += h[v * SIDE + u];
                n++;
            }
            if (n > 0) next[i] = sum / n;
            else left = 1;
        }
        memcpy(h, next, sizeof next);
    }
    for (int i = 0; i < TEXELS; i++) if (isnan(h[i])) h[i] = 4;
}

static void coarse_range(void *user, int begin, int end)
{
    const fit_job *j = user;
    for (int i = begin; i < end; i++) {
        int b[3];
        uint32_t e = j->s->index[i], t = orl_skin_first(e);
        place_of(j->surf, j->place[i], b);
        for (int f = 0; f < ORL_SKIN_FACES; f++) {
            if (!(e >> f & 1)) continue;
            float h[TEXELS];
            for (int k = 0; k < TEXELS; k++) h[k] = height(j->surf, b, f, k);
            fill_heights(h);
            for (int k = 0; k < TEXELS; k++) {
                float x[3];
                int a = f >> 1;
                x[a] = 8.0f * (float)b[a] + h[k];
                x[(a + 1) % 3] = 8.0f * (float)b[(a + 1) % 3] + (float)(k % SIDE) / ORL_SKIN_PER_CELL;
                x[(a + 2) % 3] = 8.0f * (float)b[(a + 2) % 3] + (float)(k / SIDE) / ORL_SKIN_PER_CELL;
                j->colour(j->user, x, j->coarse[(size_t)t * TEXELS + (size_t)k]);
            }
            t++;
        }
    }
}

/* What a sample says to a brick that is `off` bricks from its own: its place there, and by how much its own texture falls short of it, with weights in displayed colours. */
typedef struct { float in[3], grad[3], lack[3], w[3], top; int face; } word;

static int hear(const fit_job *j, const skin_sample *q, uint32_t entry, const int off[3], word *out)
{
    float own[3], rgb[3], slope[3], err2 = 0;
    int beyond = !(q->weight > 0);
    out->top = 0;
    for (int a = 0; a < 3; a++) {
        own[a] = (float)q->at[a] * (1.0f / 4096);
        out->in[a] = own[a] + 8.0f * (float)off[a];
        beyond |= out->in[a] < -MARGIN || out->in[a] > 8 + MARGIN;
        out->grad[a] = (float)q->grad[a];
        out->top = fmaxf(out->top, fabsf(out->grad[a]));
    }
    if (beyond) return 0;
    out->face = face_of(orl_skin_mask(entry), out->grad);
    footprint p = find(out->face, own);
    look(j->now + (size_t)orl_skin_texture(entry, out->face) * TEXELS, &p, rgb);
    for (int c = 0; c < 3; c++) {
        slope[c] = (float)q->slope[c] * (1.0f / 2048);
        out->lack[c] = (float)q->rgb[c] * (1.0f / 32768) - rgb[c];
        err2 += out->lack[c] * slope[c] * out->lack[c] * slope[c];
    }
    float rob = ROBUST * ROBUST / (err2 + ROBUST * ROBUST);
    for (int c = 0; c < 3; c++) out->w[c] = (float)q->weight * (1.0f / 255) * rob * rob * slope[c] * slope[c];
    return 1;
}

typedef struct { float sum[TEXELS][3], weight[TEXELS][3]; } gathered;

/* Adds a word to the texture of face f: as find(), but beyond the border, too. */
static void spread(const word *q, int f, gathered *to)
{
    float share[2][2], look_at = f == q->face ? 1 : (f & 1 ? -1 : 1) * q->grad[f >> 1] / q->top;
    int first[2], out = look_at < LOOK_LEAST;
    for (int d = 0; d < 2; d++) {
        float at = q->in[((f >> 1) + 1 + d) % 3] * ORL_SKIN_PER_CELL, low = floorf(at);
        first[d] = (int)low;
        share[d][1] = at - low;
        share[d][0] = 1 - share[d][1];
        out |= first[d] < -1 || first[d] >= SIDE;
    }
    if (out) return;
    look_at *= look_at;
    for (int n = 0; n < 4; n++) {
        int u = first[0] + (n & 1), v = first[1] + (n >> 1);
        if (u < 0 || v < 0 || u >= SIDE || v >= SIDE) continue;
        float s = share[0][n & 1] * share[1][n >> 1] * look_at;
        for (int c = 0; c < 3; c++) {
            to->sum[v * SIDE + u][c] += s * q->w[c] * q->lack[c];
            to->weight[v * SIDE + u][c] += s * q->w[c];
        }
    }
}

/* New texels of brick i from its own and its neighbours' samples. */
static void gather(const fit_job *j, int i)
{
    const surface *surf = j->surf;
    static _Thread_local gathered of[ORL_SKIN_FACES];       /* in the order of the brick's textures */
    uint32_t e = j->s->index[i];
    int b[3];
    place_of(surf, j->place[i], b);
    memset(of, 0, sizeof of);
    for (int k = 0; k < AROUND; k++) {
        int off[3] = { k % 3 - 1, k / 3 % 3 - 1, k / 9 - 1 }, there = 1;
        for (int a = 0; a < 3; a++) there &= b[a] + off[a] >= 0 && b[a] + off[a] < surf->nb[a];
        if (!there) continue;
        int32_t m = surf->bmap[((size_t)(b[2] + off[2]) * (size_t)surf->nb[1] + (size_t)(b[1] + off[1])) * (size_t)surf->nb[0] + (size_t)(b[0] + off[0])];
        if (m < 0) continue;
        for (const skin_sample *q = j->sample + j->begin[m]; q < j->sample + j->begin[m + 1]; q++) {
            word said;
            if (!hear(j, q, j->s->index[m], off, &said)) continue;
            for (int f = 0, t = 0; f < ORL_SKIN_FACES; f++) if (e >> f & 1) spread(&said, f, &of[t++]);
        }
    }
    for (int t = 0, n = __builtin_popcount(orl_skin_mask(e)); t < n; t++)
        for (int k = 0; k < TEXELS; k++) {
            size_t at = ((size_t)orl_skin_first(e) + (size_t)t) * TEXELS + (size_t)k;
            for (int c = 0; c < 3; c++) {
                float now = j->now[at][c], v = now + (of[t].sum[k][c] + PRIOR * (j->coarse[at][c] - now)) / (of[t].weight[k][c] + PRIOR);
                j->s->texel[at][c] = fminf(fmaxf(v, 0), 1);
            }
        }
}

static void gather_range(void *user, int begin, int end) { for (int i = begin; i < end; i++) gather(user, i); }

orl_err skin_fit(skin *s, const surface *surf, const skin_sample *sample, const uint32_t *begin, skin_coarse *colour, const void *user, int threads)
{
    size_t n = (size_t)s->n * TEXELS;
    fit_job j = { s, surf, places(surf), sample, begin, colour, user, malloc((n + 1) * sizeof *j.coarse), malloc((n + 1) * sizeof *j.now) };
    int ok = j.place && j.coarse && j.now;
    if (ok) {
        orl_parallel(threads, (int)surf->nbricks, 16, coarse_range, &j);
        memcpy(s->texel, j.coarse, n * sizeof *s->texel);
        for (int i = 0; i < ITERATIONS; i++) {
            memcpy(j.now, s->texel, n * sizeof *s->texel);
            orl_parallel(threads, (int)surf->nbricks, 16, gather_range, &j);
        }
    }
    free((void *)j.place);
    free(j.coarse);
    free(j.now);
    return ok ? ORL_OK : orl_fail(ORL_E_MEMORY, "base colour: no memory for %u textures", s->n);
}

orl_err skin_save(const skin *s, uint32_t nbricks, FILE *f)
{
    int bad = fwrite(&s->n, sizeof s->n, 1, f) != 1 || (s->n && (fwrite(s->index, sizeof *s->index, nbricks, f) != nbricks || fwrite(s->texel, sizeof *s->texel * TEXELS, s->n, f) != s->n));
    return bad ? orl_fail(ORL_E_IO, "checkpoint: write failed") : ORL_OK;
}

orl_err skin_load(skin *s, uint32_t nbricks, FILE *f, const char *path)
{
    skin made = { 0 };
    uint64_t n = 0;
    int bad = fread(&made.n, sizeof made.n, 1, f) != 1 || made.n > ORL_SKIN_MOST || made.n > 6 * (uint64_t)nbricks;
    if (bad || !made.n) return bad ? orl_fail(ORL_E_FORMAT, "%s: base colour is cut short", path) : ORL_OK;
    made.index = malloc((size_t)nbricks * sizeof *made.index);
    made.texel = malloc((size_t)made.n * TEXELS * sizeof *made.texel);
    bad = !made.index || !made.texel || fread(made.index, sizeof *made.index, nbricks, f) != nbricks || fread(made.texel, sizeof *made.texel * TEXELS, made.n, f) != made.n;
    for (uint32_t i = 0; !bad && i < nbricks; i++) {
        bad = !orl_skin_mask(made.index[i]) || orl_skin_first(made.index[i]) != n;
        n += (uint64_t)__builtin_popcount(orl_skin_mask(made.index[i]));
    }
    if (bad || n != made.n) { skin_free(&made); return orl_fail(ORL_E_FORMAT, "%s: base colour is cut short or no memory for it", path); }
    *s = made;
    return ORL_OK;
}
