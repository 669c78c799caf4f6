/* int8 networks: every variant against the reference, bit for bit, over shapes, random and extreme weights and biases, batch sizes, odd starts, guard bytes; the reference against the equation written out, and
 * against a float network; what packing turns away. On emulated aarch64: tests/tools/kernel_hash.c. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include "tests/mlp_data.h"

static const char *const variants[] = {
#define NAME(n) #n,
    ORL_KERNEL_VARIANTS(NAME)
#undef NAME
};
enum { VARIANTS = sizeof variants / sizeof *variants, GUARD = 64, N = 96 };

typedef struct { uint8_t before[GUARD + 1]; int8_t y[N * ORL_MLP_WIDTH]; uint8_t after[GUARD]; } output;

static const orl_mlp *pack(const mlp_data *d, unsigned cpu)
{
    const orl_mlp *m = NULL;
    size_t need = orl_mlp_need(d->layer, d->layers);
    void *block = aligned_alloc(64, need);
    assert_non_null(block);
    memset(block, 0x5a, need);
    assert_int_equal(orl_mlp_pack(d->layer, d->layers, cpu, block, need, &m), ORL_OK);
    assert_ptr_equal(m, block);
    return m;
}

/* The starts of x and y are odd. Nothing but n rows is written, however many layers are wider than the last one. */
static void run(const orl_mlp *m, const mlp_data *d, int n, output *o)
{
    memset(o, 0xa5, sizeof *o);
    orl_mlp_run(m, d->x + 1, n, o->y);
    for (size_t i = 0; i < sizeof o->before; i++) assert_int_equal(o->before[i], 0xa5);
    for (size_t i = (size_t)(n * d->layer[d->layers - 1].out); i < sizeof o->y; i++) assert_int_equal((uint8_t)o->y[i], 0xa5);
    for (size_t i = 0; i < sizeof o->after; i++) assert_int_equal(o->after[i], 0xa5);
}

static void compare(const mlp_data *d)
{
    output a, b;
    const orl_mlp *ref = pack(d, ORL_CPU_REF);
    for (int v = 0; v < VARIANTS; v++) {
        unsigned cpu;
        if (orl_cpu_from_name(variants[v], &cpu)) continue;
        const orl_mlp *m = pack(d, cpu);
        for (int n = 0; n <= N; n += n < 48 ? 16 : 48) {
            run(ref, d, n, &a);
            run(m, d, n, &b);
            if (memcmp(&a, &b, sizeof a)) {
                int i = 0;
                while (a.y[i] == b.y[i]) i++;
                fail_msg("%s differs from ref: %d layers, %d to %d, n %d, output %d: %d, not %d", variants[v], d->layers, d->layer[0].in, d->layer[d->layers - 1].out, n, i, b.y[i], a.y[i]);
            }
        }
        free((void *)m);
    }
    free((void *)ref);
}

static void test_bits(void **state)
{
    (void)state;
    uint64_t seed = (uint64_t)time(NULL);
    print_message("seed %llu\n", (unsigned long long)seed);
    mlp_data *d = malloc(sizeof *d);
    assert_non_null(d);
    for (int mode = 0; mode < MLP_MODES; mode++) {
        mlp_data_fill(d, seed + (uint64_t)mode, MLP_OF_BENCH, (mlp_mode)mode, N + 1);
        compare(d);
    }
    for (int i = 0; i < 120; i++) {
        int layers, width[ORL_MLP_LAYERS + 1];
        uint64_t r = seed + (uint64_t)i;
        layers = 1 + (int)(mlp_next(&r) % ORL_MLP_LAYERS);
        for (int k = 0; k <= layers; k++) width[k] = 16 + 16 * (int)(mlp_next(&r) % 4);
        mlp_data_fill(d, r, layers, width, (mlp_mode)(i % MLP_MODES), N + 1);
        compare(d);
    }
    free(d);
}

