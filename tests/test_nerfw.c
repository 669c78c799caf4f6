/* The NeRF-W baseline: gradients of a whole step against finite differences, repeatability, degenerate photos, the file's quartet, and that a new photo's right half never leaks. */
#include <math.h>
#include "tests/scratch.h"
#include "tests/wall_world.h"
#include "trainer/eval.h"

static const nerfw_options OPT = { ENC_OURS, 64, 2, 7 };

typedef struct { const char *name; float *p, *g[2]; size_t n; float h; } params;
enum { BLOCKS = 6 };
static void all_params(nerfw *n, params b[BLOCKS])
{
    mlp *m[4] = { &n->base, &n->colour, &n->transient, &n->sky };
    static const char *const NAME[4] = { "base", "colour", "transient", "sky" };
    for (int k = 0; k < 4; k++) b[k] = (params){ NAME[k], m[k]->p, { m[k]->g[0], m[k]->g[1] }, m[k]->size, 1e-3f };
    b[4] = (params){ "codes", n->codes.p, { n->codes.g[0], n->codes.g[1] }, n->codes.nverts * 32, 3e-3f };
    b[5] = (params){ "encoding", (float *)n->enc.p, { (float *)n->enc.g[0], (float *)n->enc.g[1] }, n->enc.units * 8, 3e-3f };
}

static double total(nerfw *n)
{
    nerfw_losses l;
    mlp_refresh(&n->base); mlp_refresh(&n->colour); mlp_refresh(&n->transient); mlp_refresh(&n->sky);
    nerfw_gradients(n, 0.5f, &l);
    return l.total;
}

/* The largest gradients of each block. Where samples lie depends on the density grid alone, which stays. */
static void gradients_match_finite_differences(void **state)
{
    (void)state;
    for (int kind = 0; kind < ENC_KINDS; kind++) {
        world w;
        nerfw n;
        params b[BLOCKS];
        int bad = 0;
        make_world(&w);
        nerfw_options o = OPT;
        o.encoding = (enc_kind)kind;
        ok(nerfw_init(&n, &w, &o));
        n.heuristics = 0;
        rng r = rng_make(3, 0, 0);
        for (size_t i = 0; i < n.enc.units * 8; i++) ((float *)n.enc.p)[i] = 0.5f * rng_normal(&r);
        all_params(&n, b);
        for (size_t i = 0; i < b[4].n; i++) b[4].p[i] = 0.5f * rng_normal(&r);
        total(&n);
        for (int k = 0; k < BLOCKS; k++) {
            size_t best[5];
            double grad[5];
            for (size_t i = 0; i < b[k].n; i++) { b[k].g[0][i] += b[k].g[1][i]; b[k].g[1][i] = 0; }
            for (int q = 0; q < 5; q++) {
                best[q] = 0;
                for (size_t i = 0; i < b[k].n; i++) if (fabsf(b[k].g[0][i]) > fabsf(b[k].g[0][best[q]])) best[q] = i;
                grad[q] = b[k].g[0][best[q]];
                b[k].g[0][best[q]] = 0;
            }
            for (int q = 0; q < 5; q++) {
                float keep = b[k].p[best[q]];
                b[k].p[best[q]] = keep + b[k].h;
                double up = total(&n);
                b[k].p[best[q]] = keep - b[k].h;
                double fd = (up - total(&n)) / (2 * b[k].h);
                b[k].p[best[q]] = keep;
                if (fabs(fd - grad[q]) > 0.03 * fabs(fd) + 2e-3) { printf("%s %s[%zu]: gradient %g, finite difference %g\n", ENC_NAME[kind], b[k].name, best[q], grad[q], fd); bad++; }
            }
            for (int j = 0; j < BLOCKS; j++) for (int t = 0; t < 2; t++) memset(b[j].g[t], 0, b[j].n * sizeof(float));
            total(&n);
        }
        assert_true(bad <= 1);      /* of 30: a step may cross a kink */
        nerfw_free(&n);
        world_free(&w);
    }
}

