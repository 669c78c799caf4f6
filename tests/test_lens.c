/* Lenses: a photo taken through any of the five camera models, weakly or strongly distorting, lies in a pinhole wide view within 0.1 pixel of where the model's equations put it. The equations stand here once
 * more, forwards alone (COLMAP's documentation): the wide pixel's ray is distorted into the photo, where a wave whose slope is known tells the place to a twentieth of a pixel. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "oriel/blend.h"
#include "oriel/cpu.h"

enum { PW = 320, PH = 240, WW = 600, WH = 450, PERIOD = 24, MARGIN = 10, CREST = 2 };        /* MARGIN: beyond the feather; CREST: pixels beside a crest, where a footprint would see both sides */
#define SLOPE 20.0

/* Triangle wave, 20 levels a pixel. */
static double wave(double u, int *near_crest)
{
    double t = fmod(u, PERIOD), h = PERIOD / 2.0, d = fmod(t, h);
    *near_crest = d < CREST || d > h - CREST;
    return 8 + SLOPE * (t < h ? t : PERIOD - t);
}

/* COLMAP's f, cx, cy, k...; fx, fy, cx, cy, k1, k2, p1, p2: photo pixel of a ray. 0 where the model has folded over, or nearly. */
static int distorted(orl_cam_model m, const double *p, double x, double y, double uv[2])
{
    double r2 = x * x + y * y, k1 = 0, k2 = 0, p1 = 0, p2 = 0, fx = p[0], fy = p[0], cx = p[1], cy = p[2];
    switch (m) {
    case ORL_CAM_SIMPLE_PINHOLE: break;
    case ORL_CAM_PINHOLE: fy = p[1]; cx = p[2]; cy = p[3]; break;
    case ORL_CAM_SIMPLE_RADIAL: k1 = p[3]; break;
    case ORL_CAM_RADIAL: k1 = p[3]; k2 = p[4]; break;
    case ORL_CAM_OPENCV: fy = p[1]; cx = p[2]; cy = p[3]; k1 = p[4]; k2 = p[5]; p1 = p[6]; p2 = p[7]; break;
    }
    double radial = 1 + k1 * r2 + k2 * r2 * r2;
    uv[0] = fx * (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)) + cx;
    uv[1] = fy * (y * radial + 2 * p2 * x * y + p1 * (r2 + 2 * y * y)) + cy;
    for (int i = 1; i <= 16; i++) {             /* the slope along the radius, on the way out */
        double q = r2 * i * i / 256;
        if (1 + 3 * k1 * q + 5 * k2 * q * q < 0.15) return 0;
    }
    return 1;
}

static void lines_up(void **state)
{
    (void)state;
    static const struct { const char *name; orl_cam_model model; double p[8]; int n; double wide; } LENS[] = {
        { "simple pinhole", ORL_CAM_SIMPLE_PINHOLE, { 260, 161.3, 118.9 }, 3, 290 },
        { "pinhole, finer than the wide view", ORL_CAM_PINHOLE, { 300, 290, 158.7, 121.2 }, 4, 170 },
        { "simple radial, barrel", ORL_CAM_SIMPLE_RADIAL, { 250, 160.4, 119.7, -0.1 }, 4, 250 },
        { "simple radial, strong barrel", ORL_CAM_SIMPLE_RADIAL, { 260, 160.4, 119.7, -0.3 }, 4, 260 },
        { "simple radial, strong pincushion", ORL_CAM_SIMPLE_RADIAL, { 260, 160.4, 119.7, 0.4 }, 4, 270 },
        { "radial, strong barrel that eases off", ORL_CAM_RADIAL, { 240, 161, 119, -0.35, 0.15 }, 5, 240 },
        { "OpenCV, all terms", ORL_CAM_OPENCV, { 255, 250, 163, 117, -0.28, 0.09, 0.004, -0.003 }, 8, 255 },
    };
    for (size_t l = 0; l < sizeof LENS / sizeof *LENS; l++)
        for (int down = 0; down < 2; down++) {              /* the wave runs across, then down */
            static uint8_t photo[PW * PH * 3], wide[WW * WH * 3], cov[WW * WH];
            static const double Q[4] = { 0.9, 0.1, -0.3, 0.2 }, T[3] = { 4, -2, 7 };
            orl_camera pc, wc = { ORL_CAM_PINHOLE, WW, WH, LENS[l].wide, LENS[l].wide, WW / 2.0 + 0.3, WH / 2.0 - 0.2, 0, 0, 0, 0 };
            orl_pose pose;
            assert_int_equal(orl_camera_from_params(&pc, LENS[l].model, PW, PH, LENS[l].p, LENS[l].n), ORL_OK);
            assert_int_equal(orl_pose_from_quat(&pose, Q, T), ORL_OK);
            for (int i = 0; i < PW * PH; i++) {
                int crest;
                memset(photo + 3 * i, (int)(wave((down ? i / PW : i % PW) + 0.5, &crest) + 0.5), 3);
            }
            memset(wide, 128, sizeof wide);
            memset(cov, 255, sizeof cov);
            size_t need = orl_blend_need(WW, WH);
            void *block = aligned_alloc(64, (need + 63) & ~(size_t)63);
            orl_blend *b;
            assert_int_equal(orl_blend_init(&pc, &pose, &wc, &pose, NULL, 1, block, need, &b), ORL_OK);
            orl_blend_layers(b, cov, WW);
            orl_blend_apply(b, photo, wide, orl_cpu_detect(), 1);
            double worst = 0, sum = 0, bent = 0;
            long n = 0;
            for (int y = 0; y < WH; y++)
                for (int x = 0; x < WW; x++) {
                    int crest;
                    double uv[2], straight[2], rx = (x + 0.5 - wc.cx) / wc.fx, ry = (y + 0.5 - wc.cy) / wc.fy;
                    if (!distorted(LENS[l].model, LENS[l].p, rx, ry, uv)) continue;
                    if (uv[0] < MARGIN || uv[0] > PW - MARGIN || uv[1] < MARGIN || uv[1] > PH - MARGIN) continue;
                    double want = wave(uv[down], &crest);
                    if (crest) continue;
                    double off = fabs(wide[3 * (y * WW + x)] - want) / SLOPE;
                    worst = off > worst ? off : worst;
                    sum += off;
                    n++;
                    straight[0] = pc.fx * rx + pc.cx;
                    straight[1] = pc.fy * ry + pc.cy;
                    bent = fmax(bent, hypot(straight[0] - uv[0], straight[1] - uv[1]));
                }
            free(block);
            print_message("figure: %s, %s: at most %.3f pixels off, %.3f on the mean of %ld; the lens moves %.1f\n", LENS[l].name, down ? "down" : "across", worst, sum / (double)n, n, bent);
            assert_true(n > (LENS[l].wide < 200 ? 10000 : 25000));
            assert_true(worst < 0.1);
            assert_true(LENS[l].model <= ORL_CAM_PINHOLE ? bent < 0.001 : bent > (fabs(LENS[l].p[3]) > 0.2 || LENS[l].model == ORL_CAM_OPENCV ? 15 : 5));
        }
}

int main(void)
{
    const struct CMUnitTest tests[] = { cmocka_unit_test(lines_up) };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
