/* Conversion to RGB: the specification against the real matrix over all 2^24 triples, against the formula that Y4M replays have had, every variant against it bit for bit; any width, height and stride without
 * a byte read or written outside (pages that may not be touched); frames that lie; ffmpeg's own conversion. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>
#include <math.h>
#include <sys/mman.h>
#include "oriel/source.h"
#include "runtime/kernels/convert.h"
#include "tests/scratch.h"

static const char *const VARIANT[] = {
#define NAME(n) n,
    ORL_CONVERT_VARIANTS(NAME)
#undef NAME
};
enum { VARIANTS = sizeof VARIANT / sizeof *VARIANT, N = 512, GUARD = 64 };

static orl_source_info info_of(orl_pixels p, int w, int h, orl_matrix m, int full) { return (orl_source_info) { .w = w, .h = h, .pixels = p, .full_range = full, .fps_num = 25, .fps_den = 1, .matrix = m }; }

/* ---- the specification */

/* From the standards' definition of Y, U, V, without the tables. */
static void real_rgb(orl_matrix m, int full, int y, int u, int v, double rgb[3])
{
    const double kr = m == ORL_MATRIX_709 ? 0.2126 : 0.299, kb = m == ORL_MATRIX_709 ? 0.0722 : 0.114;
    double l = full ? y / 255.0 : (y - 16) / 219.0, cb = (u - 128) / (full ? 255.0 : 224.0), cr = (v - 128) / (full ? 255.0 : 224.0);
    rgb[0] = 255 * (l + 2 * (1 - kr) * cr);
    rgb[2] = 255 * (l + 2 * (1 - kb) * cb);
    rgb[1] = (255 * l - kr * rgb[0] - kb * rgb[2]) / (1 - kr - kb);
    for (int c = 0; c < 3; c++) rgb[c] = fmin(fmax(rgb[c], 0), 255);
}

/* What Y4M pictures were converted by before there were kernels. */
static int was(int full, int c, int y, int u, int v)
{
    static const int LIMITED[5] = { 19077, 26149, 6419, 13320, 33050 }, FULL[5] = { 16384, 22970, 5638, 11700, 29032 };
    const int *k = full ? FULL : LIMITED;
    int l = (y - (full ? 0 : 16)) * k[0] + 8192, s = c == 0 ? l + k[1] * (v - 128) : c == 1 ? l - k[2] * (u - 128) - k[3] * (v - 128) : l + k[4] * (u - 128);
    return s >> 14 < 0 ? 0 : s >> 14 > 255 ? 255 : s >> 14;
}

static void all_triples(void **state)
{
    (void)state;
    orl_convert_kernels k[VARIANTS];
    int have[VARIANTS];
    static uint8_t y[256], u[256], v[256], rgb[VARIANTS][768];
    for (int i = 0; i < VARIANTS; i++) {
        unsigned cpu;
        have[i] = !orl_cpu_from_name(VARIANT[i], &cpu);
        if (have[i]) orl_convert_kernels_init(&k[i], cpu);
    }
    for (int i = 0; i < 256; i++) y[i] = (uint8_t)i;
    for (int m = 0; m < 4; m++) {
        orl_source_info info = info_of(ORL_PIX_444, 256, 1, (orl_matrix)(m / 2), m % 2);
        orl_yuv_tab t;
        double worst = 0;
        long off = 0;
        orl_yuv_table(&info, &t);
        for (int uv = 0; uv < 65536; uv++) {
            memset(u, uv & 255, sizeof u);
            memset(v, uv >> 8, sizeof v);
            for (int i = 0; i < VARIANTS; i++) {
                if (!have[i]) continue;
                k[i].row[ORL_PIX_444]((const uint8_t *const[3]) { y, u, v }, &t, 256, rgb[i]);
                if (memcmp(rgb[i], rgb[0], sizeof *rgb)) fail_msg("%s differs from ref at U %d, V %d, matrix %d, full %d", VARIANT[i], u[0], v[0], m / 2, m % 2);
            }
            for (int i = 0; i < 256; i++) {
                double want[3];
                real_rgb(info.matrix, info.full_range, i, u[0], v[0], want);
                for (int c = 0; c < 3; c++) {
                    double e = fabs(rgb[0][3 * i + c] - want[c]);
                    worst = e > worst ? e : worst;
                    off += rgb[0][3 * i + c] != (int)(want[c] + 0.5);
                    if (m < 2 && rgb[0][3 * i + c] != was(m, c, i, u[0], v[0])) fail_msg("Y %d, U %d, V %d: %d, was %d", i, u[0], v[0], rgb[0][3 * i + c], was(m, c, i, u[0], v[0]));
                }
            }
        }
        print_message("figure: BT.%s %s: at most %.4f levels from the real matrix, %.3f %% of values not its nearest\n", m / 2 ? "709" : "601", m % 2 ? "full" : "limited", worst, 100.0 * (double)off / (3.0 * (1 << 24)));
        assert_true(worst < 0.51);
    }
}

