/* Images: PNG, JPEG, EXR and Radiance there and back, EXIF orientation, area-averaged resize, conversions, sizes; files cut short or full of noise; whole files in and atomic files
 * out, where a write that fails leaves nothing behind. */
#include "tests/scratch.h"
#include <fcntl.h>
#include <math.h>
#include <signal.h>
#include <sys/resource.h>
#include "oriel/dataset.h"
#include "oriel/image.h"

static int has(const char *format) { return strstr(orl_image_formats(), format) != NULL; }
#define NEEDS(format) do { if (!has(format)) { print_message("no " format " in this build\n"); skip(); } } while (0)

static orl_image random_image(int w, int h, int c)
{
    orl_image im;
    ok(orl_image_alloc(&im, w, h, c));
    for (int i = 0; i < w * h * c; i++) im.px[i] = (uint8_t)rnd();
    return im;
}

/* Blocks of 8 x 8 in four colours, which JPEG keeps: A B over C D. */
static const uint8_t ABCD[4][3] = { { 230, 40, 40 }, { 40, 200, 60 }, { 50, 60, 220 }, { 225, 225, 225 } };
static orl_image corners(int w, int h)
{
    orl_image im;
    ok(orl_image_alloc(&im, w, h, 3));
    for (int y = 0; y < h; y++) for (int x = 0; x < w; x++) memcpy(im.px + 3 * (y * w + x), ABCD[(2 * y >= h) * 2 + (2 * x >= w)], 3);
    return im;
}

static void expect_corners(const orl_image *im, const char *order)
{
    for (int k = 0; k < 4; k++) {
        const uint8_t *p = im->px + 3 * ((k / 2 ? im->h - 3 : 2) * im->w + (k % 2 ? im->w - 3 : 2)), *want = ABCD[order[k] - 'A'];
        for (int a = 0; a < 3; a++) if (abs(p[a] - want[a]) > 6) fail_msg("corner %d of %s: %d %d %d", k, order, p[0], p[1], p[2]);
    }
}

static uint8_t *slurp(const char *path, size_t *n)
{
    uint8_t *p;
    ok(orl_file_read(path, 1 << 26, &p, n));
    return p;
}

static void allocates(void **state)
{
    (void)state;
    static const int BAD[][3] = { { 0, 1, 3 }, { 1, 0, 3 }, { -1, 5, 3 }, { 5, -1, 3 }, { 65536, 1, 1 }, { 1, 65536, 1 }, { INT32_MAX, INT32_MAX, 3 }, { 1, 1, 0 }, { 1, 1, -3 }, { 1, 1, 1000 } };
    orl_image im, was;
    orl_imagef f, fwas;
    memset(&im, 0x5a, sizeof im);
    memset(&f, 0x5a, sizeof f);
    was = im;
    fwas = f;
    for (size_t k = 0; k < sizeof BAD / sizeof *BAD; k++) {
        failed(orl_image_alloc(&im, BAD[k][0], BAD[k][1], BAD[k][2]), ORL_E_RANGE, "image size", NULL);
        failed(orl_imagef_alloc(&f, BAD[k][0], BAD[k][1], BAD[k][2]), ORL_E_RANGE, "image size", NULL);
    }
    assert_memory_equal(&im, &was, sizeof im);
    assert_memory_equal(&f, &fwas, sizeof f);
    ok(orl_image_alloc(&im, 7, 5, 3));
    ok(orl_imagef_alloc(&f, 65535, 1, 1));
    for (int i = 0; i < 7 * 5 * 3; i++) assert_int_equal(im.px[i], 0);
    for (int i = 0; i < 65535; i++) assert_true(f.px[i] == 0);
    for (int k = 0; k < 2; k++) {
        orl_image_free(&im);
        orl_imagef_free(&f);
        assert_true(!im.px && !im.w && !im.h && !im.c && !f.px && !f.w && !f.h && !f.c);
    }
}

static void conversions(void **state)
{
    (void)state;
    orl_image im, back;
    orl_imagef f;
    ok(orl_image_alloc(&im, 16, 16, 1));
    for (int i = 0; i < 256; i++) im.px[i] = (uint8_t)i;
    ok(orl_image_to_float(&im, &f));
    for (int i = 0; i < 256; i++) assert_true(f.px[i] == i / 255.0f);
    ok(orl_image_from_float(&f, &back));
    assert_memory_equal(im.px, back.px, 256);
    orl_image_free(&back);
    static const struct { float v; int want; } CASE[] = {
        { NAN, 0 }, { -NAN, 0 }, { INFINITY, 255 }, { -INFINITY, 0 }, { -0.0f, 0 }, { -1e-9f, 0 }, { -5, 0 }, { 1, 255 }, { 1.0000001f, 255 }, { 3e38f, 255 }, { 1e-40f, 0 }, { 0.999f, 255 },
        { 0.49f / 255, 0 }, { 0.51f / 255, 1 }, { 127.49f / 255, 127 }, { 127.51f / 255, 128 }, { 254.49f / 255, 254 }, { 254.51f / 255, 255 }, { 0.5f, 128 }, { 0.25f, 64 }, { 0.1f, 26 },
    };
    for (size_t k = 0; k < sizeof CASE / sizeof *CASE; k++) f.px[k] = CASE[k].v;
    ok(orl_image_from_float(&f, &back));
    for (size_t k = 0; k < sizeof CASE / sizeof *CASE; k++) if (back.px[k] != CASE[k].want) fail_msg("%g became %d", (double)CASE[k].v, back.px[k]);
    assert_true(back.w == 16 && back.h == 16 && back.c == 1);
    orl_image_free(&im);
    orl_image_free(&back);
    orl_imagef_free(&f);
}

static void long_side(void **state)
{
    (void)state;
    static const struct { int w, h, side, ow, oh; } CASE[] = {
        { 640, 480, 512, 512, 384 }, { 480, 640, 512, 384, 512 }, { 640, 480, 640, 640, 480 }, { 640, 480, 641, 640, 480 }, { 640, 480, 1000, 640, 480 }, { 640, 480, 0, 640, 480 }, { 640, 480, -7, 640, 480 },
        { 1000, 1, 100, 100, 1 }, { 1, 65535, 2, 1, 2 }, { 65535, 65535, 65534, 65534, 65534 }, { 3, 2, 1, 1, 1 }, { 1023, 682, 512, 512, 341 }, { 4, 3, 2, 2, 2 }, { 1, 1, 1, 1, 1 },
        { 800, 3, 400, 400, 2 }, { 800, 601, 400, 400, 301 },
    };
    int w, h;
    for (size_t k = 0; k < sizeof CASE / sizeof *CASE; k++) {
        orl_size_long_side(CASE[k].w, CASE[k].h, CASE[k].side, &w, &h);
        if (w != CASE[k].ow || h != CASE[k].oh) fail_msg("%d x %d to %d: %d x %d", CASE[k].w, CASE[k].h, CASE[k].side, w, h);
    }
    seed_print();
    for (int k = 0; k < 5000; k++) {
        int a = (int)(rnd() % 65535) + 1, b = (int)(rnd() % (k & 1 ? 300u : 65535u)) + 1, s = (int)(rnd() % 65535) + 1, big = a > b ? a : b;
        orl_size_long_side(a, b, s, &w, &h);
        if (s >= big) { assert_true(w == a && h == b); continue; }
        assert_int_equal(w > h ? w : h, s);
        assert_true(fabs(w - (double)a * s / big) <= 0.5 + 1e-9 || w == 1);
        assert_true(fabs(h - (double)b * s / big) <= 0.5 + 1e-9 || h == 1);
        assert_true(w >= 1 && h >= 1);
    }
}

