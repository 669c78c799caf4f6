/* Scene file: round trip, byte identity, the quartet (truncation, extra bytes, bad header, wrong version), flipped bytes, counts at extremes. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>
#include <stdio.h>
#include <unistd.h>
#include "oriel/image.h"
#include "tests/synth_scene.h"

static char path[64], path2[64];
static uint8_t *file;               /* a tiny scene as written, 64-byte aligned */
static size_t file_n;

static const orl_facings FACINGS = { 3, { { 0, 0, 1 }, { 0.6f, -0.8f, 0 }, { -0.48f, 0.6f, -0.64f } } };

static uint8_t BACKDROP[ORL_BACK_TEXELS * 4], GROUND[ORL_GROUND_SIDE * ORL_GROUND_SIDE * 3];

static uint8_t *load(const char *p, size_t *n)
{
    uint8_t *raw, *b;
    assert_int_equal(orl_file_read(p, 1 << 28, &raw, n), ORL_OK);
    b = aligned_alloc(64, (*n + 127) & ~(size_t)63);
    assert_non_null(b);
    memcpy(b, raw, *n);
    free(raw);
    return b;
}

static int setup(void **state)
{
    (void)state;
    orl_scene s;
    snprintf(path, sizeof path, "/tmp/orl_scene_%d.oriel", (int)getpid());
    snprintf(path2, sizeof path2, "/tmp/orl_scene_%d_b.oriel", (int)getpid());
    synth_scene_make(&s, 2, 1, 3);
    s.facings = FACINGS;
    size_t n = 0;
    orl_err e = orl_scene_write(path, &s, &n);
    if (e) print_message("%s\n", orl_error_text());
    assert_int_equal(e, ORL_OK);
    file = load(path, &file_n);
    assert_int_equal(n, file_n);
    synth_scene_free(&s);
    return 0;
}

static int teardown(void **state)
{
    (void)state;
    free(file);
    unlink(path);
    unlink(path2);
    return 0;
}

static void put32(uint8_t *p, uint32_t v) { memcpy(p, &v, 4); }
static void put64(uint8_t *p, uint64_t v) { memcpy(p, &v, 8); }

static uint32_t crc32_slow(const uint8_t *p, size_t n)
{
    uint32_t crc = ~0u;
    for (; n; n--) {
        crc ^= *p++;
        for (int k = 0; k < 8; k++) crc = crc & 1 ? crc >> 1 ^ 0xEDB88320u : crc >> 1;
    }
    return ~crc;
}

/* Makes all checksums right again after an edit, by SCENE.md alone. */
static void seal(uint8_t *b)
{
    uint32_t count;
    memcpy(&count, b + 12, 4);
    for (uint32_t i = 0; i < count; i++) {
        uint64_t at, n;
        memcpy(&at, b + 64 + 32 * i + 8, 8);
        memcpy(&n, b + 64 + 32 * i + 16, 8);
        if (at < file_n && n <= file_n - at) put32(b + 64 + 32 * i + 4, crc32_slow(b + at, (size_t)n));
    }
    put32(b + 24, 0);
    put32(b + 24, crc32_slow(b, 64 + 32 * (size_t)count));
}

static uint8_t *copy(void)
{
    uint8_t *b = aligned_alloc(64, (file_n + 127) & ~(size_t)63);
    assert_non_null(b);
    memcpy(b, file, file_n);
    return b;
}

static size_t section(const char *tag)
{
    uint32_t n;
    memcpy(&n, file + 12, 4);
    for (uint32_t i = 0; i < n; i++) {
        uint64_t at;
        memcpy(&at, file + 64 + 32 * i + 8, 8);
        if (!memcmp(file + 64 + 32 * i, tag, 4)) return (size_t)at;
    }
    fail_msg("no section %s", tag);
    return 0;
}

