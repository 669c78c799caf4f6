/* The blend: the photo arrives where its camera says, nothing else changes where photo and render agree, an offset along the seam is spread and fades, people do not tint it, and no thread count matters. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "oriel/blend.h"
#include "oriel/cpu.h"

enum { PW = 120, PH = 90, WW = 211, WH = 157, GUARD = 64 };

static orl_camera lens(int w, int h, double f) { return (orl_camera) { ORL_CAM_PINHOLE, w, h, f, f, w / 2.0, h / 2.0, 0, 0, 0, 0 }; }

typedef struct { orl_blend *b; uint8_t *block; size_t need; uint8_t *photo, *wide, *cov; orl_camera pc, wc; } setup;

static const double Q[4] = { 0.9, 0.1, -0.3, 0.2 }, T[3] = { 4, -2, 7 };

/* wide: focal length and size of the wide view; photo and render are filled by the caller. */
static orl_err make(setup *s, orl_camera pc, orl_camera wc, const double *turn, const uint8_t *mask)
{
    orl_pose p, w;
    size_t n = (size_t)wc.w * (size_t)wc.h;
    memset(s, 0, sizeof *s);
    s->pc = pc;
    s->wc = wc;
    s->need = orl_blend_need(wc.w, wc.h);
    s->block = aligned_alloc(64, (s->need + GUARD + 63) & ~(size_t)63);
    memset(s->block + s->need, 0xa5, GUARD);
    s->photo = calloc((size_t)pc.w * (size_t)pc.h, 3);
    s->wide = calloc(n, 3);
    s->cov = malloc(n);
    for (size_t i = 0; i < n; i++) s->cov[i] = i / (size_t)wc.w < (size_t)wc.h / 3 ? 0 : 255;
    assert_int_equal(orl_pose_from_quat(&p, Q, T), ORL_OK);
    w = p;
    if (turn) {
        double c[3];
        orl_pose_centre(&p, c);
        assert_int_equal(orl_pose_from_quat(&w, turn, T), ORL_OK);
        for (int i = 0; i < 3; i++) w.t[i] = -(w.R[3 * i] * c[0] + w.R[3 * i + 1] * c[1] + w.R[3 * i + 2] * c[2]);
    }
    orl_err e = orl_blend_init(&pc, &p, &wc, &w, mask, 2, s->block, s->need, &s->b);
    if (!e) orl_blend_layers(s->b, s->cov, (size_t)wc.w);
    return e;
}

static void drop(setup *s)
{
    for (int i = 0; i < GUARD; i++) assert_int_equal(s->block[s->need + (size_t)i], 0xa5);
    free(s->block); free(s->photo); free(s->wide); free(s->cov);
}

static uint8_t *at(setup *s, int x, int y) { return s->wide + 3 * ((size_t)y * (size_t)s->wc.w + (size_t)x); }

/* Same camera and size: the photo's inside comes through unchanged, its border is the render. */
static void identity(void **state)
{
    (void)state;
    setup s;
    assert_int_equal(make(&s, lens(PW, PH, 100), lens(PW, PH, 100), NULL, NULL), ORL_OK);
    for (size_t i = 0; i < PW * PH * 3; i++) s.photo[i] = (uint8_t)(i * 2654435761u >> 11);
    memset(s.wide, 90, PW * PH * 3);
    orl_blend_apply(s.b, s.photo, s.wide, orl_cpu_detect(), 1);
    for (int y = 6; y < PH - 6; y++) assert_memory_equal(at(&s, 6, y), s.photo + 3 * (y * PW + 6), (PW - 12) * 3);
    drop(&s);
}

