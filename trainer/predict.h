/* What every column of the evaluation predicts from the known part of a photo, and the steps that lead there. */
#ifndef TRAINER_PREDICT_H
#define TRAINER_PREDICT_H
#include "oriel/adapt.h"
#include "oriel/dataset.h"
#include "oriel/image.h"
#include "oriel/model.h"
#include "oriel/scene.h"
#include "oriel/view.h"
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

/* The photo's left w columns. */
orl_err predict_cut(const orl_image *photo, int w, orl_image *out);
/* A view in a block of its own; free(*mem) also after an error. */
orl_err predict_view(const orl_scene *s, const orl_camera *cam, const orl_pose *pose, int supersample, int threads, orl_view *v, void **mem);
/* Light of a picture of the view's left columns; the sun is traced on the way. */
orl_err predict_light(const orl_scene *s, orl_view *v, const orl_image *known, int threads, orl_adapt_result *out);
/* The view under a light, its sun traced, by the integer kernels of cpu. */
orl_err predict_shade(orl_view *v, const orl_light *light, int threads, unsigned cpu, orl_image *out);
#endif