/* Integral over the exact footprint, in double, as slow as it is plain. */
static double footprint(const orl_imagef *in, int c, double x0, double x1, double y0, double y1)
{
    double s = 0;
    for (int y = 0; y < in->h; y++)
        for (int x = 0; x < in->w; x++) s += fmax(0, fmin(x1, x + 1) - fmax(x0, x)) * fmax(0, fmin(y1, y + 1) - fmax(y0, y)) * (double)in->px[(y * in->w + x) * in->c + c];
    return s / ((x1 - x0) * (y1 - y0));
}

static void area_resize(void **state)
{
    (void)state;
    seed_print();
    for (int round = 0; round < 60; round++) {
        int w = (int)(rnd() % 40) + 1, h = (int)(rnd() % 30) + 1, c = (int)(rnd() % 4) + 1, ow = (int)(rnd() % 50) + 1, oh = (int)(rnd() % 50) + 1;
        orl_imagef in, out;
        ok(orl_imagef_alloc(&in, w, h, c));
        for (int i = 0; i < w * h * c; i++) in.px[i] = (float)uniform(-3, 9);
        ok(orl_imagef_resize_area(&in, ow, oh, &out));
        assert_true(out.w == ow && out.h == oh && out.c == c);
        for (int k = 0; k < c; k++) {
            double a = 0, b = 0;
            for (int i = 0; i < w * h; i++) a += (double)in.px[i * c + k];
            for (int i = 0; i < ow * oh; i++) b += (double)out.px[i * c + k];
            assert_true(fabs(a / (w * h) - b / (ow * oh)) < 1e-5);      /* the mean stays */
            for (int y = 0; y < oh; y += 3)
                for (int x = 0; x < ow; x += 2)
                    assert_true(fabs((double)out.px[(y * ow + x) * c + k] - footprint(&in, k, (double)x * w / ow, (x + 1.0) * w / ow, (double)y * h / oh, (y + 1.0) * h / oh)) < 1e-5);
        }
        orl_imagef_free(&in);
        orl_imagef_free(&out);
    }
}

/* Whole multiples and whole parts: plain means and plain copies, to the bit. */
static void whole_factors(void **state)
{
    (void)state;
    seed_print();
    for (int fx = 1; fx <= 7; fx++)
        for (int fy = 1; fy <= 5; fy++) {
            orl_image in = random_image(5 * fx, 4 * fy, 3), down, up, back;
            ok(orl_image_resize_area(&in, 5, 4, &down));
            for (int y = 0; y < 4; y++)
                for (int x = 0; x < 5; x++)
                    for (int k = 0; k < 3; k++) {
                        int sum = 0, n = fx * fy;
                        for (int j = 0; j < fy; j++) for (int i = 0; i < fx; i++) sum += in.px[((y * fy + j) * in.w + x * fx + i) * 3 + k];
                        int got = down.px[(y * 5 + x) * 3 + k], tie = 2 * sum % (2 * n) == n;        /* halves: up, unless the float below says otherwise */
                        assert_true(got == (2 * sum + n) / (2 * n) || (tie && got == sum / n));
                    }
            ok(orl_image_resize_area(&down, 5 * fx, 4 * fy, &up));
            for (int y = 0; y < up.h; y++) for (int x = 0; x < up.w; x++) assert_memory_equal(up.px + 3 * (y * up.w + x), down.px + 3 * (y / fy * 5 + x / fx), 3);
            ok(orl_image_resize_area(&up, 5, 4, &back));
            assert_memory_equal(back.px, down.px, 60);
            orl_image_free(&in);
            orl_image_free(&down);
            orl_image_free(&up);
            orl_image_free(&back);
        }
    orl_image in = random_image(9, 7, 4), out, was;
    ok(orl_image_resize_area(&in, 9, 7, &out));
    assert_memory_equal(in.px, out.px, 9 * 7 * 4);
    was = out;
    failed(orl_image_resize_area(&in, 0, 7, &out), ORL_E_RANGE, "image size", NULL);
    failed(orl_image_resize_area(&in, 9, 65536, &out), ORL_E_RANGE, "image size", NULL);
    assert_memory_equal(&out, &was, sizeof out);
    orl_image_free(&in);
    orl_image_free(&out);
    /* A constant stays what it is at any size. */
    for (int size = 1; size < 90; size += 4) {
        orl_imagef c, r;
        ok(orl_imagef_alloc(&c, 49, 31, 1));
        for (int i = 0; i < 49 * 31; i++) c.px[i] = 0.7f;
        ok(orl_imagef_resize_area(&c, size, 90 - size, &r));
        for (int i = 0; i < size * (90 - size); i++) assert_true(fabsf(r.px[i] - 0.7f) < 1e-6f);
        orl_imagef_free(&c);
        orl_imagef_free(&r);
    }
}

static void formats_listed(void **state)
{
    (void)state;
    char list[64];
    snprintf(list, sizeof list, "%s", orl_image_formats());
    assert_null(strpbrk(list, " \n"));
    for (char *s = strtok(list, ","); s; s = strtok(NULL, ",")) assert_true(!strcmp(s, "png") || !strcmp(s, "jpeg") || !strcmp(s, "exr"));
    if (*list) assert_true(list[strlen(list) - 1] != ',');
}