/* A linear ramp survives area averaging, so every wide pixel must show the ramp at the place that the two cameras give it: pinhole wider and narrower, turned, and through a distorting lens. */
static void geometry(void **state)
{
    (void)state;
    static const double TURN[4] = { 0.9, 0.12, -0.28, 0.21 };
    for (int kind = 0; kind < 4; kind++) {
        setup s;
        orl_camera pc = lens(PW, PH, 100), wc = lens(WW, WH, kind == 1 ? 260 : 80);
        if (kind == 3) {
            pc.model = ORL_CAM_OPENCV;
            pc.k1 = -0.12;
            pc.k2 = 0.02;
            pc.p1 = 0.002;
        }
        assert_int_equal(make(&s, pc, wc, kind == 2 ? TURN : NULL, NULL), ORL_OK);
        for (int y = 0; y < PH; y++)
            for (int x = 0; x < PW; x++) {
                uint8_t *p = s.photo + 3 * (y * PW + x);
                p[0] = (uint8_t)(2 * x);
                p[1] = (uint8_t)(2 * y);
                p[2] = 77;
            }
        memset(s.wide, 77, WW * WH * 3);
        orl_blend_apply(s.b, s.photo, s.wide, orl_cpu_detect(), 1);
        orl_pose p, w;
        orl_pose_from_quat(&p, Q, T);
        orl_pose_from_quat(&w, kind == 2 ? TURN : Q, T);
        int inside = 0;
        for (int y = 0; y < WH; y++)
            for (int x = 0; x < WW; x++) {
                double d[3], world[3], c[3], uv[2];
                orl_camera_unproject(&wc, x + 0.5, y + 0.5, d);
                orl_pose_ray(&w, d, world);
                for (int i = 0; i < 3; i++) c[i] = p.R[3 * i] * world[0] + p.R[3 * i + 1] * world[1] + p.R[3 * i + 2] * world[2];
                if (!orl_camera_project(&pc, c, uv) || uv[0] < 4 || uv[0] > PW - 4 || uv[1] < 4 || uv[1] > PH - 4) continue;
                assert_true(abs(at(&s, x, y)[0] - (int)(2 * (uv[0] - 0.5) + 0.5)) <= 1);
                assert_true(abs(at(&s, x, y)[1] - (int)(2 * (uv[1] - 0.5) + 0.5)) <= 1);
                assert_int_equal(at(&s, x, y)[2], 77);
                inside++;
            }
        assert_true(inside > 3000);
        drop(&s);
    }
}

/* Photo and render agree: nothing changes anywhere. */
static void agreement(void **state)
{
    (void)state;
    setup s;
    assert_int_equal(make(&s, lens(PW, PH, 150), lens(WW, WH, 100), NULL, NULL), ORL_OK);
    memset(s.photo, 131, PW * PH * 3);
    memset(s.wide, 131, WW * WH * 3);
    orl_blend_apply(s.b, s.photo, s.wide, orl_cpu_detect(), 1);
    for (size_t i = 0; i < WW * WH * 3; i++) assert_int_equal(s.wide[i], 131);
    drop(&s);
}

/* The photo is brighter by 12 on the surface, by -8 in the sky: no step at the seam, each side takes its own correction, both fade outwards and never overshoot. */
static void offset_spreads(void **state)
{
    (void)state;
    setup s;
    assert_int_equal(make(&s, lens(PW, PH, 150), lens(WW, WH, 100), NULL, NULL), ORL_OK);
    double top = WH / 2.0 - PH / 2.0 / 1.5;
    for (int y = 0; y < PH; y++) memset(s.photo + 3 * y * PW, y / 1.5 + top < WH / 3 ? 92 : 112, PW * 3);
    memset(s.wide, 100, WW * WH * 3);
    orl_blend_apply(s.b, s.photo, s.wide, orl_cpu_detect(), 1);
    int y = WH * 2 / 3, edge = (int)(WW / 2.0 + PW / 2.0 / 1.5);
    assert_int_equal(at(&s, WW / 2, y)[0], 112);
    assert_in_range(at(&s, edge + 1, y)[1], 107, 112);      /* a cell is 16 pixels at least: coarse in so small a picture */
    for (int x = edge; x < WW - 1; x++) assert_true(at(&s, x + 1, y)[2] <= at(&s, x, y)[2]);
    assert_in_range(at(&s, WW - 1, y)[0], 100, 106);
    assert_in_range(at(&s, WW / 2, (int)top - 1)[0], 92, 95);
    for (int x = 0; x < WW; x++) assert_in_range(at(&s, x, 0)[0], 92, 100);
    drop(&s);
}

/* Somebody stands at the border: what he wears hardly tints the render beside him, and not at all where he is masked. */
static void people(void **state)
{
    (void)state;
    uint8_t *mask = calloc(PW, PH);
    for (int masked = 0; masked < 2; masked++) {
        setup s;
        for (int y = 30; y < 70; y++) memset(mask + y * PW + PW - 12, 255, 12);
        assert_int_equal(make(&s, lens(PW, PH, 150), lens(WW, WH, 100), NULL, masked ? mask : NULL), ORL_OK);
        memset(s.photo, 100, PW * PH * 3);
        memset(s.wide, 100, WW * WH * 3);
        for (int y = 30; y < 70; y++) memset(s.photo + 3 * (y * PW + PW - 12), 250, 12 * 3);
        orl_blend_apply(s.b, s.photo, s.wide, orl_cpu_detect(), 1);
        for (int y = 0; y < WH; y++)
            for (int x = WW / 2 + PW / 3 + 2; x < WW; x++) assert_in_range(at(&s, x, y)[0], 100, masked ? 100 : 108);
        drop(&s);
    }
    free(mask);
}

