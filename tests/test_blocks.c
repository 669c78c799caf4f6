/* Photos in blocks of a byte a pixel, labels, and the choice of photos that covers a scene. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <cmocka.h>
#include "trainer/grid.h"
#include "trainer/world.h"

enum { W = 61, H = 38 };

/* Smooth shading with edges and a little noise, coloured: what photos are made of. */
static void paint(uint8_t *rgb, int w, int h, int contrast)
{
    rng r = rng_make(11, (uint64_t)w, (uint64_t)h);
    for (int y = 0; y < h; y++)
        for (int x = 0; x < w; x++) {
            float v = 128 + (float)contrast * (0.6f * sinf(0.21f * (float)x + 0.13f * (float)y) + ((x / 9 + y / 7) & 1 ? 0.3f : -0.3f)) + 4 * (rng_f(&r) - 0.5f);
            for (int c = 0; c < 3; c++) rgb[3 * (y * w + x) + c] = block_byte((int)(v + 12 * sinf(0.05f * (float)x + (float)c)));
        }
}

static double psnr(const uint8_t *rgb, int w, int h)
{
    block *b = malloc(blocks_count(w, h) * sizeof *b);
    double e = 0;
    assert_non_null(b);
    blocks_encode(rgb, w, h, b);
    for (int y = 0; y < h; y++)
        for (int x = 0; x < w; x++) {
            uint8_t q[3];
            blocks_rgb(b, w, x, y, q);
            for (int c = 0; c < 3; c++) e += (q[c] - rgb[3 * (y * w + x) + c]) * (q[c] - rgb[3 * (y * w + x) + c]);
        }
    free(b);
    return 10 * log10(65025 / (e / (3.0 * w * h) + 1e-9));
}

static void pictures_come_back(void **state)
{
    (void)state;
    static uint8_t rgb[W * H * 3];
    paint(rgb, W, H, 40);
    double soft = psnr(rgb, W, H);
    paint(rgb, W, H, 120);
    double hard = psnr(rgb, W, H);
    printf("blocks: figure %.1f dB at low contrast, %.1f dB at high\n", soft, hard);
    assert_true(soft > 43 && hard > 37);
    for (int h = 1; h < 7; h++)                 /* blocks over the rim, down to a pixel */
        for (int w = 1; w < 7; w++) {
            paint(rgb, w, h, 40);
            assert_true(psnr(rgb, w, h) > 36);
        }
}

/* One colour comes back as it was, but for rounding; so do two greys in any arrangement. */
static void flat_blocks_are_exact(void **state)
{
    (void)state;
    rng r = rng_make(5, 0, 0);
    for (int i = 0; i < 20000; i++) {
        uint8_t rgb[48], q[3], a[3], two[2] = { (uint8_t)rng_u32(&r), (uint8_t)rng_u32(&r) };
        block b;
        for (int c = 0; c < 3; c++) a[c] = (uint8_t)rng_u32(&r);
        for (int p = 0; p < 16; p++) memcpy(rgb + 3 * p, a, 3);
        blocks_encode(rgb, 4, 4, &b);
        for (int p = 0; p < 16; p++) {
            blocks_rgb(&b, 4, p % 4, p / 4, q);
            for (int c = 0; c < 3; c++) assert_true(abs(q[c] - a[c]) <= 2);
        }
        for (int p = 0; p < 16; p++) memset(rgb + 3 * p, two[rng_u32(&r) & 1], 3);
        blocks_encode(rgb, 4, 4, &b);
        for (int p = 0; p < 16; p++) {
            blocks_rgb(&b, 4, p % 4, p / 4, q);
            for (int c = 0; c < 3; c++) assert_int_equal(q[c], rgb[3 * p + c]);
        }
    }
}

/* Any block decodes to what blocks.h says of its bytes, row by row. */
static void access_is_as_specified(void **state)
{
    (void)state;
    rng r = rng_make(6, 0, 0);
    block b[6];
    for (size_t i = 0; i < sizeof b; i++) ((uint8_t *)b)[i] = (uint8_t)rng_u32(&r);
    for (int y = 0; y < 8; y++)
        for (int x = 0; x < 11; x++) {          /* three blocks a row */
            const uint8_t *p = b[y / 4 * 3 + x / 4].b;
            int i = y % 4 * 4 + x % 4, quarter = y % 4 / 2 * 2 + x % 4 / 2, index = p[2 + i / 2] >> (i % 2 ? 4 : 0) & 15, d[2];
            for (int c = 0; c < 2; c++) {
                uint32_t bits = (uint32_t)p[10 + 3 * c] | (uint32_t)p[11 + 3 * c] << 8 | (uint32_t)p[12 + 3 * c] << 16;
                d[c] = (int)(bits & 255) - 128 + BLOCK_STEP[bits >> 8 & 15] * (int)(bits >> (12 + 3 * quarter) & 7);
            }
            double luma = p[0] + (p[1] - p[0]) * index / 15.0, want[3] = { luma + 1.402 * d[1], luma - 0.344136 * d[0] - 0.714136 * d[1], luma + 1.772 * d[0] };
            uint8_t q[3];
            blocks_rgb(b, 11, x, y, q);
            for (int c = 0; c < 3; c++) assert_true(fabs(fmin(fmax(want[c], 0), 255) - q[c]) < 0.51);
        }
}

