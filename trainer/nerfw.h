/* The baseline: NeRF in the wild (Martin-Brualla et al. 2021) on the kernels of mlp.h and encoding.h, with the same data as stage 1.
 * Density instead of an SDF; appearance and transient code a photo; what leaves the box meets a background by direction and appearance. */
#ifndef TRAINER_NERFW_H
#define TRAINER_NERFW_H
#include "oriel/image.h"
#include "trainer/encoding.h"
#include "trainer/mlp.h"
#include "trainer/world.h"

enum { NERFW_CODE = 16, NERFW_CELLS = 128 };    /* density grid: cells along the longest side */

typedef struct { enc_kind encoding; int rays, threads; uint64_t seed; } nerfw_options;

/* Means over a step's rays. total: the very function that is differentiated, summed. */
typedef struct { double mse, sky, transient, distortion, samples, total; } nerfw_losses;

typedef struct nerfw_desk nerfw_desk;

typedef struct {
    nerfw_options opt;
    const world *w;                 /* NULL once loaded for evaluation */
    frame f;
    int nphotos, step;
    int heuristics;                 /* fading near cameras is not a gradient of the total: gradient tests turn it off */
    encoding enc;
    mlp base, colour, transient, sky;
    grid codes;                     /* per photo: appearance code, then transient code */
    int gn[3];                      /* density grid: expected density a cell of `cell` fine cells; steers where samples go, nothing else */
    float cell, *density;
    nerfw_desk *desk[GRID_THREADS];
} nerfw;

orl_err nerfw_init(nerfw *n, const world *w, const nerfw_options *opt);
void nerfw_free(nerfw *n);
/* One step; progress 0..1 sets the learning rates. Repeatable for seed, step, progress and thread count. */
void nerfw_step(nerfw *n, float progress, nerfw_losses *out);
/* Its first half, gradients left where they are (tests). */
void nerfw_gradients(nerfw *n, float progress, nerfw_losses *out);

/* File: header, density grid, encoding, MLPs, codes; exact size, native byte order. Written to a temporary file, fsync, rename. */
orl_err nerfw_save(const nerfw *n, const char *path);
/* For evaluation: not trainable. Refuses wrong magic, version, sizes, lengths, values that are not finite. */
orl_err nerfw_load(const char *path, nerfw *out);

/* The photo `known` is the left part of the view (cam->w x cam->h): the appearance code is fitted to it (code: NERFW_CODE floats out), then the whole view is rendered, static branch only. */
orl_err nerfw_predict(const nerfw *n, const orl_camera *cam, const orl_pose *pose, const orl_image *known, int threads, float *code, orl_image *out);
#endif