/* Refused with the error given and untouched output. */
static void refuse(const uint8_t *b, size_t n, orl_err want)
{
    orl_scene s, was;
    memset(&s, 0x5a, sizeof s);
    was = s;
    orl_err e = orl_scene_parse(b, n, "test", &s);
    if (e != want) fail_msg("got %d, want %d (%s)", e, want, orl_error_text());
    assert_memory_equal(&s, &was, sizeof s);
}

static void test_round_trip(void **state)
{
    (void)state;
    orl_scene w, r;
    synth_scene_make(&w, 4, 3, 5);
    w.facings = FACINGS;
    for (size_t i = 0; i < sizeof BACKDROP; i++) BACKDROP[i] = (uint8_t)(i * 7);
    for (size_t i = 0; i < sizeof GROUND; i++) GROUND[i] = (uint8_t)(i * 5);
    w.ground_albedo = GROUND;
    w.backdrop = (orl_backdrop){ { 40, 12.5f }, 9 };
    w.backdrop_rgba = BACKDROP;
    assert_int_equal(orl_scene_write(path2, &w, NULL), ORL_OK);
    assert_int_equal(orl_scene_open(path2, &r), ORL_OK);
    assert_memory_equal(r.nb, w.nb, sizeof r.nb);
    assert_int_equal(r.nbricks, w.nbricks);
    assert_memory_equal(r.bmap, w.bmap, 60 * 4);
    assert_memory_equal(r.sdf, w.sdf, w.nbricks * ORL_BRICK_VERTS);
    assert_int_equal(r.ntextures, w.ntextures);
    assert_memory_equal(r.skin, w.skin, w.nbricks * 4);
    assert_memory_equal(r.albedo, w.albedo, w.ntextures * ORL_SKIN_TEXELS * 3);
    assert_memory_equal(r.lite, w.lite, w.nbricks * ORL_LITE_VERTS * ORL_LITE_BYTES);
    assert_memory_equal(r.shadow, w.shadow, w.nbricks * ORL_LITE_VERTS * ORL_SHADOW_DIM);
    assert_memory_equal(r.codes, w.codes, 2 * ORL_CODE * 4);
    assert_memory_equal(r.world_to_grid, w.world_to_grid, sizeof r.world_to_grid);
    assert_int_equal(r.facings.n, 3);
    for (int k = 0; k < 3; k++) for (int a = 0; a < 3; a++) assert_true(fabsf(r.facings.dir[k][a] - FACINGS.dir[k][a]) < 2e-5f);
    assert_true(r.backdrop.half[0] == 40 && r.backdrop.half[1] == 12.5f && r.backdrop.height == 9);
    assert_memory_equal(r.backdrop_rgba, w.backdrop_rgba, sizeof BACKDROP);
    assert_memory_equal(r.ground_albedo, w.ground_albedo, sizeof GROUND);
    assert_string_equal(r.title, "synthetic");
    assert_true(((uintptr_t)r.sdf & 63) == 0 && ((uintptr_t)r.codes & 63) == 0);
    float top = 0;
    for (int i = 0; i < ORL_ENV; i++) for (int c = 0; c < 3; c++) top = fmaxf(top, fabsf(w.light.env_mean[i][c]));
    for (int i = 0; i < ORL_ENV; i++) for (int c = 0; c < 3; c++) assert_true(fabsf(r.light.env_mean[i][c] - w.light.env_mean[i][c]) <= top / 32000);
    for (int i = 0; i < ORL_CODE; i++) for (int j = 0; j <= i; j++) assert_true(r.light.prior_prec[i][j] == w.light.prior_prec[i][j] && r.light.prior_prec[j][i] == r.light.prior_prec[i][j]);
    /* write -> read -> write */
    assert_int_equal(orl_scene_write(path, &r, NULL), ORL_OK);
    orl_scene_close(&r);
    orl_scene_close(&r);            /* idempotent */
    size_t a, b;
    uint8_t *fa = load(path2, &a), *fb = load(path, &b);
    assert_int_equal(a, b);
    assert_memory_equal(fa, fb, a);
    free(fa); free(fb);
    w.ground_albedo = w.backdrop_rgba = NULL;
    synth_scene_free(&w);
}

