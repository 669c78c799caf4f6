/* The trainer's float model, as saved in a checkpoint, for evaluation and reports. */
#ifndef ORIEL_MODEL_H
#define ORIEL_MODEL_H
#include "oriel/camera.h"
#include "oriel/light.h"
typedef struct orl_model orl_model;
orl_err orl_model_load(const char *checkpoint, orl_model **out);
void orl_model_free(orl_model *m);
const orl_light_model *orl_model_light(const orl_model *m);
/* Surface samples of every pixel (row-major, cam->w * cam->h), rgb and weight 0. light: whose sun is traced (fix); NULL: none. depth (may be NULL): world units along the optical axis, 0 = sky. */
void orl_model_gbuffer(const orl_model *m, const orl_camera *cam, const orl_pose *pose, const orl_light *light, int threads, orl_sample *out, float *depth);
/* The same of n pixels only, by index. */
void orl_model_samples(const orl_model *m, const orl_camera *cam, const orl_pose *pose, const orl_light *light, const int *pixel, int n, int threads, orl_sample *out);
#define ORL_MODEL_SIGMA 0.4f        /* width of the logistic, fine cells, that stage 1 ends with */
/* The picture itself, volume-rendered (trainer/exact.h says what sigma is), side x side rays a pixel, each sample shaded on its own, then averaged. rgb: [h][w][3] display-referred, not clamped. */
void orl_model_exact(const orl_model *m, const orl_camera *cam, const orl_pose *pose, const orl_light *light, int side, float sigma, int threads, float *rgb);
/* Scene frame: rotation world -> scene frame (z up). */
void orl_model_up(const orl_model *m, double R[9]);
#endif