static void steps_repeat_and_learn(void **state)
{
    (void)state;
    world w;
    make_world(&w);
    for (int k = 0; k < 2; k++)                /* what can be learnt: ramps, of two lights */
        for (int q = 0; q < 24 * 24 * 3; q++) w.photos[k].rgb[q] = (uint8_t)(30 + 3 * (q / 72) + 40 * (q % 3) + 30 * k);
    for (int kind = 0; kind < ENC_KINDS; kind++) {
        uint8_t *bytes[2];
        size_t size[2];
        for (int run = 0; run < 2; run++) {
            nerfw n;
            nerfw_losses l = { 0 };
            nerfw_options o = OPT;
            o.encoding = (enc_kind)kind;
            double first = 0, last = 0;
            ok(nerfw_init(&n, &w, &o));
            for (int i = 0; i < 60; i++) {
                nerfw_step(&n, (float)i / 60, &l);
                if (i < 5) first += l.mse;
                if (i >= 55) last += l.mse;
                assert_true(isfinite(l.total));
            }
            print_message("figure %s: mse %.3f in the first steps, %.3f in the last\n", ENC_NAME[kind], first / 5, last / 5);
            assert_true(last < 0.5 * first);
            ok(nerfw_save(&n, at("%d", run)));
            nerfw_free(&n);
            ok(orl_file_read(at("%d", run), (size_t)1 << 30, &bytes[run], &size[run]));
        }
        assert_int_equal(size[0], size[1]);
        assert_memory_equal(bytes[0], bytes[1], size[0]);
        free(bytes[0]); free(bytes[1]);
    }
    world_free(&w);
}

/* Black and saturated photos, all sky, cameras outside the box and looking away: finite, and a file that loads. */
static void degenerate_worlds_stay_finite(void **state)
{
    (void)state;
    for (int what = 0; what < 5; what++) {
        world w;
        nerfw n, m;
        nerfw_losses l;
        make_world(&w);
        for (int k = 0; k < 2; k++) {
            world_photo *p = &w.photos[k];
            if (what < 2) memset(p->rgb, what ? 255 : 0, (size_t)(p->w * p->h * 3));
            for (int i = 0; what == 2 && i < p->w * p->h; i++) world_set_label(p, i % p->w, i / p->w, WORLD_SKY);
            if (what == 3) p->centre[1] = -1e7;
            if (what == 4) p->centre[1] = 1e3;
        }
        ok(nerfw_init(&n, &w, &OPT));
        for (int i = 0; i < 40; i++) {
            nerfw_step(&n, (float)i / 40, &l);
            assert_true(isfinite(l.total));
        }
        ok(nerfw_save(&n, at("x")));
        ok(nerfw_load(at("x"), &m));
        nerfw_free(&n);
        nerfw_free(&m);
        world_free(&w);
    }
}

