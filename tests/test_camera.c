/* Cameras and poses: distortion against formulas written here, project and unproject there and back for each model, other sizes and wider views keep rays, quaternions
 * there and back, centres and rays, values out of range; pose files, good and bad. */
#include "tests/scratch.h"
#include <math.h>
#include "oriel/camera.h"

static orl_camera make(int model, int w, int h, const double *p)
{
    orl_camera c;
    ok(orl_camera_from_params(&c, model, w, h, p, orl_camera_param_count(model)));
    return c;
}

/* reach: largest derivative of the distortion inside the image; above 1 a plain fixed-point inverse would diverge. */
static const struct { int model, w, h; double p[8], reach; } LENS[] = {
    { 0, 640, 480, { 500, 320, 240 }, 0 },
    { 1, 640, 480, { 500, 520, 300, 250 }, 0 },
    { 2, 640, 480, { 600, 320, 240, -0.05 }, 0.1 },
    { 2, 640, 480, { 620, 330, 235, -0.25 }, 0.5 },         /* strong barrel */
    { 2, 1280, 896, { 2979.6, 640, 448, 1.82 }, 0.4 },      /* of a real model: strong pincushion, long lens */
    { 3, 1024, 683, { 900, 512, 341.5, -0.2, 0.08 }, 0.4 },
    { 3, 480, 640, { 450, 240, 320, 0.1, -0.05 }, 0.4 },
    { 4, 800, 600, { 700, 690, 410, 290, -0.28, 0.09, 1e-3, -5e-4 }, 0.5 },
    { 4, 800, 600, { 900, 900, 400, 300, 0.1, 0.02, -0.01, 0.015 }, 0.3 },
    { 2, 800, 600, { 500, 400, 300, 0.3 }, 0.85 },
    { 3, 800, 600, { 450, 400, 300, 0.4, 0.1 }, 1.5 },      /* stronger than any real lens */
};
enum { LENSES = sizeof LENS / sizeof *LENS };

/* Pixel of (x, y, 1) by the formulas of COLMAP's camera models, from the parameter vector. */
static void lens(int k, double x, double y, double uv[2])
{
    const double *p = LENS[k].p, r2 = x * x + y * y, r4 = r2 * r2;
    switch (LENS[k].model) {
    case 0: uv[0] = p[0] * x + p[1]; uv[1] = p[0] * y + p[2]; break;
    case 1: uv[0] = p[0] * x + p[2]; uv[1] = p[1] * y + p[3]; break;
    case 2: uv[0] = p[0] * x * (1 + p[3] * r2) + p[1]; uv[1] = p[0] * y * (1 + p[3] * r2) + p[2]; break;
    case 3: uv[0] = p[0] * x * (1 + p[3] * r2 + p[4] * r4) + p[1]; uv[1] = p[0] * y * (1 + p[3] * r2 + p[4] * r4) + p[2]; break;
    default:
        uv[0] = p[0] * (x + x * (p[4] * r2 + p[5] * r4) + 2 * p[6] * x * y + p[7] * (r2 + 2 * x * x)) + p[2];
        uv[1] = p[1] * (y + y * (p[4] * r2 + p[5] * r4) + 2 * p[7] * x * y + p[6] * (r2 + 2 * y * y)) + p[3];
    }
}

