/* The backdrop's distance and opacity (backdrop.h). Sums are of integers, so that no order of threads matters. */
#include "trainer/backdrop.h"
#include <stdlib.h>
#include <string.h>
#include "oriel/parallel.h"

enum { ROOMS = 7, ONE = 255, UNIT = 1 << 12, AREA_W = 8, AREA_H = 2, AREAS_W = ORL_BACK_COLS / AREA_W, AREAS = AREAS_W * (ORL_BACK_ROWS / AREA_H) };
static const float ROOM[ROOMS] = { 1, 1.4f, 2, 3, 5, 10, 30 };      /* sides over the box's */
#define HEIGHT 0.3f             /* of the walls, over the mean of half their sides */
#define PRIOR 1.0f              /* photos that a texel's area weighs, and for the area all texels at its height */
#define WORTH 0.8f              /* of the error without a backdrop: what a useful one leaves at most */

typedef struct { uint32_t opaque, photos; } votes;      /* opaque: sum over the photos of their share of scene, in 1 / ONE */
typedef struct { uint16_t scene, all; } tally;          /* of one photo's pixels */
typedef struct {
    const surface *s;
    const world *w;
    const stage1 *s1;
    orl_backdrop room[ROOMS];
    votes (*v)[ORL_BACK_TEXELS], (*area)[AREAS];      /* area: sums over AREA_W x AREA_H texels */
    float (*row)[ORL_BACK_ROWS];    /* NULL: the first pass, which only counts; then the share of scene at each height */
    uint64_t error[ROOMS], bare;      /* squared errors in 1 / UNIT, of each room and of none */
    int failed, step;
} job;

/* The photo's pixels on every room's walls. missed: those wrong without a wall: scene over the walls, sky on the ground before them. bare: those wrong without a backdrop. */
static void tally_photo(job *j, int k, tally (*t)[ORL_BACK_TEXELS], uint32_t missed[ROOMS], uint32_t *bare)
{
    const world_photo *p = &j->w->photos[k];
    const double middle[2] = { 0.5 * j->s->f.dims[0], 0.5 * j->s->f.dims[1] };
    float o[3] = { (float)p->centre[0], (float)p->centre[1], (float)p->centre[2] }, d[3];
    memset(t, 0, ROOMS * sizeof *t);
    memset(missed, 0, ROOMS * sizeof *missed);
    *bare = 0;
    for (int y = 0; y < p->h; y += j->step)
        for (int x = 0; x < p->w; x += j->step) {
            int label = world_label(p, x, y), scene = label == WORLD_SCENE || label == WORLD_BEYOND;
            if (!scene && label != WORLD_SKY) continue;
            surface_hit h;
            world_ray(p, x + 0.5, y + 0.5, d);
            int met = surface_meet(j->s, o, d, SURFACE_NO_BACKDROP, &h);
            if (met == MET_SURFACE || (scene && j->s1 && stage1_transient(j->s1, k, (float)x + 0.5f, (float)y + 0.5f) > 0.5f)) continue;
            const double from[3] = { p->centre[0], p->centre[1], p->centre[2] }, along[3] = { d[0], d[1], d[2] };
            *bare += (uint32_t)(met == MET_GROUND ? !scene : scene);
            for (int r = 0; r < ROOMS; r++) {
                double far, uv[2];
                if (!orl_backdrop_meet(&j->room[r], middle, j->s->f.ground, from, along, &far, uv)) {
                    missed[r] += (uint32_t)(met == MET_GROUND ? !scene : scene);
                    continue;
                }
                if (met == MET_GROUND && (double)h.t < far) { missed[r] += !scene; continue; }
                tally *q = &t[r][(int)uv[1] * ORL_BACK_COLS + (int)uv[0]];
                if (q->all == UINT16_MAX) continue;
                q->all++;
                q->scene += (uint16_t)scene;
            }
        }
}

static int area_of(int texel) { return texel / ORL_BACK_COLS / AREA_H * AREAS_W + texel % ORL_BACK_COLS / AREA_W; }
static uint32_t share_of(const tally *q) { return (uint32_t)((ONE * q->scene + q->all / 2) / q->all); }

/* Opacity by votes, without those of `own` (NULL: all count): the texel's, drawn to its area's, drawn to its height's. */
static float told(const votes *texel, const votes *area, float row, const votes *own, const votes *own_area)
{
    static const votes none = { 0, 0 };
    if (!own) own = own_area = &none;
    float a = ((float)(area->opaque - own_area->opaque) / ONE + PRIOR * row) / ((float)(area->photos - own_area->photos) + PRIOR);
    return ((float)(texel->opaque - own->opaque) / ONE + PRIOR * a) / ((float)(texel->photos - own->photos) + PRIOR);
}