static void png_there_and_back(void **state)
{
    (void)state;
    NEEDS("png");
    static const int SIZE[][2] = { { 1, 1 }, { 1, 300 }, { 257, 1 }, { 33, 17 }, { 64, 64 } };
    seed_print();
    for (size_t k = 0; k < sizeof SIZE / sizeof *SIZE; k++)
        for (int c = 1; c <= 4; c += c == 1 ? 2 : 1) {
            orl_image w = random_image(SIZE[k][0], SIZE[k][1], c), r;
            int n = w.w * w.h;
            if (c == 4) for (int i = 0; i < n; i++) w.px[4 * i + 3] = i & 1 ? 255 : 0;
            ok(orl_image_write(at("a.png"), &w));
            ok(orl_image_read(at("a.png"), 3, &r));
            assert_true(r.w == w.w && r.h == w.h && r.c == 3);
            for (int i = 0; i < n; i++)
                for (int a = 0; a < 3; a++) assert_int_equal(r.px[3 * i + a], c == 1 ? w.px[i] : c == 3 ? w.px[3 * i + a] : i & 1 ? w.px[4 * i + a] : 0);    /* transparent: black */
            orl_image_free(&r);
            if (c < 4) {
                ok(orl_image_read(at("a.png"), 1, &r));
                assert_true(r.w == w.w && r.h == w.h && r.c == 1);
                for (int i = 0; i < n; i++) {
                    const uint8_t *p = w.px + c * i;
                    int want = c == 1 ? *p : (299 * p[0] + 587 * p[1] + 114 * p[2] + 500) / 1000;
                    if (r.px[i] != want) fail_msg("%d became %d", want, r.px[i]);       /* as JPEG's grey */
                }
                orl_image_free(&r);
            }
            orl_image_free(&w);
        }
    orl_image two = random_image(4, 4, 2);
    failed(orl_image_write(at("b.png"), &two), ORL_E_UNSUPPORTED, at("b.png"), NULL);
    orl_image_free(&two);
    assert_int_equal(entries(scratch), 1);
}

static void jpeg_there_and_back(void **state)
{
    (void)state;
    NEEDS("jpeg");
    static const char *const NAME[] = { "a.jpg", "a.jpeg", "A.JPG", "a.b.Jpeg" };
    for (int k = 0; k < 4; k++) {
        orl_image w, r;
        ok(orl_image_alloc(&w, 50 + k, 37, 3));
        for (int y = 0; y < w.h; y++)
            for (int x = 0; x < w.w; x++)
                for (int a = 0; a < 3; a++) w.px[3 * (y * w.w + x) + a] = (uint8_t)(128 + 90 * sin(x * 0.11 + a * 0.5) * cos(y * 0.13));
        ok(orl_image_write(at("%s", NAME[k]), &w));
        for (int c = 1; c <= 3; c += 2) {
            double sum = 0, worst = 0;
            ok(orl_image_read(at("%s", NAME[k]), c, &r));
            assert_true(r.w == w.w && r.h == w.h && r.c == c);
            for (int i = 0; i < w.w * w.h; i++)
                for (int a = 0; a < c; a++) {
                    const uint8_t *p = w.px + 3 * i;
                    double e = fabs(r.px[c * i + a] - (c == 3 ? p[a] : 0.299 * p[0] + 0.587 * p[1] + 0.114 * p[2]));
                    sum += e * e;
                    worst = fmax(worst, e);
                }
            assert_true(sqrt(sum / (w.w * w.h * c)) < 2 && worst < 12);
            orl_image_free(&r);
        }
        orl_image_free(&w);
    }
    /* Grey is written as grey, and read back as grey or spread. */
    orl_image g, r;
    ok(orl_image_alloc(&g, 24, 16, 1));
    for (int i = 0; i < 24 * 16; i++) g.px[i] = (uint8_t)(i / 24 * 12);
    ok(orl_image_write(at("g.jpg"), &g));
    ok(orl_image_read(at("g.jpg"), 3, &r));
    for (int i = 0; i < 24 * 16; i++) assert_true(abs(r.px[3 * i] - g.px[i]) < 6 && r.px[3 * i] == r.px[3 * i + 1] && r.px[3 * i] == r.px[3 * i + 2]);
    orl_image_free(&r);
    ok(orl_image_read(at("g.jpg"), 1, &r));
    for (int i = 0; i < 24 * 16; i++) assert_true(abs(r.px[i] - g.px[i]) < 6);
    orl_image_free(&r);
    orl_image_free(&g);
    g = random_image(4, 4, 4);
    failed(orl_image_write(at("x.jpg"), &g), ORL_E_UNSUPPORTED, at("x.jpg"), NULL);
    orl_image_free(&g);
}

/* The JPEG of a file with an EXIF block behind its first two bytes: `tags` entries, the last of them the orientation. */
static size_t with_exif(const uint8_t *jpeg, size_t n, int big, int tags, int orientation, uint8_t *out)
{
    size_t body = 6 + 8 + 2 + 12 * (size_t)tags + 4, k = 0;
#define B(v) (out[k++] = (uint8_t)(v))
#define B16(v) (big ? (B((v) >> 8), B(v)) : (B(v), B((v) >> 8)))
#define B32(v) (big ? (B16((v) >> 16), B16((v) & 0xffff)) : (B16((v) & 0xffff), B16((v) >> 16)))
    B(0xff); B(0xd8); B(0xff); B(0xe1); B((body + 2) >> 8); B(body + 2);
    memcpy(out + k, "Exif\0", 6); k += 6;
    B(big ? 'M' : 'I'); B(big ? 'M' : 'I'); B16(42); B32(8); B16(tags);
    for (int t = 1; t < tags; t++) { B16(0x100 + t); B16(3); B32(1); B16(t + 1); B16(0); }
    B16(0x112); B16(3); B32(1); B16(orientation); B16(0);
    B32(0);
    memcpy(out + k, jpeg + 2, n - 2);
    return k + n - 2;
}

static void exif_orientation(void **state)
{
    (void)state;
    NEEDS("jpeg");
    static const char *const SHOWN[] = { "ABCD", "ABCD", "BADC", "DCBA", "CDAB", "ACBD", "CADB", "DBCA", "BDAC", "ABCD", "ABCD" };     /* 0 and 9 are no orientations */
    orl_image im = corners(48, 32), r;
    size_t n, m;
    ok(orl_image_write(at("a.jpg"), &im));
    orl_image_free(&im);
    uint8_t *jpeg = slurp(at("a.jpg"), &n), *out = malloc(n + 400);
    for (int o = 0; o <= 9; o++)
        for (int k = 0; k < 4; k++) {
            m = with_exif(jpeg, n, k & 1, k & 2 ? 11 : 1, o, out);
            put_bytes(at("b.jpg"), out, m);
            ok(orl_image_read(at("b.jpg"), 3, &r));
            int turned = o >= 5 && o <= 8;
            assert_true(r.w == (turned ? 32 : 48) && r.h == (turned ? 48 : 32));
            expect_corners(&r, SHOWN[o]);
            orl_image_free(&r);
        }
    /* Broken blocks say nothing, and are not followed out of the file: each byte of the block at its extremes. */
    m = with_exif(jpeg, n, 0, 3, 1, out);
    for (size_t i = 6; i < 2 + 2 + 6 + 8 + 2 + 36 + 4; i++)
        for (int v = 0; v < 3; v++) {
            uint8_t was = out[i];
            out[i] = (uint8_t)(v == 0 ? 0xff : v == 1 ? 0 : 0x80);
            put_bytes(at("b.jpg"), out, m);
            ok(orl_image_read(at("b.jpg"), 3, &r));
            assert_int_equal(r.w * r.h, 48 * 32);
            orl_image_free(&r);
            out[i] = was;
        }
    free(out);
    free(jpeg);
}