static void models(void **state)
{
    (void)state;
    static const struct { const char *name; int n; } MODEL[] = { { "SIMPLE_PINHOLE", 3 }, { "PINHOLE", 4 }, { "SIMPLE_RADIAL", 4 }, { "RADIAL", 5 }, { "OPENCV", 8 } };
    static const char *const OTHER[] = { "", "pinhole", "PINHOLE ", "OPENCV_FISHEYE", "FOV", "PIN", "THIN_PRISM_FISHEYE" };
    static const double P[9] = { 500, 510, 300, 200, 0.5, 0.25, 0.125, 0.0625, 7 };
    orl_camera c, was;
    for (int m = 0; m < 5; m++) {
        assert_int_equal(orl_camera_model_from_name(MODEL[m].name), m);
        assert_string_equal(orl_camera_model_name((orl_cam_model)m), MODEL[m].name);
        assert_int_equal(orl_camera_param_count(m), MODEL[m].n);
        for (int n = 0; n < 10; n++) {
            memset(&c, 0x5a, sizeof c);
            was = c;
            if (n == MODEL[m].n) continue;
            failed(orl_camera_from_params(&c, m, 640, 480, P, n), ORL_E_FORMAT, MODEL[m].name, NULL);
            assert_memory_equal(&c, &was, sizeof c);
        }
    }
    for (size_t k = 0; k < sizeof OTHER / sizeof *OTHER; k++) assert_int_equal(orl_camera_model_from_name(OTHER[k]), -1);
    static const int BAD[] = { -1, 5, 6, 10, INT32_MAX, INT32_MIN };
    for (size_t k = 0; k < sizeof BAD / sizeof *BAD; k++) {
        assert_int_equal(orl_camera_param_count(BAD[k]), -1);
        assert_string_equal(orl_camera_model_name((orl_cam_model)BAD[k]), "?");
        failed(orl_camera_from_params(&c, BAD[k], 640, 480, P, 4), ORL_E_UNSUPPORTED, "model", NULL);
    }
    c = make(4, 640, 480, P);
    assert_true(c.model == ORL_CAM_OPENCV && c.w == 640 && c.h == 480 && c.fx == 500 && c.fy == 510 && c.cx == 300 && c.cy == 200);
    assert_true(c.k1 == 0.5 && c.k2 == 0.25 && c.p1 == 0.125 && c.p2 == 0.0625);
    c = make(3, 640, 480, (double[5]){ 500, 300, 200, 0.5, 0.25 });
    assert_true(c.fx == 500 && c.fy == 500 && c.cx == 300 && c.cy == 200 && c.k1 == 0.5 && c.k2 == 0.25 && c.p1 == 0 && c.p2 == 0);
}

static void ranges(void **state)
{
    (void)state;
    static const struct { int good, w, h; double p[4]; } CASE[] = {
        { 1, 1, 1, { 1, 1, 0.5, 0.5 } }, { 1, 65535, 65535, { 65535, 65535, 3e4, 3e4 } }, { 0, 0, 480, { 500, 500, 0, 0 } }, { 0, 640, 0, { 500, 500, 0, 0 } }, { 0, -640, 480, { 500, 500, 0, 0 } },
        { 0, 65536, 480, { 65536, 65536, 0, 0 } }, { 0, 640, 65536, { 65536, 65536, 0, 0 } }, { 0, INT32_MAX, INT32_MAX, { 1e9, 1e9, 0, 0 } },
        { 0, 640, 480, { 0, 500, 320, 240 } }, { 0, 640, 480, { 500, 0, 320, 240 } }, { 0, 640, 480, { -500, 500, 320, 240 } }, { 0, 640, 480, { 500, -500, 320, 240 } },
        { 1, 640, 480, { 32.1, 32.1, 320, 240 } }, { 0, 640, 480, { 31.9, 500, 320, 240 } }, { 0, 640, 480, { 500, 31.9, 320, 240 } }, { 0, 480, 640, { 31.9, 500, 240, 320 } },
        { 1, 640, 480, { 63999, 63999, 320, 240 } }, { 0, 640, 480, { 64001, 500, 320, 240 } }, { 0, 640, 480, { 500, 64001, 320, 240 } },
        { 1, 640, 480, { 500, 500, -6000, 6000 } }, { 0, 640, 480, { 500, 500, 6500, 240 } }, { 0, 640, 480, { 500, 500, 320, -6500 } },
    };
    orl_camera c, was;
    for (size_t k = 0; k < sizeof CASE / sizeof *CASE; k++) {
        memset(&c, 0x5a, sizeof c);
        was = c;
        orl_err e = orl_camera_from_params(&c, ORL_CAM_PINHOLE, CASE[k].w, CASE[k].h, CASE[k].p, 4);
        if (CASE[k].good) { ok(e); continue; }
        if (e != ORL_E_RANGE) fail_msg("case %zu: %d", k, e);
        failed(e, ORL_E_RANGE, "PINHOLE", NULL);
        assert_memory_equal(&c, &was, sizeof c);
    }
    for (int m = 0; m < 5; m++)
        for (int i = 0; i < orl_camera_param_count(m); i++)
            for (int v = 0; v < 3; v++) {
                double p[8] = { 500, m == 1 || m == 4 ? 500 : 320, 240, 0, 0, 0, 0, 0 };
                p[i] = v == 0 ? (double)NAN : v == 1 ? (double)INFINITY : -(double)INFINITY;
                char field[32];
                snprintf(field, sizeof field, "parameter %d", i);
                failed(orl_camera_from_params(&c, m, 640, 480, p, orl_camera_param_count(m)), ORL_E_RANGE, field, NULL);
            }
}

