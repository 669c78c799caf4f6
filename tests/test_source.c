/* Sources and sinks: the Y4M parser's quartet, lost pictures, random bytes; a folder; colours there and back; the sinks' files and hash. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>
#include "oriel/cpu.h"
#include "oriel/image.h"
#include "oriel/sink.h"
#include "oriel/source.h"

static uint32_t seed;
static uint32_t rnd(void) { return seed = seed * 1664525u + 1013904223u, seed >> 8; }

typedef struct { char bytes[8192]; size_t n; } stream;

static void add(stream *s, const void *p, size_t n) { memcpy(s->bytes + s->n, p, n); s->n += n; }
static void add_text(stream *s, const char *t) { add(s, t, strlen(t)); }
static void add_picture(stream *s, size_t n, int v)
{
    add_text(s, "FRAME\n");
    memset(s->bytes + s->n, v, n);
    s->n += n;
}

static orl_err open_bytes(const void *p, size_t n, orl_source **out)
{
    FILE *f = n ? fmemopen((void *)p, n, "rb") : fopen("/dev/null", "rb");
    assert_non_null(f);
    return orl_source_y4m(f, "test", out);
}

static orl_err open_text(const char *t, orl_source **out) { return open_bytes(t, strlen(t), out); }

static void y4m_formats(void **state)
{
    (void)state;
    static const struct { const char *c; orl_pixels pixels; size_t bytes; size_t cw; } CASE[] = {
        { "", ORL_PIX_420, 5 * 3 + 2 * 3 * 2, 3 }, { " C420jpeg", ORL_PIX_420, 27, 3 }, { " C420mpeg2", ORL_PIX_420, 27, 3 }, { " C420paldv", ORL_PIX_420, 27, 3 },
        { " C422", ORL_PIX_422, 15 + 2 * 9, 3 }, { " C444", ORL_PIX_444, 45, 5 }, { " Cmono", ORL_PIX_MONO, 15, 0 },
    };
    for (size_t i = 0; i < sizeof CASE / sizeof *CASE; i++) {
        stream s = { .n = 0 };
        orl_source *y;
        orl_frame f;
        add_text(&s, "YUV4MPEG2 W5 H3 F30000:1001 Ip A1:1");
        add_text(&s, CASE[i].c);
        add_text(&s, " XSOMETHING\n");
        add_picture(&s, CASE[i].bytes, 7);
        add_text(&s, "FRAME Ip\n");
        for (size_t k = 0; k < CASE[i].bytes; k++) s.bytes[s.n++] = (char)k;
        assert_int_equal(open_bytes(s.bytes, s.n, &y), ORL_OK);
        assert_int_equal(y->info.w, 5);
        assert_int_equal(y->info.h, 3);
        assert_int_equal(y->info.fps_num, 30000);
        assert_int_equal(y->info.fps_den, 1001);
        assert_int_equal(y->info.pixels, CASE[i].pixels);
        assert_int_equal(orl_source_next(y, &f), 1);
        assert_int_equal(f.plane[0][14], 7);
        assert_int_equal(orl_source_next(y, &f), 1);
        assert_int_equal(f.plane[0][14], 14);
        if (CASE[i].cw) {
            assert_int_equal(f.stride[1], CASE[i].cw);
            assert_int_equal(f.plane[1][0], 15);
            assert_int_equal(f.plane[2][0], 15 + (CASE[i].bytes - 15) / 2);
        }
        assert_int_equal(orl_source_next(y, &f), 0);
        assert_int_equal(y->frame, 2);
        orl_source_close(y);
    }
}

static void y4m_bad_headers(void **state)
{
    (void)state;
    static const char *const BAD[] = {
        "", "\n", "YUV4MPEG2", "YUV4MPEG2\n", "YUV4MPEG3 W4 H4\n", "YUV4MPEG2W4 H4\n", "YUV4MPEG2 W4\n", "YUV4MPEG2 W0 H4\n", "YUV4MPEG2 W-4 H4\n", "YUV4MPEG2 W4x H4\n",
        "YUV4MPEG2 W99999999999999999999 H4\n", "YUV4MPEG2 W16384 H16384\n", "YUV4MPEG2 W4 H4 F25\n", "YUV4MPEG2 W4 H4 F25:0\n", "YUV4MPEG2 W4 H4 Fx:1\n", "YUV4MPEG2 W4 H4 C420p10\n",
        "YUV4MPEG2 W4 H4 C444alpha\n", "YUV4MPEG2 W4 H4 C\n", "YUV4MPEG2 W4 H4 It\n", "YUV4MPEG2 W4 H4 Im\n", "\xff\xd8\xff\xe0 not a stream\n",
    };
    for (size_t i = 0; i < sizeof BAD / sizeof *BAD; i++) {
        orl_source *y = (orl_source *)BAD;
        assert_int_not_equal(open_text(BAD[i], &y), ORL_OK);
        assert_ptr_equal(y, BAD);
        assert_null(strchr(orl_error_text(), '\n'));
        assert_non_null(strstr(orl_error_text(), "test"));
    }
    char far[4000];
    memset(far, 'X', sizeof far);
    memcpy(far, "YUV4MPEG2 W4 H4 ", 16);
    orl_source *y;
    assert_int_equal(open_bytes(far, sizeof far, &y), ORL_E_FORMAT);
}

/* Every truncation: whole pictures come out, a cut one is lost and named, then it ends. */
static void y4m_truncated(void **state)
{
    (void)state;
    stream s = { .n = 0 };
    add_text(&s, "YUV4MPEG2 W4 H2 C420\n");
    size_t head = s.n, each = 6 + 12;
    for (int i = 0; i < 3; i++) add_picture(&s, 12, 10 + i);
    for (size_t n = 0; n <= s.n; n++) {
        orl_source *y;
        orl_frame f;
        if (n < head) {
            assert_int_not_equal(open_bytes(s.bytes, n, &y), ORL_OK);
            continue;
        }
        assert_int_equal(open_bytes(s.bytes, n, &y), ORL_OK);
        for (size_t k = 0; k < (n - head) / each; k++) {
            assert_int_equal(orl_source_next(y, &f), 1);
            assert_int_equal(f.plane[0][0], 10 + (int)k);
            assert_int_equal(f.plane[2][1], 10 + (int)k);
        }
        if ((n - head) % each) {
            assert_int_equal(orl_source_next(y, &f), -1);
            assert_non_null(strstr(orl_error_text(), "picture "));
        }
        assert_int_equal(orl_source_next(y, &f), 0);
        assert_int_equal(orl_source_next(y, &f), 0);
        orl_source_close(y);
    }
}

