/* MLP kernels: against a plain loop for every width, gradients against finite differences, repeatability, the optimiser. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <cmocka.h>
#include "trainer/mlp.h"

enum { ROWS = 144 };                /* two blocks and a part of one */

static float *fill(size_t n, rng *r)
{
    float *p = aligned_alloc(64, (n * sizeof *p + 63) & ~(size_t)63);
    for (size_t i = 0; i < n; i++) p[i] = 2 * rng_f(r) - 1;
    return p;
}

static void forward_is_the_sum(void **state)
{
    (void)state;
    static const int SHAPES[][5] = { { 1, 16, 16 }, { 1, 32, 64 }, { 2, 48, 64, 32 }, { 3, 32, 64, 64, 16 }, { 3, 64, 48, 16, 48 } };
    for (size_t s = 0; s < sizeof SHAPES / sizeof *SHAPES; s++) {
        mlp m;
        rng r = rng_make(5, s, 0);
        assert_int_equal(mlp_init(&m, SHAPES[s][0], SHAPES[s] + 1, 1, 3, 0), ORL_OK);
        for (size_t i = 0; i < m.size; i++) m.p[i] = 0.4f * rng_normal(&r);
        float *in = fill(ROWS * (size_t)m.n[0], &r), *hidden = fill(ROWS * (size_t)(m.hidden + 16), &r), *out = fill(ROWS * (size_t)m.n[m.layers], &r);
        mlp_forward(&m, ROWS, in, hidden, out);
        for (int row = 0; row < ROWS; row++) {
            double a[64], b[64];
            for (int i = 0; i < m.n[0]; i++) a[i] = in[row * m.n[0] + i];
            for (int l = 0; l < m.layers; l++) {
                for (int j = 0; j < m.n[l + 1]; j++) {
                    const float *w = m.p + m.w[l];
                    b[j] = w[m.n[l] * m.n[l + 1] + j];
                    for (int i = 0; i < m.n[l]; i++) b[j] += a[i] * w[i * m.n[l + 1] + j];
                    if (l + 1 < m.layers && b[j] < 0) b[j] = 0;
                }
                memcpy(a, b, sizeof a);
            }
            for (int j = 0; j < m.n[m.layers]; j++) if (fabs(a[j] - out[row * m.n[m.layers] + j]) > 2e-4 * (1 + fabs(a[j]))) fail_msg("shape %zu, row %d, output %d: %g, not %g", s, row, j, out[row * m.n[m.layers] + j], a[j]);
        }
        free(in); free(hidden); free(out);
        mlp_free(&m);
    }
}

/* loss = sum of target * output */
static double loss(const mlp *m, const float *in, float *hidden, float *out, const float *target)
{
    double s = 0;
    mlp_forward(m, ROWS, in, hidden, out);
    for (int i = 0; i < ROWS * m->n[m->layers]; i++) s += (double)target[i] * out[i];
    return s;
}

static void gradients_match_finite_differences(void **state)
{
    (void)state;
    mlp m;
    rng r = rng_make(9, 0, 0);
    assert_int_equal(mlp_init(&m, 3, (int[]){ 32, 64, 48, 16 }, 1, 3, 2), ORL_OK);
    float *in = fill(ROWS * 32, &r), *hidden = fill(ROWS * (size_t)m.hidden, &r), *out = fill(ROWS * 16, &r), *target = fill(ROWS * 16, &r), *din = fill(ROWS * 32, &r);
    loss(&m, in, hidden, out, target);
    mlp_backward(&m, 1, ROWS, in, hidden, target, din);
    int bad = 0;
    const float h = 3e-4f;
    for (int k = 0; k < 60; k++) {
        size_t i = k < 20 ? m.w[2] - 1 - (size_t)k : rng_below(&r, (uint32_t)m.size);      /* some biases, then anything */
        float keep = m.p[i];
        m.p[i] = keep + h;
        double up = loss(&m, in, hidden, out, target);
        m.p[i] = keep - h;
        double fd = (up - loss(&m, in, hidden, out, target)) / (2 * h);
        m.p[i] = keep;
        if (fabs(fd - m.g[1][i]) > 0.03 * fabs(fd) + 0.02) { printf("parameter %zu: gradient %g, finite difference %g\n", i, m.g[1][i], fd); bad++; }
    }
    for (int k = 0; k < 60; k++) {
        size_t i = rng_below(&r, ROWS * 32);
        float keep = in[i];
        in[i] = keep + h;
        double up = loss(&m, in, hidden, out, target);
        in[i] = keep - h;
        double fd = (up - loss(&m, in, hidden, out, target)) / (2 * h);
        in[i] = keep;
        if (fabs(fd - din[i]) > 0.03 * fabs(fd) + 0.02) { printf("input %zu: gradient %g, finite difference %g\n", i, din[i], fd); bad++; }
    }
    assert_true(bad <= 2);          /* a step may cross a kink of the ReLU */
    for (size_t i = 0; i < m.size; i++) assert_true(m.g[0][i] == 0);
    free(in); free(hidden); free(out); free(target); free(din);
    mlp_free(&m);
}

/* Two threads' gradients are summed; a regression goes down; the same again, bit for bit. */
static void training_repeats(void **state)
{
    (void)state;
    float *seen[2] = { NULL, NULL };
    size_t size = 0;
    for (int run = 0; run < 2; run++) {
        mlp m;
        rng r = rng_make(11, 0, 0);
        assert_int_equal(mlp_init(&m, 2, (int[]){ 16, 32, 16 }, 1, 3, 2), ORL_OK);
        float *in = fill(ROWS * 16, &r), *hidden = fill(ROWS * (size_t)m.hidden, &r), *out = fill(ROWS * 16, &r), *d = fill(ROWS * 16, &r);
        double first = 0, last = 0;
        for (int step = 0; step < 200; step++) {
            last = 0;
            mlp_forward(&m, ROWS, in, hidden, out);
            for (int i = 0; i < ROWS * 16; i++) {
                float want = i % 16 == 3 ? in[i] * in[i - 1] : 0.5f;
                last += (out[i] - want) * (out[i] - want);
                d[i] = 2 * (out[i] - want) / ROWS;
            }
            if (!step) first = last;
            mlp_backward(&m, 0, 64, in, hidden, d, NULL);
            mlp_backward(&m, 1, ROWS - 64, in + 64 * 16, hidden + 64 * m.hidden, d + 64 * 16, NULL);
            mlp_adam(&m, 3e-3f, 0);
        }
        assert_true(last < 0.05 * first);
        size = m.size;
        seen[run] = m.p;
        m.p = NULL;
        free(in); free(hidden); free(out); free(d);
        mlp_free(&m);
    }
    assert_memory_equal(seen[0], seen[1], size * sizeof(float));
    free(seen[0]); free(seen[1]);
}

static void bad_shapes_are_refused(void **state)
{
    (void)state;
    mlp m;
    assert_int_equal(mlp_init(&m, 2, (int[]){ 16, 30, 16 }, 1, 1, 1), ORL_E_RANGE);
    assert_int_equal(mlp_init(&m, 2, (int[]){ 16, 128, 16 }, 1, 1, 1), ORL_E_RANGE);
    assert_int_equal(mlp_init(&m, MLP_LAYERS + 1, (int[]){ 16, 16, 16, 16, 16, 16 }, 1, 1, 1), ORL_E_RANGE);
}

int main(void)
{
    const struct CMUnitTest tests[] = { cmocka_unit_test(forward_is_the_sum), cmocka_unit_test(gradients_match_finite_differences), cmocka_unit_test(training_repeats), cmocka_unit_test(bad_shapes_are_refused) };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