static void projects(void **state)
{
    (void)state;
    for (int k = 0; k < LENSES; k++) {
        orl_camera c = make(LENS[k].model, LENS[k].w, LENS[k].h, LENS[k].p);
        for (int i = -10; i <= 10; i++)
            for (int j = -10; j <= 10; j++) {
                double x = i * 0.5 * c.w / c.fx / 10, y = j * 0.5 * c.h / c.fy / 10, want[2], uv[2];
                lens(k, x, y, want);
                for (double z = 1e-6; z < 1e7; z *= 1000) {
                    assert_int_equal(orl_camera_project(&c, (double[3]){ x * z, y * z, z }, uv), 1);
                    assert_true(fabs(uv[0] - want[0]) < 1e-9 * c.w && fabs(uv[1] - want[1]) < 1e-9 * c.w);
                }
            }
    }
}

static void there_and_back(void **state)
{
    (void)state;
    for (int k = 0; k < LENSES; k++) {
        orl_camera c = make(LENS[k].model, LENS[k].w, LENS[k].h, LENS[k].p);
        const double bound = 1e-7;                  /* pixels */
        double worst = 0, steepest = 0;
        for (int i = 0; i <= 40; i++)
            for (int j = 0; j <= 40; j++) {
                double u = i * c.w / 40.0, v = j * c.h / 40.0, d[3], uv[2], back[2], a[2], b[2];
                const double e = 1e-6;
                orl_camera_unproject(&c, u, v, d);
                assert_true(d[2] == 1);
                assert_int_equal(orl_camera_project(&c, d, uv), 1);
                worst = fmax(worst, hypot(uv[0] - u, uv[1] - v));
                lens(k, d[0], d[1], back);          /* not only the inverse of itself */
                worst = fmax(worst, hypot(back[0] - u, back[1] - v));
                lens(k, d[0] + e, d[1], a);
                lens(k, d[0], d[1] + e, b);
                double xx = (a[0] - back[0]) / e / c.fx - 1, yx = (a[1] - back[1]) / e / c.fy, xy = (b[0] - back[0]) / e / c.fx, yy = (b[1] - back[1]) / e / c.fy - 1;
                double sum = xx * xx + yx * yx + xy * xy + yy * yy, det = xx * yy - xy * yx;
                steepest = fmax(steepest, sqrt((sum + sqrt(fmax(0, sum * sum - 4 * det * det))) / 2));
            }
        if (!(worst <= bound)) fail_msg("lens %d: %g pixels off, %g allowed", k, worst, bound);
        if (!(steepest <= LENS[k].reach + 1e-5)) fail_msg("lens %d: reach is %g", k, steepest);     /* the table tells the truth */
        double d[3];
        orl_camera_unproject(&c, c.cx, c.cy, d);
        assert_true(fabs(d[0]) < 1e-3 && fabs(d[1]) < 1e-3);
    }
    /* Out of any lens's range there is no answer, but a number. */
    for (int sign = -1; sign <= 1; sign += 2) {
        orl_camera c = make(4, 640, 480, (double[8]){ 100, 100, 320, 240, sign * 5, sign * 30, 0.5, -0.5 });
        for (int i = -9; i <= 9; i++) {
            double d[3];
            orl_camera_unproject(&c, 320 + i * 1e4, 240 - i * 1e5, d);
            assert_true(isfinite(d[0]) && isfinite(d[1]) && d[2] == 1);
        }
    }
}

static void behind(void **state)
{
    (void)state;
    static const double Z[] = { 1e-9, 0, -0.0, -1e-9, -1, -1e300, -(double)INFINITY, (double)NAN };
    for (int k = 0; k < LENSES; k++) {
        orl_camera c = make(LENS[k].model, LENS[k].w, LENS[k].h, LENS[k].p);
        double uv[2] = { 12, 34 };
        for (size_t i = 0; i < sizeof Z / sizeof *Z; i++) {
            assert_int_equal(orl_camera_project(&c, (double[3]){ 1, 2, Z[i] }, uv), 0);
            assert_int_equal(orl_camera_project(&c, (double[3]){ 0, 0, Z[i] }, uv), 0);
            assert_true(uv[0] == 12 && uv[1] == 34);
        }
        assert_int_equal(orl_camera_project(&c, (double[3]){ 0, 0, 1.0000001e-9 }, uv), 1);
        assert_true(uv[0] == c.cx && uv[1] == c.cy);
    }
}