/* A broken FRAME line costs its own picture only; bytes that are missing or in excess cost the picture where it shows. */
static void y4m_resumes(void **state)
{
    (void)state;
    for (int kind = 0; kind < 4; kind++) {
        stream s = { .n = 0 };
        orl_source *y;
        orl_frame f;
        int got[8], n = 0;
        add_text(&s, "YUV4MPEG2 W4 H2 C420\n");
        add_picture(&s, 12, 10);
        size_t at = s.n;
        add_picture(&s, kind == 3 ? 15 : 12, 11);
        if (kind == 0) s.bytes[at + 2] = '?';
        if (kind == 1) s.bytes[at + 5] = '!';
        if (kind == 2) memset(s.bytes + at, 'F', 6);
        add_picture(&s, 12, 12);
        add_picture(&s, 12, 13);
        assert_int_equal(open_bytes(s.bytes, s.n, &y), ORL_OK);
        for (int r; n < 8 && (r = orl_source_next(y, &f)); n++) got[n] = r < 0 ? -1 : f.plane[0][0];
        orl_source_close(y);
        assert_int_equal(n, kind == 3 ? 5 : 4);
        assert_int_equal(got[0], 10);
        assert_int_equal(got[1], kind == 3 ? 11 : -1);
        assert_int_equal(got[n - 2], 12);
        assert_int_equal(got[n - 1], 13);
    }
}

