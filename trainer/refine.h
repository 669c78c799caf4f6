/* Small corrections of the training photos' poses and lenses, held near COLMAP's. */
#ifndef TRAINER_REFINE_H
#define TRAINER_REFINE_H
#include "trainer/stage1.h"

/* Over all sightings of SfM points: rms distance in pixels (of training size, 8 at most) before and after. Corrections so far, rms over photos: degrees, fine cells, share of the focal length. */
typedef struct { double before, after, degrees, cells, focal; } refine_figures;

/* Each photo by itself: damped Gauss-Newton over turn, shift, focal length and k1, on its sightings of SfM points (which hold it where COLMAP put it, as firmly as their own scatter warrants) and,
 * where s is not NULL, on its pixels against stage 1's static colours, transients and saturated pixels left out. The SfM points stay and so fix the gauge: photos cannot drift together.
 * Repeatable for a seed and round, whatever the thread count. */
void refine_photos(world *w, const stage1 *s, uint64_t seed, int round, int threads, refine_figures *out);
orl_err refine_save(const world *w, FILE *f);
orl_err refine_load(world *w, FILE *f, const char *path);
#endif