static void same_ray(const orl_camera *a, double u, double v, const orl_camera *b, double u2, double v2, double tolerance)
{
    double d[3], e[3];
    orl_camera_unproject(a, u, v, d);
    orl_camera_unproject(b, u2, v2, e);
    assert_true(fabs(d[0] - e[0]) <= tolerance && fabs(d[1] - e[1]) <= tolerance);
}

static void resized(void **state)
{
    (void)state;
    static const int SIZE[][2] = { { 320, 240 }, { 1, 1 }, { 1333, 7 }, { 65535, 65535 } };
    for (int k = 0; k < LENSES; k++) {
        orl_camera c = make(LENS[k].model, LENS[k].w, LENS[k].h, LENS[k].p), r = orl_camera_resized(&c, c.w, c.h);
        assert_true(r.model == c.model && r.w == c.w && r.h == c.h && r.fx == c.fx && r.fy == c.fy && r.cx == c.cx && r.cy == c.cy);
        assert_true(r.k1 == c.k1 && r.k2 == c.k2 && r.p1 == c.p1 && r.p2 == c.p2);
        for (size_t s = 0; s < sizeof SIZE / sizeof *SIZE; s++) {
            r = orl_camera_resized(&c, SIZE[s][0], SIZE[s][1]);
            assert_int_equal(r.w, SIZE[s][0]);
            assert_int_equal(r.h, SIZE[s][1]);
            for (int i = 0; i <= 4; i++)
                for (int j = 0; j <= 4; j++) same_ray(&c, c.w * i / 4.0, c.h * j / 4.0, &r, r.w * i / 4.0, r.h * j / 4.0, 1e-9);
        }
    }
}

static void widened(void **state)
{
    (void)state;
    static const struct { double factor; int w, h; } WIDE[] = { { 1, 640, 480 }, { 2, 1280, 960 }, { 2.2, 640, 480 }, { 1.5, 1920, 480 }, { 1.5, 300, 900 }, { 0.5, 64, 48 } };
    orl_camera plain = make(1, 640, 480, (double[4]){ 500, 520, 300, 250 });
    for (size_t s = 0; s < sizeof WIDE / sizeof *WIDE; s++) {
        double f = WIDE[s].factor, scale = fmin(WIDE[s].w / 640.0, WIDE[s].h / 480.0) / f;
        orl_camera w = orl_camera_widened(&plain, f, WIDE[s].w, WIDE[s].h);
        assert_true(w.model == ORL_CAM_PINHOLE && w.w == WIDE[s].w && w.h == WIDE[s].h);
        /* The photo lies in the middle, scaled alike in x and y; its own aspect is as wide as asked. */
        for (int i = 0; i <= 8; i++)
            for (int j = 0; j <= 8; j++) {
                double u = 640 * i / 8.0, v = 480 * j / 8.0;
                same_ray(&plain, u, v, &w, 0.5 * w.w + (u - 320) * scale, 0.5 * w.h + (v - 240) * scale, 1e-12);
            }
        double l[3], r[3], t[3], b[3];
        orl_camera_unproject(&w, 0, 0, l);
        orl_camera_unproject(&w, w.w, w.h, r);
        orl_camera_unproject(&plain, 0, 0, t);
        orl_camera_unproject(&plain, 640, 480, b);
        double wide = (r[0] - l[0]) / (b[0] - t[0]), high = (r[1] - l[1]) / (b[1] - t[1]);
        assert_true(fabs(fmin(wide, high) - f) < 1e-12 && fmax(wide, high) >= f - 1e-12);
    }
    /* Distortion goes: what the lens bent stands where a pinhole sees it. */
    for (int k = 0; k < LENSES; k++) {
        orl_camera c = make(LENS[k].model, LENS[k].w, LENS[k].h, LENS[k].p), w = orl_camera_widened(&c, 1.5, c.w, c.h);
        assert_true(w.model == ORL_CAM_PINHOLE && w.k1 == 0 && w.k2 == 0 && w.p1 == 0 && w.p2 == 0);
        for (int i = 1; i < 8; i++)
            for (int j = 1; j < 8; j++) {
                double d[3], uv[2];
                orl_camera_unproject(&c, c.w * i / 8.0, c.h * j / 8.0, d);
                assert_int_equal(orl_camera_project(&w, d, uv), 1);
                assert_true(fabs(uv[0] - (w.w / 2.0 + (c.cx - c.w / 2.0 + c.fx * d[0]) / 1.5)) < 1e-9);
                assert_true(fabs(uv[1] - (w.h / 2.0 + (c.cy - c.h / 2.0 + c.fy * d[1]) / 1.5)) < 1e-9);
                same_ray(&w, uv[0], uv[1], &w, uv[0], uv[1], 0);
            }
    }
}

