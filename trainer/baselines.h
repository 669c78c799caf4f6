/* Trivial predictions that a product has to beat. `known` is the photo cut after its left columns (known->w < cam->w): all of the test
 * photo that they get. */
#ifndef TRAINER_BASELINES_H
#define TRAINER_BASELINES_H
#include "oriel/dataset.h"

/* Training photos at evaluation size, loaded when first asked for. */
typedef struct {
    const orl_dataset *data;
    int long_side;
    orl_image *photo;           /* [nphotos], px NULL until loaded */
    orl_camera *cam;
} baselines;

orl_err baselines_open(const orl_dataset *d, int long_side, baselines *out);
void baselines_close(baselines *b);

/* Each row: its mean over the known columns. Width w; out allocated here, as below. */
orl_err baselines_row_mean(const orl_image *known, int w, orl_image *out);
/* The nearest training photo (most of the view covered, seen from nearly the same place) warped through interpolated SfM depth, its
 * colours matched by a 3 x 4 affine map fitted robustly on the known columns; and the median of the BASELINES_WARPS nearest such warps.
 * What no photo covers gets the row mean. Where the view shares no SfM points with any photo both are the row mean. */
enum { BASELINES_WARPS = 12 };
orl_err baselines_warp(baselines *b, const orl_camera *cam, const orl_pose *pose, const orl_image *known, orl_image *nearest, orl_image *median);
/* Inverse depth (1 / camera z) of a view at every pixel, from the SfM points of the training photos that look the same way; 0
 * everywhere if too few. out: cam->w * cam->h. */
orl_err baselines_inverse_depth(const orl_dataset *d, const orl_camera *cam, const orl_pose *pose, float *out);
#endif
