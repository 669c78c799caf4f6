/* Casters (oriel/caster.h) out of the photos' suns: from each pixel the way to the sun is open or not, as the model can tell by the pixel's colour. */
#ifndef TRAINER_CASTERS_H
#define TRAINER_CASTERS_H
#include "trainer/stage2.h"

/* The way from a surface point to a photo's sun (d unit, d_z > 0), past the surface. open: how surely nothing hides the sun (> 0) or something does (< 0), as a share of the photo: 1 is all its pixels, sure. */
typedef struct { double o[3], d[3]; float open; int photo; } caster_ray;
/* What a camera looks through, o to o + far d, d_z >= 0. */
typedef struct { double o[3], d[3], far; } caster_sight;

enum { CASTER_PHOTOS = 256 };           /* the most that are asked */

/* Boxes that hide the sun where it is hidden and not where it is seen, that no sight crosses and that more than one photo asks for; none where photos do not agree on any. ground: z it stands on; size: of the
 * place, cells. Repeatable, whatever the thread count. ORL_E_MEMORY. */
orl_err casters_fit(const caster_ray *ray, int nrays, const caster_sight *sight, int nsights, float ground, float size, uint64_t seed, int threads, orl_casters *out);
/* The same from stage 2's pixels under its codes of now; the casters that its surface has do not count. Found anew whatever was known before. */
orl_err casters_find(const stage2 *s, orl_casters *out);
#endif
