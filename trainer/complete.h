/* Walls that stereo cannot see: no texture, or too few photos look past what stands before them. What is measured around says which plane they lie in. */
#ifndef TRAINER_COMPLETE_H
#define TRAINER_COMPLETE_H
#include "trainer/grid.h"
#include "trainer/stereo.h"

#define COMPLETE_WEIGHT 0.3f    /* of such a point */

/* Adds to st, where a photo's pixel has no point and meets the hull far from any, the local plane's point on its ray, at weight COMPLETE_WEIGHT. Points that st has keep their order. ORL_E_MEMORY: st is as it was. */
orl_err complete_planes(const world *w, stereo *st, const grid *hull, int threads);
#endif