static void threads_agree(void **state)
{
    (void)state;
    uint8_t *first = malloc(WW * WH * 3);
    for (int threads = 1; threads <= 4; threads++) {
        setup s;
        assert_int_equal(make(&s, lens(PW, PH, 150), lens(WW, WH, 100), NULL, NULL), ORL_OK);
        for (int round = 0; round < 2; round++) {       /* nothing is left over from the frame before */
            for (size_t i = 0; i < PW * PH * 3; i++) s.photo[i] = (uint8_t)(i * 2654435761u >> 13);
            for (size_t i = 0; i < WW * WH * 3; i++) s.wide[i] = (uint8_t)(i * 2246822519u >> 13);
            orl_blend_apply(s.b, s.photo, s.wide, threads & 1 ? orl_cpu_detect() : ORL_CPU_REF, threads);
        }
        if (threads == 1) memcpy(first, s.wide, WW * WH * 3);
        assert_memory_equal(first, s.wide, WW * WH * 3);
        drop(&s);
    }
    free(first);
}

/* What the photo covers is never read: whatever the render holds there, the picture is the same. */
static void inside_is_unread(void **state)
{
    (void)state;
    uint8_t *first = malloc(WW * WH * 3);
    int covered = 0;
    for (int round = 0; round < 2; round++) {
        setup s;
        assert_int_equal(make(&s, lens(PW, PH, 150), lens(WW, WH, 100), NULL, NULL), ORL_OK);
        for (size_t i = 0; i < PW * PH * 3; i++) s.photo[i] = (uint8_t)(i * 2654435761u >> 13);
        for (size_t i = 0; i < WW * WH * 3; i++) s.wide[i] = (uint8_t)(i * 2246822519u >> 13);
        for (int y = 0; y < WH; y++) {
            int x0, x1;
            orl_blend_covered(s.b, y, &x0, &x1);
            assert_true(x0 >= 0 && x0 <= x1 && x1 <= WW);
            for (int x = x0; x < x1; x++) { covered++; memset(at(&s, x, y), round ? 255 : 0, 3); }
        }
        orl_blend_apply(s.b, s.photo, s.wide, ORL_CPU_REF, 1);
        if (!round) memcpy(first, s.wide, WW * WH * 3);
        assert_memory_equal(first, s.wide, WW * WH * 3);
        drop(&s);
    }
    assert_true(covered > 2 * 2500);            /* of the photo's 80 x 60 */
    free(first);
}

static void extremes(void **state)
{
    (void)state;
    static const int SIZE[][2] = { { 1, 1 }, { 1, 40 }, { 40, 1 }, { 8, 8 }, { 257, 3 }, { 64, 65 } };
    for (size_t i = 0; i < sizeof SIZE / sizeof *SIZE; i++)
        for (int k = 0; k < 4; k++) {
            setup s;
            assert_int_equal(make(&s, lens(PW, PH, 100), lens(SIZE[i][0], SIZE[i][1], k & 1 ? 2 : 300), NULL, NULL), ORL_OK);
            memset(s.photo, k & 2 ? 255 : 0, PW * PH * 3);
            memset(s.wide, k & 2 ? 0 : 255, (size_t)SIZE[i][0] * (size_t)SIZE[i][1] * 3);
            orl_blend_apply(s.b, s.photo, s.wide, orl_cpu_detect(), 1);
            drop(&s);
        }
}

static void refusals(void **state)
{
    (void)state;
    setup s;
    orl_pose p, w;
    assert_int_equal(make(&s, lens(PW, PH, 150), lens(WW, WH, 100), NULL, NULL), ORL_OK);
    orl_pose_from_quat(&p, Q, T);
    w = p;
    w.t[0] += 0.1;
    orl_blend *b = s.b;
    assert_int_equal(orl_blend_init(&s.pc, &p, &s.wc, &w, NULL, 1, s.block, s.need, &b), ORL_E_RANGE);
    assert_int_equal(orl_blend_init(&s.pc, &p, &s.wc, &p, NULL, 1, s.block, s.need - 1, &b), ORL_E_MEMORY);
    assert_ptr_equal(b, s.b);
    drop(&s);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(identity), cmocka_unit_test(geometry), cmocka_unit_test(agreement), cmocka_unit_test(offset_spreads), cmocka_unit_test(people), cmocka_unit_test(threads_agree), cmocka_unit_test(inside_is_unread),
        cmocka_unit_test(extremes), cmocka_unit_test(refusals),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
