/* Stereo on a textured plane and a post before it, seen by six photos of different gain: most pixels are found, where they are and with their normals; the result does not depend on
 * threads or on a stop half-way; photos that say nothing yield nothing. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#include <cmocka.h>
#include "trainer/stereo.h"

enum { N = 6, W = 96, H = 72, POINTS = 60 };

static uint32_t hash3(int x, int y, int z)
{
    uint32_t h = (uint32_t)x * 73856093u ^ (uint32_t)y * 19349663u ^ (uint32_t)z * 83492791u;
    h = (h ^ h >> 13) * 0x5bd1e995u;
    return h ^ h >> 15;
}

/* Smooth noise on the plane z = 0, 0..1. */
static float texture(float x, float y)
{
    float v = 0, gain = 0.5f;
    for (int o = 0; o < 3; o++, x *= 2, y *= 2, gain *= 0.5f) {
        int i = (int)floorf(x), j = (int)floorf(y);
        float fx = x - (float)i, fy = y - (float)j, c[4];
        for (int k = 0; k < 4; k++) c[k] = (float)(hash3(i + (k & 1), j + (k >> 1), o) & 1023) / 1023;
        v += gain * ((c[0] + fx * (c[1] - c[0])) * (1 - fy) + (c[2] + fx * (c[3] - c[2])) * fy);
    }
    return v;
}

/* Cameras stand at z = 60 and look down, some aside and turned; the plane z = 10 fills every picture but for the post, a square at z = 20. */
static void make(world *w, int photos, int flat)
{
    memset(w, 0, sizeof *w);
    w->frame = (frame){ .dims = { 96, 96, 64 }, .scale = 1, .R = { 1, 0, 0, 0, 1, 0, 0, 0, 1 } };
    w->nphotos = photos;
    w->photos = calloc((size_t)photos, sizeof *w->photos);
    w->npoints = POINTS;
    w->points = calloc(POINTS, sizeof *w->points);
    w->nobs = (uint32_t)(photos * POINTS);
    w->obs = calloc(w->nobs, sizeof *w->obs);
    for (int i = 0; i < POINTS; i++) w->points[i] = (world_point){ { 30 + (float)(i % 10) * 4, 30 + (float)(i / 10) * 6, 10 }, 1 };
    for (int k = 0; k < photos; k++) {
        world_photo *p = &w->photos[k];
        p->cam = (orl_camera){ .model = ORL_CAM_PINHOLE, .w = W, .h = H, .fx = 90, .fy = 90, .cx = W / 2.0, .cy = H / 2.0 };
        double a = 0.05 * (k - 2.5), centre[3] = { 40 + 3.5 * k, 46 + 2 * (k % 3), 60 };
        double axes[9] = { cos(a), 0, -sin(a), 0, -1, 0, -sin(a), 0, -cos(a) };    /* columns: camera x, y, z in the grid frame */
        memcpy(p->centre, centre, sizeof centre);
        memcpy(p->axes, axes, sizeof axes);
        static uint8_t rgb[W * H * 3];
        for (int y = 0; y < H; y++)
            for (int x = 0; x < W; x++) {
                float d[3];
                world_ray(p, x + 0.5, y + 0.5, d);
                float t = (float)((20 - centre[2]) / d[2]), u = (float)centre[0] + t * d[0], v = (float)centre[1] + t * d[1], post = 7;
                if (!(u > 44 && u < 52 && v > 44 && v < 52)) {
                    t = (float)((10 - centre[2]) / d[2]);
                    u = (float)centre[0] + t * d[0];
                    v = (float)centre[1] + t * d[1];
                    post = 0;
                }
                float g = flat ? 90 : (40.0f + 20.0f * (float)(k % 3)) + (120.0f - 15.0f * (float)(k % 4)) * texture(0.45f * u + post, 0.45f * v);
                for (int c = 0; c < 3; c++) rgb[3 * (y * W + x) + c] = (uint8_t)(g + 0.5f);
            }
        assert_int_equal(world_photo_fill(p, W, H, rgb, NULL, 0), ORL_OK);
        p->obs_begin = (uint32_t)(k * POINTS);
        p->obs_count = POINTS;
        for (uint32_t i = 0; i < POINTS; i++) w->obs[p->obs_begin + i].point = i;
    }
}

