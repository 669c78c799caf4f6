/* What stands in single training photos and not in the scene: people, cars, birds. */
#ifndef TRAINER_TRANSIENT_H
#define TRAINER_TRANSIENT_H
#include "trainer/stage2.h"

enum { TRANSIENT_HALF = 2 };        /* masks and evidence are at the training size over this, rounded down */

/* Masks of all training photos, 255 = transient, out[k] of (w / 2) x (h / 2) pixels, malloc'd one by one; out[nphotos] is the caller's and NULL throughout after a failure.
 * Repeatable, whatever the thread count. Sky is never taken for a transient. */
orl_err transient_masks(const world *w, const stage2 *s2, int threads, uint8_t **out);
#endif
