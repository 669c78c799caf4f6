/* The float model volume-rendered: what every picture of the runtime is measured against. */
#ifndef TRAINER_EXACT_H
#define TRAINER_EXACT_H
#include "trainer/stage2.h"

/* One ray (grid frame, d unit): C = sum_k T_k alpha_k c_k + the rest times what lies behind, alpha_k = max((S(f_k) - S(f_k+1)) / S(f_k), 0), S the logistic CDF of the SDF f over sigma, T_k = prod_{j<k} (1 - alpha_j), samples
 * sigma / 2 apart where S is neither 0 nor 1. Each sample c_k has its own base colour, normal, shadow, horizons and ray to the sun, and is shaded on its own. What is behind is where surface_meet ends: the surface
 * itself (all that is left 7 sigma behind the crossing counts as the crossing's), ground, backdrop where it is at least so opaque (0..255), or sky. sigma: fine cells, above 0; ORL_MODEL_SIGMA is the model as it was trained, much less its surface. Display-referred, not clamped. */
void exact_ray(const stage2 *s, const orl_light *l, const float o[3], const float d[3], float opaque, float sigma, float rgb[3]);
#endif
