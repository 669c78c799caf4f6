/* Many rays against the scene's bricks at once. Arithmetic is that of IEEE floats, + - * / alone, in one order: every machine finds the same surface, and so does every variant.
 *
 * Positions are cells in the grid, p = o + t d taken into [0, 8 nb); t runs from where the ray was begun. Empty space is left in one step by the brick map's Chebyshev distance: no brick within
 * m - 1 bricks. Inside bricks the trilinear SDF f is sampled.
 *
 * Steps. 7/8 of f, ORL_RAY_LEAST to ORL_RAY_MOST. From the second sample of a stretch on the slope is known: where f goes on as it did, the next sphere touches this one's at 2 f / (1 - slope), and 7/8 of
 * that is gone, ORL_RAY_FAR at most (Ban and Valasek's auto-relaxed sphere tracing, Eurographics 2023); if the spheres then do not touch, back to 7/8 of f. And where f falls to 0 within
 * ORL_RAY_LEAP, 9/8 of the way there is gone at once: of what bends, the lattice holds nothing so fine.
 *
 * What counts as a hit: the first sample that is not positive after free space, then up to four steps of regula falsi until |f| < ORL_RAY_FINE. Space without bricks is free: a ray that leaves it straight
 * into the solid (a wall's back at the box border, the cut side of bricks that nobody saw) hits there. A ray with `within` that begins in the solid sees through it until the first free sample. */
#ifndef RUNTIME_KERNELS_RAYS_H
#define RUNTIME_KERNELS_RAYS_H
#include "oriel/scene.h"

enum { ORL_RAYS = 256, ORL_RAY_STEP = 16, ORL_RAY_STEPS = 4096, ORL_RAY_REFINES = 4 };     /* most rays at a time; their number is padded to STEP; samples and boxes of a ray at most */
#define ORL_RAY_LEAST 0.25f
#define ORL_RAY_MOST  3.5f
#define ORL_RAY_FAR   7.0f
#define ORL_RAY_LEAP  0.5f
#define ORL_RAY_FINE  (1 / 256.0f)
#define ORL_RAY_NUDGE (1 / 64.0f)       /* past a box's face */
#define ORL_RAY_CUT   (-1 / 32.0f)      /* a ray that comes out of empty bricks and finds itself deeper than this met a section, no surface */
#define ORL_RAY_FREE  8.0f              /* f without a brick */
#define ORL_RAY_FLAT  (1 / 1024.0f)     /* least f of a free sample in what is interpolated */

typedef struct {
    float o[3][ORL_RAYS], d[3][ORL_RAYS];       /* begin, within the box; unit direction, entries not nearer to 0 than 2^-20 */
    float end[ORL_RAYS];                        /* length of the way; 0: no ray, whatever o and d */
    int32_t within[ORL_RAYS];                   /* -1: what it begins in does not count; 0: it does */
    float t[ORL_RAYS];                          /* out: way to the hit, -1 if none */
    int32_t brick[ORL_RAYS];                    /* out: there */
    int32_t cut[ORL_RAYS];                      /* out: -1: a section, 0: a surface */
} orl_rays;

/* n: a multiple of ORL_RAY_STEP. refine 0: t is the sample's. Scenes of one brick at least. By the best variant that the flags allow. */
void orl_rays_march(const orl_scene *s, int n, int refine, unsigned cpu, orl_rays *r);
/* Instruction sets; but for _ref, ORL_RAY_BRICKS bricks at most. */
enum { ORL_RAY_BRICKS = 2000000 };
void orl_rays_march_ref(const orl_scene *s, int n, int refine, orl_rays *r);
void orl_rays_march_avx2(const orl_scene *s, int n, int refine, orl_rays *r);
void orl_rays_march_avx512(const orl_scene *s, int n, int refine, orl_rays *r);
void orl_rays_march_neon(const orl_scene *s, int n, int refine, orl_rays *r);
#endif
