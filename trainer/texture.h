/* Base colour in textures, after stage 2's rounds, and what stage 2 lends to it. */
#ifndef TRAINER_TEXTURE_H
#define TRAINER_TEXTURE_H
#include "trainer/stage2.h"

/* After the last round: s->skin, from all pixels. The grids are trained no more. ORL_E_MEMORY, ORL_E_RANGE. */
orl_err stage2_texture(stage2 *s);

/* ---- in stage2.c ---- */

/* Photos visited so far: the first of the order. */
int stage2_visited(const stage2 *s);
/* Does the sun of a code reach photo k's pixels, up to `end`? Kept as what the horizons miss. light: the code's, decoded on the way. */
void stage2_trace_sun(stage2 *s, int k, uint32_t end, const float code[ORL_CODE], orl_light *light);
/* The pixel as a sample, base colour by the grids. */
void stage2_sample(const stage2 *s, const stage2_pixel *q, orl_sample *out);
/* Gradient of the robust loss by the shaded colour, and the squared error before it is made robust. */
float stage2_residual(const orl_light *light, const stage2_pixel *q, const orl_sample *o, float d[3]);
/* Weight of a squared error. */
float stage2_robust(float err2);
/* How much a pixel says of its base colour, 0..1: little on the floor, nothing where few photos see it. */
float stage2_says(const stage2 *s, const stage2_pixel *q);
#endif