static void rotate(const double q[4], const double v[3], double out[3])    /* v + 2 u x (u x v + w v), |q| = 1 */
{
    double a[3];
    for (int i = 0; i < 3; i++) { int j = (i + 1) % 3, k = (i + 2) % 3; a[i] = q[1 + j] * v[k] - q[1 + k] * v[j] + q[0] * v[i]; }
    for (int i = 0; i < 3; i++) { int j = (i + 1) % 3, k = (i + 2) % 3; out[i] = v[i] + 2 * (q[1 + j] * a[k] - q[1 + k] * a[j]); }
}

static void quaternions(void **state)
{
    (void)state;
    seed_print();
    const double t[3] = { 1, -2, 3 };
    for (int round = 0; round < 3000; round++) {
        double q[4], b[4], n = 0, dot = 0;
        /* Every sign and zero first (half turns about each axis among them), then anything, near half turns too. */
        for (int i = 0, c = round; i < 4; i++, c /= 3) q[i] = round < 81 ? c % 3 - 1 : uniform(-1, 1) * (round & 1 && i == 0 ? 1e-9 : 1);
        for (int i = 0; i < 4; i++) n += q[i] * q[i];
        orl_pose p;
        if (n == 0) { failed(orl_pose_from_quat(&p, q, t), ORL_E_DEGENERATE, "quaternion", NULL); continue; }
        n = sqrt(n);
        double scale = round % 3 ? 1 : uniform(1e-3, 1e3) / n, s[4] = { q[0] * scale, q[1] * scale, q[2] * scale, q[3] * scale };
        ok(orl_pose_from_quat(&p, s, t));
        for (int i = 0; i < 4; i++) q[i] /= n;
        for (int a = 0; a < 3; a++) {
            double e[3] = { a == 0, a == 1, a == 2 }, v[3], c[3];
            rotate(q, e, v);
            orl_pose_apply(&p, e, c);
            for (int i = 0; i < 3; i++) assert_true(fabs(c[i] - v[i] - t[i]) < 1e-14);
        }
        orl_pose_to_quat(&p, b);
        for (int i = 0; i < 4; i++) dot += q[i] * b[i];
        for (int i = 0; i < 4; i++) assert_true(fabs(b[i] - (dot < 0 ? -q[i] : q[i])) < 1e-14);
    }
}

static void singular(void **state)
{
    (void)state;
    static const double Q[][4] = { { 0, 0, 0, 0 }, { -0.0, 0, 0, 0 }, { 1e-7, 0, 1e-8, 0 }, { 1e-300, 1e-300, 1e-300, 1e-300 }, { (double)NAN, 1, 1, 1 }, { 1, 0, 0, (double)NAN }, { (double)INFINITY, 0, 0, 0 },
                                   { 1, 0, -(double)INFINITY, 0 } };
    static const double ZERO[3] = { 0 };
    orl_pose p, was;
    memset(&p, 0x5a, sizeof p);
    was = p;
    for (size_t k = 0; k < sizeof Q / sizeof *Q; k++) failed(orl_pose_from_quat(&p, Q[k], ZERO), ORL_E_DEGENERATE, "quaternion", NULL);
    for (int i = 0; i < 6; i++) {
        double t[3] = { 0 };
        t[i % 3] = i < 3 ? (double)NAN : (double)INFINITY;
        failed(orl_pose_from_quat(&p, (double[4]){ 1, 0, 0, 0 }, t), ORL_E_DEGENERATE, "translation", NULL);
    }
    assert_memory_equal(&p, &was, sizeof p);
    ok(orl_pose_from_quat(&p, (double[4]){ 1e-5, 0, 0, 0 }, ZERO));
}

