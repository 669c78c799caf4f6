/* Half-photo protocol: what every column predicts from the known part of a photo. */
#ifndef TRAINER_EVAL_H
#define TRAINER_EVAL_H
#include "oriel/adapt.h"
#include "oriel/dataset.h"
#include "oriel/image.h"
#include "oriel/metrics.h"
#include "oriel/model.h"
#include "oriel/scene.h"
#include "trainer/baselines.h"
#include "trainer/nerfw.h"

enum { EVAL_FIXED, EVAL_FLOAT, EVAL_NERFW, EVAL_ROW_MEAN, EVAL_NEAREST, EVAL_MEDIAN, EVAL_COLUMNS };

typedef struct {
    const orl_scene *scene;         /* NULL: no column `fixed` */
    const orl_model *model;         /* NULL: no column `float` */
    const nerfw *nerfw;             /* NULL: no column `nerfw` */
    baselines *base;                /* NULL: no warps */
    unsigned cpu;
    int threads;
} eval_setup;

typedef struct {
    orl_image rgb[EVAL_COLUMNS];            /* px NULL where the column is left out */
    orl_adapt_result adapt[EVAL_FLOAT + 1]; /* of `fixed` and `float` */
    float nerfw_code[NERFW_CODE];           /* of `nerfw` */
} eval_prediction;

/* Predicts the whole picture of a view (cam->w x cam->h, the photo's size) from the photo's columns [0, known_w): the photo is cut
 * there first, and the cut is all that adaptation and baselines are given. known_w = cam->w lets them see everything. */
orl_err eval_predict(const eval_setup *s, const orl_camera *cam, const orl_pose *pose, const orl_image *photo, int known_w, eval_prediction *out);
void eval_prediction_free(eval_prediction *p);

/* Scores of a photo's columns on its right half and on all of it; name is the caller's. */
typedef struct { orl_score right[EVAL_COLUMNS], full[EVAL_COLUMNS]; int has[EVAL_COLUMNS]; const char *name; } eval_row;
extern const char *const EVAL_NAMES[EVAL_COLUMNS];
orl_err eval_score(const orl_image *photo, const eval_prediction *p, eval_row *r);
eval_row eval_mean(const eval_row *rows, int n);
/* Figures of `eval --geometry`: against gt/ where there is one, else the sky by its masks; SfM points held out from training; transients, where SCENE has masks and the run its checkpoint (NULL: none).
 * depth_median_rel, normal_mean_deg (true depth under 80 m), the same with _all, scene_missed, sky_covered, sfm_heldout_median_rel, sfm_heldout_points, transient_iou. */
enum { EVAL_FIGURES = 10 };
typedef struct { double v; const char *key; int digits; } figure;
orl_err eval_geometry(const orl_dataset *d, const orl_scene *s, const char *checkpoint, int threads, figure out[EVAL_FIGURES], int *count);
#endif
