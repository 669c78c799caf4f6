/* Stage 2: geometry frozen; base colour, shadow features, sky generator, ground and every photo's codes. */
#ifndef TRAINER_STAGE2_H
#define TRAINER_STAGE2_H
#include "oriel/adapt.h"
#include "trainer/skin.h"
#include "trainer/surface.h"

enum { ALBEDO_LEVELS = 3, GROUND_LEVELS = 3, BACKDROP_LEVELS = 3, STAGE2_VISITS = 64 };

/* A pixel of a training photo, reduced to what light needs. */
typedef struct {
    float x[3], n[3];               /* surface point and normal; sky: x = direction */
    uint8_t open, horizon[ORL_HORIZON];
    int8_t fix;                     /* of orl_sample, in 1/127, for the sun traced last */
    uint8_t rgb[3];                 /* target */
    uint8_t weight, surface;        /* weight / 255; MET_NOTHING: sky */
    uint8_t few;                    /* ground that few photos see: how many; else 0 */
} stage2_pixel;

/* Components that can be left out, to see what each is worth: bits of stage2_options.without. VISIBILITY is the surface's (surface_uncover). */
enum { WITHOUT_TONE = 1, WITHOUT_SHADOW = 2, WITHOUT_VISIBILITY = 4, WITHOUT_GROUND = 8, WITHOUT_DISTILL = 16, WITHOUT_SKY_PRIOR = 32, WITHOUTS = 6 };
extern const char *const WITHOUT_NAME[WITHOUTS];        /* of each bit in turn */
#define LIGHT_PAPER (WITHOUT_VISIBILITY | WITHOUT_GROUND)       /* the paper's single product a s E(n) */

/* pixels per photo (fewer where many photos would make too many in all); steps per round */
typedef struct { int pixels, rounds, steps; uint64_t seed; int threads; unsigned without; } stage2_options;
typedef struct { double mse, shadow, adapt_rms; int degenerate, dropped; } stage2_losses;        /* dropped: steps whose loss or gradient was no number; they moved nothing */

typedef struct {
    const world *w;
    const surface *surf;
    stage2_options opt;
    int round;
    orl_light_model light;
    grid albedo[ALBEDO_LEVELS];     /* cells of 1, 4, 16; RGB linear, summed */
    grid shadow;                    /* cell 4: 8 features */
    skin skin;                      /* base colour once the rounds are over; nothing before */
    float (*codes)[ORL_CODE];       /* per training photo */
    float common[3];                /* median base colour of ground that many photos see */
    grid ground[GROUND_LEVELS];     /* over the plan of the box and as much again on each side, cells of 8, 32, 128: what the ground beyond the surface has besides the common colour */
    grid backdrop[BACKDROP_LEVELS]; /* over its texels, cells of 1, 4, 16 */
    int *order;                     /* in which rounds visit the photos */
    int detail;                     /* pixels of a photo that are kept for textures, at most; rounds take the first opt.pixels of them */
    uint32_t *begin;                /* pixels of photo k: [begin[k], begin[k + 1]) */
    stage2_pixel *px;
    float *adam;                    /* moments of sky generator and ground */
} stage2;

/* s1 may be NULL (evaluation: only grids are set up, no pixels). */
orl_err stage2_init(stage2 *s, const world *w, const surface *surf, const stage1 *s1, const orl_light_model *light, const stage2_options *opt);
void stage2_free(stage2 *s);
/* One round: adapt photos' codes (Gauss-Newton, as at run time), then gradient steps on what they share. A round visits every photo of a small collection, and STAGE2_VISITS of a large one in turn. */
void stage2_round(stage2 *s, stage2_losses *out);
/* Gaussian prior from the training codes, shrunk towards the decoder's. */
void stage2_prior(stage2 *s);
/* Fills albedo, normal, phi, open, horizon of a surface sample. */
void stage2_surface_sample(const stage2 *s, const surface_hit *h, orl_sample *out);
/* The same for the ground beyond the surface: open, no horizon, no shadow features. */
void stage2_ground_sample(const stage2 *s, const float x[3], orl_sample *out);
/* And for the backdrop. */
void stage2_backdrop_sample(const stage2 *s, const float x[3], const float n[3], orl_sample *out);
/* Whether the sun of a light is traced on the surface: it stands over the horizon, and visibility is not left out. */
int stage2_traces(const stage2 *s, const orl_light *l);
/* fix of a sample (whose own is 0) at x with normal n, by a ray to the sun; 0 where none is traced. */
float stage2_fix(const stage2 *s, const orl_light *l, const float x[3], const float n[3], const orl_sample *o);
/* Base colour of a texel of the backdrop. */
void stage2_backdrop_texel(const stage2 *s, int texel, float rgb[3]);
/* Base colour by the grids. */
void stage2_albedo(const stage2 *s, const float x[3], float rgb[3]);
orl_err stage2_save(const stage2 *s, FILE *f, int moments);
orl_err stage2_load(stage2 *s, FILE *f, int moments, const char *path);
#endif