/* A half's value by its bits: sign, 5 bits of exponent, 10 of fraction. */
static float half(uint32_t b)
{
    int e = b >> 10 & 31;
    double v = e ? ldexp(1024 + (b & 1023), e - 25) : ldexp(b & 1023, -24);
    return (float)(b >> 15 ? -v : v);
}

static void exr_there_and_back(void **state)
{
    (void)state;
    NEEDS("exr");
    static const struct { int w, h, c; const char *names, *read, order[6]; } CASE[] = {
        { 1, 1, 1, "Y", "Y", { 0 } }, { 37, 1, 3, "R,G,B", "RGB", { 0, 1, 2 } }, { 1, 50, 3, "R,G,B", "BGR", { 2, 1, 0 } }, { 20, 16, 3, "R,G,B", "G", { 1 } }, { 20, 17, 3, "B,G,R", "RGB", { 2, 1, 0 } },
        { 33, 40, 4, "albedo.R,albedo.G,albedo.B,Z", "Z,albedo.B,albedo.R", { 3, 2, 0 } }, { 9, 33, 4, "R,G,B,A", "RGBA", { 0, 1, 2, 3 } }, { 5, 5, 2, "depth,depth2", "depth2,depth", { 1, 0 } },
        { 9, 33, 4, "R,G,B,A", "RGB", { 0, 1, 2 } }, { 9, 33, 4, "R,G,B,A", "ABGR", { 3, 2, 1, 0 } }, { 9, 33, 4, "A,B,G,R", "RGBA", { 3, 2, 1, 0 } }, { 16, 16, 4, "R,G,B,A", "A", { 3 } },
        { 16, 16, 3, "R,G,B", "RB", { 0, 2 } }, { 8, 8, 5, "a,b,c,d,e", "e,b", { 4, 1 } }, { 70, 50, 4, "A,R,G,B", "BRG", { 3, 1, 2 } },
    };
    seed_print();
    for (size_t k = 0; k < sizeof CASE / sizeof *CASE; k++) {
        orl_imagef w, r;
        int n = CASE[k].w * CASE[k].h, c = CASE[k].c, rc = (int)strlen(CASE[k].read);
        if (strchr(CASE[k].read, ',')) { rc = 1; for (const char *s = CASE[k].read; *s; s++) rc += *s == ','; }
        ok(orl_imagef_alloc(&w, CASE[k].w, CASE[k].h, c));
        for (int i = 0; i < n * c; i++) do w.px[i] = half(rnd() & 0xffff); while (!(fabsf(w.px[i]) <= 65504));
        ok(orl_exr_write(at("a.exr"), &w, CASE[k].names));
        ok(orl_exr_read(at("a.exr"), CASE[k].read, &r));
        assert_true(r.w == w.w && r.h == w.h && r.c == rc);
        for (int i = 0; i < n; i++) for (int a = 0; a < rc; a++) if (r.px[i * rc + a] != w.px[i * c + CASE[k].order[a]]) fail_msg("%s as %s: pixel %d, channel %d is %g and was %g", CASE[k].names, CASE[k].read, i, a, (double)r.px[i * rc + a], (double)w.px[i * c + CASE[k].order[a]]);
        orl_imagef_free(&r);
        orl_imagef_free(&w);
    }
    assert_int_equal(entries(scratch), 1);
}

static void exr_values(void **state)
{
    (void)state;
    NEEDS("exr");
    static const struct { float v, want; } CASE[] = { { NAN, 0 }, { INFINITY, 65504 }, { 1e9f, 65504 }, { 65504, 65504 }, { 1, 1 }, { -2.5f, -2.5f }, { 1e-9f, 0 }, { 1.0004f, 1 } };
    enum { N = sizeof CASE / sizeof *CASE };
    orl_imagef w, r, was;
    ok(orl_imagef_alloc(&w, N, 3, 3));
    for (int i = 0; i < N; i++) w.px[3 * i] = CASE[i].v;
    for (int i = 3 * N; i < 9 * N; i++) w.px[i] = (float)uniform(0.01, 100);
    ok(orl_exr_write(at("a.exr"), &w, "R,G,B"));
    ok(orl_exr_read(at("a.exr"), "RGB", &r));
    for (int i = 0; i < N; i++) if (r.px[3 * i] != CASE[i].want) fail_msg("%g became %g", (double)CASE[i].v, (double)r.px[3 * i]);
    for (int i = 3 * N; i < 9 * N; i++) assert_true(fabsf(r.px[i] / w.px[i] - 1) <= 1 / 2048.0f);      /* nearest half */
    orl_imagef_free(&r);
    memset(&r, 0x5a, sizeof r);
    was = r;
    static const char *const MISSING[] = { "Y", "RGBA", "A", "r", "R,G,Bb", "R,G,albedo.B", "Z,R" };
    for (size_t k = 0; k < sizeof MISSING / sizeof *MISSING; k++) failed(orl_exr_read(at("a.exr"), MISSING[k], &r), ORL_E_FORMAT, at("a.exr"), MISSING[k], NULL);
    assert_memory_equal(&r, &was, sizeof r);
    static const char *const NAMES[] = { "R,G", "R,G,B,A", "RGB", "R,,B", "", "R,G,B,", ",R,G" };
    for (size_t k = 0; k < sizeof NAMES / sizeof *NAMES; k++) failed(orl_exr_write(at("b.exr"), &w, NAMES[k]), ORL_E_RANGE, at("b.exr"), NULL);
    failed(orl_exr_read(at("none.exr"), "RGB", &r), ORL_E_IO, at("none.exr"), NULL);
    assert_int_equal(entries(scratch), 1);
    orl_imagef_free(&w);
}

/* 32 bits keep every bit, for as many channels as an image may have. */
static void exr_float(void **state)
{
    (void)state;
    NEEDS("exr");
    orl_imagef w, r;
    char names[200] = "";
    seed_print();
    for (int k = 0; k < ORL_IMAGEF_MAX_CHANNELS; k++) sprintf(names + strlen(names), "%slayer.%c", k ? "," : "", 'x' - k);
    ok(orl_imagef_alloc(&w, 21, 19, ORL_IMAGEF_MAX_CHANNELS));
    int n = w.w * w.h * w.c;
    for (int i = 0; i < n; i++) w.px[i] = (float)uniform(-1, 1) * (i % 7 ? 1.0f : 1e30f);
    ok(orl_exr_write_float(at("a.exr"), &w, names));
    ok(orl_exr_read(at("a.exr"), names, &r));
    assert_memory_equal(w.px, r.px, (size_t)n * sizeof *w.px);
    failed(orl_exr_write_float(at("b.exr"), &w, "R,G,B"), ORL_E_RANGE, at("b.exr"), NULL);
    strcat(names, ",y");
    failed(orl_exr_write_float(at("b.exr"), &w, names), ORL_E_RANGE, at("b.exr"), NULL);
    failed(orl_exr_write_float(at("none/b.exr"), &w, names), ORL_E_RANGE, at("none/b.exr"), NULL);
    assert_int_equal(entries(scratch), 1);
    orl_imagef_free(&r);
    orl_imagef_free(&w);
}

