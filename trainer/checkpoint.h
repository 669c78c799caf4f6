/* Checkpoints: everything a run needs to go on, and the float model for evaluation.
 * One file, native byte order: header, then by phase
 *   phase 0 (stereo under way)    depth maps
 *   phase 1 (stage 1 under way)   stereo points, stage 1 with moments
 *   phase 2 (stage 2 under way)   surface, stage 2 with moments, sky labels, stage 1 without
 *   phase 3 (done)                surface, stage 2 without moments, sky labels, stage 1 without
 * and from phase 1 on the corrections of poses and lenses. */
#ifndef TRAINER_CHECKPOINT_H
#define TRAINER_CHECKPOINT_H
#include "trainer/stage1.h"
#include "trainer/stage2.h"
#include "trainer/surface.h"

typedef struct {
    char magic[8];                  /* "ORLCKPT3" */
    int phase;
    int long_side, longest, rays, steps, pixels, rounds, threads, nphotos;
    uint32_t place;                 /* checkpoint_place of the photos it was made from; 0: not recorded */
    uint64_t seed;
    double seconds, cpu_seconds, samples;   /* spent so far */
    int dropped;                    /* steps without finite gradients */
    uint32_t crc;                   /* of the whole file, this field 0 */
} checkpoint_header;

/* What there is of a run; what its phase does not need may be NULL. */
typedef struct { const world *w; const stereo_work *maps; const stereo *st; const stage1 *s1; const surface *surf; const stage2 *s2; } checkpoint_parts;
orl_err checkpoint_save(const char *path, const checkpoint_header *h, const checkpoint_parts *p);
orl_err checkpoint_load_sky(world *w, FILE *f, const char *path);
/* Checksum of the photos' names, sizes and cameras in the grid frame: tells one place's checkpoint from another's. Never 0. */
uint32_t checkpoint_place(const world *w);
/* Checks header and checksum; what follows the header is read from f, which the caller closes. */
orl_err checkpoint_peek(const char *path, checkpoint_header *h, FILE **f);
orl_err stage1_save(const stage1 *s, FILE *f, int moments);
orl_err stage1_load(stage1 *s, FILE *f, int moments, const char *path);

/* Quantises the model into a scene and writes it. */
orl_err export_scene(const char *path, const surface *surf, const stage2 *s2, const char *title, size_t *bytes);
#endif
