/* A view: the per-pixel store of one pose and lens, made by marching the scene in fixed point, re-lit in integers. */
#ifndef ORIEL_VIEW_H
#define ORIEL_VIEW_H
#include "oriel/camera.h"
#include "oriel/scene.h"

/* What is left out where nobody would see it. Bits of no_skip turn that off, to measure it: the same picture, later; EMPTY may move a hit by a fraction of a cell. */
enum {
    ORL_SKIP_PHOTO = 1,             /* pixels that the photo covers */
    ORL_SKIP_SKY = 2,               /* light on a surface in runs of pixels that have none */
    ORL_SKIP_SHADOW = 4,            /* shadow features of a scene that has none */
    ORL_SKIP_SAME = 8,              /* shading once more in the light of the last picture */
    ORL_SKIP_EMPTY = 16,            /* steps through bricks known to be empty: the scene's brick map */
    ORL_SKIP_LIGHT = 32,            /* the search for a light where nothing changed */
    ORL_SKIP_ALL = 63
};

/* Structure of arrays, rows padded to a multiple of 32 pixels (stride). Owned by the caller's block. */
typedef struct {
    int w, h, stride;
    int8_t  *normal[3];             /* unit, 127ths, -127..127; 0 where nothing is */
    uint8_t *albedo[3];             /* linear^(5/12), 255ths: steps as even to the eye as sRGB's, and what the kernels multiply */
    uint8_t *open, *cov;            /* 0..255 */
    uint8_t *horizon;               /* 16 planes, one an azimuth */
    int8_t  *phi[2];                /* [pixel][4]: features 0..3, 4..7 */
    const uint8_t *ceiling;         /* 16 planes of a baked view: 255 - elevation of what hangs over it in each azimuth, 0 nothing; NULL: the scene tells */
    int8_t *fix;                    /* what a traced sun has over the horizons', in 1/127; 0: not traced */
    uint16_t *depth;                /* Q.4 fine cells along the ray, 65535 = none */
    float phi_scale[ORL_SHADOW_DIM];
    orl_camera cam; orl_pose pose;
    double grid_from_cam[9];        /* rotation camera -> scene frame (z up) */
    double eye[3];                  /* grid frame */
    unsigned no_skip;               /* ORL_SKIP_SKY, ORL_SKIP_SHADOW: not skipped */
    const orl_scene *scene;         /* not owned; for orl_view_trace_sun, NULL where ceiling is there */
    void *sky;                      /* coarse grid of sky directions, private */
} orl_view;

int orl_view_stride(int w);                                         /* pixels of a padded row */
size_t orl_view_need(int w, int h);                                 /* bytes, 64-byte aligned block */
/* Rays of a pixel, attributes averaged, coverage counted: one through its middle; four of its own; or four through its corners, which neighbours share: little more than one, and softer. Where a pixel is wider
 * than a cell, so that more is to be seen in it, its corners are not enough, and it has four of its own. */
enum { ORL_RAYS_MIDDLE = 1, ORL_RAYS_FOUR = 2, ORL_RAYS_CORNERS = 3 };
/* Marches every pixel; supersample: ORL_RAYS_*. Light is that of the middle of a pixel's hits in a brick. Rays are marched in floats (runtime/kernels/rays.h); bit-identical for any thread count and machine. */
orl_err orl_view_build(const orl_scene *s, const orl_camera *cam, const orl_pose *pose, int supersample, int threads, void *block, size_t bytes, orl_view *out);
/* The same of pixels that are wanted alone ([h][w], nonzero; NULL: all): the others hold sky. beside: other work, which one of the threads does while the others march; NULL: none. */
typedef struct { void (*fn)(void *user); void *user; } orl_beside;
orl_err orl_view_build_some(const orl_scene *s, const orl_camera *cam, const orl_pose *pose, int supersample, const uint8_t *wanted, const orl_beside *beside, int threads, void *block, size_t bytes, orl_view *out);

/* Baking: horizons and ceilings traced for the pixels themselves, after which no sun needs the scene. Between its horizon and its ceiling, the widest gap of an azimuth, a sun shines on a pixel.
 * ceiling: [16][stride h], the caller's, zeroed; v->ceiling when all rows are done. Bit-identical for any thread count. */
void orl_view_bake(orl_view *v, int y0, int y1, int threads, uint8_t *ceiling);
/* A view whose planes (all but fix), cam, pose, grid_from_cam, eye and phi_scale stand in *from, as they were baked: rests in block, the planes stay where they are. */
size_t orl_view_attach_need(int w, int h);
orl_err orl_view_attach(const orl_view *from, void *block, size_t bytes, orl_view *out);

/* Dequantised pixel for adaptation (rgb and weight left 0). */
void orl_view_sample(const orl_view *v, int x, int y, orl_sample *out);

/* Traces a light's sun for such samples of n pixels alone, spot[0], spot[step], .. (y w + x each): by one ray, which sets fix, or by a baked view's ceilings, which set the horizon. */
void orl_view_sample_sun(const orl_view *v, const orl_light *l, const int *spot, int step, orl_sample *s, int n);

/* Whether the sun of a light reaches the pixels of rows [y0, y1), by rays from ORL_SUN_LIFT cells over the surface: one from every other pixel of every other row, and from those that look at the sun while what
 * is known of their neighbours differs; a sun under the horizon is left to the horizons. Goes on counting as the
 * sun moves, so trace again where it moved by more than a degree or so. A baked view looks it up. Bit-identical for any thread count and cpu. */
void orl_view_trace_sun(orl_view *v, const orl_light *l, int y0, int y1, unsigned cpu, int threads);

/* Tables of one light in fixed point (formats in runtime/kernels/shade.h). */
typedef struct orl_view_light orl_view_light;
size_t orl_view_light_need(void);
orl_view_light *orl_view_light_make(const orl_view *v, const orl_light *l, void *block, size_t bytes);
/* Shades rows [y0, y1) into rgb8 (w * 3 bytes a row). cpu: orl_cpu_detect() or a subset. */
void orl_view_shade(const orl_view *v, const orl_view_light *l, unsigned cpu, int y0, int y1, uint8_t *rgb, size_t row_bytes);
/* The same of one row, w * 3 bytes at rgb, but for columns [x0, x1), which may be left as they are: what a photo covers. */
void orl_view_shade_row(const orl_view *v, const orl_view_light *l, unsigned cpu, int y, int x0, int x1, uint8_t *rgb);
#endif
