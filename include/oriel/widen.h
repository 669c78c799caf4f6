/* One camera, one wide view: what `extend` does once and `run` every frame.
 *
 * A small view at the photo's camera serves adaptation, marched where adaptation looks alone; the wide view, marched where the photo does not stand alone, is re-lit and shaded; the blend lays the photo in. Everything lives in the caller's block;
 * after orl_widen_init nothing is allocated. Same bytes for any number of threads, any kernel and machine. */
#ifndef ORIEL_WIDEN_H
#define ORIEL_WIDEN_H
#include "oriel/adapt.h"
#include "oriel/blend.h"
#include "oriel/view.h"

typedef struct {
    const orl_scene *scene;             /* or, with baked, only its light model and codes */
    const orl_view *baked;              /* [ORL_VIEWS], the photo's and the wide view, kept by the caller; NULL: both are built */
    orl_camera photo, wide;             /* photo: at the frame's size */
    orl_pose photo_pose, wide_pose;
    const uint8_t *mask;                /* photo-size, nonzero = person: left out of adaptation; NULL */
    int blend;                          /* 0: the render alone */
    int quick;                          /* views by ORL_RAYS_CORNERS instead of ORL_RAYS_FOUR: the first picture twice as soon */
    unsigned no_skip;                   /* ORL_SKIP_* that are not taken (EMPTY is the scene's: oriel/view.h); without PHOTO what it covers is not even marched */
    int threads;
    unsigned cpu;
} orl_widen_config;

/* A view's sun: traced all at once when it jumps, by and by (a band of rows a frame) when it creeps. dir: where it stood when the trace under way began; rows from `row` on wait. */
typedef struct { float dir[3]; int row, traced; } orl_sun_trace;

typedef struct {
    orl_widen_config config;
    orl_view small, wide;
    orl_sun_trace wide_sun;
    orl_blend *blend;                   /* NULL without */
    orl_adapt_result fit;               /* of the last adaptation */
    int adapted;                        /* fit.code holds a light */
    int starts;                         /* adaptations run for the last frame */
    orl_light *light;
    orl_sample *samples; int nsamples;
    orl_sample *rival;                  /* of other suns on trial: [nsamples], */
    float rival_code[ORL_CODE];         /* the best one of the last frame, */
    int rival_stands, sun, round;       /* if there was one; which sun is next, which share of the samples */
    float (*seen)[3]; int still;        /* samples' colours when the light last changed; frames since */
    int *spot;                          /* [nsamples] pixel of the small view */
    uint8_t *unmasked;                  /* [small pixel] 1 = no person */
    void *adapt_work, *light_block, *last_light;        /* last_light: the tables before */
    orl_view_light *tables;
    uint8_t *kept;                      /* the render of a light that has stayed, before the photo was laid in */
    int same;                           /* pictures shaded since light or sun changed */
} orl_widen;

size_t orl_widen_need(const orl_widen_config *c);
orl_err orl_widen_init(const orl_widen_config *c, void *block, size_t bytes, orl_widen *out);
/* The same, and orl_widen_adapt for a first photo, while the wide view is marched. */
orl_err orl_widen_start(const orl_widen_config *c, const uint8_t *photo, void *block, size_t bytes, orl_widen *out);
/* Finds the light of a photo (tight RGB): from several starts the first time, then from the last codes. ORL_E_DEGENERATE is not an error here: see fit.status.
 * Where the samples stay within a level of what they were when the light last changed (mean over runs of 16 neighbours; 16 levels at most count of each), codes move for 4 frames more, other suns are tried for another 12, and then the light stands. */
orl_err orl_widen_adapt(orl_widen *w, const uint8_t *photo);
/* The wide picture (tight RGB) in the light found last. photo is blended in, if the configuration says so. */
orl_err orl_widen_render(orl_widen *w, const uint8_t *photo, uint8_t *out);
/* The photo's camera at the size in which light is found. */
orl_camera orl_widen_small(const orl_camera *photo);
/* 64-byte aligned memory for such blocks; NULL if there is none. */
void *orl_widen_block(size_t bytes);
#endif
