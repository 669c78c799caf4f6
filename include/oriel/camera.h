/* Camera models and poses, in COLMAP's conventions: camera x right, y down, z forward; X_cam = R X_world + t;
 * the first pixel's centre is (0.5, 0.5). All double; only + - * / sqrt are used, so results repeat on every machine. */
#ifndef ORIEL_CAMERA_H
#define ORIEL_CAMERA_H
#include "oriel/error.h"

typedef enum { ORL_CAM_SIMPLE_PINHOLE = 0, ORL_CAM_PINHOLE = 1, ORL_CAM_SIMPLE_RADIAL = 2, ORL_CAM_RADIAL = 3, ORL_CAM_OPENCV = 4 } orl_cam_model; /* COLMAP's ids */

typedef struct {
    orl_cam_model model;
    int w, h;                       /* pixels */
    double fx, fy, cx, cy;          /* pixels */
    double k1, k2, p1, p2;          /* distortion, 0 where the model has none */
} orl_camera;

typedef struct {
    double R[9];                    /* row-major rotation world -> camera */
    double t[3];                    /* world units */
} orl_pose;

/* From COLMAP's parameter vector. ORL_E_RANGE on non-finite values, w or h < 1 or > 65535, focal length <= 0 or absurd (> 100 or < 0.05 image long sides). */
orl_err orl_camera_from_params(orl_camera *out, int model, int w, int h, const double *params, int nparams);
int  orl_camera_model_from_name(const char *name);   /* -1 if unknown */
const char *orl_camera_model_name(orl_cam_model m);
int  orl_camera_param_count(int model);              /* -1 if unknown */
/* Same lens at another image size (anisotropic allowed). */
orl_camera orl_camera_resized(const orl_camera *c, int w, int h);
/* Same centre and pose, no distortion, field of view widened `factor` times (focal / factor) at size w x h. */
orl_camera orl_camera_widened(const orl_camera *c, double factor, int w, int h);
/* Pixel (u, v) -> ray direction in camera space, not normalised, z = 1. Undistorted by Newton's method, 20 steps at most; beyond the radius where the lens model folds over, the last sane direction. */
void orl_camera_unproject(const orl_camera *c, double u, double v, double dir[3]);
/* Camera-space point -> pixel. Returns 0 if z <= 1e-9 (uv untouched), else 1. */
int  orl_camera_project(const orl_camera *c, const double p[3], double uv[2]);

/* Quaternion w, x, y, z (normalised here) and t. ORL_E_DEGENERATE on non-finite or near-zero quaternions. */
orl_err orl_pose_from_quat(orl_pose *out, const double q[4], const double t[3]);
void orl_pose_to_quat(const orl_pose *p, double q[4]);
void orl_pose_apply(const orl_pose *p, const double world[3], double cam[3]);
void orl_pose_centre(const orl_pose *p, double centre[3]);          /* -R^T t */
void orl_pose_ray(const orl_pose *p, const double cam_dir[3], double world_dir[3]); /* R^T d, unit length out */

/* Pose file: lines `NAME MODEL WIDTH HEIGHT PARAMS… QW QX QY QZ TX TY TZ`, '#' comments. First line: recorded view; second, where present: wide view wanted. */
typedef struct { char name[128]; orl_camera cam; orl_pose pose; } orl_view_pose;
orl_err orl_posefile_read(const char *path, orl_view_pose *out, int cap, int *count);
#endif
