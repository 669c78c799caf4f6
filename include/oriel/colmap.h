/* COLMAP sparse models (binary or text), read whole and checked: every count against the bytes that remain, every index against its table. */
#ifndef ORIEL_COLMAP_H
#define ORIEL_COLMAP_H
#include <stddef.h>
#include <stdint.h>
#include "oriel/camera.h"

typedef struct { float x, y; int32_t point; } orl_colmap_obs;       /* pixel; index into points, -1 = none */
typedef struct {
    char name[256];
    uint32_t id;
    int camera;                                                     /* index into cameras */
    orl_pose pose;
    uint32_t obs_begin, obs_count;                                  /* into obs */
} orl_colmap_image;
typedef struct {
    uint64_t id;                                                    /* COLMAP's; not written */
    double xyz[3];
    uint8_t rgb[3];
    float error_px;                                                 /* mean reprojection error */
    uint32_t track_length;
} orl_colmap_point;
typedef struct {
    orl_camera *cameras; uint32_t ncameras;
    orl_colmap_image *images; uint32_t nimages;                     /* sorted by name, so that order repeats */
    orl_colmap_obs *obs; uint32_t nobs;
    orl_colmap_point *points; uint32_t npoints;                     /* sorted by COLMAP's point id */
} orl_colmap;

/* dir holds cameras/images/points3D as .bin or .txt (binary wins); points3D may be absent (then npoints = 0).
 * Images whose camera is absurd or whose pose is singular are left out; each is named through warn (may be NULL). */
orl_err orl_colmap_read(const char *dir, void (*warn)(void *user, const char *line), void *user, orl_colmap *out);
void orl_colmap_free(orl_colmap *m);
/* Text model, for tools that make scenes. Atomic per file. */
orl_err orl_colmap_write_text(const char *dir, const orl_colmap *m);
#endif