/* The room stands around the box, on a ground. */
static void test_backdrop(void **state)
{
    (void)state;
    const orl_backdrop bad[] = { { { 15.9f, 12 }, 9 }, { { 16, 11 }, 9 }, { { NAN, 12 }, 9 }, { { 16, INFINITY }, 9 }, { { 16, 12 }, 0 }, { { 16, 12 }, -1 }, { { 16, 12 }, NAN }, { { 16, 12 }, 2e6f } };
    orl_scene w;
    synth_scene_make(&w, 4, 3, 5);
    w.backdrop = (orl_backdrop){ { 16, 12 }, 9 };
    w.backdrop_rgba = BACKDROP;
    assert_int_equal(orl_scene_write(path2, &w, NULL), ORL_E_FORMAT);      /* no ground */
    w.ground_albedo = GROUND;
    assert_int_equal(orl_scene_write(path2, &w, NULL), ORL_OK);
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        w.backdrop = bad[i];
        assert_int_equal(orl_scene_write(path2, &w, NULL), ORL_E_RANGE);
    }
    w.ground_albedo = w.backdrop_rgba = NULL;
    synth_scene_free(&w);
}

static void test_optional(void **state)
{
    (void)state;
    orl_scene w, r;
    orl_scene_section list[16];
    int n;
    synth_scene_make(&w, 2, 2, 3);
    orl_scene bare = w;
    bare.lite = NULL; bare.shadow = NULL; bare.ncodes = 0;
    assert_int_equal(orl_scene_write(path2, &bare, NULL), ORL_OK);
    assert_int_equal(orl_scene_sections(path2, list, 16, &n), ORL_OK);
    assert_int_equal(n, 9);
    assert_int_equal(orl_scene_sections(path2, list, 8, &n), ORL_E_MEMORY);
    assert_int_equal(orl_scene_open(path2, &r), ORL_OK);
    assert_null(r.lite); assert_null(r.shadow); assert_null(r.codes);
    assert_true(r.shadow_scale[0] == 0 && r.facings.n == 0);
    orl_scene_close(&r);
    /* a sky file: no geometry at all */
    orl_scene sky = { .light = w.light };
    assert_int_equal(orl_scene_write(path2, &sky, NULL), ORL_OK);
    assert_int_equal(orl_scene_open(path2, &r), ORL_OK);
    assert_null(r.bmap);
    assert_int_equal(r.nb[0], 0);
    orl_scene_close(&r);
    /* no brick at all is valid; what cannot be read is not written */
    orl_scene empty = w;
    int32_t map[12];
    for (int i = 0; i < 12; i++) map[i] = -127;
    empty.bmap = map; empty.nbricks = empty.ntextures = 0;
    assert_int_equal(orl_scene_write(path2, &empty, NULL), ORL_OK);
    map[3] = 0;
    assert_int_equal(orl_scene_write(path2, &empty, NULL), ORL_E_RANGE);
    w.ntextures--;
    assert_int_equal(orl_scene_write(path2, &w, NULL), ORL_E_FORMAT);
    w.ntextures++;
    w.facings = FACINGS;
    w.facings.dir[1][0] = NAN;
    assert_int_equal(orl_scene_write(path2, &w, NULL), ORL_E_RANGE);
    w.facings.dir[1][0] = 0.1f;
    assert_int_equal(orl_scene_write(path2, &w, NULL), ORL_E_RANGE);
    w.facings.n = 0;
    w.light.env_mean[7][1] = NAN;
    assert_int_equal(orl_scene_write(path2, &w, NULL), ORL_E_RANGE);
    w.light.env_mean[7][1] = 0;
    w.light.prior_mean[3] = INFINITY;
    assert_int_equal(orl_scene_write(path2, &w, NULL), ORL_E_RANGE);
    synth_scene_free(&w);
    assert_int_equal(orl_scene_open("/nonexistent/x.oriel", &r), ORL_E_IO);
    assert_int_equal(orl_scene_open("/tmp", &r), ORL_E_IO);
}

