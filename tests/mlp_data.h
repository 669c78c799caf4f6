/* Networks and inputs anywhere in the ranges that runtime/kernels/mlp.h allows: random, extreme, and scaled as a trained one would be. */
#ifndef TESTS_MLP_DATA_H
#define TESTS_MLP_DATA_H
#include <math.h>
#include "runtime/kernels/mlp.h"
#include "runtime/kernels/shade.h"      /* the list of variants */

enum { MLP_ROWS = 128 };
typedef enum { MLP_SENSIBLE, MLP_RANDOM, MLP_HIGH, MLP_LOW, MLP_BOTH, MLP_BIAS, MLP_MODES } mlp_mode;     /* all 127; all -127; signs by turns; biases at their ends */
#define MLP_OF_BENCH 3, (const int[]){ 32, 64, 64, 16 }

typedef struct {
    int layers;
    orl_mlp_layer layer[ORL_MLP_LAYERS + 1];
    int8_t w[ORL_MLP_LAYERS][ORL_MLP_WIDTH * ORL_MLP_WIDTH], x[MLP_ROWS * ORL_MLP_WIDTH];
    int32_t bias[ORL_MLP_LAYERS][ORL_MLP_WIDTH];
    int16_t mul[ORL_MLP_LAYERS][ORL_MLP_WIDTH];
    uint8_t shift[ORL_MLP_LAYERS][ORL_MLP_WIDTH];
    double scale[ORL_MLP_LAYERS][ORL_MLP_WIDTH];        /* what mul and shift stand for; 0 where they are at random */
} mlp_data;

static inline uint32_t mlp_next(uint64_t *r) { *r = *r * 6364136223846793005u + 1442695040888963407u; return (uint32_t)(*r >> 33); }
static inline int mlp_in(uint64_t *r, int lo, int hi) { return lo + (int)(mlp_next(r) % (uint32_t)(hi - lo + 1)); }

/* rows of x: at most MLP_ROWS. */
static inline void mlp_data_fill(mlp_data *d, uint64_t seed, int layers, const int *width, mlp_mode mode, int rows)
{
    uint64_t r = seed;
    *d = (mlp_data){ .layers = layers };
    for (int k = 0; k < layers; k++) {
        const int in = width[k], out = width[k + 1], sign = mode == MLP_LOW ? -1 : 1;
        d->layer[k] = (orl_mlp_layer){ in, out, d->w[k], d->bias[k], d->mul[k], d->shift[k] };
        for (int i = 0; i < in * out; i++) d->w[k][i] = (int8_t)(mode == MLP_HIGH || mode == MLP_LOW ? 127 * sign : mode == MLP_BOTH ? (i + i / in) & 1 ? 127 : -127 : mlp_in(&r, -127, 127));
        for (int o = 0; o < out; o++) {
            d->bias[k][o] = mode == MLP_BIAS ? mlp_in(&r, 0, 1) ? ORL_MLP_BIAS : -ORL_MLP_BIAS : mlp_in(&r, -60000, 60000);
            if (mode == MLP_SENSIBLE) {
                d->scale[k][o] = mlp_in(&r, 700, 2800) / (1024.0 * 73 * (k ? 128 : 74) * sqrt(in)) * (k + 1 < layers ? 100 : 50);
                orl_mlp_scale(d->scale[k][o], &d->mul[k][o], &d->shift[k][o]);
            } else {
                d->mul[k][o] = (int16_t)(mlp_in(&r, 0, 7) ? mlp_in(&r, 0, 4095) : 32767);
                d->shift[k][o] = (uint8_t)mlp_in(&r, 0, mode == MLP_BIAS ? ORL_MLP_SHIFT : 12);
            }
        }
    }
    for (int i = 0; i < rows * width[0]; i++) d->x[i] = (int8_t)(mode == MLP_HIGH || mode == MLP_LOW ? mlp_in(&r, 0, 1) ? 127 : -128 : mlp_in(&r, -128, 127));
}
#endif