static void centres_and_rays(void **state)
{
    (void)state;
    seed_print();
    for (int round = 0; round < 500; round++) {
        int k = round % LENSES;
        orl_camera c = make(LENS[k].model, LENS[k].w, LENS[k].h, LENS[k].p);
        double q[4] = { uniform(-1, 1), uniform(-1, 1), uniform(-1, 1), uniform(0.1, 1) }, t[3] = { uniform(-9, 9), uniform(-9, 9), uniform(-9, 9) }, o[3], x[3], d[3], ray[3], uv[2];
        orl_pose p;
        ok(orl_pose_from_quat(&p, q, t));
        orl_pose_centre(&p, o);
        orl_pose_apply(&p, o, x);
        for (int i = 0; i < 3; i++) assert_true(fabs(x[i]) < 1e-13);
        /* A pixel's ray, walked any way in the world, comes back to the pixel; walked backwards it is behind. */
        double u = uniform(0, c.w), v = uniform(0, c.h), far = uniform(0.1, 1000), w[3];
        orl_camera_unproject(&c, u, v, d);
        orl_pose_ray(&p, d, ray);
        assert_true(fabs(ray[0] * ray[0] + ray[1] * ray[1] + ray[2] * ray[2] - 1) < 1e-14);
        for (int sign = -1; sign <= 1; sign += 2) {
            for (int i = 0; i < 3; i++) w[i] = o[i] + sign * far * ray[i];
            orl_pose_apply(&p, w, x);
            assert_int_equal(orl_camera_project(&c, x, uv), sign > 0);
        }
        if (!(hypot(uv[0] - u, uv[1] - v) < 1e-3)) fail_msg("lens %d: %g %g came back as %g %g from %g", k, u, v, uv[0], uv[1], far);
        assert_true(fabs(x[0] * x[0] + x[1] * x[1] + x[2] * x[2] - far * far) < 1e-10 * far * far + 1e-10);
    }
    orl_pose p;
    double ray[3] = { 1, 1, 1 };
    ok(orl_pose_from_quat(&p, (double[4]){ 1, 2, 3, 4 }, (double[3]){ 0, 0, 0 }));
    orl_pose_ray(&p, (double[3]){ 0, 0, 0 }, ray);
    assert_true(ray[0] == 0 && ray[1] == 0 && ray[2] == 0);
}

#define POSE " 1 0 0 0 0.5 -1e1 +3"
static const char GOOD[] = "photo.jpg PINHOLE 640 480 500 510 320 240" POSE "\n";

static void pose_files(void **state)
{
    (void)state;
    static const struct { const char *text; int count; } FILES[] = {
        { "photo.jpg PINHOLE 640 480 500 510 320 240" POSE "\n", 1 }, { "photo.jpg PINHOLE 640 480 500 510 320 240" POSE, 1 }, { "photo.jpg PINHOLE 640 480 500 510 320 240" POSE "\r\n", 1 },
        { "# comment\n\n  \t\n\t# another\nphoto.jpg\tPINHOLE 640   480 500 510 320 240" POSE " \t\n\n#\n", 1 },
        { "photo.jpg PINHOLE 640 480 500 510 320 240" POSE " # its camera\n", 1 },
        { "photo.jpg PINHOLE 640 480 500 510 320 240" POSE "\r\n\r\n# wide\r\nwide OPENCV 1280 960 400 401 640 480 0.1 0.2 0.3 0.4 0 0 2 0 7 8 9\r\n", 2 },
        { "photo.jpg PINHOLE 640 480 500 510 320 240" POSE "\nwide OPENCV 1280 960 400 401 640 480 0.1 0.2 0.3 0.4 0 0 2 0 7 8 9\nnot read at all\n", 2 },
    };
    for (size_t k = 0; k < sizeof FILES / sizeof *FILES; k++) {
        orl_view_pose v[3];
        int n = -1;
        memset(v, 0x5a, sizeof v);
        put_text(at("pose.txt"), FILES[k].text);
        ok(orl_posefile_read(at("pose.txt"), v, 2, &n));
        assert_int_equal(n, FILES[k].count);
        assert_string_equal(v[0].name, "photo.jpg");
        assert_true(v[0].cam.model == ORL_CAM_PINHOLE && v[0].cam.w == 640 && v[0].cam.h == 480 && v[0].cam.fx == 500 && v[0].cam.fy == 510 && v[0].cam.cx == 320 && v[0].cam.cy == 240);
        for (int i = 0; i < 9; i++) assert_true(v[0].pose.R[i] == (i % 4 == 0));
        assert_true(v[0].pose.t[0] == 0.5 && v[0].pose.t[1] == -10 && v[0].pose.t[2] == 3);
        if (n == 2) {
            assert_string_equal(v[1].name, "wide");
            assert_true(v[1].cam.model == ORL_CAM_OPENCV && v[1].cam.w == 1280 && v[1].cam.k1 == 0.1 && v[1].cam.p2 == 0.4);
            assert_true(v[1].pose.R[0] == -1 && v[1].pose.R[4] == 1 && v[1].pose.R[8] == -1 && v[1].pose.t[2] == 9);
        }
        assert_int_equal((uint8_t)v[n].name[0], 0x5a);      /* no more than counted */
        assert_int_equal((uint8_t)v[2].name[0], 0x5a);
        ok(orl_posefile_read(at("pose.txt"), v, 1, &n));
        assert_int_equal(n, 1);
    }
    for (int m = 0; m < 5; m++) {       /* every model's parameters, told apart from the pose */
        orl_view_pose v;
        int n;
        char s[256];
        int k = snprintf(s, sizeof s, "a %s 640 480", orl_camera_model_name((orl_cam_model)m));
        for (int i = 0; i < orl_camera_param_count(m); i++) k += snprintf(s + k, sizeof s - (size_t)k, " %d", i < 4 ? 100 + i : 0);
        snprintf(s + k, sizeof s - (size_t)k, " 1 0 0 0 7 8 9");
        put_text(at("pose.txt"), s);
        ok(orl_posefile_read(at("pose.txt"), &v, 1, &n));
        assert_true((int)v.cam.model == m && v.cam.fx == 100 && v.cam.cy == (m == 1 || m == 4 ? 103 : 102) && v.pose.t[0] == 7 && v.pose.t[2] == 9);
    }
}

