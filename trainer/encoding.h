/* Position encodings for the MLPs: trainable features on nested lattices, 32 floats a position, one interface for two layouts.
 *
 * ENC_OURS      4 levels x 8 floats: one vector load a corner; simplex interpolation (4 corners of the tetrahedron that holds the point, not 8 of the cube). Vertices lie in tiles of 4^3
 *               that are contiguous in memory; a level whose tiles do not fit the table hashes the tile, never the vertex, so the corners of a cell stay beside each other.
 * ENC_TEXTBOOK  16 levels x 2 floats, at most 2^19 entries a level, dense where the level fits, else hashed by vertex; trilinear, 8 corners (Mueller et al. 2022).
 * Both have at most 2^24 parameters and end at the fine cell of the box.
 *
 * Parameters are kept in units of one 8-float vector (ours: a vertex; textbook: 4 entries). A bit a unit says what a batch touched: the optimiser visits nothing else.
 * Gradients are per thread and summed in thread order: a run repeats for a given thread count. */
#ifndef TRAINER_ENCODING_H
#define TRAINER_ENCODING_H
#include "trainer/grid.h"

typedef enum { ENC_OURS, ENC_TEXTBOOK, ENC_KINDS } enc_kind;
enum { ENC_WIDTH = 32, ENC_LEVELS = 16 };
extern const char *const ENC_NAME[ENC_KINDS];

typedef struct {
    int n[3];                       /* vertices per axis */
    float scale, top[3];            /* vertices a fine cell; largest lattice coordinate */
    uint32_t *axis[3];              /* share of each axis in a vertex's address: added where dense, exclusive-or'd and masked where hashed */
    uint32_t mask;                  /* 0: dense */
    size_t first;                   /* units before this level */
} enc_level;

typedef struct {
    enc_kind kind;
    int levels, threads;
    enc_level level[ENC_LEVELS];
    size_t units, keep;             /* keep: bytes a position hands from forward to backward */
    v8 *p;                          /* [units] */
    v8 (*mv)[2];                    /* Adam moments side by side */
    v8 *g[GRID_THREADS];
    uint64_t *dirty[GRID_THREADS];  /* a bit a unit */
} encoding;

/* dims in fine cells; threads = 0: not trained. */
orl_err enc_init(encoding *e, enc_kind kind, const int dims[3], uint64_t seed, int threads);
void enc_free(encoding *e);
/* x: n positions in fine cells, clamped into the box (NaN: a corner of it); out: n x ENC_WIDTH; keep: n * e->keep bytes of the caller's, for enc_backward. All 64-byte aligned. */
void enc_forward(const encoding *e, int n, const float (*x)[3], float *out, void *keep);
/* dout: n x ENC_WIDTH. */
void enc_backward(encoding *e, int thread, int n, const void *keep, const float *dout);
/* Adam (beta 0.9, 0.99) on what was touched, gradients cleared. A parameter whose gradient is exactly 0 keeps its moments. No bias correction: both moments start at 0, and the first
 * step is lr by construction, as in grid_adam. Returns the units visited. */
size_t enc_adam(encoding *e, float lr, int threads);
#endif
