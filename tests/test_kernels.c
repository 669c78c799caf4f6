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
#define NAME(n) #n,
    ORL_KERNEL_VARIANTS(NAME)
#undef NAME
};
enum { VARIANTS = sizeof variants / sizeof *variants };

typedef struct { uint8_t before[KD_GUARD]; int16_t vis[KD_N]; uint8_t b1[KD_GUARD]; int16_t s[KD_N]; uint8_t b2[KD_GUARD], rgb[KD_N * 3], b3[KD_GUARD], mixed[KD_N * 3], b4[KD_GUARD], warped[KD_N * 3], after[KD_GUARD]; } output;

static void run(const orl_kernels *k, const kernel_data *d, int x, int n, output *o)
{
    memset(o, 0xa5, sizeof *o);
    orl_vis_in vis = kd_vis_struct(d, x);
    orl_shade_in in = kd_in_struct(d, x);
    orl_mix_in mix = kd_mix_struct(d, x);
    k->vis(&vis, &d->vis_tab, n, o->vis);
    k->shadow((const int8_t *const[]){ d->phi[0] + ORL_PHI_GROUP * x, d->phi[1] + ORL_PHI_GROUP * x }, d->cov + x, &d->tab, n, o->s);
    k->shade(&in, &d->tab, n, o->rgb);
    memcpy(o->mixed, d->render + 3 * x, 3 * (size_t)n);
    k->mix(&mix, n, o->mixed);
    orl_warp_in warp = kd_warp_struct(d, x);
    k->warp(&warp, n ? n - 5 : 0, o->warped);
}

static void compare(kernel_data *d, output *ref, output *got, int x, int n)
{
    orl_kernels k;
    orl_kernels_init(&k, ORL_CPU_REF);
    run(&k, d, x, n, ref);
    for (size_t i = 0; i < sizeof ref->before; i++) assert_true(ref->before[i] == 0xa5 && ref->b1[i] == 0xa5 && ref->b2[i] == 0xa5 && ref->b3[i] == 0xa5 && ref->b4[i] == 0xa5 && ref->after[i] == 0xa5);
    if (n < KD_N) assert_true((uint16_t)ref->vis[n] == 0xa5a5 && (uint16_t)ref->s[n] == 0xa5a5 && ref->rgb[3 * n] == 0xa5 && ref->mixed[3 * n] == 0xa5 && ref->warped[n ? 3 * n - 15 : 0] == 0xa5);
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
        for (int n = 0; n <= 128; n += ORL_KERNEL_STEP) compare(d, a, b, ORL_KERNEL_STEP * (i % 8), n);
    }
    free(d); free(a); free(b);
}

static double smoothstep(double el, double h)
{
    double x = fmin(fmax((el - h) / ORL_SUN_SOFT + 0.5, 0), 1);
    return x * x * (3 - 2 * x);
}

static void test_vis_is_smoothstep(void **state)
{
    (void)state;
    const double quarter = 1.5707963267949, el = 0.7, unit = 255 * 256 / quarter;
    uint8_t h0[256], h1[256];
    int8_t fix[256];
    uint8_t cov[256];
    int16_t vis[256];
    for (int i = 0; i < 256; i++) { cov[i] = 255; h0[i] = (uint8_t)i; h1[i] = (uint8_t)(255 - i); fix[i] = (int8_t)(i % 3 * 127 - 127); }
    for (int f = 0; f <= 256; f += 37)
        for (int mode = 0; mode < 3; mode++) {
            orl_vis_tab t = { 3, 4, f, 255, (int32_t)((el + ORL_SUN_SOFT / 2) * unit), (int32_t)((quarter - el + ORL_SUN_SOFT / 2) * unit) };
            orl_vis_in in = { { h0, h1 }, { mode == 1 ? h0 : NULL, mode == 1 ? h1 : NULL }, mode == 2 ? fix : NULL, cov };
            orl_vis_ref(&in, &t, 256, vis);
            for (int i = 0; i < 256; i++) {
                double h = (i + (255 - 2 * i) * f / 256.0) / 255 * quarter, want = smoothstep(el, h);
                if (mode == 1) want *= smoothstep(quarter - el, h);
                if (mode == 2) want = fmin(fmax(want + (i % 3 - 1), 0), 1);
                assert_true(fabs(vis[i] - 32767 * want) <= 30);
            }
        }
}