/* A line refused: the file, the line's number, one line of text. */
static void bad_pose_files(void **state)
{
    (void)state;
    static const struct { const char *line; orl_err e; const char *word; } BAD[] = {
        { "photo.jpg", ORL_E_FORMAT, "MODEL" }, { "photo.jpg PINHOLE", ORL_E_FORMAT, "WIDTH" }, { "photo.jpg PINHOLE 640", ORL_E_FORMAT, "HEIGHT" }, { "photo.jpg PINHOLE w h", ORL_E_FORMAT, "WIDTH" },
        { "photo.jpg FISHEYE 640 480 500 510 320 240" POSE, ORL_E_UNSUPPORTED, "FISHEYE" }, { "photo.jpg pinhole 640 480 500 510 320 240" POSE, ORL_E_UNSUPPORTED, "pinhole" },
        { "photo.jpg PINHOLE 640 480", ORL_E_FORMAT, "value 1 of 11" }, { "photo.jpg PINHOLE 640 480 500 510 320 x", ORL_E_FORMAT, "value 4 of 11" },
        { "photo.jpg PINHOLE 640 480 500 510 320 240 1 0 0 0 0.5 -10", ORL_E_FORMAT, "value 11 of 11" },
        { "photo.jpg PINHOLE 640 480 500 510 320 240" POSE " 1", ORL_E_FORMAT, "more than 11 values" },     /* another model's parameters: all that follows would be shifted */
        { "photo.jpg SIMPLE_RADIAL 640 480 500 320 240 0 0" POSE, ORL_E_FORMAT, "more than 11 values" },
        { "photo.jpg PINHOLE 640 480 500 510 320 240" POSE "x", ORL_E_FORMAT, "more than 11 values" },
        { "photo.jpg PINHOLE 0 480 500 510 320 240" POSE, ORL_E_RANGE, "image size" }, { "photo.jpg PINHOLE 640 -480 500 510 320 240" POSE, ORL_E_RANGE, "image size" },
        { "photo.jpg PINHOLE 4294967936 480 500 510 320 240" POSE, ORL_E_RANGE, "image size" }, { "photo.jpg PINHOLE 640 99999999999999999999999 500 510 320 240" POSE, ORL_E_RANGE, "image size" },
        { "photo.jpg PINHOLE 640 480 0 510 320 240" POSE, ORL_E_RANGE, "focal length" }, { "photo.jpg PINHOLE 640 480 nan 510 320 240" POSE, ORL_E_RANGE, "parameter 0" },
        { "photo.jpg PINHOLE 640 480 500 510 320 inf" POSE, ORL_E_RANGE, "parameter 3" }, { "photo.jpg PINHOLE 640 480 500 510 320 1e5" POSE, ORL_E_RANGE, "principal point" },
        { "photo.jpg PINHOLE 640 480 500 510 320 240 0 0 0 0 1 2 3", ORL_E_DEGENERATE, "quaternion" }, { "photo.jpg PINHOLE 640 480 500 510 320 240 1 nan 0 0 1 2 3", ORL_E_DEGENERATE, "quaternion" },
        { "photo.jpg PINHOLE 640 480 500 510 320 240 1 0 0 0 inf 2 3", ORL_E_DEGENERATE, "translation" },
    };
    char file[4096];
    orl_view_pose v[2];
    int n = 77;
    for (size_t k = 0; k < sizeof BAD / sizeof *BAD; k++)
        for (int second = 0; second < 2; second++) {        /* as the only line behind a comment, and behind a good one */
            snprintf(file, sizeof file, "# comment\n%s%s\n", second ? GOOD : "", BAD[k].line);
            put_text(at("pose.txt"), file);
            failed(orl_posefile_read(at("pose.txt"), v, 2, &n), BAD[k].e, at("pose.txt:%d: ", 2 + second), BAD[k].word, NULL);
            assert_int_equal(n, 77);
        }
    for (int k = 0; k < 3; k++) {
        put_text(at("pose.txt"), k == 0 ? "" : k == 1 ? "# nothing\n\n" : "\n \n\r\n");
        failed(orl_posefile_read(at("pose.txt"), v, 2, &n), ORL_E_FORMAT, at("pose.txt"), NULL);
    }
    failed(orl_posefile_read(at("none.txt"), v, 2, &n), ORL_E_IO, at("none.txt"), NULL);
    failed(orl_posefile_read(scratch, v, 2, &n), ORL_E_FORMAT, scratch, NULL);
    assert_int_equal(n, 77);
}