/* ---- variants, formats */

/* The layouts once more, pixel by pixel, without the program's tables. */
static void yuv_at(const orl_source_info *i, const orl_frame *f, int x, int y, int yuv[3])
{
    const uint8_t *p = f->plane[0] + (size_t)y * f->stride[0], *q = f->plane[1] ? f->plane[1] + (size_t)y * f->stride[1] : NULL, *r = f->plane[2] ? f->plane[2] + (size_t)y * f->stride[2] : NULL;
    const uint8_t *q2 = q ? f->plane[1] + (size_t)(y / 2) * f->stride[1] : NULL, *r2 = r ? f->plane[2] + (size_t)(y / 2) * f->stride[2] : NULL;
    int e = x & ~1;
    switch (i->pixels) {
    case ORL_PIX_MONO: yuv[0] = p[x]; yuv[1] = yuv[2] = 128; break;
    case ORL_PIX_420: yuv[0] = p[x]; yuv[1] = q2[x / 2]; yuv[2] = r2[x / 2]; break;
    case ORL_PIX_422: yuv[0] = p[x]; yuv[1] = q[x / 2]; yuv[2] = r[x / 2]; break;
    case ORL_PIX_444: yuv[0] = p[x]; yuv[1] = q[x]; yuv[2] = r[x]; break;
    case ORL_PIX_NV12: yuv[0] = p[x]; yuv[1] = q2[e]; yuv[2] = q2[e + 1]; break;
    case ORL_PIX_NV21: yuv[0] = p[x]; yuv[1] = q2[e + 1]; yuv[2] = q2[e]; break;
    case ORL_PIX_YUYV: yuv[0] = p[2 * x]; yuv[1] = p[2 * e + 1]; yuv[2] = p[2 * e + 3]; break;
    default: yuv[0] = p[2 * x + 1]; yuv[1] = p[2 * e]; yuv[2] = p[2 * e + 2]; break;
    }
}

static int want_at(const orl_source_info *i, const orl_frame *f, int x, int y, int c)
{
    int yuv[3];
    double rgb[3];
    if (i->pixels == ORL_PIX_RGB || i->pixels == ORL_PIX_BGR) return f->plane[0][(size_t)y * f->stride[0] + (size_t)(3 * x + (i->pixels == ORL_PIX_RGB ? c : 2 - c))];
    yuv_at(i, f, x, y, yuv);
    if (i->matrix == ORL_MATRIX_601) return was(i->full_range, c, yuv[0], yuv[1], yuv[2]);
    real_rgb(i->matrix, i->full_range, yuv[0], yuv[1], yuv[2], rgb);
    return (int)(rgb[c] + 0.5);
}