/* A file as another program may write it, by https://openexr.com/en/latest/OpenEXRFileLayout.html: no compression, a window that does not begin at 0, half, float, whole numbers. */
static void exr_of_others(void **state)
{
    (void)state;
    NEEDS("exr");
    enum { X0 = -3, Y0 = 7, W = 5, H = 4 };
    static uint8_t b[2000];
    size_t n = 0;
    orl_imagef r;
#define LE(v, bytes) do { uint64_t v_ = (uint64_t)(v); memcpy(b + n, &v_, bytes); n += bytes; } while (0)
#define TEXT(t) do { memcpy(b + n, t, sizeof t); n += sizeof t; } while (0)
#define F32(v) do { float f_ = (v); memcpy(b + n, &f_, 4); n += 4; } while (0)
#define CHANNEL(name, type, step) do { TEXT(name); LE(type, 4); LE(0, 4); LE(step, 4); LE(1, 4); } while (0)
    LE(20000630, 4); LE(2, 4);
    TEXT("channels"); TEXT("chlist"); LE(4 * 18 + 1, 4); CHANNEL("A", 1, 1); CHANNEL("F", 2, 1); CHANNEL("T", 1, 1); CHANNEL("U", 0, 1); LE(0, 1);
    TEXT("compression"); TEXT("compression"); LE(1, 4); LE(0, 1);
    for (int k = 0; k < 2; k++) {
        if (k) TEXT("displayWindow"); else TEXT("dataWindow");
        TEXT("box2i"); LE(16, 4); LE(X0, 4); LE(Y0, 4); LE(X0 + W - 1, 4); LE(Y0 + H - 1, 4);
    }
    TEXT("lineOrder"); TEXT("lineOrder"); LE(1, 4); LE(0, 1);
    TEXT("pixelAspectRatio"); TEXT("float"); LE(4, 4); F32(1);
    TEXT("screenWindowCenter"); TEXT("v2f"); LE(8, 4); F32(0); F32(0);
    TEXT("screenWindowWidth"); TEXT("float"); LE(4, 4); F32(1);
    LE(0, 1);
    size_t line = W * (2 + 4 + 2 + 4), table = n;
    for (int y = 0; y < H; y++) LE(table + 8 * H + (size_t)y * (line + 8), 8);
    for (int y = 0; y < H; y++) {
        LE(Y0 + y, 4); LE(line, 4);
        for (int x = 0; x < W; x++) LE(0x3c00 + y * 16 + x, 2);         /* half: 1 + (16 y + x) / 1024 */
        for (int x = 0; x < W; x++) F32(x == 4 ? NAN : 1e30f * (float)(y - 1) + (float)x * 0.1f);
        for (int x = 0; x < W; x++) LE(x == 0 ? 0xfc00 : x == 1 ? 0x7c00 : x == 2 ? 1 : x == 3 ? 0x83ff : 0x7e00, 2);      /* -inf, inf, the smallest, nearly the largest that is not normal, NaN */
        for (int x = 0; x < W; x++) LE(4000000000u + (uint32_t)(256 * (x + y)), 4);
    }
    put_bytes(at("o.exr"), b, n);
    ok(orl_exr_read(at("o.exr"), "UFTA", &r));
    assert_true(r.w == W && r.h == H && r.c == 4);
    for (int y = 0; y < H; y++)
        for (int x = 0; x < W; x++) {
            const float *p = r.px + 4 * (y * W + x);
            assert_true(p[0] == 4000000000.0f + (float)(256 * (x + y)));
            assert_true(p[1] == (x == 4 ? 0 : 1e30f * (float)(y - 1) + (float)x * 0.1f));
            assert_true(x == 0 ? isfinite(p[2]) && p[2] <= 0 : p[2] == (x == 1 ? 65504 : x == 2 ? 0x1p-24f : x == 3 ? -1023 * 0x1p-24f : 0));
            assert_true(p[3] == 1 + (float)(16 * y + x) / 1024);
        }
    orl_imagef_free(&r);
    ok(orl_exr_read(at("o.exr"), "F", &r));
    assert_true(r.c == 1 && r.px[6] == 0.1f);
    orl_imagef_free(&r);
    for (size_t m = 0; m < n; m++) {
        put_bytes(at("o.exr"), b, m);
        failed(orl_exr_read(at("o.exr"), "AF", &r), ORL_E_FORMAT, at("o.exr"), NULL);
    }
}

/* ---- Radiance ---- */

enum { FLAT, OLD_RUNS, NEW_RUNS };
#define HDR_HEAD "#?RADIANCE\n# made by a test\nEXPOSURE=4\nFORMAT=32-bit_rle_rgbe\n\n"

static uint8_t *put_repeat(uint8_t *o, int n)       /* old runs: the digits of n to base 256, lowest first */
{
    for (; n; n >>= 8) { memcpy(o, "\1\1\1", 3); o[3] = (uint8_t)n; o += 4; }
    return o;
}

static uint8_t *put_line(const uint8_t (*px)[4], int w, int how, uint8_t *o)
{
    if (how == NEW_RUNS) { *o++ = 2; *o++ = 2; *o++ = (uint8_t)(w >> 8); *o++ = (uint8_t)w; }
    for (int c = 0; how == NEW_RUNS && c < 4; c++)
        for (int x = 0, n; x < w; x += n) {
            for (n = 1; x + n < w && n < 127 && px[x + n][c] == px[x][c]; n++) {}
            if (n > 2 || (n == 2 && rnd() % 2)) { *o++ = (uint8_t)(128 + n); *o++ = px[x][c]; continue; }
            n = 1 + (int)(rnd() % 128);             /* as others may write it: literal, whatever follows */
            if (n > w - x) n = w - x;
            *o++ = (uint8_t)n;
            for (int k = 0; k < n; k++) *o++ = px[x + k][c];
        }
    for (int x = 0, n; how != NEW_RUNS && x < w; x += n) {
        for (n = 1; how == OLD_RUNS && x + n < w && !memcmp(px[x + n], px[x], 4); n++) {}
        memcpy(o, px[x], 4);
        o = n > 1 ? put_repeat(o + 4, n - 1) : o + 4;
    }
    return o;
}

/* A picture of noise and of runs up to a line; px is what it holds. Returns the file's bytes. */
static uint8_t *make_hdr(int w, int h, int how, uint8_t (*px)[4], size_t *n)
{
    uint8_t *b = malloc(200 + (size_t)w * (size_t)h * 9 + 8 * (size_t)h), *o = b + sprintf((char *)b, HDR_HEAD "-Y %d +X %d\n", h, w);
    for (int y = 0; y < h; y++) {
        uint8_t (*row)[4] = px + (size_t)y * (size_t)w;
        for (int x = 0; x < w; x++) {
            if (x && rnd() % 8) memcpy(row[x], row[x - 1], 4);
            else for (int c = 0; c < 4; c++) row[x][c] = (uint8_t)(c == 0 ? 128 | rnd() : c == 3 && rnd() % 4 == 0 ? 0 : rnd());
            if (y == h - 1) memcpy(row[x], row[0], 4);
        }
        o = put_line((const uint8_t (*)[4])row, w, how, o);
    }
    *n = (size_t)(o - b);
    return b;
}