/* Of every E, and of the encoding of every u by way of one pixel: within 4e-4 and a tenth of a level. */
static void test_power_and_encoding(void **state)
{
    (void)state;
    double worst = 0;
    for (int e = 2; e < 32768; e++) {
        double want = 32760 * pow(e / 32768.0, 5.0 / 12);
        assert_in_range(orl_power_ref(e), 1, 32767);
        worst = fmax(worst, fabs(orl_power_ref(e) - want) - 1 - 4e-4 * want);
    }
    assert_true(worst <= 0);
    enum { N = 256 };
    static int8_t up[3][N];
    static uint8_t albedo[N], full[N], rgb[3 * N];
    static int16_t lit[N], node[3];
    orl_shade_tab t = { .gain = 8192, .tone_shift = 4, .no_shadow = 32767 };
    for (int c = 0; c < 3; c++) {
        t.ground[c][0] = 32767;                         /* E and its root are 1 (0.9997) of their scale */
        t.tone[c][c] = 16320;                           /* 255 / 256 */
        t.tone_b[c] = 8;
    }
    for (int i = 0; i < N; i++) { albedo[i] = (uint8_t)i; full[i] = 255; }
    orl_shade_ref(&(orl_shade_in){ .normal = { up[0], up[1], up[2] }, .albedo = { albedo, albedo, albedo }, .open = full, .cov = full, .vis = lit, .sky = { node, node, node }, .sky_log2 = 15 }, &t, N, rgb);
    for (int i = 0; i < N; i++) {
        double linear = pow(i / 256.0 * 0.9997 / 1.055, 2.4), want = 255 * (linear > 0.0031308 ? 1.055 * pow(linear, 1 / 2.4) - 0.055 : 12.92 * linear);
        if (fabs(rgb[3 * i] - want) > 0.65) fail_msg("u %d / 256: %d, not %.2f", i, rgb[3 * i], want);
    }
}

/* A box of two and a half pixels over a photo of three steps. */
static void test_warp_is_a_mean(void **state)
{
    (void)state;
    static int16_t column[256 * ORL_WARP_PARTS * 16], row[256 * ORL_WARP_ROWS];
    uint8_t photo[4][4][3], rgb[3];
    for (int y = 0; y < 4; y++) for (int x = 0; x < 4; x++) for (int c = 0; c < 3; c++) photo[y][x][c] = (uint8_t)(60 * x + 7 * y + 3 * c);
    const int f = 64, share[3] = { 192 * 32767 / 640, 256 * 32767 / 640, 32767 - 192 * 32767 / 640 - 256 * 32767 / 640 };      /* of a box from 0.25 to 2.75 */
    for (int k = 0; k < 3; k++) {
        row[f * ORL_WARP_ROWS + k] = (int16_t)(k == 1 ? 102 : 77);
        for (int c = 0; c < 3; c++) column[f * 16 + 3 * k + c] = (int16_t)share[k];
    }
    orl_warp_ref(&(orl_warp_in){ photo[0][0], 12, sizeof photo, &(orl_warp_at){ 3, f, f, 0 }, 4, 1, 0, column, row }, 1, rgb);
    for (int c = 0; c < 3; c++) assert_int_equal(rgb[c], (int)((192 * 67 + 256 * 127 + 192 * 187) / 640.0 - 7 + (192 * 0 + 256 * 7 + 192 * 14) / 640.0 + 3 * c + 0.5));
}

/* No correction and no photo: the render; the photo's whole share: the photo; half a correction between two cells. */
static void test_mix_is_exact(void **state)
{
    (void)state;
    enum { N = 32 };
    static const int16_t none[6] = { 0 }, up[6] = { 320, 320, 960, 960 }, down[6] = { -320, -320, -960, -960 };        /* of cells of 16: 10 and 30 levels */
    uint8_t layer[N] = { 0 }, weight[N] = { 0 }, photo[3 * N], rgb[3 * N];
    for (int i = 0; i < 3 * N; i++) { rgb[i] = (uint8_t)(100 + i); photo[i] = (uint8_t)(2 * i); }
    for (int i = 0; i < N; i += 2) layer[i] = 255;
    weight[1] = 255;
    weight[3] = 128;
    orl_mix_ref(&(orl_mix_in){ .node = { { none, none }, { none, up }, { down, none } }, .log2 = 4, .layer = layer, .weight = weight, .photo = photo }, N, rgb);
    for (int i = 0; i < N; i++) {
        double at = fmin(fmax((i + 0.5 - 8) / 16, 0), 1), more = 10 + 20 * at, add[3] = { 0, layer[i] ? more : 0, layer[i] ? 0 : -more };
        for (int c = 0; c < 3; c++) {
            double want = (photo[3 * i + c] * weight[i] + (100 + 3 * i + c + add[c]) * (255 - weight[i])) / 255;
            if (fabs(rgb[3 * i + c] - want) > (add[c] != 0 && weight[i] < 255 ? 1.05 : 0.51)) fail_msg("pixel %d, channel %d: %d, not %.2f", i, c, rgb[3 * i + c], want);
        }
    }
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
    const struct CMUnitTest tests[] = { cmocka_unit_test(test_bits), cmocka_unit_test(test_vis_is_smoothstep), cmocka_unit_test(test_power_and_encoding), cmocka_unit_test(test_warp_is_a_mean), cmocka_unit_test(test_mix_is_exact), cmocka_unit_test(test_unknown_cpu) };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
