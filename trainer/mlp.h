/* Small fused multilayer perceptrons in float32: y = W_L relu(... relu(W_1 x + b_1) ...) + b_L.
 *
 * Rows are samples, row-major; every width and every number of rows is a multiple of MLP_PAD by contract, so kernels have no tails (fill up with zero rows and zero columns).
 * Samples pass in blocks of MLP_BLOCK rows that stay in the first-level cache through all layers, forward and backward. One register-blocked kernel does all three products
 * (activations, input gradients, weight gradients): C(m, n) += A(m, k) B(k, n) with n along the vectors and A broadcast, so that A may have any strides.
 * Weight gradients are per thread and summed in thread order: a run repeats for a given thread count. */
#ifndef TRAINER_MLP_H
#define TRAINER_MLP_H
#include "trainer/grid.h"

enum { MLP_PAD = 16, MLP_BLOCK = 64, MLP_LAYERS = 4, MLP_WIDTH = 64 };

typedef struct {
    int layers, n[MLP_LAYERS + 1];  /* n[0] inputs, n[layers] outputs; multiples of MLP_PAD, at most MLP_WIDTH */
    size_t w[MLP_LAYERS], size;     /* offset of layer l: weights [n[l]][n[l + 1]], then n[l + 1] biases; floats in all */
    int threads, hidden;            /* hidden: activations a sample keeps from forward to backward, floats */
    int step;
    float *p, *t;                   /* parameters; weights transposed, for the way back */
    float *m, *v;                   /* Adam moments */
    float *g[GRID_THREADS];
} mlp;

/* He-uniform weights, zero biases; out_scale scales the last layer's weights. threads = 0: not trained. */
orl_err mlp_init(mlp *m, int layers, const int *widths, float out_scale, uint64_t seed, int threads);
void mlp_free(mlp *m);
/* After parameters were written from outside. */
void mlp_refresh(mlp *m);
/* in: rows x n[0]; hidden: rows x m->hidden floats of the caller's, kept for mlp_backward; out: rows x n[layers]. All 64-byte aligned. */
void mlp_forward(const mlp *m, int rows, const float *in, float *hidden, float *out);
/* dout: rows x n[layers]; din (NULL: not wanted): rows x n[0]. Adds to the gradients of `thread`; thread < 0: input gradients only. */
void mlp_backward(mlp *m, int thread, int rows, const float *in, const float *hidden, const float *dout, float *din);
/* One Adam step (beta 0.9, 0.99, bias corrected) with the sum of the threads' gradients, which are cleared. decay: weights shrink by lr * decay. */
void mlp_adam(mlp *m, float lr, float decay);
/* Multiply-adds of a sample: forward; backward is twice that. */
size_t mlp_macs(const mlp *m);
/* Float peak of one core as an FMA loop on registers reaches it, multiply-adds a second (`seconds`: how long to measure). */
double mlp_peak(double seconds);
#endif
