/* Rays: every variant of the kernel against the plain C one, bit for bit, on a scene, on noise and on rays that no camera has; and how far a ball of rays goes freely, against steps along them. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>
#include <time.h>
#include "oriel/cpu.h"
#include "runtime/march.h"
#include "tests/synth_scene.h"

typedef void kernel(const orl_scene *, int, int, orl_rays *);
typedef struct { const char *name; kernel *march; unsigned needs; } variant;
static const variant VARIANTS[] = {
#if defined(__x86_64__)
    { "avx2", orl_rays_march_avx2, ORL_CPU_AVX2 }, { "avx512", orl_rays_march_avx512, ORL_CPU_AVX512 },
#elif defined(__aarch64__)
    { "neon", orl_rays_march_neon, ORL_CPU_NEON },
#endif
    { "ref", orl_rays_march_ref, 0 },
};

static uint64_t seed, state_of;
static uint32_t next(void) { state_of = state_of * 6364136223846793005u + 1442695040888963407u; return (uint32_t)(state_of >> 33); }
static double unit(void) { return (double)next() / 2147483648.0; }

static void direction(double d[3])
{
    double len = 0;
    for (int a = 0; a < 3; a++) {
        d[a] = next() % 8 ? 2 * unit() - 1 : 0;     /* along axes and planes, too */
        len += d[a] * d[a];
    }
    if (!(len > 0)) { d[next() % 3] = next() & 1 ? 1 : -1; return; }
    for (int a = 0; a < 3; a++) d[a] /= sqrt(len);
}

static void rays(const orl_scene *s, int n, orl_march *m)
{
    memset(m, 0xff, sizeof *m);                     /* what is not a ray may hold anything */
    m->n = 0;
    while (m->n < n) {
        double o[3], d[3];
        direction(d);
        for (int a = 0; a < 3; a++) o[a] = 8.0 * s->nb[a] * (next() % 4 ? unit() : next() % 4 ? 3 * unit() - 1 : next() & 1);
        orl_march_begin(s, o, d, next() % 4 ? 0 : 20 * unit(), m);
        if (next() % 64 == 0) m->rays.within[m->n - 1] = 0;
    }
    for (int k = m->n; k < ORL_RAYS; k++) m->rays.end[k] = 0;
}

static int hits, cuts;

static void compare(const orl_scene *s, int rounds)
{
    static orl_march in;
    static orl_rays want, got;
    for (int round = 0; round < rounds; round++) {
        int n = ORL_RAY_STEP * (1 + (int)(next() % (ORL_RAYS / ORL_RAY_STEP))), refine = (int)(next() & 1);
        rays(s, n - (int)(next() % ORL_RAY_STEP), &in);
        want = in.rays;
        orl_rays_march_ref(s, n, refine, &want);
        for (size_t v = 0; v < sizeof VARIANTS / sizeof *VARIANTS; v++) {
            if (VARIANTS[v].needs & ~orl_cpu_detect()) continue;
            got = in.rays;
            VARIANTS[v].march(s, n, refine, &got);
            for (int k = 0; k < n; k++)
                if (memcmp(&want.t[k], &got.t[k], 4) || want.brick[k] != got.brick[k] || want.cut[k] != got.cut[k])
                    fail_msg("%s, seed %llu, round %d: ray %d: t %.9g %.9g, brick %d %d, cut %d %d", VARIANTS[v].name, (unsigned long long)seed, round, k, (double)want.t[k], (double)got.t[k], want.brick[k], got.brick[k], want.cut[k], got.cut[k]);
            assert_memory_equal(&want, &got, sizeof want);              /* nothing else is written */
        }
        for (int k = 0; k < n; k++) {
            assert_true(want.t[k] == -1 ? want.brick[k] == -1 && !want.cut[k] : want.t[k] >= 0 && want.t[k] < want.end[k] && want.brick[k] >= 0 && (uint32_t)want.brick[k] < s->nbricks);
            hits += want.t[k] >= 0;
            cuts += want.cut[k] != 0;
        }
    }
}