/* One layer, written out with 64 bits and divisions that round down. */
static void test_ref_is_the_equation(void **state)
{
    (void)state;
    mlp_data *d = malloc(sizeof *d);
    assert_non_null(d);
    int clamped = 0, middle = 0;
    for (int mode = 0; mode < MLP_MODES; mode++) {
        mlp_data_fill(d, 7, 1, (const int[]){ 48, 64 }, (mlp_mode)mode, 16);
        const orl_mlp_layer *l = d->layer;
        const orl_mlp *m = pack(d, ORL_CPU_REF);
        int8_t y[16 * 64];
        orl_mlp_run(m, d->x, 16, y);
        for (int i = 0; i < 16 * 64; i++) {
            int s = i / 64, o = i % 64;
            int64_t acc = l->bias[o];
            for (int k = 0; k < 48; k++) acc += (int64_t)l->w[o * 48 + k] * d->x[s * 48 + k];
            double t = l->shift[o] ? floor((double)acc / (double)(1 << l->shift[o]) + 0.5) : (double)acc;
            double u = floor(fmin(fmax(t, -32768), 32767) * l->mul[o] / 32768 + 0.5), want = fmin(fmax(u, -128), 127);
            if (y[i] != (int)want) fail_msg("fill %d, output %d: %d, not %g", mode, i, y[i], want);
            clamped += u != want;
            middle += u == want && fabs(u) > 8;
        }
        free((void *)m);
    }
    print_message("figure: %d outputs within int8, %d clamped\n", middle, clamped);
    assert_true(middle > 300 && clamped > 300);
    free(d);
}

/* Layer by layer from the same inputs: a result is off the quotient by less than the header says. Then all layers: the rounding of an output is small beside its range. */
static void test_float(void **state)
{
    (void)state;
    mlp_data *d = malloc(sizeof *d);
    assert_non_null(d);
    double worst = 0, sum = 0;
    int count = 0;
    for (int i = 0; i < 8; i++) {
        mlp_data_fill(d, 100 + (uint64_t)i, MLP_OF_BENCH, MLP_SENSIBLE, N);
        const orl_mlp *m = pack(d, ORL_CPU_REF);
        int8_t y[N * 16];
        orl_mlp_run(m, d->x, N, y);
        for (int s = 0; s < N; s++) {
            double a[2][64];
            int h[2][64];
            for (int k = 0; k < 32; k++) a[0][k] = h[0][k] = d->x[s * 32 + k];
            for (int k = 0; k < 3; k++) {
                const orl_mlp_layer *l = d->layer + k;
                double hi = k < 2 ? 255 : 127, lo = k < 2 ? 0 : -128;
                for (int o = 0; o < l->out; o++) {
                    double f = l->bias[o];
                    int64_t acc = l->bias[o];
                    for (int c = 0; c < l->in; c++) { f += l->w[o * l->in + c] * a[k & 1][c]; acc += l->w[o * l->in + c] * h[k & 1][c]; }
                    double exact = fmin(fmax((double)acc * d->scale[k][o], lo), hi);
                    int64_t t = l->shift[o] ? (acc + (1 << (l->shift[o] - 1))) >> l->shift[o] : acc;
                    t = t < -32768 ? -32768 : t > 32767 ? 32767 : t;
                    double u = fmin(fmax((double)((t * l->mul[o] + (1 << 14)) >> 15), lo), hi);
                    worst = fmax(worst, fabs(u - exact));
                    h[~k & 1][o] = (int)u;
                    a[~k & 1][o] = fmin(fmax(f * d->scale[k][o], lo), hi);
                }
            }
            for (int o = 0; o < 16; o++) {
                assert_int_equal(y[s * 16 + o], h[1][o]);
                sum += (y[s * 16 + o] - a[1][o]) * (y[s * 16 + o] - a[1][o]);
                count++;
            }
        }
        free((void *)m);
    }
    print_message("figure: a layer off the quotient by %.3f at most (0.6 stated); three layers off float by %.3f of 255, RMS\n", worst, sqrt(sum / count));
    assert_true(worst > 0.45 && worst < 0.6);
    assert_true(sqrt(sum / count) < 1);
    free(d);
}