static void test_truncation(void **state)
{
    (void)state;
    uint8_t *b = copy();
    for (size_t n = 0; n < file_n; n++) {
        refuse(b, n, ORL_E_FORMAT);
        if (n >= 64) {              /* the header's size corrected: the sections still do not fit */
            uint8_t keep[32];
            memcpy(keep, b, 32);
            if (n % 97 == 0 || n > file_n - 70) {
                put64(b + 16, n);
                put32(b + 24, 0);
                size_t head = 64 + 32 * (size_t)b[12];
                if (n >= head) put32(b + 24, crc32_slow(b, head));
                refuse(b, n, ORL_E_FORMAT);
                memcpy(b, keep, 32);
            }
        }
    }
    free(b);
}

static void test_extra_bytes(void **state)
{
    (void)state;
    uint8_t *b = aligned_alloc(64, ((file_n + 63) & ~(size_t)63) + 256);
    assert_non_null(b);
    memcpy(b, file, file_n);
    memset(b + file_n, 0, 192);
    refuse(b, file_n + 1, ORL_E_FORMAT);
    refuse(b, file_n + 64, ORL_E_FORMAT);
    put64(b + 16, file_n + 64);
    seal(b);
    refuse(b, file_n + 64, ORL_E_FORMAT);
    free(b);
}

static void test_bad_header(void **state)
{
    (void)state;
    struct { size_t at; uint8_t value; orl_err want; } edit[] = {
        { 0, 'o', ORL_E_FORMAT }, { 7, 0, ORL_E_FORMAT },
        { 8, 2, ORL_E_UNSUPPORTED }, { 8, 0, ORL_E_UNSUPPORTED }, { 11, 1, ORL_E_UNSUPPORTED },
        { 12, 0, ORL_E_RANGE }, { 12, 33, ORL_E_RANGE }, { 15, 255, ORL_E_RANGE }, { 28, 1, ORL_E_FORMAT }, { 31, 1, ORL_E_FORMAT },
        { 64, 'X', ORL_E_UNSUPPORTED }, { 64, 'h', ORL_E_FORMAT }, { 64, 1, ORL_E_FORMAT }, { 72, 1, ORL_E_FORMAT }, { 79, 0x80, ORL_E_FORMAT }, { 80, 1, ORL_E_FORMAT }, { 87, 255, ORL_E_FORMAT }, { 88, 1, ORL_E_FORMAT },
    };
    for (size_t i = 0; i < sizeof edit / sizeof *edit; i++) {
        uint8_t *b = copy();
        uint32_t count;
        b[edit[i].at] = edit[i].value;
        memcpy(&count, b + 12, 4);
        if (count <= 32) seal(b);
        refuse(b, file_n, edit[i].want);
        free(b);
    }
    /* unused bytes are ignored */
    uint8_t *b = copy();
    orl_scene s;
    memset(b + 32, 0xff, 32);
    seal(b);
    assert_int_equal(orl_scene_parse(b, file_n, "test", &s), ORL_OK);
    orl_scene_close(&s);
    /* memory that is not aligned is refused, not read */
    assert_int_equal(orl_scene_parse(b + 1, file_n - 1, "test", &s), ORL_E_RANGE);
    free(b);
}

static void test_flipped_bytes(void **state)
{
    (void)state;
    uint8_t *b = copy();
    orl_scene s;
    for (size_t i = 0; i < file_n; i++) {
        b[i] ^= (uint8_t)(1 << (i % 8));
        if (!orl_scene_parse(b, file_n, "test", &s)) fail_msg("a flipped bit at %zu went unseen", i);
        b[i] = file[i];
    }
    free(b);
}

