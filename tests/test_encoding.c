/* Both encodings: continuous, linear in their parameters, gradients exact, the optimiser touches what was touched and nothing else, runs repeat. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <cmocka.h>
#include "trainer/encoding.h"

enum { N = 320 };
static const int SMALL[3] = { 48, 32, 16 }, LARGE[3] = { 512, 304, 160 };   /* LARGE: fine levels are hashed */

typedef struct { float x[N][3], out[N * ENC_WIDTH], d[N * ENC_WIDTH]; void *keep; } room;

static room *room_make(const encoding *e, const int dims[3], uint64_t seed)
{
    room *r = aligned_alloc(64, (sizeof *r + 63) & ~(size_t)63);
    r->keep = aligned_alloc(64, (N * e->keep + 63) & ~(size_t)63);
    rng g = rng_make(seed, 0, 0);
    for (int i = 0; i < N; i++) for (int a = 0; a < 3; a++) r->x[i][a] = (float)dims[a] * rng_f(&g);
    for (int i = 0; i < N * ENC_WIDTH; i++) r->d[i] = 2 * rng_f(&g) - 1;
    return r;
}

static void room_free(room *r) { free(r->keep); free(r); }
static void forward(const encoding *e, room *r) { enc_forward(e, N, (const float (*)[3])r->x, r->out, r->keep); }
static double loss(const encoding *e, room *r)
{
    double s = 0;
    forward(e, r);
    for (int i = 0; i < N * ENC_WIDTH; i++) s += (double)r->out[i] * r->d[i];
    return s;
}

static void randomise(encoding *e, uint64_t seed)
{
    rng g = rng_make(seed, 1, 0);
    for (size_t i = 0; i < e->units * 8; i++) ((float *)e->p)[i] = 2 * rng_f(&g) - 1;
}

/* Interpolation reproduces constants, and small steps across cells, tiles and tetrahedra make small changes. */
static void features_are_continuous(void **state)
{
    (void)state;
    for (int kind = 0; kind < ENC_KINDS; kind++)
        for (int big = 0; big < 2; big++) {
            const int *dims = big ? LARGE : SMALL;
            encoding e;
            assert_int_equal(enc_init(&e, (enc_kind)kind, dims, 1, 0), ORL_OK);
            room *r = room_make(&e, dims, 3);
            for (size_t i = 0; i < e.units * 8; i++) ((float *)e.p)[i] = 0.75f;
            forward(&e, r);
            for (int i = 0; i < N * ENC_WIDTH; i++) assert_true(fabsf(r->out[i] - 0.75f) < 1e-5f);
            randomise(&e, 4);
            for (int i = 0; i < N; i++) for (int a = 0; a < 3; a++) r->x[i][a] = (float)dims[a] * (0.2f + 0.6f * (float)i / N) + (a ? 0.37f * (float)a : 0);
            for (int i = 1; i < N; i += 2) for (int a = 0; a < 3; a++) r->x[i][a] = r->x[i - 1][a] + (a == i / 2 % 3 ? 1e-3f : 0);
            for (int i = 0; i < 64; i += 2) { int a = i / 2 % 3; r->x[i][a] = (float)(4 * (i / 8 + 1)) - 5e-4f; r->x[i + 1][a] = r->x[i][a] + 1e-3f; }    /* across faces of tiles */
            forward(&e, r);
            for (int i = 0; i < N; i += 2) for (int j = 0; j < ENC_WIDTH; j++) assert_true(fabsf(r->out[i * ENC_WIDTH + j] - r->out[(i + 1) * ENC_WIDTH + j]) < 0.01f);
            room_free(r);
            enc_free(&e);
        }
}

