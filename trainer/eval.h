/* Half-photo protocol: scores of what every column predicts. */
#ifndef TRAINER_EVAL_H
#define TRAINER_EVAL_H
#include "oriel/metrics.h"
#include "trainer/predict.h"

/* Scores of a photo's columns on its right half and on all of it; name is the caller's. */
typedef struct { orl_score right[EVAL_COLUMNS], full[EVAL_COLUMNS]; int has[EVAL_COLUMNS]; const char *name; } eval_row;
extern const char *const EVAL_NAMES[EVAL_COLUMNS];
orl_err eval_score(const orl_image *photo, const eval_prediction *p, eval_row *r);
eval_row eval_mean(const eval_row *rows, int n);
#endif