static void test_field_ranges(void **state)
{
    (void)state;
    size_t head = section("HEAD"), map = section("PMAP"), skin = section("PSKN"), sdf = section("PSDF"), base = section("PALB"), skyd = section("SKYD"), skyg = section("SKYG");
    size_t prio = section("PRIO"), code = section("CODE"), face = section("FACE"), meta = section("META");
    const uint32_t nan = 0x7fc00000, inf = 0x7f800000, huge = 0xffffffff;
    struct { size_t at; uint32_t v; orl_err want; } edit[] = {
        { head, 0, ORL_E_RANGE }, { head, 513, ORL_E_RANGE }, { head, huge, ORL_E_RANGE }, { head + 4, 512, ORL_E_FORMAT },
        { head + 8, 0x80000000, ORL_E_RANGE },
        { head + 12, huge, ORL_E_RANGE }, { head + 12, 7, ORL_E_RANGE }, { head + 12, 1, ORL_E_RANGE },
        { head + 20, 0x7ff00000, ORL_E_RANGE }, { head + 20, 0, ORL_E_RANGE }, { head + 20, 0x42000000, ORL_E_RANGE },
        { head + 112, nan, ORL_E_RANGE }, { head + 112, 0, ORL_E_RANGE }, { head + 112, 0x3f800000, ORL_E_RANGE },
        { head + 116, 0x3f800001, ORL_E_RANGE }, { head + 116, inf, ORL_E_RANGE }, { head + 116, 0xbf800000, ORL_E_RANGE }, { head + 148, 1, ORL_E_FORMAT },
        { map, 0, ORL_E_RANGE }, { skin, 0x00ffff00, ORL_E_RANGE }, { sdf, 0, ORL_E_FORMAT }, { sdf, 1, ORL_E_FORMAT }, { sdf, 0x01000101, ORL_E_FORMAT }, { sdf + 4, 1, ORL_E_FORMAT }, { base, 0x100, ORL_E_FORMAT },
        { skyd, 16, ORL_E_RANGE }, { skyd + 4, (uint32_t)-41, ORL_E_RANGE }, { skyd + 60, 1, ORL_E_FORMAT },
        { skyg, huge / 2, ORL_E_RANGE }, { skyg + 60, 0x10000, ORL_E_FORMAT },
        { prio, nan, ORL_E_RANGE }, { prio + 148, 0xbf800000, ORL_E_RANGE }, { prio + 152, inf, ORL_E_RANGE },
        { face, 0x12341234, ORL_E_RANGE }, { face + 4, 0, ORL_E_RANGE }, { face + 6, 0x7fff7fff, ORL_E_RANGE }, { code, inf, ORL_E_RANGE }, { code + 4, 0x7f000000, ORL_E_RANGE },
        { meta, 0x0a313131, ORL_E_FORMAT }, { meta + 60, 0x61616161, ORL_E_FORMAT },
    };
    for (size_t i = 0; i < sizeof edit / sizeof *edit; i++) {
        uint8_t *b = copy();
        put32(b + edit[i].at, edit[i].v);
        seal(b);
        orl_scene s;
        orl_err e = orl_scene_parse(b, file_n, "test", &s);
        if (!e) orl_scene_close(&s);
        if (e != edit[i].want) fail_msg("edit %zu: got %d, want %d (%s)", i, e, edit[i].want, e ? orl_error_text() : "");
        free(b);
    }
    /* 512^3 places and every brick claimed, in a file that has none of them */
    uint8_t *b = copy();
    for (int k = 0; k < 3; k++) put32(b + head + 4 * (size_t)k, 512);
    put32(b + head + 12, 1u << 24);
    seal(b);
    refuse(b, file_n, ORL_E_RANGE);
    put32(b + head, 64);
    seal(b);
    refuse(b, file_n, ORL_E_RANGE);
    put32(b + head + 12, ORL_BRICKS_MOST);
    seal(b);
    refuse(b, file_n, ORL_E_FORMAT);
    free(b);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_round_trip), cmocka_unit_test(test_backdrop), cmocka_unit_test(test_optional), cmocka_unit_test(test_truncation), cmocka_unit_test(test_extra_bytes),
        cmocka_unit_test(test_bad_header), cmocka_unit_test(test_flipped_bytes), cmocka_unit_test(test_field_ranges),
    };
    return cmocka_run_group_tests(tests, setup, teardown);
}
