/* Marks of what anything looks at: with all else overwritten, every ray that meets the surface finds the same colour and light; and they leave something out. */
#include "tests/scratch.h"
#include "runtime/march.h"
#include "tests/synth_scene.h"
#include "trainer/used.h"

static uint32_t rng;
static uint32_t draw(void) { rng ^= rng << 13; rng ^= rng >> 17; return rng ^= rng << 5; }
static double unit(void) { return draw() / 4294967296.0; }

typedef struct { int met; orl_hit hit; uint16_t lite[ORL_LITE_BYTES]; int16_t phi[ORL_SHADOW_DIM]; } seen_at;

static seen_at meet(const orl_scene *s, const double o[3], const double d[3])
{
    static orl_march m;
    seen_at r;
    memset(&r, 0, sizeof r);
    m.n = 0;
    orl_march_begin(s, o, d, 0, &m);
    orl_march_run(s, 1, &m);
    if (!(r.met = orl_march_hit(s, &m, 0, &r.hit))) return r;
    orl_march_surface(s, &r.hit);
    orl_march_light(s, r.hit.brick, r.hit.at, r.lite, r.phi);
    return r;
}

static void test_the_rest_is_not_seen(void **state)
{
    (void)state;
    static uint8_t ground[ORL_GROUND_SIDE * ORL_GROUND_SIDE * 3];
    orl_scene s;
    synth_scene_make(&s, 8, 8, 6);
    assert_int_equal(used_mark(&s), ORL_OK);
    assert_null(s.texel_used);                  /* no ground: cuts are looked at */
    s.ground_albedo = ground;
    s.step[ORL_PACK_SDF].step[0] = 1;
    assert_int_equal(used_mark(&s), ORL_OK);
    orl_scene other = s;
    size_t texels = (size_t)s.ntextures * ORL_SKIN_TEXELS, lights = (size_t)s.nbricks * ORL_LITE_VERTS, seen[2] = { 0 };
    uint8_t *albedo = malloc(texels * 3), *lite = malloc(lights * ORL_LITE_BYTES);
    int8_t *shadow = malloc(lights * ORL_SHADOW_DIM);
    for (size_t i = 0; i < texels; i++) {
        seen[0] += s.texel_used[i];
        for (size_t c = 0; c < 3; c++) albedo[3 * i + c] = s.texel_used[i] ? s.albedo[3 * i + c] : (uint8_t)draw();
    }
    for (size_t i = 0; i < lights; i++) {
        seen[1] += s.light_used[i];
        for (size_t c = 0; c < ORL_LITE_BYTES; c++) lite[i * ORL_LITE_BYTES + c] = s.light_used[i] ? s.lite[i * ORL_LITE_BYTES + c] : (uint8_t)draw();
        for (size_t c = 0; c < ORL_SHADOW_DIM; c++) shadow[i * ORL_SHADOW_DIM + c] = s.light_used[i] ? s.shadow[i * ORL_SHADOW_DIM + c] : (int8_t)draw();
    }
    other.albedo = albedo;
    other.lite = lite;
    other.shadow = shadow;
    int hits = 0;
    for (int k = 0; k < 200000; k++) {
        double o[3], d[3], len = 0;
        for (int a = 0; a < 3; a++) {
            o[a] = 8 * s.nb[a] * (1.6 * unit() - 0.3);
            d[a] = 8 * s.nb[a] * unit() - o[a];
            len += d[a] * d[a];
        }
        for (int a = 0; a < 3; a++) d[a] /= sqrt(len);
        seen_at a = meet(&s, o, d), b = meet(&other, o, d);
        assert_int_equal(a.met, b.met);
        if (!a.met || a.hit.cut) continue;
        hits++;
        assert_memory_equal(&a, &b, sizeof a);
    }
    print_message("figure: %.1f %% of the texels and %.1f %% of the light vertices count, %d hits\n", 100.0 * (double)seen[0] / (double)texels, 100.0 * (double)seen[1] / (double)lights, hits);
    assert_true(hits > 20000 && seen[0] < texels && seen[1] < lights);
    free(albedo);
    free(lite);
    free(shadow);
    used_free(&s);
    s.ground_albedo = NULL;
    synth_scene_free(&s);
}

int main(void)
{
    rng = getenv("SEED") ? (uint32_t)atoi(getenv("SEED")) | 1 : (uint32_t)time(NULL) | 1;
    print_message("seed %u\n", rng);
    const struct CMUnitTest tests[] = { cmocka_unit_test(test_the_rest_is_not_seen) };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