static void hdr_there_and_back(void **state)
{
    (void)state;
    static const int SIZE[][2] = { { 1, 1 }, { 1, 9 }, { 7, 3 }, { 8, 1 }, { 9, 5 }, { 128, 4 }, { 129, 3 }, { 300, 7 }, { 1000, 6 }, { 33000, 2 } };
    static uint8_t px[70000][4];
    seed_print();
    for (size_t k = 0; k < sizeof SIZE / sizeof *SIZE; k++)
        for (int how = FLAT; how <= NEW_RUNS; how++) {
            int w = SIZE[k][0], h = SIZE[k][1];
            orl_imagef r, o;
            size_t n;
            char path[100];
            if (how == NEW_RUNS && (w < 8 || w > 32767)) continue;
            uint8_t *b = make_hdr(w, h, how, px, &n);
            snprintf(path, sizeof path, "%s", at("%d_%d_%d.hdr", w, h, how));        /* OpenImageIO remembers a name's size */
            put_bytes(path, b, n);
            ok(orl_imagef_read(path, &r));
            assert_true(r.w == w && r.h == h && r.c == 3);
            for (int i = 0; i < w * h; i++)
                for (int c = 0; c < 3; c++) {
                    float want = px[i][3] ? (float)ldexp(px[i][c], px[i][3] - 136) : 0;
                    if (r.px[3 * i + c] != want) fail_msg("%d x %d, kind %d: pixel %d, channel %d is %g, not %g", w, h, how, i, c, (double)r.px[3 * i + c], (double)want);
                }
            if (how != OLD_RUNS && w < 32768) {     /* the trainer's reader knows no old runs */
                ok(orl_oiio_read_float(path, &o));
                assert_true(o.w == w && o.h == h);
                for (int i = 0; i < w * h * 3; i++) assert_true(fabsf(o.px[i] - r.px[i]) <= 1e-6f * r.px[i]);       /* its powers of two are not quite exact far from 1 */
                orl_imagef_free(&o);
            }
            orl_imagef_free(&r);
            free(b);
        }
}

/* Real panoramas, as the trainer reads them. */
static void hdr_of_others(void **state)
{
    (void)state;
    static const char *const NAME[] = { "noon_grass_1k", "venice_sunset_1k", "dikhololo_night_1k" };
    int seen = 0;
    for (int k = 0; k < 3; k++) {
        char path[200];
        orl_imagef a, b;
        snprintf(path, sizeof path, "../shared/data/sky/%s.hdr", NAME[k]);
        if (access(path, R_OK)) continue;
        ok(orl_imagef_read(path, &a));
        ok(orl_oiio_read_float(path, &b));
        assert_true(a.w == b.w && a.h == b.h && a.c == b.c);
        assert_memory_equal(a.px, b.px, (size_t)a.w * (size_t)a.h * 12);
        orl_imagef_free(&a);
        orl_imagef_free(&b);
        seen++;
    }
    if (!seen) { print_message("no ../shared/data/sky\n"); skip(); }
}

/* Headers and scan lines that lie, each named by file and field. */
static void hdr_lies(void **state)
{
    (void)state;
#define F "FORMAT=32-bit_rle_rgbe\n"
#define DATA "abcdabcdabcdabcd"
    static const struct { const char *text; orl_err want; const char *field; } CASE[] = {
        { "RADIANCE\n" F "\n-Y 1 +X 1\n" DATA, ORL_E_FORMAT, "neither" }, { "#?RADIANCE", ORL_E_FORMAT, "not a Radiance picture" }, { "#?RADIANCE\n" F, ORL_E_FORMAT, "header has no end" },
        { "#?RADIANCE\n\n-Y 1 +X 1\n" DATA, ORL_E_FORMAT, "no FORMAT" }, { "#?RADIANCE\nFORMAT=32-bit_rle_xyze\n\n-Y 1 +X 1\n" DATA, ORL_E_UNSUPPORTED, "FORMAT 32-bit_rle_xyze" },
        { "#?RADIANCE\n" F "\n", ORL_E_FORMAT, "no size" }, { "#?RADIANCE\n" F "\n-Y 1 +X 1", ORL_E_FORMAT, "no size" }, { "#?RADIANCE\n" F "\n+Y 1 +X 1\n" DATA, ORL_E_UNSUPPORTED, "orientation +Y 1 +X 1" },
        { "#?RADIANCE\n" F "\n+X 1 -Y 1\n" DATA, ORL_E_UNSUPPORTED, "orientation" }, { "#?RADIANCE\n" F "\n-Y 1 -X 1\n" DATA, ORL_E_UNSUPPORTED, "orientation" },
        { "#?RADIANCE\n" F "\n-Y 1 +X\n" DATA, ORL_E_FORMAT, "size" }, { "#?RADIANCE\n" F "\n-Y 1 +X 1 1\n" DATA, ORL_E_FORMAT, "size" }, { "#?RADIANCE\n" F "\n-Y 0x9 +X 1\n" DATA, ORL_E_FORMAT, "size" },
        { "#?RADIANCE\n" F "\n-Y 0 +X 1\n" DATA, ORL_E_RANGE, "size 1 x 0" }, { "#?RADIANCE\n" F "\n-Y 1 +X -1\n" DATA, ORL_E_RANGE, "size -1 x 1" }, { "#?RADIANCE\n" F "\n-Y 65536 +X 1\n" DATA, ORL_E_RANGE, "size 1 x 65536" },
        { "#?RADIANCE\n" F "\n-Y 65535 +X 65535\n" DATA, ORL_E_RANGE, "size 65535 x 65535" }, { "#?RADIANCE\n" F "\n-Y 99999999999999999999 +X 8\n" DATA, ORL_E_FORMAT, "size" },
        { "#?RADIANCE\n" F "\n-Y 16000 +X 16000\n" DATA, ORL_E_FORMAT, "size 16000 x 16000" }, { "#?RADIANCE\n" F "\n-Y 3 +X 2\n" DATA, ORL_E_FORMAT, "16 bytes" }, { "#?RADIANCE\n" F "\n-Y 1 +X 5\n" DATA, ORL_E_FORMAT, "scan line 0" },
        { "#?RADIANCE\n" F "\n-Y 1 +X 8\n\2\2\1\1" DATA, ORL_E_FORMAT, "scan line 0" }, { "#?RADIANCE\n" F "\n-Y 1 +X 2\n\1\1\1\2" DATA, ORL_E_FORMAT, "scan line 0" },
        { "#?RADIANCE\n" F "\n-Y 1 +X 8\nabcd\1\1\1\10" DATA, ORL_E_FORMAT, "scan line 0" }, { "#?RADIANCE\n" F "\n-Y 1 +X 9\nabcd\1\1\1\377\1\1\1\377\1\1\1\377\1\1\1\377" DATA, ORL_E_FORMAT, "scan line 0" },
        { "#?RADIANCE\n" F "\n-Y 1 +X 300\n\2\2\1\54\377a\377a\377a" DATA, ORL_E_FORMAT, "scan line 0" },
    };
    orl_imagef r, was;
    memset(&r, 0x5a, sizeof r);
    was = r;
    for (size_t k = 0; k < sizeof CASE / sizeof *CASE; k++) {
        put_text(at("l.hdr"), CASE[k].text);
        failed(orl_imagef_read(at("l.hdr"), &r), CASE[k].want, at("l.hdr"), CASE[k].field, NULL);
        assert_memory_equal(&r, &was, sizeof r);
    }
    /* New runs of no pixel, and one pixel too many. */
    for (int bad = 0; bad < 3; bad++) {
        uint8_t b[200], *o = b + sprintf((char *)b, HDR_HEAD "-Y 1 +X 8\n");
        memcpy(o, "\2\2\0\10", 4); o += 4;
        for (int c = 0; c < 4; c++) { *o++ = (uint8_t)(bad == 0 ? 0 : 136 + (bad == 1 && c == 3)); *o++ = 130; }
        put_bytes(at("l.hdr"), b, (size_t)(o - b));
        if (bad < 2) { failed(orl_imagef_read(at("l.hdr"), &r), ORL_E_FORMAT, at("l.hdr"), "scan line 0", NULL); continue; }
        ok(orl_imagef_read(at("l.hdr"), &r));       /* what is right after all */
        assert_true(r.px[0] == (float)ldexp(130, 130 - 136) && r.px[23] == r.px[0]);
        orl_imagef_free(&r);
    }
    /* Lines may end as elsewhere, and a comment be long. */
    put_text(at("l.hdr"), "#?RGBE\r\n# 0123456789012345678901234567890123456789012345678901234567890123456789012345678901234567890123456789012345678901234567890123456789\r\nFORMAT=32-bit_rle_rgbe \r\n\r\n-Y 1 +X 1\r\nabc\200");
    ok(orl_imagef_read(at("l.hdr"), &r));
    assert_true(r.px[0] == 'a' / 256.0f && r.px[2] == 'c' / 256.0f);
    orl_imagef_free(&r);
#undef F
#undef DATA
}

