/* Fused small MLPs (mlp.h): one matrix kernel, forward, backward, Adam. */
#include "trainer/mlp.h"
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

/* The widest vectors this machine has, and a tile of C that fits its registers beside one row of B: R rows x NV vectors. */
#ifdef __AVX512F__
enum { VL = 16, NV = 4 };
#else
enum { VL = 8, NV = 2 };
#endif
typedef float vf __attribute__((vector_size(4 * VL)));
typedef int32_t vi __attribute__((vector_size(4 * VL)));

/* Keeps a row of B in registers: left alone, compilers load it again for every row of A, and loads become the bound. */
#if defined __x86_64__ && defined __AVX__
#define HOLD(x) __asm__("" : "+v"(x))
#else
#define HOLD(x) (void)(x)
#endif

typedef enum { PLAIN, RELU, GATE, ADD } finish;     /* C = x, max(x, 0), x where gate > 0, C + x */

/* The tile of R x nv vectors at C: start (biases, NULL: 0) + sum_k A(r, k) B(k, .). gate has C's layout. */
static inline __attribute__((always_inline)) void tile(const int R, const int nv, int K, const float *A, size_t ar, size_t ak, const float *B, size_t bk, const float *bias,
                                                       float *C, size_t cr, const float *gate, const finish how)
{
    vf c[8][4];
#pragma GCC unroll 8
    for (int r = 0; r < R; r++)
#pragma GCC unroll 4
        for (int j = 0; j < nv; j++) c[r][j] = bias ? *(const vf *)(bias + j * VL) : (vf){ 0 };
    for (int k = 0; k < K; k++, A += ak, B += bk) {
        const vf *row = (const vf *)B;
        vf b0 = row[0], b1 = nv > 1 ? row[1] : b0, b2 = nv > 2 ? row[2] : b0, b3 = nv > 3 ? row[3] : b0;
        HOLD(b0); HOLD(b1); HOLD(b2); HOLD(b3);
#pragma GCC unroll 8
        for (int r = 0; r < R; r++) {
            float a = A[(size_t)r * ar];
            c[r][0] += a * b0;
            if (nv > 1) c[r][1] += a * b1;
            if (nv > 2) c[r][2] += a * b2;
            if (nv > 3) c[r][3] += a * b3;
        }
    }
#pragma GCC unroll 8
    for (int r = 0; r < R; r++)
#pragma GCC unroll 4
        for (int j = 0; j < nv; j++) {
            vf *o = (vf *)(C + (size_t)r * cr + (size_t)(j * VL));
            vf x = c[r][j];
            if (how == RELU) x = (vf)((vi)x & (x > 0));
            if (how == GATE) x = (vf)((vi)x & (*(const vf *)(gate + (size_t)r * cr + (size_t)(j * VL)) > 0));
            if (how == ADD) x += *o;
            *o = x;
        }
}

/* M rows of C, n columns, both multiples of MLP_PAD. Wide tiles first, then what is left with more rows. */
static inline __attribute__((always_inline)) void product(int M, int n, int K, const float *A, size_t ar, size_t ak, const float *B, size_t bk, const float *bias,
                                                          float *C, size_t cr, const float *gate, const finish how)
{
    int j = 0;
    for (; j + NV * VL <= n; j += NV * VL)
        for (int i = 0; i < M; i += 4) tile(4, NV, K, A + (size_t)i * ar, ar, ak, B + j, bk, bias ? bias + j : NULL, C + (size_t)i * cr + j, cr, gate ? gate + (size_t)i * cr + j : NULL, how);
    for (; NV == 4 && j + 2 * VL <= n; j += 2 * VL)
        for (int i = 0; i < M; i += 8) tile(8, 2, K, A + (size_t)i * ar, ar, ak, B + j, bk, bias ? bias + j : NULL, C + (size_t)i * cr + j, cr, gate ? gate + (size_t)i * cr + j : NULL, how);
    for (; j + VL <= n; j += VL)
        for (int i = 0; i < M; i += 8) tile(8, 1, K, A + (size_t)i * ar, ar, ak, B + j, bk, bias ? bias + j : NULL, C + (size_t)i * cr + j, cr, gate ? gate + (size_t)i * cr + j : NULL, how);
}