static void y4m_random(void **state)
{
    (void)state;
    static const char *const WORD[] = { "YUV4MPEG2 ", "W4 ", "H2 ", "W3 ", "C444 ", "C420 ", "Cmono ", "F1:1 ", "\n", "FRAME\n", "FRAME ", "Ip ", "\0\0\0\0\0\0\0\0\0\0\0\0" };
    seed = (uint32_t)time(NULL);
    print_message("seed %u\n", seed);
    for (int round = 0; round < 20000; round++) {
        stream s = { .n = 0 };
        orl_source *y;
        orl_frame f;
        if (rnd() % 4) add_text(&s, "YUV4MPEG2 W4 H2 ");
        for (int k = (int)(rnd() % 20); k >= 0; k--) {
            size_t w = rnd() % (sizeof WORD / sizeof *WORD + 2);
            if (w < sizeof WORD / sizeof *WORD) add(&s, WORD[w], w == sizeof WORD / sizeof *WORD - 1 ? 12 : strlen(WORD[w]));
            else for (int b = (int)(rnd() % 9); b >= 0; b--) s.bytes[s.n++] = (char)rnd();
        }
        if (open_bytes(s.bytes, s.n, &y)) continue;
        uint8_t rgb[64 * 3];
        int calls = 0;
        for (int r; (r = orl_source_next(y, &f)); calls++)
            if (r > 0 && y->info.w * y->info.h <= 64) orl_frame_to_rgb(&y->info, &f, orl_cpu_detect(), 0, y->info.h, rgb, (size_t)y->info.w * 3);
        assert_true(calls <= (int)s.n);
        orl_source_close(y);
    }
}

static void yuv_colours(void **state)
{
    (void)state;
    static const struct { uint8_t y, u, v, r, g, b; } KNOWN[] = {      /* BT.601, limited */
        { 16, 128, 128, 0, 0, 0 }, { 235, 128, 128, 255, 255, 255 }, { 126, 128, 128, 128, 128, 128 }, { 81, 90, 240, 254, 0, 0 }, { 145, 54, 34, 0, 255, 1 }, { 41, 240, 110, 0, 0, 255 },
        { 0, 128, 128, 0, 0, 0 }, { 255, 128, 128, 255, 255, 255 },
    };
    for (size_t i = 0; i < sizeof KNOWN / sizeof *KNOWN; i++) {
        orl_source_info info = { .w = 1, .h = 1, .pixels = ORL_PIX_444 };
        orl_frame f = { { &KNOWN[i].y, &KNOWN[i].u, &KNOWN[i].v }, { 1, 1, 1 }, { 1, 1, 1 } };
        uint8_t rgb[3];
        orl_frame_to_rgb(&info, &f, orl_cpu_detect(), 0, 1, rgb, 3);
        assert_int_equal(rgb[0], KNOWN[i].r);
        assert_int_equal(rgb[1], KNOWN[i].g);
        assert_int_equal(rgb[2], KNOWN[i].b);
    }
    /* there and back within rounding, for flat 2 x 2 blocks */
    int worst = 0;
    for (int k = 0; k < 4096; k++) {
        uint8_t in[6], y[4], u, v, out[12];
        for (int c = 0; c < 3; c++) in[c] = in[3 + c] = (uint8_t)((k >> (4 * c) & 15) * 17);
        orl_rgb_to_420(in, in, 2, y, y + 2, &u, &v);
        orl_source_info info = { .w = 2, .h = 2, .pixels = ORL_PIX_420 };
        orl_frame f = { { y, &u, &v }, { 2, 1, 1 }, { 4, 1, 1 } };
        orl_frame_to_rgb(&info, &f, orl_cpu_detect(), 0, 2, out, 6);
        for (int c = 0; c < 12; c++) worst = abs(out[c] - in[c % 3]) > worst ? abs(out[c] - in[c % 3]) : worst;
    }
    assert_in_range(worst, 1, 3);
}