static orl_err read_any(const char *path)
{
    if (strstr(path, ".exr") || strstr(path, ".hdr")) {
        orl_imagef f, was;
        memset(&f, 0x5a, sizeof f);
        was = f;
        orl_err e = orl_imagef_read(path, &f);
        if (e) assert_memory_equal(&f, &was, sizeof f);
        else orl_imagef_free(&f);
        return e;
    }
    orl_image im, was;
    memset(&im, 0x5a, sizeof im);
    was = im;
    orl_err e = orl_image_read(path, 3, &im);
    if (e) assert_memory_equal(&im, &was, sizeof im);
    else orl_image_free(&im);
    return e;
}

/* A small picture of each format. */
static int write_any(const char *format, const char *path)
{
    if (!strcmp(format, "hdr")) {
        static uint8_t px[24 * 20][4];
        size_t n;
        uint8_t *b = make_hdr(24, 20, NEW_RUNS, px, &n);
        put_bytes(path, b, n);
        free(b);
        return 1;
    }
    orl_image im = corners(24, 20);
    orl_imagef f;
    if (!has(format)) { orl_image_free(&im); return 0; }
    ok(orl_image_to_float(&im, &f));
    ok(!strcmp(format, "exr") ? orl_exr_write(path, &f, "R,G,B") : orl_image_write(path, &im));
    orl_image_free(&im);
    orl_imagef_free(&f);
    return 1;
}

static const struct { const char *format, *file, *magic; size_t nmagic; } KIND[] = {
    { "png", "a.png", "\x89PNG\r\n\x1a\n", 8 }, { "jpeg", "a.jpg", "\xff\xd8\xff\xe0", 4 }, { "exr", "a.exr", "\x76\x2f\x31\x01\x02\0\0\0", 8 },
    { "hdr", "a.hdr", "#?RADIAN", 8 },
};

/* Every length that is too short is refused by name. */
static void cut_short(void **state)
{
    (void)state;
    for (int k = 0; k < 4; k++) {
        size_t n;
        if (!write_any(KIND[k].format, at("%s", KIND[k].file))) continue;
        uint8_t *bytes = slurp(at("%s", KIND[k].file), &n);
        ok(read_any(at("%s", KIND[k].file)));
        for (size_t m = 0; m < n; m++) {
            put_bytes(at("%s", KIND[k].file), bytes, m);
            orl_err e = read_any(at("%s", KIND[k].file));
            if (!e) fail_msg("%s: %zu of %zu bytes were taken for a picture", KIND[k].file, m, n);
            failed(e, ORL_E_FORMAT, at("%s", KIND[k].file), NULL);
        }
        free(bytes);
    }
}

static void noise(void **state)
{
    (void)state;
    uint8_t b[3000];
    seed_print();
    for (int k = 0; k < 4; k++) {
        if (k < 3 && !has(KIND[k].format)) continue;
        for (int round = 0; round < 60; round++) {
            size_t n = round ? rnd() % sizeof b : 0;
            for (size_t i = 0; i < n; i++) b[i] = (uint8_t)rnd();
            if (round & 1 && n > 8) memcpy(b, KIND[k].magic, KIND[k].nmagic);       /* noise that begins well */
            put_bytes(at("%s", KIND[k].file), b, n);
            failed(read_any(at("%s", KIND[k].file)), ORL_E_FORMAT, at("%s", KIND[k].file), NULL);
        }
        failed(read_any(at("none/%s", KIND[k].file)), ORL_E_IO, at("none/%s", KIND[k].file), NULL);
    }
    put_text(at("t.png"), "This is no picture at all.\n");
    failed(read_any(at("t.png")), ORL_E_FORMAT, at("t.png"), "PNG", NULL);
    failed(orl_image_read(scratch, 3, &(orl_image){ 0 }), ORL_E_IO, scratch, NULL);
    orl_image im = corners(8, 8);
    static const char *const OTHER[] = { "a.bmp", "a", "png", "a.png.tif", "a.jpgx" };
    for (size_t k = 0; k < sizeof OTHER / sizeof *OTHER; k++) failed(orl_image_write(at("%s", OTHER[k]), &im), ORL_E_UNSUPPORTED, at("%s", OTHER[k]), NULL);
    orl_image_free(&im);
}