/* Rows at any address, of random and extreme bytes: the same from every variant, 3 n bytes and no more. */
static void variants(void **state)
{
    (void)state;
    static uint8_t in[3][4 * N + 16], out[VARIANTS][3 * N + GUARD];
    seed_print();
    for (int round = 0; round < 400; round++) {
        orl_pixels p = (orl_pixels)(round % ORL_PIX_COUNT);
        orl_source_info info = info_of(p, N, 1, (orl_matrix)(rnd() & 1), (int)(rnd() & 1));
        orl_yuv_tab t;
        orl_yuv_table(&info, &t);
        for (int k = 0; k < 3; k++) for (size_t i = 0; i < sizeof *in; i++) in[k][i] = (uint8_t)(round / ORL_PIX_COUNT == 0 ? 0 : round / ORL_PIX_COUNT == 1 ? 255 : rnd() % 4 ? rnd() : rnd() & 1 ? 255 : 0);
        int n = (int)(rnd() % (N / ORL_CONVERT_STEP + 1)) * ORL_CONVERT_STEP;
        const uint8_t *const at_[3] = { in[0] + rnd() % 16, in[1] + rnd() % 16, in[2] + rnd() % 16 };
        memset(out, 0xa5, sizeof out);
        for (int v = 0; v < VARIANTS; v++) {
            orl_convert_kernels k;
            unsigned cpu;
            if (orl_cpu_from_name(VARIANT[v], &cpu)) continue;
            orl_convert_kernels_init(&k, cpu);
            k.row[p](at_, &t, n, out[v]);
            if (memcmp(out[v], out[0], sizeof *out)) fail_msg("%s, %s, n %d: differs from ref", orl_pixels_name(p), VARIANT[v], n);
            for (int i = 3 * n; i < 3 * N + GUARD; i++) assert_int_equal(out[v][i], 0xa5);
        }
    }
}