static __attribute__((noinline)) void affine(int M, int n, int K, const float *A, const float *W, float *C) { product(M, n, K, A, (size_t)K, 1, W, (size_t)n, W + (size_t)K * (size_t)n, C, (size_t)n, NULL, PLAIN); }
static __attribute__((noinline)) void affine_relu(int M, int n, int K, const float *A, const float *W, float *C) { product(M, n, K, A, (size_t)K, 1, W, (size_t)n, W + (size_t)K * (size_t)n, C, (size_t)n, NULL, RELU); }
static __attribute__((noinline)) void back(int M, int n, int K, const float *D, const float *T, float *C) { product(M, n, K, D, (size_t)K, 1, T, (size_t)n, NULL, C, (size_t)n, NULL, PLAIN); }
static __attribute__((noinline)) void back_relu(int M, int n, int K, const float *D, const float *T, float *C, const float *act) { product(M, n, K, D, (size_t)K, 1, T, (size_t)n, NULL, C, (size_t)n, act, GATE); }
static __attribute__((noinline)) void outer(int M, int n, int K, const float *A, const float *D, float *C) { product(M, n, K, A, 1, (size_t)M, D, (size_t)n, NULL, C, (size_t)n, NULL, ADD); }

static void *block(size_t floats) { void *p = aligned_alloc(64, (floats * sizeof(float) + 63) & ~(size_t)63); if (p) memset(p, 0, floats * sizeof(float)); return p; }

orl_err mlp_init(mlp *m, int layers, const int *widths, float out_scale, uint64_t seed, int threads)
{
    memset(m, 0, sizeof *m);
    if (layers < 1 || layers > MLP_LAYERS) return orl_fail(ORL_E_RANGE, "MLP of %d layers", layers);
    m->layers = layers;
    m->threads = threads < GRID_THREADS ? threads : GRID_THREADS;
    for (int l = 0; l <= layers; l++) {
        if (widths[l] < MLP_PAD || widths[l] > MLP_WIDTH || widths[l] % MLP_PAD) return orl_fail(ORL_E_RANGE, "MLP layer %d of width %d", l, widths[l]);
        m->n[l] = widths[l];
        if (l && l < layers) m->hidden += widths[l];
    }
    for (int l = 0; l < layers; l++) {
        m->w[l] = m->size;
        m->size += (size_t)(m->n[l] + 1) * (size_t)m->n[l + 1];
    }
    m->p = block(m->size);
    m->t = block(m->size);
    int ok = m->p && m->t;
    if (ok && threads) ok = (m->m = block(m->size)) && (m->v = block(m->size));
    for (int k = 0; ok && k < m->threads; k++) ok = (m->g[k] = block(m->size)) != NULL;
    if (!ok) {
        mlp_free(m);
        return orl_fail(ORL_E_MEMORY, "no memory for an MLP");
    }
    rng r = rng_make(seed, 0x31b, 0);
    for (int l = 0; l < layers; l++) {
        float a = sqrtf(6.0f / (float)m->n[l]) * (l + 1 == layers ? out_scale : 1);
        for (int i = 0; i < m->n[l] * m->n[l + 1]; i++) m->p[m->w[l] + (size_t)i] = a * (2 * rng_f(&r) - 1);
    }
    mlp_refresh(m);
    return ORL_OK;
}

void mlp_free(mlp *m)
{
    free(m->p); free(m->t); free(m->m); free(m->v);
    for (int k = 0; k < GRID_THREADS; k++) free(m->g[k]);
    memset(m, 0, sizeof *m);
}

void mlp_refresh(mlp *m)
{
    for (int l = 0; l < m->layers; l++)
        for (int i = 0; i < m->n[l]; i++)
            for (int j = 0; j < m->n[l + 1]; j++) m->t[m->w[l] + (size_t)(j * m->n[l] + i)] = m->p[m->w[l] + (size_t)(i * m->n[l + 1] + j)];
}

size_t mlp_macs(const mlp *m)
{
    size_t s = 0;
    for (int l = 0; l < m->layers; l++) s += (size_t)m->n[l] * (size_t)m->n[l + 1];
    return s;
}

