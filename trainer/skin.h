/* Base colour on the surface as the scene file has it (oriel/skin.h), in floats, and how it is found: each photo's pixel, its light and tone taken away, is a sample of it. */
#ifndef TRAINER_SKIN_H
#define TRAINER_SKIN_H
#include "oriel/skin.h"
#include "trainer/surface.h"

typedef struct {
    uint32_t n;                     /* textures */
    uint32_t *index;                /* [nbricks], as orl_scene.skin */
    float (*texel)[3];              /* [n][ORL_SKIN_TEXELS], linear */
} skin;

/* One pixel's say, packed. */
typedef struct {
    uint16_t at[3], rgb[3], slope[3];       /* place in its brick, Q12 cells; base colour by this pixel, Q15; what a unit of it adds to a displayed colour, Q11 */
    int8_t grad[3];                         /* direction of the SDF's gradient, 1/127 */
    uint8_t weight;                         /* 1/255; 0: says nothing */
} skin_sample;

/* Which textures the surface needs; all texels 0. */
orl_err skin_init(skin *s, const surface *surf, int threads);
void skin_free(skin *s);
/* Colour at x in brick `brick` at place b, where the SDF has this gradient. */
void skin_colour(const skin *s, uint32_t brick, const int b[3], const float x[3], const float grad[3], float rgb[3]);
/* A sample at x in the brick at place b; what is out of range or no number says nothing. */
void skin_say(skin_sample *out, const int b[3], const float x[3], const float grad[3], const float rgb[3], const float slope[3], float weight);
/* Texels from samples (those of brick i are [begin[i], begin[i + 1])), drawn to what colour() says of a texel's place on the surface, grid frame, where samples are few. The same for any number of threads. */
typedef void skin_coarse(const void *user, const float x[3], float rgb[3]);
orl_err skin_fit(skin *s, const surface *surf, const skin_sample *sample, const uint32_t *begin, skin_coarse *colour, const void *user, int threads);
orl_err skin_save(const skin *s, uint32_t nbricks, FILE *f);
orl_err skin_load(skin *s, uint32_t nbricks, FILE *f, const char *path);
#endif