/* Counts a photo's pixels in. */
static void vote(job *j, int r, const tally t[ORL_BACK_TEXELS])
{
    for (int i = 0; i < ORL_BACK_TEXELS; i++) {
        if (!t[i].all) continue;
        votes *to[2] = { &j->v[r][i], &j->area[r][area_of(i)] };
        for (int k = 0; k < 2; k++) {
            __atomic_fetch_add(&to[k]->opaque, share_of(&t[i]), __ATOMIC_RELAXED);
            __atomic_fetch_add(&to[k]->photos, 1, __ATOMIC_RELAXED);
        }
    }
}

/* Squared error of what the other photos foretell of a photo's pixels. */
static double foretell(const job *j, int r, const tally t[ORL_BACK_TEXELS])
{
    votes own[AREAS] = { { 0, 0 } };
    double error = 0;
    for (int i = 0; i < ORL_BACK_TEXELS; i++) {
        if (!t[i].all) continue;
        own[area_of(i)].opaque += share_of(&t[i]);
        own[area_of(i)].photos++;
    }
    for (int i = 0; i < ORL_BACK_TEXELS; i++) {
        if (!t[i].all) continue;
        int a = area_of(i);
        float p = told(&j->v[r][i], &j->area[r][a], j->row[r][i / ORL_BACK_COLS], &(votes){ share_of(&t[i]), 1 }, &own[a]);
        error += t[i].scene * (1 - p) * (1 - p) + (t[i].all - t[i].scene) * p * p;
    }
    return error;
}

static void photo_range(void *user, int begin, int end)
{
    job *j = user;
    tally (*t)[ORL_BACK_TEXELS] = malloc(ROOMS * sizeof *t);
    if (!t) { __atomic_store_n(&j->failed, 1, __ATOMIC_RELAXED); return; }
    for (int k = begin; k < end; k++) {
        uint32_t missed[ROOMS], bare;
        tally_photo(j, k, t, missed, &bare);
        for (int r = 0; r < ROOMS; r++) {
            if (j->row) __atomic_fetch_add(&j->error[r], (uint64_t)((missed[r] + foretell(j, r, t[r])) * UNIT), __ATOMIC_RELAXED);
            else vote(j, r, t[r]);
        }
        if (j->row) __atomic_fetch_add(&j->bare, (uint64_t)bare * UNIT, __ATOMIC_RELAXED);
    }
    free(t);
}

/* Share of scene at each height of a room, of the texels that photos show. */
static void row_means(const votes *v, float row[ORL_BACK_ROWS])
{
    for (int y = 0; y < ORL_BACK_ROWS; y++) {
        double opaque = 0, photos = 0;
        for (int x = 0; x < ORL_BACK_COLS; x++) {
            opaque += v[y * ORL_BACK_COLS + x].opaque;
            photos += v[y * ORL_BACK_COLS + x].photos;
        }
        row[y] = photos > 0 ? (float)(opaque / ONE / photos) : 0;
    }
}

orl_err backdrop_find(surface *s, const world *w, const stage1 *s1, int threads)
{
    job j = { .s = s, .w = w, .s1 = s1, .step = world_ray_step(w) };
    float row[ROOMS][ORL_BACK_ROWS];
    int best = 0;
    j.v = calloc(ROOMS, sizeof *j.v);
    j.area = calloc(ROOMS, sizeof *j.area);
    if (!s->opacity) s->opacity = malloc(ORL_BACK_TEXELS);
    if (!j.v || !j.area || !s->opacity) { free(j.v); free(j.area); return orl_fail(ORL_E_MEMORY, "backdrop: no memory"); }
    memset(s->opacity, 0, ORL_BACK_TEXELS);
    s->back = (orl_backdrop){ { 0, 0 }, 0 };
    for (int r = 0; r < ROOMS; r++) {
        for (int a = 0; a < 2; a++) j.room[r].half[a] = 0.5f * ROOM[r] * (float)s->f.dims[a];
        j.room[r].height = HEIGHT * 0.5f * (j.room[r].half[0] + j.room[r].half[1]);
    }
    orl_parallel(threads, w->nphotos, 1, photo_range, &j);
    for (int r = 0; r < ROOMS; r++) row_means(j.v[r], row[r]);
    j.row = row;
    orl_parallel(threads, w->nphotos, 1, photo_range, &j);
    for (int r = 1; r < ROOMS; r++) if (j.error[r] < j.error[best]) best = r;
    if (!j.failed && (double)j.error[best] < WORTH * (double)j.bare) {
        s->back = j.room[best];
        for (int i = 0; i < ORL_BACK_TEXELS; i++)
            s->opacity[i] = (uint8_t)(ONE * told(&j.v[best][i], &j.area[best][area_of(i)], row[best][i / ORL_BACK_COLS], NULL, NULL) + 0.5f);
    }
    free(j.v);
    free(j.area);
    return j.failed ? orl_fail(ORL_E_MEMORY, "backdrop: no memory") : ORL_OK;
}