/* Hidden activations lie block after block, layer after layer within a block. */
void mlp_forward(const mlp *m, int rows, const float *in, float *hidden, float *out)
{
    int L = m->layers, nin = m->n[0], nout = m->n[L];
    for (int b = 0; b < rows; b += MLP_BLOCK) {
        int M = rows - b < MLP_BLOCK ? rows - b : MLP_BLOCK;
        const float *x = in + (size_t)b * (size_t)nin;
        float *h = hidden + (size_t)b * (size_t)m->hidden;
        for (int l = 0; l < L - 1; l++) {
            affine_relu(M, m->n[l + 1], m->n[l], x, m->p + m->w[l], h);
            x = h;
            h += M * m->n[l + 1];
        }
        affine(M, nout, m->n[L - 1], x, m->p + m->w[L - 1], out + (size_t)b * (size_t)nout);
    }
}

void mlp_backward(mlp *m, int thread, int rows, const float *in, const float *hidden, const float *dout, float *din)
{
    _Alignas(64) float buf[2][MLP_BLOCK * MLP_WIDTH];
    int L = m->layers;
    for (int b = 0; b < rows; b += MLP_BLOCK) {
        int M = rows - b < MLP_BLOCK ? rows - b : MLP_BLOCK;
        const float *d = dout + (size_t)b * (size_t)m->n[L], *h = hidden + (size_t)b * (size_t)m->hidden + (size_t)(M * m->hidden);
        for (int l = L - 1; l >= 0; l--) {
            int ni = m->n[l], no = m->n[l + 1];
            const float *x = l ? (h -= M * ni) : in + (size_t)b * (size_t)ni;
            if (thread >= 0) {
                float *g = m->g[thread] + m->w[l], *gb = g + ni * no;
                outer(ni, no, M, x, d, g);
                for (int j = 0; j < no; j += VL) {
                    vf s = *(vf *)(gb + j);
                    for (int r = 0; r < M; r++) s += *(const vf *)(d + r * no + j);
                    *(vf *)(gb + j) = s;
                }
            }
            if (l) back_relu(M, ni, no, d, m->t + m->w[l], buf[l & 1], x);
            else if (din) back(M, ni, no, d, m->t + m->w[l], din + (size_t)b * (size_t)ni);
            d = buf[l & 1];
        }
    }
}

void mlp_adam(mlp *m, float lr, float decay)
{
    m->step++;
    float c1 = 1 / (1 - powf(0.9f, (float)m->step)), c2 = 1 / (1 - powf(0.99f, (float)m->step)), shrink = 1 - lr * decay;
    for (size_t i = 0; i < m->size; i++) {
        float d = m->g[0][i];
        for (int k = 1; k < m->threads; k++) { d += m->g[k][i]; m->g[k][i] = 0; }
        m->g[0][i] = 0;
        m->m[i] = 0.9f * m->m[i] + 0.1f * d;
        m->v[i] = 0.99f * m->v[i] + 0.01f * d * d;
        m->p[i] = shrink * m->p[i] - lr * c1 * m->m[i] / (sqrtf(c2 * m->v[i]) + 1e-10f);
    }
    mlp_refresh(m);
}

double mlp_peak(double seconds)
{
    enum { N = VL == 16 ? 16 : 10 };
    vf c[N];
    volatile float a0 = 0.999f, b0 = 1e-3f;
    float a = a0, b = b0;
    for (int i = 0; i < N; i++) c[i] = (vf){ 0 } + (float)i;
    double best = 0, spent = 0;
    while (spent < seconds) {
        struct timespec s, e;
        clock_gettime(CLOCK_THREAD_CPUTIME_ID, &s);
        for (int k = 0; k < 200000; k++) {
#pragma GCC unroll 16
            for (int i = 0; i < N; i++) c[i] = c[i] * a + b;
        }
        clock_gettime(CLOCK_THREAD_CPUTIME_ID, &e);
        double t = (double)(e.tv_sec - s.tv_sec) + 1e-9 * (double)(e.tv_nsec - s.tv_nsec);
        double rate = 200000.0 * N * VL / t;
        best = rate > best ? rate : best;
        spent += t;
    }
    float sum = 0;
    for (int i = 0; i < N; i++) for (int j = 0; j < VL; j++) sum += c[i][j];
    a0 = sum;                                   /* or the loop would be dropped */
    return best;
}