/* Truncations, extra bytes, bad header, wrong version: one line that names file and field, and the out-pointer untouched. */
static void bad_files_are_refused(void **state)
{
    (void)state;
    world w;
    nerfw n, m;
    uint8_t *b;
    size_t size;
    make_world(&w);
    ok(nerfw_init(&n, &w, &OPT));
    ok(nerfw_save(&n, at("good")));
    nerfw_free(&n);
    world_free(&w);
    ok(orl_file_read(at("good"), (size_t)1 << 30, &b, &size));
    for (size_t cut = 0; cut < size; cut += cut < 256 ? 1 : size / 7) {
        put_bytes(at("bad"), b, cut);
        failed(nerfw_load(at("bad"), &m), ORL_E_FORMAT, "bad", NULL);
    }
    uint8_t *more = calloc(1, size + 5);
    memcpy(more, b, size);
    put_bytes(at("bad"), more, size + 5);
    failed(nerfw_load(at("bad"), &m), ORL_E_FORMAT, "bad", "bytes", NULL);
    static const struct { size_t at; uint32_t value; orl_err e; const char *word; } CASES[] = {
        { 0, 0, ORL_E_FORMAT, "not a NeRF-W" }, { 8, 2, ORL_E_UNSUPPORTED, "version" }, { 12, 7, ORL_E_FORMAT, "encoding" }, { 12, ENC_TEXTBOOK, ORL_E_FORMAT, "bytes" },
        { 16 + offsetof(frame, dims), 0, ORL_E_RANGE, "frame" }, { 16 + offsetof(frame, dims), 1u << 31, ORL_E_RANGE, "frame" }, { 16 + offsetof(frame, dims), 8000, ORL_E_FORMAT, "bytes" },
        { 16 + offsetof(frame, scale) + 4, 0x7ff80000u, ORL_E_RANGE, "frame" }, { 16 + sizeof(frame), 0, ORL_E_RANGE, "photos" }, { 16 + sizeof(frame), 900000, ORL_E_FORMAT, "bytes" },
    };
    for (size_t i = 0; i < sizeof CASES / sizeof *CASES; i++) {
        memcpy(more, b, size);
        memcpy(more + CASES[i].at, &CASES[i].value, 4);
        put_bytes(at("bad"), more, size);
        failed(nerfw_load(at("bad"), &m), CASES[i].e, "bad", CASES[i].word, NULL);
    }
    memcpy(more, b, size);
    memcpy(more + size / 2 / 4 * 4, &(float){ NAN }, 4);
    put_bytes(at("bad"), more, size);
    failed(nerfw_load(at("bad"), &m), ORL_E_RANGE, "bad", "value", NULL);
    free(more); free(b);
}

/* Noise over the right half leaves the code and every pixel as they were; given the whole photo, both move. */
static void the_right_half_does_not_leak(void **state)
{
    (void)state;
    enum { W = 24, H = 24 };
    world w;
    nerfw n;
    nerfw_losses l;
    make_world(&w);
    ok(nerfw_init(&n, &w, &OPT));
    for (int i = 0; i < 60; i++) nerfw_step(&n, (float)i / 60, &l);
    orl_camera cam = w.photos[0].cam;
    orl_pose pose;
    ok(orl_pose_from_quat(&pose, (double[]){ 0.70710678, 0.70710678, 0, 0 }, (double[]){ -14, 12, -1 }));   /* looks along +y, as the world's cameras do */
    orl_image photo = { .w = W, .h = H, .c = 3, .px = w.photos[0].rgb }, painted;
    ok(orl_image_alloc(&painted, W, H, 3));
    memcpy(painted.px, photo.px, W * H * 3);
    for (int y = 0; y < H; y++) for (int x = W / 2 * 3; x < W * 3; x++) painted.px[y * W * 3 + x] = (uint8_t)(rnd() >> 3);
    eval_setup setup = { .nerfw = &n, .threads = 1 };
    eval_prediction p[4];
    for (int k = 0; k < 4; k++) ok(eval_predict(&setup, &cam, &pose, k & 1 ? &painted : &photo, k < 2 ? W / 2 : W, &p[k]));
    assert_memory_equal(p[0].nerfw_code, p[1].nerfw_code, sizeof p[0].nerfw_code);
    assert_memory_equal(p[0].rgb[EVAL_NERFW].px, p[1].rgb[EVAL_NERFW].px, W * H * 3);
    assert_true(memcmp(p[2].nerfw_code, p[3].nerfw_code, sizeof p[0].nerfw_code) != 0);
    assert_true(memcmp(p[2].rgb[EVAL_NERFW].px, p[3].rgb[EVAL_NERFW].px, W * H * 3) != 0);
    for (int k = 0; k < 4; k++) eval_prediction_free(&p[k]);
    orl_image_free(&painted);
    nerfw_free(&n);
    world_free(&w);
}

int main(void)
{
    seed_print();
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(gradients_match_finite_differences), cmocka_unit_test_setup_teardown(steps_repeat_and_learn, scratch_make, scratch_remove),
        cmocka_unit_test_setup_teardown(degenerate_worlds_stay_finite, scratch_make, scratch_remove), cmocka_unit_test_setup_teardown(bad_files_are_refused, scratch_make, scratch_remove),
        cmocka_unit_test(the_right_half_does_not_leak),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