/* ---- folders and sinks, in a scratch folder ---- */

static char dir[64];
static int set_up(void **state)
{
    (void)state;
    strcpy(dir, "/tmp/oriel-test-XXXXXX");
    return !mkdtemp(dir);
}

static int tear_down(void **state)
{
    (void)state;
    char cmd[128];
    snprintf(cmd, sizeof cmd, "rm -rf '%s'", dir);
    return system(cmd) != 0;
}

static const char *in_dir(const char *name)
{
    static char path[4][256];
    static int k;
    k = (k + 1) % 4;
    snprintf(path[k], sizeof path[k], "%s/%s", dir, name);
    return path[k];
}

static void write_picture(const char *name, int w, int h, int v)
{
    orl_image im;
    assert_int_equal(orl_image_alloc(&im, w, h, 3), ORL_OK);
    memset(im.px, v, (size_t)w * (size_t)h * 3);
    assert_int_equal(orl_image_write(in_dir(name), &im), ORL_OK);
    orl_image_free(&im);
}

static void folder_order(void **state)
{
    (void)state;
    orl_source *s = NULL;
    orl_frame f;
    char spec[300];
    if (!strstr(orl_image_formats(), "png")) skip();
    snprintf(spec, sizeof spec, "replay:%s", dir);
    assert_int_equal(orl_source_open(spec, &s), ORL_E_RANGE);       /* no pictures yet */
    orl_file_write(in_dir("a00.png"), "junk", 4);
    assert_int_not_equal(orl_source_open(spec, &s), ORL_OK);        /* none that can be read */
    write_picture("a10.png", 6, 4, 10);
    write_picture("a9.png", 6, 4, 9);
    write_picture("a11.png", 7, 4, 11);
    write_picture("a12.png", 6, 4, 12);
    orl_file_write(in_dir("a05.txt"), "junk", 4);
    assert_int_equal(orl_source_open(spec, &s), ORL_OK);
    assert_int_equal(s->info.w, 6);
    assert_int_equal(orl_source_next(s, &f), -1);
    assert_non_null(strstr(orl_error_text(), "a00.png"));
    assert_int_equal(orl_source_next(s, &f), 1);
    assert_int_equal(f.plane[0][0], 10);
    assert_int_equal(orl_source_next(s, &f), -1);
    assert_non_null(strstr(orl_error_text(), "a11.png"));
    assert_int_equal(orl_source_next(s, &f), 1);
    assert_int_equal(f.plane[0][71], 12);
    assert_int_equal(orl_source_next(s, &f), 1);
    assert_int_equal(f.plane[0][0], 9);
    assert_int_equal(orl_source_next(s, &f), 0);
    orl_source_close(s);
}

static void bad_specs(void **state)
{
    (void)state;
    orl_source *s;
    orl_sink *k;
    static const char *const SOURCE[] = { "", "x", "v4l2:/dev/null", "replay:", "replay:/nonexistent/clip.y4m", "replay:/dev/null" };
    static const char *const SINK[] = { "", "x:y", "files:", "files:/tmp/%s.png", "files:/tmp/%d%d.png", "files:/tmp/%010d.png", "files:/tmp/%n", "files:/nonexistent/a/b", "y4m:", "y4m:/nonexistent/a" };
    for (size_t i = 0; i < sizeof SOURCE / sizeof *SOURCE; i++) assert_int_not_equal(orl_source_open(SOURCE[i], &s), ORL_OK);
    for (size_t i = 0; i < sizeof SINK / sizeof *SINK; i++) assert_int_not_equal(orl_sink_open(SINK[i], 8, 8, 25, 1, &k), ORL_OK);
}