static void gradients_match_finite_differences(void **state)
{
    (void)state;
    for (int kind = 0; kind < ENC_KINDS; kind++)
        for (int big = 0; big < 2; big++) {
            encoding e;
            assert_int_equal(enc_init(&e, (enc_kind)kind, big ? LARGE : SMALL, 1, 2), ORL_OK);
            room *r = room_make(&e, big ? LARGE : SMALL, 5);
            randomise(&e, 6);
            forward(&e, r);
            enc_backward(&e, 1, N, r->keep, r->d);
            rng g = rng_make(7, 0, 0);
            int seen = 0;
            float *p = (float *)e.p, *grad = (float *)e.g[1];
            for (int tries = 0; seen < 40 && tries < 100000000; tries++) {
                size_t i = (size_t)(((uint64_t)rng_u32(&g) << 20 ^ rng_u32(&g)) % (e.units * 8));
                if (grad[i] == 0) continue;
                assert_true(e.dirty[1][i / 512] >> (i / 8 & 63) & 1);
                seen++;
                float keep = p[i];
                p[i] = keep + 0.25f;
                double up = loss(&e, r);
                p[i] = keep - 0.25f;
                double fd = (up - loss(&e, r)) / 0.5;
                p[i] = keep;
                if (fabs(fd - grad[i]) > 1e-3 + 1e-3 * fabs(fd)) fail_msg("%s %d, parameter %zu: gradient %g, finite difference %g", ENC_NAME[kind], big, i, grad[i], fd);
            }
            assert_int_equal(seen, 40);
            room_free(r);
            enc_free(&e);
        }
}

/* What has no gradient keeps its bits; what has moves against it by the learning rate; the gradients are cleared; two threads' shares add up in any split of work. */
static void the_optimiser_visits_what_was_touched(void **state)
{
    (void)state;
    for (int kind = 0; kind < ENC_KINDS; kind++) {
        float *seen[2];
        size_t floats = 0;
        for (int run = 0; run < 2; run++) {
            encoding e;
            assert_int_equal(enc_init(&e, (enc_kind)kind, LARGE, 1, 2), ORL_OK);
            room *r = room_make(&e, LARGE, 8);
            floats = e.units * 8;
            float *before = malloc(floats * sizeof *before), *grad = calloc(floats, sizeof *grad), *p = (float *)e.p;
            memcpy(before, p, floats * sizeof *before);
            forward(&e, r);
            enc_backward(&e, 0, N, r->keep, r->d);
            enc_backward(&e, 1, N, r->keep, r->d);
            for (size_t i = 0; i < floats; i++) grad[i] = ((float *)e.g[0])[i] + ((float *)e.g[1])[i];
            size_t units = 0, visited = enc_adam(&e, 0.01f, 1 + run);
            for (size_t i = 0; i < floats; i += 8) {
                int any = 0;
                for (size_t j = i; j < i + 8; j++) {
                    any |= grad[j] != 0;
                    if (grad[j] == 0) assert_true(p[j] == before[j]);
                    else if (fabsf(grad[j]) > 1e-6f) assert_true(fabsf(before[j] - p[j] - (grad[j] > 0 ? 0.01f : -0.01f)) < 1e-4f);
                    assert_true(((float *)e.g[0])[j] == 0 && ((float *)e.g[1])[j] == 0);
                }
                units += (size_t)any;
            }
            assert_true(visited >= units && visited <= units + N);      /* corners of weight 0 are visited too */
            assert_int_equal(enc_adam(&e, 0.01f, 1), 0);
            seen[run] = malloc(floats * sizeof(float));
            memcpy(seen[run], p, floats * sizeof(float));
            free(before); free(grad);
            room_free(r);
            enc_free(&e);
        }
        assert_memory_equal(seen[0], seen[1], floats * sizeof(float));
        free(seen[0]); free(seen[1]);
    }
}

/* Positions outside the box, infinite or NaN, stay within the tables and give finite features. */
static void strange_positions_are_harmless(void **state)
{
    (void)state;
    static const float ODD[] = { -1, 1e9f, INFINITY, -INFINITY, NAN, 512, 0, -0.0f };
    for (int kind = 0; kind < ENC_KINDS; kind++) {
        encoding e;
        assert_int_equal(enc_init(&e, (enc_kind)kind, LARGE, 1, 1), ORL_OK);
        room *r = room_make(&e, LARGE, 9);
        for (int i = 0; i < N; i++) for (int a = 0; a < 3; a++) r->x[i][a] = ODD[(i / (a == 0 ? 1 : a == 1 ? 8 : 64)) % 8];
        forward(&e, r);
        enc_backward(&e, 0, N, r->keep, r->d);
        for (int i = 0; i < N * ENC_WIDTH; i++) assert_true(isfinite(r->out[i]));
        room_free(r);
        enc_free(&e);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(features_are_continuous), cmocka_unit_test(gradients_match_finite_differences), cmocka_unit_test(the_optimiser_visits_what_was_touched),
        cmocka_unit_test(strange_positions_are_harmless),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
