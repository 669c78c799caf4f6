/* Every variant of the re-lighting kernels against the reference, bit for bit: random and extreme inputs, odd starts, guard bytes; and the reference against the equation. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>
#include <math.h>
#include <stdlib.h>
#include <time.h>
#include "tests/kernel_data.h"

static const char *const variants[] = {
#define NAME(n) n,
    ORL_KERNEL_VARIANTS(NAME)
#undef NAME
};
enum { VARIANTS = sizeof variants / sizeof *variants };

typedef struct { uint8_t before[KD_GUARD], vis[KD_N], b1[KD_GUARD]; int16_t s[KD_N]; uint8_t b2[KD_GUARD], rgb[KD_N * 3], b3[KD_GUARD], mixed[KD_N * 3], after[KD_GUARD]; } output;

static void run(const orl_kernels *k, const kernel_data *d, int x, int n, output *o)
{
    memset(o, 0xa5, sizeof *o);
    orl_shade_in in = kd_in_struct(d, x);
    k->vis(d->horizon[0] + x, d->horizon[1] + x, &d->vis_tab, n, o->vis);
    k->shadow(d->phi + 8 * x, &d->tab, n, o->s);
    k->shade(&in, &d->tab, n, o->rgb);
    orl_mix_in mix = kd_mix_struct(d, x);
    memcpy(o->mixed, d->render + 3 * x, 3 * (size_t)n);
    k->mix(&mix, n, o->mixed);
}

static void compare(kernel_data *d, output *ref, output *got, int x, int n)
{
    orl_kernels k;
    orl_kernels_init(&k, ORL_CPU_REF);
    run(&k, d, x, n, ref);
    for (size_t i = 0; i < sizeof ref->before; i++) assert_true(ref->before[i] == 0xa5 && ref->b1[i] == 0xa5 && ref->b2[i] == 0xa5 && ref->b3[i] == 0xa5 && ref->after[i] == 0xa5);
    if (n < KD_N) assert_true(ref->vis[n] == 0xa5 && (uint16_t)ref->s[n] == 0xa5a5 && ref->rgb[3 * n] == 0xa5 && ref->mixed[3 * n] == 0xa5);
    for (int v = 0; v < VARIANTS; v++) {
        unsigned cpu;
        if (orl_cpu_from_name(variants[v], &cpu)) continue;
        orl_kernels_init(&k, cpu);
        run(&k, d, x, n, got);
        if (memcmp(ref, got, sizeof *ref)) fail_msg("%s differs from ref at x %d, n %d", variants[v], x, n);
    }
}

static void test_bits(void **state)
{
    (void)state;
    uint64_t seed = (uint64_t)time(NULL);
    print_message("seed %llu\n", (unsigned long long)seed);
    kernel_data *d = malloc(sizeof *d);
    output *a = malloc(sizeof *a), *b = malloc(sizeof *b);
    assert_non_null(d); assert_non_null(a); assert_non_null(b);
    for (int i = 0; i < 60; i++) {
        kd_fill(d, seed + (uint64_t)i, i < KD_MODES ? (kd_mode)i : KD_RANDOM);
        compare(d, a, b, 0, KD_N);
        for (int n = 0; n <= 64; n += 16) compare(d, a, b, 16 * (i % 8), n);
    }
    free(d); free(a); free(b);
}

static void test_vis_is_smoothstep(void **state)
{
    (void)state;
    uint8_t h0[256], h1[256], vis[256];
    for (int i = 0; i < 256; i++) { h0[i] = (uint8_t)i; h1[i] = (uint8_t)(255 - i); }
    for (int f = 0; f <= 256; f += 37) {
        double el = 0.7;
        orl_vis_tab t = { 3, 4, f, (int32_t)((el + ORL_SUN_SOFT / 2) * 255 * 256 * 2 / 3.14159265358979) };
        orl_vis_ref(h0, h1, &t, 256, vis);
        for (int i = 0; i < 256; i++) {
            double h = (i + (255 - 2 * i) * f / 256.0) / 255 * 1.5707963267949, x = fmin(fmax((el - h) / ORL_SUN_SOFT + 0.5, 0), 1);
            assert_true(fabs(vis[i] - 255 * x * x * (3 - 2 * x)) <= 1.5);
        }
    }
}

/* No correction and no photo: the render; the photo's whole share: the photo; half a correction between two cells. */
static void test_mix_is_exact(void **state)
{
    (void)state;
    static const int16_t cell[2][3][2] = { { { 0, 0 }, { 0, 320 }, { -320, 0 } }, { { 0, 0 }, { 0, 960 }, { -960, 0 } } };      /* 0; +10 and +30 levels on the surface; -10 and -30 in the sky */
    const uint8_t cell_of[1] = { 0 }, layer[8] = { 255, 255, 255, 255, 0, 0, 0, 0 }, weight[8] = { 0, 255, 0, 128, 0, 255, 0, 0 };
    const int16_t share[8] = { 0, 0, 16384, 0, 0, 0, 16384, 32767 };
    uint8_t rgb[24], photo[24];
    for (int i = 0; i < 24; i++) { rgb[i] = (uint8_t)(100 + i); photo[i] = (uint8_t)(10 * i); }
    orl_mix_ref(&(orl_mix_in){ cell, cell_of, share, layer, weight, photo }, 8, rgb);
    const int want[24] = { 100, 111, 102, 30, 40, 50, 106, 127, 108, (90 * 128 + 109 * 127 + 127) / 255, (100 * 128 + 120 * 127 + 127) / 255, (110 * 128 + 111 * 127 + 127) / 255,
                           112, 113, 104, 150, 160, 170, 118, 119, 100, 121, 122, 93 };
    for (int i = 0; i < 24; i++) if (abs(rgb[i] - want[i]) > (i % 3 && weight[i / 3] < 255)) fail_msg("byte %d: %d, not %d", i, rgb[i], want[i]);
}

static void test_unknown_cpu(void **state)
{
    (void)state;
    unsigned f = 77;
    assert_int_equal(orl_cpu_from_name("quantum", &f), ORL_E_UNSUPPORTED);
    assert_int_equal(f, 77);
    assert_int_equal(orl_cpu_from_name("auto", &f), ORL_OK);
    assert_int_equal(f, orl_cpu_detect());
    assert_int_equal(orl_cpu_from_name(orl_cpu_name(f), &f), ORL_OK);
}

int main(void)
{
    const struct CMUnitTest tests[] = { cmocka_unit_test(test_bits), cmocka_unit_test(test_vis_is_smoothstep), cmocka_unit_test(test_mix_is_exact), cmocka_unit_test(test_unknown_cpu) };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
