/* Dense oriented points by multi-view stereo: where a photo's patch is found again in other photos, whatever their light. */
#ifndef TRAINER_STEREO_H
#define TRAINER_STEREO_H
#include <stdio.h>
#include "oriel/facing.h"
#include "trainer/grid.h"
#include "trainer/world.h"

typedef struct {
    float x[3], n[3];               /* grid frame; unit normal, towards the photo */
    uint32_t photo;                 /* whose pixel it is: the way from its centre is free */
    float weight;                   /* 0..1: how many photos agree, and how well the patches match */
} stereo_point;

typedef struct stereo {
    stereo_point *points; uint32_t npoints;
    uint32_t *begin;                /* points of photo k: [begin[k], begin[k + 1]) */
    uint32_t *found;                /* the first so many of them are stereo's own, the rest completed (complete.h); NULL: all are */
    orl_facings facings;            /* what walls face (facing.h); the points' normals are drawn there */
} stereo;

/* PatchMatch stereo over the training photos at their training size, one photo a step. Repeatable for a seed, whatever the thread count. A scene without a pair of photos that see the same
 * points yields none. */
typedef struct stereo_work stereo_work;
orl_err stereo_begin(const world *w, uint64_t seed, int threads, stereo_work **out);    /* ORL_E_MEMORY */
int stereo_step(stereo_work *s);                /* 0: nothing was left to do */
double stereo_progress(const stereo_work *s);   /* 0..1 */
orl_err stereo_finish(stereo_work *s, stereo *out);     /* no step after it; of very many points a share stays, and their normals are drawn to what walls face */
void stereo_end(stereo_work *s);                /* NULL is fine */
/* Depth maps on the way. Only where stereo_can_save says so: between the passes that need all maps at once, or within the first. */
int stereo_can_save(const stereo_work *s);
orl_err stereo_work_save(const stereo_work *s, FILE *f);
orl_err stereo_work_load(stereo_work *s, FILE *f, const char *path);

/* Gives the depth maps back and keeps pictures and companions, with the poses of now, for stereo_slope. Before any step (a run that is resumed), after the last, or again. ORL_E_MEMORY. */
orl_err stereo_watch(stereo_work *s);
/* How much worse a photo's patch of 7 x 7 pixels at a surface point x with normal n matches its companions for every cell (grid frame) that the point moves away from the camera: d (1 - correlation) / d cell.
 * 0 where nothing can be said: no texture, no companion that sees the same. */
float stereo_slope(const stereo_work *s, int photo, const float x[3], const float n[3], rng *r);

/* Keeps points at even distances in their order, so that at most `most` stay. */
void stereo_thin(stereo *s, int photos, uint32_t most);

orl_err stereo_save(const stereo *s, FILE *f);          /* what stereo found itself */
orl_err stereo_load(stereo *s, const world *w, FILE *f, const char *path);
/* Points of photo k by the square of side x side pixels that they lie in: index + 1, 0 = none; (w / side + 1) x (h / side + 1), malloc'd. NULL: no memory. */
uint32_t *stereo_hits(const stereo *s, const world *w, int k, int side);
void stereo_free(stereo *s);
#endif