static void scene_rays(void **state)
{
    (void)state;
    orl_scene s;
    synth_scene_make(&s, 8, 7, 6);
    hits = cuts = 0;
    compare(&s, 60);
    int32_t *map = (int32_t *)s.bmap;               /* bricks that nobody saw */
    for (int i = 0; i < 8 * 7 * 6; i++) if (map[i] >= 0 && next() % 4 == 0) map[i] = -1;
    compare(&s, 60);
    print_message("%d hits, %d of them cuts\n", hits, cuts);
    assert_true(hits > 1500 && cuts > 300);
    synth_scene_free(&s);
}

/* Bytes at random, distances that do not fit: still defined, still the same, still inside the arrays. */
static void noise(void **state)
{
    (void)state;
    enum { SIDE = 5, PLACES = SIDE * SIDE * SIDE, BRICKS = 20 };
    int32_t map[PLACES];
    int8_t *sdf = malloc(BRICKS * ORL_BRICK_VERTS + 2);
    orl_scene s = { .nb = { SIDE, SIDE, SIDE }, .nbricks = BRICKS, .bmap = map, .sdf = sdf };
    for (int kind = 0; kind < 6; kind++) {
        for (int i = 0; i < PLACES; i++) map[i] = next() % 3 ? -1 - (int)(next() % (kind & 1 ? 127u : 2u)) : (int)(next() % BRICKS);
        for (int i = 0; i < BRICKS * ORL_BRICK_VERTS; i++) sdf[i] = (int8_t)(kind / 2 == 0 ? (int)(next() & 255) : kind / 2 == 1 ? (next() & 1 ? 127 : -128) : 1 + (int)(next() % 3));
        compare(&s, 12);
    }
    free(sdf);
}

static void freely(void **state)
{
    (void)state;
    orl_scene s;
    synth_scene_make(&s, 8, 8, 6);
    int far = 0, never = 0;
    for (int i = 0; i < 4000; i++) {
        double o[3], d[3], spread = 0.2 * unit() * unit(), t;
        direction(d);
        for (int a = 0; a < 3; a++) o[a] = 8.0 * s.nb[a] * (3 * unit() - 1);
        if (i % 4) {                                /* towards the box */
            double len = 0;
            for (int a = 0; a < 3; a++) { d[a] = 8.0 * s.nb[a] * unit() - o[a]; len += d[a] * d[a]; }
            for (int a = 0; a < 3; a++) d[a] /= sqrt(len);
        }
        t = orl_march_freely(&s, o, d, spread);
        assert_true(t >= 0 && t <= 1e12);
        far += t > 10 && t < 1e12;
        never += t >= 1e12;
        for (int k = 0; k < 8; k++) {               /* rays in the ball */
            double e[3], len = 0, way[3];
            direction(e);
            for (int a = 0; a < 3; a++) { way[a] = d[a] + 0.9 * spread * e[a]; len += way[a] * way[a]; }
            double off = 0;
            for (int a = 0; a < 3; a++) { way[a] /= sqrt(len); off += (way[a] - d[a]) * (way[a] - d[a]); }
            if (off > spread * spread) continue;
            for (double u = 0; u < t && u < 300; u += 0.25) {
                int at[3], in = 1;
                for (int a = 0; a < 3; a++) {
                    double p = (o[a] + u * way[a]) / 8;
                    in &= p >= 0 && p < s.nb[a];
                    at[a] = (int)p;
                }
                if (in && s.bmap[(at[2] * (int)s.nb[1] + at[1]) * (int)s.nb[0] + at[0]] >= 0) fail_msg("seed %llu, ball %d: a brick at %g of %g", (unsigned long long)seed, i, u, t);
            }
        }
    }
    print_message("%d balls went far, %d for ever\n", far, never);
    assert_true(far > 500 && never > 300);
    const double nan3[3] = { NAN, 0, 0 }, down[3] = { 0, 0, -1 }, o[3] = { 30, 30, 40 };
    assert_true(orl_march_freely(&s, nan3, down, 0.1) == 0);
    assert_true(orl_march_freely(&s, o, (const double[3]){ 0, 0, 0 }, 0) < 1e13);
    synth_scene_free(&s);
}

int main(void)
{
    seed = state_of = (uint64_t)time(NULL);
    print_message("seed %llu\n", (unsigned long long)seed);
    const struct CMUnitTest tests[] = { cmocka_unit_test(scene_rays), cmocka_unit_test(noise), cmocka_unit_test(freely) };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
