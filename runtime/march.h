/* Rays against the scene's bricks, many at a time (march.c). */
#ifndef RUNTIME_MARCH_H
#define RUNTIME_MARCH_H
#include "runtime/kernels/rays.h"

typedef struct { orl_rays rays; double start[ORL_RAYS]; int n; } orl_march;     /* start: way from a ray's origin to where it is marched from */

typedef struct {
    int64_t t;                          /* along the unit ray from its origin, cells Q16 */
    int32_t at[3], brick;               /* cells Q12 in the grid, and the brick there */
    int cut;                            /* not a surface but the solid's section, met on coming out of empty bricks: a brick that nobody saw is missing */
    int32_t grad[3];                    /* of the SDF over +-2 cells, Q16; points into free space */
    uint32_t albedo[3];                 /* linear Q16, at most 65535 */
} orl_hit;

/* Adds a ray to m->n of them, ORL_RAYS at most. origin and unit dir in the grid frame; up to `from` cells along it no surface stands. Not finite: it hits nothing. */
void orl_march_begin(const orl_scene *s, const double origin[3], const double dir[3], double from, orl_march *m);
/* Marches them all. refine 0: where only hit or not is asked for. Ray k hit something if rays.t[k] >= 0. */
void orl_march_run(const orl_scene *s, int refine, orl_march *m);
/* 0: ray k hit nothing, out untouched. grad and albedo are left. */
int orl_march_hit(const orl_scene *s, const orl_march *m, int k, orl_hit *out);
/* How far rays from o whose unit directions lie within `spread` (a chord) of d run until the first may come upon a brick: below 1e12, or 1e12: none ever does. d: unit or 0. */
double orl_march_freely(const orl_scene *s, const double o[3], const double d[3], double spread);
/* grad and albedo of a hit. */
void orl_march_surface(const orl_scene *s, orl_hit *h);
/* What light needs to know of a place (cells Q12) in a brick: the file's bytes, Q8. brick -1: under the open sky. */
void orl_march_light(const orl_scene *s, int32_t brick, const int32_t at[3], uint16_t lite[ORL_LITE_BYTES], int16_t phi[ORL_SHADOW_DIM]);
#endif