static void run(const world *w, int threads, int stop, stereo *out)
{
    stereo_work *s;
    assert_int_equal(stereo_begin(w, 5, threads, &s), ORL_OK);
    for (int i = 0; stereo_step(s); i++) {
        assert_true(stereo_progress(s) > 0 && stereo_progress(s) <= 1);
        if (i != stop) continue;
        assert_true(stereo_can_save(s));
        FILE *f = tmpfile();
        assert_int_equal(stereo_work_save(s, f), ORL_OK);
        stereo_end(s);
        rewind(f);
        assert_int_equal(stereo_begin(w, 5, threads, &s), ORL_OK);
        assert_int_equal(stereo_work_load(s, f, "half-way"), ORL_OK);
        fclose(f);
    }
    assert_true(stereo_progress(s) > 0.999);
    assert_int_equal(stereo_finish(s, out), ORL_OK);
    stereo_end(s);
}

static int by_float(const void *a, const void *b)
{
    float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

static void finds_the_plane(void **state)
{
    (void)state;
    world w;
    stereo s;
    make(&w, N, 0);
    run(&w, 2, -1, &s);
    assert_true(s.npoints > N * W * H / 3);
    float *off = malloc(s.npoints * sizeof *off), *tilt = malloc(s.npoints * sizeof *tilt);
    uint32_t on_post = 0;
    for (uint32_t i = 0; i < s.npoints; i++) {
        const stereo_point *q = &s.points[i];
        int post = q->x[0] > 45 && q->x[0] < 51 && q->x[1] > 45 && q->x[1] < 51 && q->x[2] > 15;
        off[i] = fabsf(q->x[2] - (post ? 20 : 10));
        tilt[i] = acosf(fminf(q->n[2], 1)) * 57.29578f;
        on_post += post;
        assert_true(q->weight > 0 && q->weight <= 1);
        assert_true(fabsf(q->n[0] * q->n[0] + q->n[1] * q->n[1] + q->n[2] * q->n[2] - 1) < 1e-3f);
        assert_true(i >= s.begin[q->photo] && i < s.begin[q->photo + 1]);
    }
    qsort(off, s.npoints, sizeof *off, by_float);
    qsort(tilt, s.npoints, sizeof *tilt, by_float);
    print_message("%u points, median off %.3f of 50, 90 %% %.3f, median tilt %.1f degrees, %u on the post\n", s.npoints, off[s.npoints / 2], off[s.npoints * 9 / 10], tilt[s.npoints / 2], on_post);
    assert_true(off[s.npoints / 2] < 0.15f);
    assert_true(off[s.npoints * 9 / 10] < 1.0f);
    assert_true(tilt[s.npoints / 2] < 12);
    assert_true(on_post > 300);
    free(off);
    free(tilt);
    stereo_free(&s);
    world_free(&w);
}

static void repeats(void **state)
{
    (void)state;
    world w;
    stereo a, b;
    make(&w, N, 0);
    run(&w, 1, -1, &a);
    static const int STOPS[3] = { 2, N - 1, 2 * N - 1 };       /* within the first round, at its end, at the second's */
    for (int k = 0; k < 3; k++) {
        run(&w, 2, STOPS[k], &b);
        assert_int_equal(a.npoints, b.npoints);
        assert_memory_equal(a.begin, b.begin, (N + 1) * sizeof *a.begin);
        assert_memory_equal(a.points, b.points, a.npoints * sizeof *a.points);
        stereo_free(&b);
    }
    FILE *f = tmpfile();
    assert_int_equal(stereo_save(&a, f), ORL_OK);
    long bytes = ftell(f);
    rewind(f);
    assert_int_equal(stereo_load(&b, &w, f, "points"), ORL_OK);
    assert_memory_equal(a.points, b.points, a.npoints * sizeof *a.points);
    assert_memory_equal(a.begin, b.begin, (N + 1) * sizeof *a.begin);
    stereo_free(&b);
    assert_int_equal(ftruncate(fileno(f), bytes - 1), 0);
    rewind(f);
    assert_int_equal(stereo_load(&b, &w, f, "points"), ORL_E_FORMAT);
    assert_non_null(strstr(orl_error_text(), "points"));
    uint32_t lies = 0xffffffff;
    rewind(f);
    fwrite(&lies, sizeof lies, 1, f);
    rewind(f);
    assert_int_equal(stereo_load(&b, &w, f, "points"), ORL_E_RANGE);
    fclose(f);
    stereo_free(&a);
    world_free(&w);
}

static void finds_nothing_in_nothing(void **state)
{
    (void)state;
    for (int flat = 0; flat < 2; flat++) {
        world w;
        stereo s;
        make(&w, flat ? N : 1, flat);           /* one photo; six that are one grey */
        run(&w, 1, -1, &s);
        assert_int_equal(s.npoints, 0);
        stereo_free(&s);
        world_free(&w);
    }
}

/* Where the surface lies, a patch matches as well before as behind it; off by a cell, it matches the better the nearer the surface comes. */
static void slopes_to_the_surface(void **state)
{
    (void)state;
    world w;
    stereo_work *s;
    double mean[3] = { 0 };
    int right[3] = { 0 }, n[3] = { 0 };
    make(&w, N, 0);
    assert_int_equal(stereo_begin(&w, 5, 1, &s), ORL_OK);
    assert_int_equal(stereo_watch(s), ORL_OK);
    rng r = rng_make(3, 0, 0);
    for (int i = 0; i < 6000; i++) {
        const world_photo *p = &w.photos[i % N];
        int off = i / N % 3 - 1;                /* cells towards the camera */
        float d[3], x[3], up[3] = { 0, 0, 1 };
        world_ray(p, 8.5 + rng_below(&r, W - 16), 8.5 + rng_below(&r, H - 16), d);
        for (int a = 0; a < 3; a++) x[a] = (float)p->centre[a] + d[a] * (10 + (float)off - (float)p->centre[2]) / d[2];
        if (x[0] > 38 && x[0] < 58 && x[1] > 38 && x[1] < 58) continue;       /* the post and its neighbourhood */
        float slope = stereo_slope(s, i % N, x, up, &r);
        if (slope == 0) continue;
        n[off + 1]++;
        mean[off + 1] += slope;
        right[off + 1] += off < 0 ? slope > 0 : slope < 0;
    }
    for (int k = 0; k < 3; k++) {
        mean[k] /= n[k] > 0 ? n[k] : 1;
        print_message("%+d cells: mean slope %.3f a cell of %d, %d down\n", k - 1, mean[k], n[k], right[k]);
        assert_true(n[k] > 300);
    }
    assert_true(mean[0] > 0.02 && mean[2] < -0.02);
    assert_true(fabs(mean[1]) < 0.25 * fmin(mean[0], -mean[2]));
    assert_true(right[0] > n[0] * 8 / 10 && right[2] > n[2] * 8 / 10);
    assert_true(stereo_slope(s, 0, (float[3]){ 40, 46, 200 }, (float[3]){ 0, 0, 1 }, &r) == 0);    /* behind the camera */
    stereo_end(s);
    world_free(&w);
}

/* Each photo keeps its share, in order, and knows where its points begin. */
static void thins_evenly(void **state)
{
    (void)state;
    enum { PHOTOS = 4, ALL = 100, MOST = 30 };
    static const uint32_t BEGIN[PHOTOS + 1] = { 0, 40, 40, 43, ALL };
    static stereo_point p[ALL];
    uint32_t begin[PHOTOS + 1], k = 0;
    stereo st = { .points = p, .npoints = ALL, .begin = begin };
    memcpy(begin, BEGIN, sizeof begin);
    for (uint32_t i = 0; i < ALL; i++) {
        while (i >= BEGIN[k + 1]) k++;
        p[i] = (stereo_point){ .x = { (float)i, 0, 0 }, .photo = k };
    }
    stereo_thin(&st, PHOTOS, ALL);
    assert_int_equal(st.npoints, ALL);
    stereo_thin(&st, PHOTOS, MOST);
    assert_int_equal(st.npoints, MOST);
    assert_int_equal(begin[0], 0);
    assert_int_equal(begin[PHOTOS], MOST);
    for (uint32_t q = 0; q < PHOTOS; q++) {
        int32_t share = (int32_t)((BEGIN[q + 1] - BEGIN[q]) * MOST / ALL), got = (int32_t)(begin[q + 1] - begin[q]);
        assert_in_range(got - share + 1, 0, 2);
        for (uint32_t i = begin[q]; i < begin[q + 1]; i++) {
            assert_int_equal(p[i].photo, q);
            assert_true(i == 0 || p[i].x[0] > p[i - 1].x[0]);
        }
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = { cmocka_unit_test(finds_the_plane), cmocka_unit_test(repeats), cmocka_unit_test(slopes_to_the_surface), cmocka_unit_test(finds_nothing_in_nothing),
                                         cmocka_unit_test(thins_evenly) };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