static void labels_hold(void **state)
{
    (void)state;
    static uint8_t rgb[W * H * 3], sky[W * H];
    paint(rgb, W, H, 60);
    for (int i = 0; i < W * H; i++) sky[i] = i / W < 11 ? 255 : i % W > 40 && i % W < 51 ? 128 : 0;
    for (int packed = 0; packed < 2; packed++) {
        world_photo p = { .name = "p" };
        assert_int_equal(world_photo_fill(&p, W, H, rgb, sky, packed), ORL_OK);
        size_t bytes = world_label_bytes(&p) + (packed ? blocks_count(W, H) * sizeof(block) : W * H * 3);
        assert_true((double)bytes / (W * H) < (packed ? 1.3 : 3.3));      /* most of the overhang is a small picture's */
        for (int y = 0; y < H; y++)
            for (int x = 0; x < W; x++) {
                int own = y < 11 ? WORLD_SKY : x > 40 && x < 51 ? WORLD_UNKNOWN : WORLD_SCENE, rim = packed && y == 10;
                for (int k = 0; packed && k < 4; k++) {        /* 2 x 2 pixels of different labels are unknown */
                    int v = (y & ~1) + k / 2, u = (x & ~1) + k % 2;
                    if (u < W && v < H && (v < 11 ? WORLD_SKY : u > 40 && u < 51 ? WORLD_UNKNOWN : WORLD_SCENE) != own) rim = 1;
                }
                assert_int_equal(world_label(&p, x, y), rim ? WORLD_UNKNOWN : own);
                uint8_t q[3];
                world_rgb(&p, x, y, q);
                if (!packed) assert_memory_equal(q, rgb + 3 * (y * W + x), 3);
            }
        world_set_label(&p, W - 1, H - 1, WORLD_SKY);
        assert_int_equal(world_label(&p, W - 1, H - 1), WORLD_SKY);
        assert_int_equal(world_label(&p, W - 4, H - 1), WORLD_SCENE);
        free(p.rgb);
        free(p.blocks);
        free(p.labels);
    }
}

/* Thirty photos in three places see ten points each: a choice of nine looks at every place three times. */
static void cover_spreads(void **state)
{
    (void)state;
    world_photo photos[30] = { { .name = "" } };
    world_obs obs[300];
    world_point points[30];
    for (int i = 0; i < 30; i++) points[i].weight = 1;
    for (int k = 0; k < 30; k++) {
        int place = k < 20 ? 0 : k < 26 ? 1 : 2;
        photos[k].w = photos[k].h = 10;
        photos[k].obs_begin = (uint32_t)k * 10;
        photos[k].obs_count = 10;
        for (int i = 0; i < 10; i++) obs[10 * k + i].point = (uint32_t)(10 * place + i);
    }
    world w = { .photos = photos, .nphotos = 30, .obs = obs, .nobs = 300, .points = points, .npoints = 30 };
    uint8_t *all = world_cover(&w, 30, 3000), *few = world_cover(&w, 30, 950), *two = world_cover(&w, 2, SIZE_MAX);
    int n = 0, seen[3] = { 0 };
    assert_true(all && few && two);
    for (int k = 0; k < 30; k++) {
        assert_int_equal(all[k], 1);
        n += two[k];
        seen[k < 20 ? 0 : k < 26 ? 1 : 2] += few[k];
    }
    assert_int_equal(n, 2);
    assert_int_equal(seen[0] + seen[1] + seen[2], 9);
    for (int i = 0; i < 3; i++) assert_int_equal(seen[i], 3);
    free(all);
    free(few);
    free(two);
}

/* Giving gradients' memory back between steps changes nothing; what is frozen keeps its values. */
static void trimmed_grids_train_on(void **state)
{
    (void)state;
    grid g[2];
    for (int k = 0; k < 2; k++) assert_int_equal(grid_init(&g[k], (int[3]){ 64, 64, 64 }, 1, 8, 2), ORL_OK);
    for (int step = 0; step < 20; step++)
        for (int k = 0; k < 2; k++) {
            rng r = rng_make(9, (uint64_t)step, 0);
            for (int i = 0; i < 300; i++) {
                grid_cell c;
                grid_find(&g[k], (float[3]){ 64 * rng_f(&r), 64 * rng_f(&r), 64 * rng_f(&r) }, &c);
                grid_vector_back(&g[k], i & 1, &c, 1, (v8[1]){ { rng_f(&r) - 0.5f, 1, -1, rng_f(&r) } });
            }
            assert_true(grid_sum(&g[k], 2));
            grid_adam(&g[k], 0.1f, 2);
            if (k) grid_trim(&g[k]);
        }
    grid_freeze(&g[1]);
    assert_memory_equal(g[0].p, g[1].p, g[0].nverts * 8 * sizeof(float));
    assert_memory_equal(g[0].live, g[1].live, g[0].ntiles);
    float sum = 0;
    for (size_t i = 0; i < g[0].nverts * 8; i++) sum += fabsf(g[1].p[i]);
    assert_true(sum > 100);
    for (int k = 0; k < 2; k++) grid_free(&g[k]);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(pictures_come_back), cmocka_unit_test(flat_blocks_are_exact), cmocka_unit_test(access_is_as_specified), cmocka_unit_test(labels_hold), cmocka_unit_test(cover_spreads),
        cmocka_unit_test(trimmed_grids_train_on),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
