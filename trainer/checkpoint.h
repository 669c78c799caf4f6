/* Checkpoints: everything a run needs to go on, and the float model for evaluation.
 * One file, native byte order: header, then by phase
 *   phase 1 (stage 1 under way)   stage 1 with moments
 *   phase 2 (stage 2 under way)   surface, stage 2 with moments, stage 1 without
 *   phase 3 (done)                surface, stage 2 without moments, stage 1 without */
#ifndef TRAINER_CHECKPOINT_H
#define TRAINER_CHECKPOINT_H
#include "trainer/stage1.h"
#include "trainer/stage2.h"
#include "trainer/surface.h"

typedef struct {
    char magic[8];                  /* "ORLCKPT1" */
    int phase;
    int long_side, longest, rays, steps, pixels, rounds, threads, nphotos;
    uint64_t seed;
    double seconds, cpu_seconds, samples;   /* spent so far */
} checkpoint_header;

orl_err checkpoint_save(const char *path, const checkpoint_header *h, const stage1 *s1, const surface *surf, const stage2 *s2);
orl_err checkpoint_peek(const char *path, checkpoint_header *h, FILE **f);
orl_err stage1_save(const stage1 *s, FILE *f, int moments);
orl_err stage1_load(stage1 *s, FILE *f, int moments, const char *path);

/* Quantises the model into a scene and writes it. */
orl_err export_scene(const char *path, const surface *surf, const stage2 *s2, const char *title, size_t *bytes);
#endif
