/* Finds the backdrop (oriel/backdrop.h): how far away its walls best stand, and how opaque they are. */
#ifndef TRAINER_BACKDROP_H
#define TRAINER_BACKDROP_H
#include "trainer/stage1.h"
#include "trainer/surface.h"

/* Fills s->back and s->opacity from what the photos show beyond the surface: pixels labelled scene or sky whose rays meet neither surface nor nearer ground; s1 (may be NULL) tells passers-by. Each photo's pixels are
 * foretold by the other photos, for walls at several distances, and the best are taken; none where they foretell little. Repeats for any number of threads. */
orl_err backdrop_find(surface *s, const world *w, const stage1 *s1, int threads);
#endif
