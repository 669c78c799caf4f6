/* Lays the photo into the wide render. Both share one centre, so the photo is carried over exactly by projecting wide pixels into its camera; its border is feathered, and the
 * slow part of the difference photo - render, seen along the border, is spread outwards over the render, for sky and surface apart, fading with distance. All per-frame work is integer. */
#ifndef ORIEL_BLEND_H
#define ORIEL_BLEND_H
#include <stddef.h>
#include <stdint.h>
#include "oriel/camera.h"

typedef struct orl_blend orl_blend;
size_t orl_blend_need(int w, int h);            /* bytes for a wide view of w x h, 64-byte aligned block */
/* mask: photo-size, nonzero = person, kept out of the seam's colours, or NULL; not kept. ORL_E_RANGE if the two centres differ, ORL_E_MEMORY if the block is too small. */
orl_err orl_blend_init(const orl_camera *photo, const orl_pose *photo_pose, const orl_camera *wide, const orl_pose *wide_pose,
                       const uint8_t *mask, int threads, void *block, size_t bytes, orl_blend **out);
/* Wanted before the first picture. cov: coverage of the wide view (orl_view), 0 sky .. 255 surface, rows cov_stride apart; not kept. What the photo covers is not looked at. */
void orl_blend_layers(orl_blend *b, const uint8_t *cov, size_t cov_stride);
/* Columns [x0, x1) of a row of the wide view whose render the blend never reads: the photo's inside. */
void orl_blend_covered(const orl_blend *b, int y, int *x0, int *x1);
/* photo: its camera's size, tight RGB. wide: the render, tight RGB, overwritten by the blend. cpu: orl_cpu_detect() or a subset. Same bytes for any thread count and cpu. */
void orl_blend_apply(orl_blend *b, const uint8_t *photo, uint8_t *wide, unsigned cpu, int threads);
#endif