/* Lines and names of any length: a comment is one however long, the rest is refused and not cut. */
static void long_lines(void **state)
{
    (void)state;
    static char s[20000];
    orl_view_pose v[2];
    int n = 77;
    static const int LENGTH[] = { 100, 2046, 2047, 2048, 2049, 4095, 9000 };
    for (size_t k = 0; k < sizeof LENGTH / sizeof *LENGTH; k++) {
        memset(s, 'c', sizeof s);
        s[0] = '#';
        snprintf(s + LENGTH[k], sizeof s - (size_t)LENGTH[k], "\n%s", GOOD);
        put_text(at("pose.txt"), s);
        ok(orl_posefile_read(at("pose.txt"), v, 2, &n));
        assert_int_equal(n, 1);
        memset(s, ' ', sizeof s);                           /* a good line, far out */
        memcpy(s, "photo.jpg PINHOLE ", 18);
        snprintf(s + 18 + LENGTH[k], sizeof s - (size_t)LENGTH[k] - 18, "640 480 500 510 320 240" POSE "\n");
        put_text(at("pose.txt"), s);
        if (LENGTH[k] < 1000) ok(orl_posefile_read(at("pose.txt"), v, 2, &n));
        else failed(orl_posefile_read(at("pose.txt"), v, 2, &n), ORL_E_FORMAT, at("pose.txt:1: "), "too long", NULL);
    }
    for (int length = 126; length < 135; length++) {
        memset(s, 'n', (size_t)length);
        strcpy(s + length, strchr(GOOD, ' '));
        put_text(at("pose.txt"), s);
        orl_err e = orl_posefile_read(at("pose.txt"), v, 2, &n);
        if (length < 128) { ok(e); assert_int_equal(strlen(v[0].name), length); }
        else failed(e, ORL_E_FORMAT, at("pose.txt:1: "), "name", NULL);
    }
}

static void kiosk(void **state)
{
    (void)state;
    orl_view_pose v[2];
    int n;
    if (access("../shared/data/basilica/kiosk/camera.txt", R_OK)) { print_message("no ../shared/data/basilica\n"); skip(); }
    ok(orl_posefile_read("../shared/data/basilica/kiosk/camera.txt", v, 2, &n));
    assert_int_equal(n, 2);
    assert_string_equal(v[0].name, "frames");
    assert_string_equal(v[1].name, "gt_wide");
    assert_true(v[0].cam.fx == 1102.222222 && v[1].cam.fx == 501.010101 && v[1].pose.t[2] == 46.07057887);
    orl_camera w = orl_camera_widened(&v[0].cam, 2.2, 640, 480);        /* as the recording was made */
    assert_true(fabs(w.fx - v[1].cam.fx) < 1e-6 && w.cx == v[1].cam.cx && w.cy == v[1].cam.cy);
}

#define TEST(f) cmocka_unit_test_setup_teardown(f, scratch_make, scratch_remove)
int main(void)
{
    const struct CMUnitTest tests[] = {
        TEST(models), TEST(ranges), TEST(projects), TEST(there_and_back), TEST(behind), TEST(resized), TEST(widened), TEST(quaternions), TEST(singular), TEST(centres_and_rays),
        TEST(pose_files), TEST(bad_pose_files), TEST(long_lines), TEST(kiosk),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