/* A block of n bytes that ends where the address space does. */
typedef struct { uint8_t *map, *p; size_t bytes; } fenced;
static fenced fence(size_t n)
{
    size_t page = (size_t)sysconf(_SC_PAGESIZE), body = (n + page - 1) / page * page;
    fenced f = { NULL, NULL, body + 2 * page };
    f.map = mmap(NULL, f.bytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    assert_true(f.map != MAP_FAILED);
    assert_int_equal(mprotect(f.map, page, PROT_NONE), 0);
    assert_int_equal(mprotect(f.map + page + body, page, PROT_NONE), 0);
    f.p = f.map + page + body - n;
    return f;
}

/* Pictures of any size and stride, planes that end on a forbidden page, output too: every pixel as the layout says. */
static void any_size(void **state)
{
    (void)state;
    static const int SIDE[] = { 1, 2, 3, 7, 31, 33, 63, 64, 65, 127, 129, 200 };
    seed_print();
    for (int round = 0; round < 1200; round++) {
        orl_source_info info = info_of((orl_pixels)(round % ORL_PIX_COUNT), SIDE[rnd() % 12], SIDE[rnd() % 6], (orl_matrix)(rnd() & 1), (int)(rnd() & 1));
        orl_frame f;
        fenced plane[3], out = { 0 };
        unsigned cpu;
        int v = (int)(rnd() % VARIANTS);
        if (orl_cpu_from_name(VARIANT[v], &cpu)) continue;
        orl_frame_layout(&info, (const uint8_t *)&f, &f);
        for (int k = 0; k < 3; k++) {
            if (!f.plane[k]) continue;
            size_t rows = f.bytes[k] / f.stride[k], row = f.stride[k];
            if (rnd() % 2) f.stride[k] += rnd() % 100;
            f.bytes[k] = (rows - 1) * f.stride[k] + row;
            plane[k] = fence(f.bytes[k]);
            for (size_t i = 0; i < f.bytes[k]; i++) plane[k].p[i] = (uint8_t)rnd();
            f.plane[k] = plane[k].p;
        }
        ok(orl_frame_check(&info, &f));
        size_t row = 3 * (size_t)info.w + rnd() % 2 * 5;
        out = fence(row * (size_t)(info.h - 1) + 3 * (size_t)info.w);
        memset(out.p, 0xa5, row * (size_t)(info.h - 1) + 3 * (size_t)info.w);
        int cut = info.h > 1 ? (int)(rnd() % (uint32_t)info.h) : 0;         /* in two parts, as threads do */
        orl_frame_to_rgb(&info, &f, cpu, cut, info.h, out.p, row);
        orl_frame_to_rgb(&info, &f, cpu, 0, cut, out.p, row);
        for (int y = 0; y < info.h; y++) {
            for (int x = 0; x < info.w; x++)
                for (int c = 0; c < 3; c++) {
                    int got = out.p[(size_t)y * row + (size_t)(3 * x + c)], want = want_at(&info, &f, x, y, c);
                    if (abs(got - want) > (info.matrix == ORL_MATRIX_709)) fail_msg("%s %s %d x %d at %d, %d, %d: %d, not %d", orl_pixels_name(info.pixels), VARIANT[v], info.w, info.h, x, y, c, got, want);
                }
            for (size_t i = 3 * (size_t)info.w; y + 1 < info.h && i < row; i++) assert_int_equal(out.p[(size_t)y * row + i], 0xa5);
        }
        for (int k = 0; k < 3; k++) if (f.plane[k]) munmap(plane[k].map, plane[k].bytes);
        munmap(out.map, out.bytes);
    }
}

/* ---- frames that lie */

static void bad_frames(void **state)
{
    (void)state;
    static const uint8_t byte[1];
    for (orl_pixels p = 0; p < ORL_PIX_COUNT; p++) {
        orl_source_info info = info_of(p, 33, 5, ORL_MATRIX_601, 0), broken = info;
        orl_frame good, f;
        assert_int_equal(orl_pixels_from_name(orl_pixels_name(p)), p);
        orl_frame_layout(&info, byte, &good);
        ok(orl_frame_check(&info, &good));
        for (int k = 0; k < 3; k++) {
            if (!good.plane[k]) continue;
            char which[16];
            snprintf(which, sizeof which, "plane %d", k);
            f = good; f.plane[k] = NULL; failed(orl_frame_check(&info, &f), ORL_E_RANGE, which, "missing", NULL);
            f = good; f.stride[k]--; failed(orl_frame_check(&info, &f), ORL_E_RANGE, which, "apart", NULL);
            f = good; f.stride[k] = 0; failed(orl_frame_check(&info, &f), ORL_E_RANGE, which, NULL);
            f = good; f.bytes[k]--; failed(orl_frame_check(&info, &f), ORL_E_RANGE, which, "hold", NULL);
            f = good; f.bytes[k] = 0; failed(orl_frame_check(&info, &f), ORL_E_RANGE, which, NULL);
            f = good; f.stride[k]++; failed(orl_frame_check(&info, &f), ORL_E_RANGE, which, NULL);
            f = good; f.stride[k] = SIZE_MAX; failed(orl_frame_check(&info, &f), ORL_E_RANGE, which, NULL);
            f = good; f.stride[k] = SIZE_MAX / 4 + 1; f.bytes[k] = SIZE_MAX / 2; failed(orl_frame_check(&info, &f), ORL_E_RANGE, which, NULL);
            f = good; f.stride[k] += 3; f.bytes[k] = SIZE_MAX; ok(orl_frame_check(&info, &f));
        }
        static const int SIZE[][2] = { { 0, 5 }, { 33, 0 }, { -33, 5 }, { 33, -1 }, { 65536, 5 }, { 34, 5 }, { 33, 7 } };      /* the last two: more than there is */
        for (size_t i = 0; i < sizeof SIZE / sizeof *SIZE; i++) {
            broken.w = SIZE[i][0];
            broken.h = SIZE[i][1];
            if (broken.w == 34 && (p == ORL_PIX_YUYV || p == ORL_PIX_UYVY)) continue;       /* an odd row's last pair has room */
            failed(orl_frame_check(&broken, &good), ORL_E_RANGE, NULL);
        }
        broken = info;
        broken.pixels = ORL_PIX_COUNT;
        failed(orl_frame_check(&broken, &good), ORL_E_UNSUPPORTED, NULL);
    }
    assert_int_equal(orl_pixels_from_name("mjpeg"), ORL_PIX_COUNT);
}

/* Sizes, strides and lengths at random, planes no longer than they say: refused in a line, or converted without a byte read outside. */
static void random_frames(void **state)
{
    (void)state;
    static uint8_t rgb[40 * 200 * 3];
    int taken = 0;
    seed_print();
    fenced plane[3] = { fence(8192), fence(8192), fence(8192) };
    for (int k = 0; k < 3; k++) memset(plane[k].p, 0x5a, 8192);
    for (int round = 0; round < 100000; round++) {
        orl_source_info info = info_of((orl_pixels)(rnd() % ORL_PIX_COUNT), (int)(rnd() % 201) - (rnd() % 16 == 0), (int)(rnd() % 41), (orl_matrix)(rnd() & 1), (int)(rnd() & 1));
        orl_frame f = { { NULL }, { 0 }, { 0 } };
        for (int k = 0; k < 3; k++) {
            size_t even = info.w > 0 && rnd() % 4 ? (size_t)info.w * (1 + rnd() % 3) : rnd() % 700;
            f.stride[k] = rnd() % 64 ? even : SIZE_MAX - even;
            f.bytes[k] = rnd() % 8 && info.h > 0 ? even * (size_t)info.h : rnd() % 8193;
            if (f.bytes[k] > 8192) f.bytes[k] = 8192;
            if (rnd() % 64) f.plane[k] = plane[k].p + 8192 - f.bytes[k];
        }
        if (orl_frame_check(&info, &f)) {
            failed(ORL_E_RANGE, ORL_E_RANGE, NULL);
            continue;
        }
        orl_frame_to_rgb(&info, &f, orl_cpu_detect(), 0, info.h, rgb, 3 * (size_t)info.w);
        taken++;
    }
    for (int k = 0; k < 3; k++) munmap(plane[k].map, plane[k].bytes);
    print_message("%d of 100000 taken\n", taken);
    assert_in_range(taken, 5000, 95000);
}

/* A camera whose driver hands out what it should not: such pictures are lost, named, and the next ones come. */
typedef struct { orl_source base; int at; uint8_t px[2][6 * 4 * 2]; } camera;
static int camera_next(orl_source *s, orl_frame *f)
{
    camera *c = (camera *)s;
    orl_frame_layout(&s->info, c->px[0], f);
    switch (c->at++) {
    case 1: f->bytes[0] = 11; break;
    case 2: f->stride[0] = 8; break;
    case 3: f->plane[0] = NULL; break;
    case 4: f->bytes[0] = 0; break;
    case 6: return 0;
    }
    return 1;
}
static void camera_close(orl_source *s) { (void)s; }

static void bad_frames_are_lost(void **state)
{
    (void)state;
    static const orl_source_ops OPS = { camera_next, camera_close };
    camera c = { .base = { &OPS, info_of(ORL_PIX_YUYV, 6, 4, ORL_MATRIX_601, 0), 0 } };
    orl_frame f;
    for (int i = 0; i < 6; i++) {
        int lost = i >= 1 && i <= 4;
        assert_int_equal(orl_source_next(&c.base, &f), lost ? -1 : 1);
        if (lost) failed(ORL_E_RANGE, ORL_E_RANGE, "picture ", "plane 0", NULL);
    }
    assert_int_equal(orl_source_next(&c.base, &f), 0);
    assert_int_equal(c.base.frame, 6);
}

static void raw_files(void **state)
{
    (void)state;
    uint8_t bytes[3 * 24];
    orl_source *s;
    orl_frame f;
    char spec[300];
    for (size_t i = 0; i < sizeof bytes; i++) bytes[i] = (uint8_t)i;
    for (size_t n = 0; n <= sizeof bytes; n++) {            /* 4 x 3 YUYV is 24 bytes: every truncation */
        put_bytes(at("clip:1.yuyv"), bytes, n);
        snprintf(spec, sizeof spec, "raw:yuyv,709,full:4x3@30:%s", at("clip:1.yuyv"));
        ok(orl_source_open(spec, &s));
        assert_true(s->info.w == 4 && s->info.h == 3 && s->info.fps_num == 30 && s->info.matrix == ORL_MATRIX_709 && s->info.full_range && s->info.pixels == ORL_PIX_YUYV);
        for (size_t k = 0; k < n / 24; k++) {
            assert_int_equal(orl_source_next(s, &f), 1);
            assert_memory_equal(f.plane[0], bytes + 24 * k, 24);
        }
        if (n % 24) {
            assert_int_equal(orl_source_next(s, &f), -1);
            failed(ORL_E_FORMAT, ORL_E_FORMAT, "clip:1.yuyv", "picture ", "of its 24 bytes", NULL);
        }
        assert_int_equal(orl_source_next(s, &f), 0);
        assert_int_equal(orl_source_next(s, &f), 0);
        orl_source_close(s);
    }
    static const char *const BAD[] = { "", "yuyv", "yuyv:4x3", "yuyv:4x3:", ":4x3:", "mjpeg:4x3:", "yuyv,:4x3:", "yuyv,708:4x3:", "yuyv:0x3:", "yuyv:4x0:", "yuyv:-4x3:", "yuyv:4:", "yuyv:4x3x:", "yuyv:4x3@:", "yuyv:4x3@0:", "yuyv:4x3@-1:", "yuyv:4x3@5s:", "yuyv:16385x1:",
                                       "yuyv:16384x16384:", "yuyv:99999999999x3:", "yuyv,full,full,full,full,full,full,full,full:4x3:", "yuyv:4x3@30                                  :" };
    for (size_t i = 0; i < sizeof BAD / sizeof *BAD; i++) {
        int whole = *BAD[i] && BAD[i][strlen(BAD[i]) - 1] == ':' && strcmp(BAD[i], "yuyv:4x3:");
        snprintf(spec, sizeof spec, "raw:%s%s", BAD[i], whole ? at("clip:1.yuyv") : "");
        s = (orl_source *)spec;
        orl_err e = orl_source_open(spec, &s);
        if (!strcmp(BAD[i], "yuyv,:4x3:")) { ok(e); orl_source_close(s); continue; }       /* an empty word says nothing */
        assert_true(e == ORL_E_RANGE || e == ORL_E_UNSUPPORTED);
        failed(e, e, "raw:", NULL);
        assert_ptr_equal(s, spec);
    }
    failed(orl_source_open("raw:yuyv:4x3:/nonexistent/a", &s), ORL_E_IO, "/nonexistent/a", NULL);
}

/* ---- ffmpeg */

enum { FW = 318, FH = 202 };        /* neither is a multiple of a kernel's step; 4:2:0 and 4:2:2 want even ones */

static int run(const char *fmt, ...) __attribute__((format(printf, 1, 2)));
static int run(const char *fmt, ...)
{
    char cmd[4096];
    va_list ap;
    va_start(ap, fmt);
    vsnprintf(cmd, sizeof cmd, fmt, ap);
    va_end(ap);
    return system(cmd);
}

/* Smooth, every hue, with a faint edge. ffmpeg's neighbor scaler repeats chroma as Oriel does. */
static void picture(uint8_t *rgb)
{
    for (int y = 0; y < FH; y++)
        for (int x = 0; x < FW; x++)
            for (int c = 0; c < 3; c++) rgb[3 * (y * FW + x) + c] = (uint8_t)(127.5 + 110 * sin(0.02 * x + 2.1 * c) * cos(0.017 * y - 1.3 * c) + (x > FW / 2 && y > FH / 2 ? 12 : 0));
}

static void agrees_with_ffmpeg(void **state)
{
    (void)state;
    static const struct { orl_pixels p; const char *name; } FORMAT[] = { { ORL_PIX_YUYV, "yuyv422" }, { ORL_PIX_UYVY, "uyvy422" }, { ORL_PIX_NV12, "nv12" }, { ORL_PIX_NV21, "nv21" }, { ORL_PIX_420, "yuv420p" }, { ORL_PIX_422, "yuv422p" },
                                                                      { ORL_PIX_444, "yuv444p" }, { ORL_PIX_RGB, "rgb24" }, { ORL_PIX_BGR, "bgr24" }, { ORL_PIX_MONO, "gray" } };
    if (system("ffmpeg -version >/dev/null 2>&1")) {
        print_message("skipped: no ffmpeg\n");
        skip();
    }
    static uint8_t rgb[FW * FH * 3], ours[FW * FH * 3];
    picture(rgb);
    put_bytes(at("in.rgb"), rgb, sizeof rgb);
    for (size_t i = 0; i < sizeof FORMAT / sizeof *FORMAT; i++) {
        int most = 0;
        for (int m = 0; m < 4; m++) {
            const char *matrix = m / 2 ? "bt709" : "bt601", *range = m % 2 ? "pc" : "tv";
            int yuv = FORMAT[i].p != ORL_PIX_RGB && FORMAT[i].p != ORL_PIX_BGR;
            if (!yuv && m) continue;
            if (FORMAT[i].p == ORL_PIX_MONO && m != 1) continue;           /* ffmpeg's gray is of full range */
            if (run("cd %s && ffmpeg -nostdin -v error -y -f rawvideo -pix_fmt rgb24 -s %dx%d -i in.rgb -vf scale=out_color_matrix=%s:out_range=%s:flags=accurate_rnd+full_chroma_inp+area -pix_fmt %s -f rawvideo frame.raw"
                    " && ffmpeg -nostdin -v error -y -f rawvideo -pix_fmt %s -s %dx%d -i frame.raw -vf scale=in_color_matrix=%s:in_range=%s:flags=accurate_rnd+full_chroma_int+neighbor -pix_fmt rgb24 -f rawvideo back.rgb",
                    scratch, FW, FH, matrix, range, FORMAT[i].name, FORMAT[i].name, FW, FH, matrix, range))
                fail_msg("ffmpeg cannot convert %s", FORMAT[i].name);
            FILE *f = fopen(at("back.rgb"), "rb");
            static uint8_t theirs[FW * FH * 3];
            assert_non_null(f);
            assert_int_equal(fread(theirs, 1, sizeof theirs, f), sizeof theirs);
            fclose(f);
            char spec[300];
            orl_source *s;
            orl_frame frame;
            snprintf(spec, sizeof spec, "raw:%s%s%s:%dx%d:%s", orl_pixels_name(FORMAT[i].p), m / 2 ? ",709" : "", m % 2 ? ",full" : "", FW, FH, at("frame.raw"));
            ok(orl_source_open(spec, &s));
            assert_int_equal(orl_source_next(s, &frame), 1);
            orl_frame_to_rgb(&s->info, &frame, orl_cpu_detect(), 0, FH, ours, 3 * FW);
            assert_int_equal(orl_source_next(s, &frame), 0);
            orl_source_close(s);
            int worst = 0;
            double sum = 0, photo = 0;
            for (int k = 0; k < FW * FH * 3; k++) {
                int d = abs(ours[k] - theirs[k]);
                worst = d > worst ? d : worst;
                sum += d;
                photo += abs(ours[k] - rgb[k]);
            }
            most = worst > most ? worst : most;
            assert_true(sum / (FW * FH * 3) < 0.05);
            if (FORMAT[i].p != ORL_PIX_MONO) assert_true(photo / (FW * FH * 3) < (yuv ? 2 : 0.001));
        }
        print_message("figure: %s: at most %d levels from ffmpeg's\n", FORMAT[i].name, most);
        assert_true(most <= (FORMAT[i].p == ORL_PIX_RGB || FORMAT[i].p == ORL_PIX_BGR ? 0 : 2));
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(all_triples), cmocka_unit_test(variants), cmocka_unit_test(any_size), cmocka_unit_test(bad_frames), cmocka_unit_test(random_frames), cmocka_unit_test(bad_frames_are_lost),
        cmocka_unit_test_setup_teardown(raw_files, scratch_make, scratch_remove), cmocka_unit_test_setup_teardown(agrees_with_ffmpeg, scratch_make, scratch_remove),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
