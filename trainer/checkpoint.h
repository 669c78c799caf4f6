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

/* How a run went: means around a step, time and CPU time spent until then. */
enum { LOG_ROWS = 512 };
typedef struct { float stage, step, minutes, cpu_minutes, psnr, sky, eikonal, points, transient, codes_rms; } log_row;

typedef struct {
    char magic[8];                  /* "ORLCKPTB" */
    int phase;
    int long_side, longest, rays, steps, pixels, rounds, threads, nphotos;
    uint32_t place;                 /* checkpoint_place of the photos it was made from; 0: not recorded */
    uint64_t seed;
    double seconds, cpu_seconds, samples;   /* spent so far */
    int dropped;                    /* steps without finite gradients */
    uint32_t crc;                   /* of the whole file, this field 0 */
    int32_t logged;
    uint32_t without;               /* stage2_options.without */
    log_row log[LOG_ROWS];          /* the first `logged` */
} checkpoint_header;

/* What there is of a run; what its phase does not need may be NULL. */
typedef struct { const world *w; const stereo_work *maps; const stereo *st; const stage1 *s1; const surface *surf; const stage2 *s2; } checkpoint_parts;
/* Adds a row; every second one goes when the log is full. */
void checkpoint_note(checkpoint_header *h, const log_row *row);
orl_err checkpoint_save(const char *path, const checkpoint_header *h, const checkpoint_parts *p);
orl_err checkpoint_load_sky(world *w, FILE *f, const char *path);
/* Checksum of the photos' names, sizes and cameras in the grid frame: tells one place's checkpoint from another's. Never 0. */
uint32_t checkpoint_place(const world *w);
/* Checks header and checksum; what follows the header is read from f, which the caller closes. */
orl_err checkpoint_peek(const char *path, checkpoint_header *h, FILE **f);
/* A finished run put together again with the photos it was made from, for what is measured on them. */
typedef struct { checkpoint_header head; world w; surface surf; stage2 s2; } finished_run;
orl_err finished_open(const char *path, const orl_dataset *d, int threads, finished_run *out);
void finished_close(finished_run *r);
orl_err stage1_save(const stage1 *s, FILE *f, int moments);
orl_err stage1_load(stage1 *s, FILE *f, int moments, const char *path);

/* Quantises the model into a scene and writes it. */
orl_err export_scene(const char *path, const surface *surf, const stage2 *s2, const char *title, size_t *bytes);
#endif
