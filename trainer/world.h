/* The training set in memory, in the grid frame: photos, cameras, sky masks, SfM observations. */
#ifndef TRAINER_WORLD_H
#define TRAINER_WORLD_H
#include <string.h>
#include "oriel/dataset.h"
#include "oriel/scene.h"
#include "trainer/blocks.h"

/* Similarity world -> grid: z up, one unit = one fine cell, the box is [0, dims]. */
typedef struct {
    double R[9];                    /* world -> scene axes (z up) */
    double scale, offset[3];        /* grid = scale * R * world + offset */
    int dims[3];                    /* fine cells, multiples of 16 */
    float ground[3];                /* z = ground[0] + ground[1] x + ground[2] y, fine cells: a guess until the hull is built */
} frame;

enum { WORLD_FIX = 8 };             /* correction of a pose and lens: turn, shift (camera axes; radians, fine cells), ln focal length, k1 */

typedef struct {
    char name[256];
    orl_camera cam;                 /* at training size */
    orl_pose pose;
    double centre[3];               /* grid frame */
    double axes[9];                 /* grid direction = axes * camera direction (row-major rotation) */
    orl_camera given_cam;           /* before correction, as are */
    double given_centre[3], given_axes[9], fix[WORLD_FIX];
    float near;                     /* half the median depth of its SfM points, fine cells: what is nearer than this teaches less */
    int w, h;
    int packed;                     /* 1: blocks and a label for 2 x 2 pixels; 0: plain bytes and a label each */
    uint8_t *rgb, *labels;          /* these are for world_rgb, world_label and their kin only */
    block *blocks;
    uint32_t obs_begin, obs_count;  /* into world.obs */
} world_photo;

enum { WORLD_SCENE, WORLD_UNKNOWN, WORLD_SKY, WORLD_BEYOND };   /* a pixel's label; BEYOND: scene, but not of what is in the box */

typedef struct { float u, v; uint32_t point; } world_obs;        /* pixel at training size */
typedef struct { float x[3]; float weight; } world_point;       /* grid frame; weight from track length and reprojection error */

typedef struct {
    char title[64];
    frame frame; int longest;       /* fine cells along the place's longest side; the box may be longer: photographers stand in it */
    world_photo *photos; int nphotos;
    world_obs *obs; uint32_t nobs;
    world_point *points; uint32_t npoints;
} world;

/* Plain pixels while they fit in here; larger collections are packed: a byte a pixel instead of three. */
#define WORLD_PLAIN_BYTES ((size_t)1 << 30)

/* Loads the training photos (never the test ones) at long_side and places the box with `longest` fine cells along its longest side. use_masks: take the sky label of given masks (never the transient one). */
orl_err world_load(const orl_dataset *d, int long_side, int longest, int use_masks, int threads, world *out);
/* One SfM point in 20, by a hash of its COLMAP id, trains nothing but the size of the box: `eval --geometry` measures the surface against it. */
int world_held_out(const orl_colmap_point *p);
/* Gives the photos' colours back; labels and cameras stay. No world_rgb after it. */
void world_forget(world *w);
void world_free(world *w);
void frame_apply(const frame *f, const double world[3], double grid[3]);
float frame_ground_height(const frame *f, const float x[3]);
/* Distance t > 0 along o + t d (unit) to the ground; 0: looks over the horizon. Seen from too low or from under it, the ground gives way (SCENE.md 4.8). */
int  frame_ground_hit(const frame *f, const float o[3], const float d[3], float *t);
/* cam, centre and axes from what was given and fix. */
void world_correct(world_photo *p);
/* Camera of a view in the grid frame: cam, w, h, centre and axes are set, all else is 0. */
void frame_view(const frame *f, const orl_camera *cam, const orl_pose *pose, world_photo *out);
/* Unit ray of pixel (u, v) in the grid frame. */
void world_ray(const world_photo *p, double u, double v, float dir[3]);
/* Projects a grid point; 0 if behind. depth (may be NULL) in fine cells along the optical axis. */
int  world_project(const world_photo *p, const float x[3], double uv[2], double *depth);
/* The same; 0 outside the picture, too. */
int  world_sees(const world_photo *p, const float x[3], double uv[2], double *depth);
/* Pixel (x, y), sRGB. */
static inline void world_rgb(const world_photo *p, int x, int y, uint8_t rgb[3])
{
    if (p->packed) blocks_rgb(p->blocks, p->w, x, y, rgb);
    else memcpy(rgb, p->rgb + 3 * ((size_t)y * (size_t)p->w + (size_t)x), 3);
}
/* Its label, four of them a byte. */
static inline size_t world_label_at(const world_photo *p, int x, int y) { return (size_t)(y >> p->packed) * (size_t)((p->w + p->packed) >> p->packed) + (size_t)(x >> p->packed); }
static inline int world_label(const world_photo *p, int x, int y)
{
    size_t i = world_label_at(p, x, y);
    return p->labels[i / 4] >> 2 * (i % 4) & 3;
}
static inline void world_set_label(world_photo *p, int x, int y, int label)    /* one thread a photo; packed: of all 2 x 2 pixels */
{
    size_t i = world_label_at(p, x, y);
    p->labels[i / 4] = (uint8_t)((p->labels[i / 4] & ~(3 << 2 * (i % 4))) | label << 2 * (i % 4));
}
static inline size_t world_label_bytes(const world_photo *p) { return (world_label_at(p, p->w - 1, p->h - 1) + 4) / 4; }
/* Gives a photo its size, pixels (w * h * 3) and labels from a sky mask (w * h: 255 surely sky .. 0 surely scene; NULL: all scene); both are copied. Where 2 x 2 pixels share a label
 * and differ, it is unknown. ORL_E_MEMORY. */
orl_err world_photo_fill(world_photo *p, int w, int h, const uint8_t *rgb, const uint8_t *sky, int packed);
int  box_clip(const int dims[3], const float o[3], const float d[3], float *t0, float *t1);

/* A choice of at most `most` photos of together at most `pixels` pixels for what cannot ask all of a large collection: 1 for each chosen one, greedily by the SfM points that few chosen ones see yet,
 * so that three or more see what can be seen. All of them if they fit. malloc'd; NULL: no memory. */
uint8_t *world_cover(const world *w, int most, size_t pixels);
/* Pixels between two rays, along rows and columns, for what casts rays through all photos: 2, and more where that would make over 16 M rays. */
int world_ray_step(const world *w);

struct stereo;
/* Finds the ground (frame.ground). First SDF from SfM points, stereo points (NULL: none) and sky masks (space carving): values in fine cells at lattice `cell`, z-major order x fastest, (dims / cell + 1) per axis; malloc'd. */
orl_err hull_build(world *w, const struct stereo *st, int cell, int threads, float **sdf);
/* Pixels labelled sky with stereo points of three or more other photos all around become unknown where a photo has many: stone in the sun taken for sky. ORL_E_MEMORY. */
orl_err hull_unsky(world *w, const struct stereo *st, int threads);
/* Pixels labelled scene whose rays miss the hull (a background outside the box, clouds taken for stone) are labelled beyond: nothing is asked of the surface there. */
void hull_relabel(world *w, const float *sdf, int cell, int threads);
#endif
