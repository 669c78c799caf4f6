/* Stage 1: geometry by volume rendering over an SDF, with appearance codes and a transient branch. */
#ifndef TRAINER_STAGE1_H
#define TRAINER_STAGE1_H
#include "trainer/grid.h"
#include "trainer/stereo.h"

enum { SDF_LEVELS = 4, FEAT_LEVELS = 2, FEAT = 16, APPEARANCE = 4, TRANSIENT_PX = 8, TRANSIENT_CELLS = 96, TRANSIENT_ALL = 1 << 19 };

typedef struct {
    int rays;                       /* per step */
    int steps;
    uint64_t seed;
    int threads;
    float sigma;                    /* width of the logistic, fine cells; 0: by schedule */
} stage1_options;

/* Losses of one step, means over its rays (for progress lines). */
typedef struct { double photo, sky, eikonal, points, mse, transient; double samples, total; } stage1_losses;   /* total: the very function that is differentiated */

typedef struct {
    const world *w;
    const stereo *st;               /* NULL: none */
    orl_facings square;             /* what walls face; none without stereo */
    const stereo_work *watch;       /* for stereo_slope, not owned; NULL: patches do not pull at the surface */
    stage1_options opt;
    int step, heuristics;           /* fading near cameras, the photos' share in the shape, the patches' pull, weight-scaled smoothness, the pull towards what walls face and what is left out as too faint are not gradients of the total: gradient tests turn them off */
    grid sdf[SDF_LEVELS];           /* cells of 1, 2, 4, 16 fine cells; values in fine cells, positive in free space */
    grid hull, fused;               /* the first SDF, kept (cells of 2), and what the fused points add to it (cells of 1): the surface stays near their sum unless photos insist */
    grid feat[FEAT_LEVELS];         /* cells of 2 and 8; 16 floats: base RGB, then RGB for each of 4 appearance code entries */
    grid codes;                     /* per photo: appearance code 0..3, gain 4..6, bias 7..9, background 10..12 */
    float transient_px;             /* pixels between two of its vertices: TRANSIENT_PX, more where that makes over TRANSIENT_CELLS along the longest photo or TRANSIENT_ALL in all photos */
    grid transient;                 /* per photo: logit of alpha, RGB, beta before softplus */
} stage1;

/* Grids of zeros, to be started or loaded. */
orl_err stage1_init(stage1 *s, const world *w, const stage1_options *opt);
/* The hull as the first SDF; sky labels that contradict it become unknown. st: kept, and completed by planes where it is blind; NULL if there is none. */
orl_err stage1_start(stage1 *s, world *w, stereo *st);
void stage1_free(stage1 *s);
/* Trained no more: keeps what stage1_sdf, stage1_colour and stage1_transient need. */
void stage1_freeze(stage1 *s);
/* One optimisation step; repeatable for seed, step and thread count. 0: loss or a gradient was no number and the step was dropped, nothing moved. */
int stage1_step(stage1 *s, stage1_losses *out);
/* Its first half: losses of the step's batch, gradients left in the grids (tests compare them with finite differences). */
void stage1_gradients(stage1 *s, stage1_losses *out);
/* Sum of all SDF levels at a point (fine cells) and its gradient (may be NULL). */
float stage1_sdf(const stage1 *s, const float x[3], float grad[3]);
/* Static branch at a surface point in photo k's appearance: the occlusion-free colour, sRGB 0..1. */
void stage1_colour(const stage1 *s, int photo, const float x[3], float rgb[3]);
/* Transient share of a pixel, 0..1. */
float stage1_transient(const stage1 *s, int photo, float u, float v);
#endif
