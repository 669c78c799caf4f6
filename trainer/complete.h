/* Walls that stereo cannot see: no texture, or too few photos look past what stands before them. What is measured around says which plane they lie in. */
#ifndef TRAINER_COMPLETE_H
#define TRAINER_COMPLETE_H
#include "trainer/grid.h"
#include "trainer/stereo.h"

#define COMPLETE_WEIGHT 0.3f    /* of such a point */

/* st's points and, where a photo's pixel has none and meets the hull far from any, the local plane's point on its ray, at weight COMPLETE_WEIGHT; in *out, to be freed by stereo_free. ORL_E_MEMORY. */
orl_err complete_planes(const world *w, const stereo *st, const grid *hull, int threads, stereo *out);
#endif