static void test_scale(void **state)
{
    (void)state;
    for (double scale = ldexp(1, -28); scale < 1; scale *= 1.0001234) {
        int16_t mul;
        uint8_t shift;
        orl_mlp_scale(scale, &mul, &shift);
        assert_true(shift <= ORL_MLP_SHIFT && (shift ? mul >= 2048 && mul <= 4095 : mul >= 2048));
        assert_true(fabs(ldexp(mul, -15 - shift) / scale - 1) <= 0.5 / 2048 + 1e-9);
    }
    int16_t mul;
    uint8_t shift;
    orl_mlp_scale(0, &mul, &shift);
    assert_true(mul == 0 && shift == ORL_MLP_SHIFT);
    orl_mlp_scale(nextafter(1, 0), &mul, &shift);
    assert_true(mul == 32767 && shift == 0);
}

static void refuse(const mlp_data *d, const char *text)
{
    const orl_mlp *m = (const orl_mlp *)d;
    static _Alignas(64) uint8_t block[1 << 16];
    assert_int_equal(orl_mlp_pack(d->layer, d->layers, ORL_CPU_REF, block, sizeof block, &m), ORL_E_RANGE);
    assert_ptr_equal(m, d);
    if (!strstr(orl_error_text(), text)) fail_msg("'%s', not '%s'", orl_error_text(), text);
}

static void test_refused(void **state)
{
    (void)state;
    mlp_data *d = malloc(sizeof *d);
    assert_non_null(d);
    static _Alignas(64) uint8_t block[1 << 16];
    const orl_mlp *m = NULL;
#define WITH(field, value, text) do { mlp_data_fill(d, 3, MLP_OF_BENCH, MLP_RANDOM, N); d->field = value; refuse(d, text); } while (0)
    WITH(layers, 0, "0 layers");
    WITH(layers, ORL_MLP_LAYERS + 1, "9 layers");
    WITH(layer[0].in, 24, "layer 0: 24 to 64");
    WITH(layer[2].out, 80, "layer 2: 64 to 80");
    WITH(layer[1].out, 0, "layer 1: 64 to 0");
    WITH(layer[1].in, 48, "layer 1: takes 48 of the 64");
    WITH(w[1][70], -128, "layer 1: weight 70 is -128");
    WITH(bias[2][3], ORL_MLP_BIAS + 1, "layer 2: bias 3");
    WITH(bias[2][3], -ORL_MLP_BIAS - 1, "layer 2: bias 3");
    WITH(mul[0][63], -1, "layer 0: multiplier 63 is -1");
    WITH(shift[0][0], 25, "layer 0: shift 0 is 25");
#undef WITH
    mlp_data_fill(d, 3, MLP_OF_BENCH, MLP_RANDOM, N);
    size_t need = orl_mlp_need(d->layer, d->layers);
    assert_true(need > 2 * 7168 && need <= sizeof block);
    assert_int_equal(orl_mlp_pack(d->layer, d->layers, ORL_CPU_REF, block, need - 1, &m), ORL_E_MEMORY);
    assert_int_equal(orl_mlp_pack(d->layer, d->layers, ORL_CPU_REF, block + 1, need + 64, &m), ORL_E_MEMORY);
    assert_null(m);
    d->layers = 0;
    assert_int_equal(orl_mlp_need(d->layer, d->layers), 0);
    free(d);
}

int main(void)
{
    const struct CMUnitTest tests[] = { cmocka_unit_test(test_bits), cmocka_unit_test(test_ref_is_the_equation), cmocka_unit_test(test_float), cmocka_unit_test(test_scale), cmocka_unit_test(test_refused) };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
