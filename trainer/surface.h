/* The surface after stage 1: one float SDF in bricks of 8^3 cells (the same bricks that the scene file stores), with what light needs to know of its shape. */
#ifndef TRAINER_SURFACE_H
#define TRAINER_SURFACE_H
#include "oriel/backdrop.h"
#include "oriel/scene.h"
#include "trainer/grid.h"
#include "trainer/stage1.h"

typedef struct {
    frame f;
    int nb[3];
    uint32_t nbricks;
    int32_t *bmap;                  /* as orl_scene.bmap */
    float *sdf;                     /* [nbricks][729], fine cells */
    orl_facings facings;            /* towards which normals are turned */
    orl_backdrop back;              /* what stands beyond the box (backdrop_find) */
    uint8_t *opacity;               /* [ROWS][COLS] of the backdrop, 0..255; NULL: there is none */
    grid lite;                      /* cell 4, 24 floats: openness, 16 horizon elevations (radians), unused */
} surface;

typedef struct { float x[3], n[3], grad[3], t; int cut; } surface_hit;      /* grad: the SDF's, n before it is turned and made unit. cut: not a surface but the solid's section, where a brick that nobody saw is missing */

/* Collapses stage 1's levels into bricks around the zero set. */
orl_err surface_build(const stage1 *s, surface *out);
/* Takes away what the photos' sky shines through. Bricks may be left without surface; surface_prune drops them. */
orl_err surface_carve(surface *s, const world *w, int threads);
/* Drops bricks that no training ray of a pixel labelled scene hits, but for those that no ray hits and that lie beside one that is hit. What only unlabelled pixels show (sky between twigs, clouds) is most often no
 * surface. */
orl_err surface_prune(surface *s, const world *w, int threads);
/* Openness and horizons on the light vertices of every brick, traced on the surface itself. */
orl_err surface_light(surface *s, int threads);
/* As if nothing hid sky or sun: openness 1, horizons 0. */
void surface_uncover(surface *s);
void surface_free(surface *s);
/* First crossing from free space into the solid along o + t d (grid frame), 0 if none. */
int surface_march(const surface *s, const float o[3], const float d[3], surface_hit *hit);
/* SDF at x; 8 where no brick is. */
float surface_value(const surface *s, const float x[3]);
/* Central difference of the SDF over +-2 cells at x in, or on the border of, the brick at b. */
void surface_gradient(const surface *s, const float x[3], const int b[3], float grad[3]);
/* Place of the brick that holds x, and its index; < 0: there is none. */
int32_t surface_brick(const surface *s, const float x[3], int b[3]);
/* Does the sun in direction d reach x, with normal n, on the surface? 0 or 1. */
int surface_sunlit(const surface *s, const float x[3], const float n[3], const float d[3]);
/* What a pixel shows: the surface, or the ground (hit->x may lie outside the box) where the ray meets no surface or a low cut, or the backdrop before that ground where it is at least so opaque (0..255).
 * Higher cuts are passed through (SCENE.md 4.8). */
enum { MET_NOTHING, MET_SURFACE, MET_GROUND, MET_BACKDROP };
#define SURFACE_NO_BACKDROP 1e9f
int surface_meet(const surface *s, const float o[3], const float d[3], float opaque, surface_hit *hit);
/* Place of x on the backdrop, in texels. */
void surface_backdrop_place(const surface *s, const float x[3], double uv[2]);
orl_err surface_save(const surface *s, FILE *f);
orl_err surface_load(surface *s, FILE *f, const char *path);
#endif