/* Flipped bytes in the middle of good files: an answer or an error, never a crash. */
static void flipped(void **state)
{
    (void)state;
    seed_print();
    for (int k = 0; k < 4; k++) {
        size_t n;
        int refused = 0;
        if (!write_any(KIND[k].format, at("%s", KIND[k].file))) continue;
        uint8_t *bytes = slurp(at("%s", KIND[k].file), &n);
        for (int round = 0; round < 300; round++) {
            size_t head = k == 1 ? 180 : 40, i = head + rnd() % (n - head);     /* behind PNG's and JPEG's size: a vast picture would only try the memory */
            uint8_t was = bytes[i];
            bytes[i] ^= (uint8_t)(1u << rnd() % 8);
            put_bytes(at("%s", KIND[k].file), bytes, n);
            orl_err e = read_any(at("%s", KIND[k].file));
            if (e) { refused++; failed(e, e, at("%s", KIND[k].file), NULL); }
            bytes[i] = was;
        }
        print_message("%s: %d of 300 refused\n", KIND[k].format, refused);
        assert_true(refused > 0);
        free(bytes);
    }
}

static void file_read(void **state)
{
    (void)state;
    uint8_t data[1000], *p = data;
    size_t n = 77;
    for (int i = 0; i < 1000; i++) data[i] = (uint8_t)(i * 7);
    ok(orl_file_write(at("f"), data, 1000));
    for (size_t max = 998; max < 1003; max++) {
        orl_err e = orl_file_read(at("f"), max, &p, &n);
        if (max < 1000) {
            failed(e, ORL_E_RANGE, at("f"), "1000 bytes", NULL);
            assert_ptr_equal(p, data);
            assert_int_equal(n, 77);
            continue;
        }
        ok(e);
        assert_int_equal(n, 1000);
        assert_memory_equal(p, data, 1000);
        free(p);
        p = data;
        n = 77;
    }
    failed(orl_file_read(at("none"), 9, &p, &n), ORL_E_IO, at("none"), NULL);
    failed(orl_file_read(at("f/x"), 9, &p, &n), ORL_E_IO, at("f/x"), NULL);
    failed(orl_file_read(scratch, 1 << 20, &p, &n), ORL_E_IO, scratch, "regular", NULL);
    failed(orl_file_read("/dev/zero", 1 << 20, &p, &n), ORL_E_IO, "/dev/zero", "regular", NULL);
    assert_ptr_equal(p, data);
    assert_int_equal(n, 77);
    ok(orl_file_write(at("e"), NULL, 0));
    ok(orl_file_read(at("e"), 0, &p, &n));
    assert_int_equal(n, 0);
    assert_non_null(p);
    free(p);
}

static void file_write(void **state)
{
    (void)state;
    uint8_t *p;
    size_t n;
    static uint8_t big[300000];
    for (size_t i = 0; i < sizeof big; i++) big[i] = (uint8_t)(i * 31 >> 3);
    ok(orl_file_write(at("f"), big, sizeof big));
    ok(orl_file_write(at("f"), "new", 3));             /* in the old one's place, not over its bytes */
    ok(orl_file_read(at("f"), 10, &p, &n));
    assert_int_equal(n, 3);
    assert_memory_equal(p, "new", 3);
    free(p);
    assert_int_equal(entries(scratch), 1);
    char far[5000];
    memset(far, 'a', sizeof far - 1);
    far[sizeof far - 1] = 0;
    failed(orl_file_write(far, "x", 1), ORL_E_RANGE, NULL);
}

/* What fails leaves the old file as it was, and nothing beside it. Not /dev/full itself: the rename would take its place. */
static void failing_writes(void **state)
{
    (void)state;
    orl_image im;
    orl_imagef f;
    struct rlimit was, tight = { 2048, 0 };
    seed_print();
    im = random_image(90, 70, 3);
    ok(orl_image_to_float(&im, &f));
    assert_int_equal(getrlimit(RLIMIT_FSIZE, &was), 0);
    tight.rlim_max = was.rlim_max;
    signal(SIGXFSZ, SIG_IGN);
    for (int k = 0; k < 4; k++) {
        static const char *const NAME[] = { "a.bin", "a.png", "a.jpg", "a.exr" };
        const char *name = NAME[k];
        if (k && !has(k == 1 ? "png" : k == 2 ? "jpeg" : "exr")) continue;
#define WRITE(path) (k == 0 ? orl_file_write(path, f.px, 60000) : k == 3 ? orl_exr_write(path, &f, "R,G,B") : orl_image_write(path, &im))
        failed(WRITE(at("none/%s", name)), ORL_E_IO, at("none/%s", name), NULL);
        assert_int_equal(entries(scratch), 0);
        put_text(at("f"), "");
        failed(WRITE(at("f/%s", name)), ORL_E_IO, at("f/%s", name), NULL);        /* a file where a folder should be */
        unlink(at("f"));
        for (int old = 0; old < 2; old++) {
            if (old) put_text(at("%s", name), "old");
            for (int how = 0; how < 2; how++) {
                if (how == 0) assert_int_equal(symlink("/dev/full", at("%s.tmp%ld", name, (long)getpid())), 0);     /* the disk is full */
                else assert_int_equal(setrlimit(RLIMIT_FSIZE, &tight), 0);                                          /* it fills on the way */
                orl_err e = WRITE(at("%s", name));
                assert_int_equal(setrlimit(RLIMIT_FSIZE, &was), 0);
                failed(e, ORL_E_IO, at("%s", name), NULL);
                assert_int_equal(entries(scratch), old);
                if (old) {
                    size_t n;
                    uint8_t *p = slurp(at("%s", name), &n);
                    assert_int_equal(n, 3);
                    assert_memory_equal(p, "old", 3);
                    free(p);
                }
            }
        }
        unlink(at("%s", name));
        mkdir(at("%s", name), 0777);                    /* written whole, but cannot take its place */
        failed(WRITE(at("%s", name)), ORL_E_IO, at("%s", name), NULL);
        assert_int_equal(entries(scratch), 1);
        rmdir(at("%s", name));
        ok(WRITE(at("%s", name)));
        assert_int_equal(entries(scratch), 1);
        unlink(at("%s", name));
    }
    struct stat st;
    assert_int_equal(stat("/dev/full", &st), 0);
    assert_true(S_ISCHR(st.st_mode));
    orl_image_free(&im);
    orl_imagef_free(&f);
}

#define TEST(f) cmocka_unit_test_setup_teardown(f, scratch_make, scratch_remove)
int main(void)
{
    const struct CMUnitTest tests[] = {
        TEST(allocates), TEST(conversions), TEST(long_side), TEST(area_resize), TEST(whole_factors), TEST(formats_listed), TEST(png_there_and_back), TEST(jpeg_there_and_back),
        TEST(exif_orientation), TEST(exr_there_and_back), TEST(exr_values), TEST(exr_of_others), TEST(exr_float), TEST(hdr_there_and_back), TEST(hdr_of_others), TEST(hdr_lies), TEST(cut_short), TEST(noise), TEST(flipped), TEST(file_read), TEST(file_write), TEST(failing_writes),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