static void sink_y4m_reads_back(void **state)
{
    (void)state;
    enum { PW = 7, PH = 5 };
    orl_sink *k;
    orl_source *s;
    orl_frame f;
    char spec[300];
    uint8_t rgb[PH][PW][3], back[PH][PW][3];
    snprintf(spec, sizeof spec, "y4m:%s", in_dir("out.y4m"));
    assert_int_equal(orl_sink_open(spec, PW, PH, 30, 1, &k), ORL_OK);
    for (int i = 0; i < 3; i++) {
        memset(rgb, 60 * i + 40, sizeof rgb);
        assert_int_equal(orl_sink_put(k, &rgb[0][0][0], sizeof *rgb), ORL_OK);
    }
    assert_int_equal(orl_sink_close(k, NULL, 0), ORL_OK);
    snprintf(spec, sizeof spec, "replay:%s", in_dir("out.y4m"));
    assert_int_equal(orl_source_open(spec, &s), ORL_OK);
    assert_int_equal(s->info.fps_num, 30);
    for (int i = 0; i < 3; i++) {
        assert_int_equal(orl_source_next(s, &f), 1);
        orl_frame_to_rgb(&s->info, &f, orl_cpu_detect(), 0, PH, &back[0][0][0], sizeof *back);
        assert_true(abs(back[PH - 1][PW - 1][1] - (60 * i + 40)) <= 1);
    }
    assert_int_equal(orl_source_next(s, &f), 0);
    orl_source_close(s);
}

static void sink_files_names(void **state)
{
    (void)state;
    orl_sink *k;
    char spec[300];
    uint8_t rgb[8 * 8 * 3] = { 0 };
    if (!strstr(orl_image_formats(), "png")) skip();
    snprintf(spec, sizeof spec, "files:%s", in_dir("a"));
    assert_int_equal(orl_sink_open(spec, 8, 8, 25, 1, &k), ORL_OK);
    for (int i = 0; i < 2; i++) assert_int_equal(orl_sink_put(k, rgb, 24), ORL_OK);
    assert_int_equal(orl_sink_close(k, NULL, 0), ORL_OK);
    assert_int_equal(access(in_dir("a/000000.png"), R_OK), 0);
    assert_int_equal(access(in_dir("a/000001.png"), R_OK), 0);
    snprintf(spec, sizeof spec, "files:%s", in_dir("b/p%03d-x.png"));
    assert_int_equal(orl_sink_open(spec, 8, 8, 25, 1, &k), ORL_OK);
    assert_int_equal(orl_sink_put(k, rgb, 24), ORL_OK);
    assert_int_equal(orl_sink_close(k, NULL, 0), ORL_OK);
    assert_int_equal(access(in_dir("b/p000-x.png"), R_OK), 0);
}

static void hash_is_fixed(void **state)
{
    (void)state;
    uint8_t rgb[2 * 5 * 3];
    char a[128], b[128];
    orl_sink *k;
    for (size_t i = 0; i < sizeof rgb; i++) rgb[i] = (uint8_t)(i * 37);
    for (int flip = 0; flip < 2; flip++) {
        assert_int_equal(orl_sink_open("hash:", 5, 2, 25, 1, &k), ORL_OK);
        rgb[29] ^= (uint8_t)flip;
        assert_int_equal(orl_sink_put(k, rgb, 15), ORL_OK);
        assert_int_equal(orl_sink_close(k, flip ? b : a, sizeof a), ORL_OK);
    }
    assert_string_not_equal(a, b);
    assert_string_equal(a, "hash 03a48bae43fe6eec  1 frames of 5 x 2");      /* the figure is part of the format */
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(y4m_formats), cmocka_unit_test(y4m_bad_headers), cmocka_unit_test(y4m_truncated), cmocka_unit_test(y4m_resumes), cmocka_unit_test(y4m_random),
        cmocka_unit_test(yuv_colours), cmocka_unit_test_setup_teardown(folder_order, set_up, tear_down), cmocka_unit_test(bad_specs),
        cmocka_unit_test_setup_teardown(sink_y4m_reads_back, set_up, tear_down), cmocka_unit_test_setup_teardown(sink_files_names, set_up, tear_down), cmocka_unit_test(hash_is_fixed),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
