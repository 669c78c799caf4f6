/* The fixed-point view against the analytic scene: depth, normal, coverage, thread-count identity, degenerate poses, the sun's way, and fixed shading against the float model on the view's own samples. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>
#include "oriel/cpu.h"
#include "oriel/view.h"
#include "tests/synth_scene.h"

static orl_scene scene;
static int setup(void **state) { (void)state; synth_scene_make(&scene, 8, 8, 6); return 0; }
static int teardown(void **state) { (void)state; synth_scene_free(&scene); return 0; }

typedef struct { orl_view v; void *block; size_t bytes; } built;

static void build(built *b, const orl_camera *cam, const orl_pose *pose, int ss, int threads)
{
    b->bytes = orl_view_need(cam->w, cam->h);
    b->block = aligned_alloc(64, b->bytes);
    assert_non_null(b->block);
    memset(b->block, 0x5a, b->bytes);
    orl_err e = orl_view_build(&scene, cam, pose, ss, threads, b->block, b->bytes, &b->v);
    if (e) fail_msg("%s", orl_error_text());
}

/* Rays that enter the box below the ground see the solid's cut side, about which the analytic scene says nothing. */
static int enters_below(const double o[3], const double d[3])
{
    double t = 0;
    for (int a = 0; a < 3; a++) {
        double e = fmin(-o[a] / d[a], (8.0 * scene.nb[a] - o[a]) / d[a]);
        t = fmax(t, e);
    }
    return o[2] + t * d[2] < SYNTH_GROUND + 0.5;
}

/* Analytic ray: distance to sphere or ground inside the box, -1 if none. */
static double analytic(const double o[3], const double d[3], double n[3])
{
    double c[3], r, best = 1e9;
    synth_sphere(&scene, c, &r);
    double b = 0, q = -r * r;
    for (int a = 0; a < 3; a++) { b += (o[a] - c[a]) * d[a]; q += (o[a] - c[a]) * (o[a] - c[a]); }
    if (b * b - q > 0 && -b - sqrt(b * b - q) > 0) {
        best = -b - sqrt(b * b - q);
        for (int a = 0; a < 3; a++) n[a] = (o[a] + best * d[a] - c[a]) / r;
    }
    double g = (SYNTH_GROUND - o[2]) / d[2], x = o[0] + g * d[0], y = o[1] + g * d[1];
    if (d[2] < 0 && g > 0 && g < best && x > 0 && y > 0 && x < 8.0 * scene.nb[0] && y < 8.0 * scene.nb[1]) {
        best = g;
        n[0] = n[1] = 0; n[2] = 1;
    }
    return best < 1e9 ? best : -1;
}

static const double eye[3] = { -40, -60, 70 }, target[3] = { 32, 32, 18 };

/* What pixel (x, y) of a picture taken from `eye` holds, its ray, and the analytic scene's distance and normal along it. */
static double look(const built *b, int x, int y, orl_sample *s, double d[3], double n[3])
{
    orl_view_sample(&b->v, x, y, s);
    for (int a = 0; a < 3; a++) d[a] = s->dir[a];
    return analytic(eye, d, n);
}

static double depth_of(const built *b, int x, int y) { return b->v.depth[(size_t)y * (size_t)b->v.stride + (size_t)x] / 16.0; }

/* The scene's brick map without the bricks [lo, hi), malloc'd. */
static int32_t *map_without(const int lo[3], const int hi[3])
{
    size_t total = (size_t)scene.nb[0] * scene.nb[1] * scene.nb[2];
    int32_t *map = malloc(total * sizeof *map);
    memcpy(map, scene.bmap, total * sizeof *map);
    for (int z = lo[2]; z < hi[2]; z++) for (int y = lo[1]; y < hi[1]; y++) for (int x = lo[0]; x < hi[0]; x++) map[((size_t)z * scene.nb[1] + (size_t)y) * scene.nb[0] + (size_t)x] = -1;
    return map;
}

static void test_depth_and_normal(void **state)
{
    (void)state;
    orl_camera cam = synth_camera(160, 120, 45);
    orl_pose pose = synth_look(&scene, eye, target);
    built b;
    build(&b, &cam, &pose, 1, 1);
    int hits = 0, wrong = 0;
    double depth_sum = 0, depth_max = 0, angle_sum = 0, albedo_sum = 0;
    for (int y = 0; y < cam.h; y++) for (int x = 0; x < cam.w; x++) {
        orl_sample s;
        double n[3], d[3], t = look(&b, x, y, &s, d, n);
        if (enters_below(eye, d)) continue;
        size_t at = (size_t)y * (size_t)b.v.stride + (size_t)x;
        if ((t > 0) != (s.cov == 1)) { wrong++; continue; }
        if (t <= 0) { assert_int_equal(b.v.depth[at], 65535); continue; }
        double e = fabs(depth_of(&b, x, y) - t), dot = 0;
        if (e > 2) { wrong++; continue; }           /* other side of a silhouette or of the crease */
        for (int a = 0; a < 3; a++) dot += n[a] * s.normal[a];
        hits++;
        depth_sum += e;
        if (e > depth_max) depth_max = e;
        angle_sum += acos(fmin(dot, 1)) * 57.29578;
        double p[3] = { eye[0] + t * d[0], eye[1] + t * d[1], eye[2] + t * d[2] }, v = (120 + 100 * synth_wave(p[0] / 17)) / 255;
        albedo_sum += fabs(s.albedo[0] - v * v);
    }
    print_message("%d hits, %d wrong, depth error mean %.3f max %.3f cells, normal %.2f degrees, base colour %.4f\n", hits, wrong, depth_sum / hits, depth_max, angle_sum / hits, albedo_sum / hits);
    assert_true(hits > 4000);
    assert_true(wrong < hits / 100);
    assert_true(depth_sum / hits < 0.08);
    assert_true(angle_sum / hits < 2.5);        /* taken over +-2 cells, which rounds this small scene's edges */
    assert_true(albedo_sum / hits < 0.006);
    free(b.block);
}

/* Four rays a quarter of a pixel from its sides; through its corners where those are asked for and a pixel is less than a cell wide. */
static void coverage(int rays, double fov, double first, double pitch)
{
    orl_camera cam = synth_camera(96, 64, fov);
    orl_pose pose = synth_look(&scene, eye, target);
    built b;
    build(&b, &cam, &pose, rays, 1);
    int wrong = 0, partial = 0;
    for (int y = 0; y < cam.h; y++) for (int x = 0; x < cam.w; x++) {
        int n = 0, skip = 0;
        for (int k = 0; k < 4; k++) {
            double c[3], d[3] = { 0 }, normal[3];
            orl_camera_unproject(&cam, x + first + pitch * (k & 1), y + first + pitch * (k >> 1), c);
            double len = sqrt(c[0] * c[0] + c[1] * c[1] + c[2] * c[2]);
            for (int a = 0; a < 3; a++) for (int i = 0; i < 3; i++) d[a] += b.v.grid_from_cam[3 * a + i] * c[i] / len;
            n += analytic(eye, d, normal) > 0;
            skip |= enters_below(eye, d);
        }
        if (skip) continue;
        int cov = b.v.cov[(size_t)y * (size_t)b.v.stride + (size_t)x];
        assert_true(cov == 0 || cov == 64 || cov == 128 || cov == 191 || cov == 255);
        wrong += cov != (255 * n + 2) / 4;
        partial += n > 0 && n < 4;
        if (!cov) assert_int_equal(b.v.depth[(size_t)y * (size_t)b.v.stride + (size_t)x], 65535);
    }
    print_message("%d partly covered pixels, %d differ from the analytic count\n", partial, wrong);
    assert_true(partial > 20 && wrong < partial / 3);
    free(b.block);
}

static void test_coverage(void **state)
{
    (void)state;
    coverage(ORL_RAYS_FOUR, 26, 0.25, 0.5);
    coverage(ORL_RAYS_CORNERS, 95, 0.25, 0.5);
    coverage(ORL_RAYS_CORNERS, 26, 0, 1);
}

/* A brick of the sphere left out: rays that enter there leave the sphere again and meet the ground behind it. */
static void test_gap(void **state)
{
    (void)state;
    enum { GAP = 3 };
    static uint8_t colour[ORL_GROUND_SIDE * ORL_GROUND_SIDE][3];
    int32_t *whole = (int32_t *)scene.bmap, *gap = map_without((int[3]){ GAP, GAP, GAP }, (int[3]){ GAP + 1, GAP + 1, GAP + 1 });
    orl_camera cam = synth_camera(320, 240, 45);
    orl_pose pose = synth_look(&scene, eye, target);
    scene.bmap = gap;
    scene.ground_albedo = colour[0];
    scene.ground[0] = (float)SYNTH_GROUND;
    built b;
    int through = 0;
    build(&b, &cam, &pose, 1, 2);
    for (int y = 0; y < cam.h; y++) for (int x = 0; x < cam.w; x++) {
        orl_sample s;
        double n[3], d[3], t = look(&b, x, y, &s, d, n), fall = (SYNTH_GROUND - eye[2]) / d[2];
        int in = t > 0 && d[2] < 0 && t < fall - 2;
        for (int a = 0; a < 3; a++) in &= fabs((eye[a] + t * d[a]) / 8 - GAP - 0.5) < 0.48 && (a == 2 || fabs((eye[a] + fall * d[a]) / 8 - 4) < 4);
        if (!in) continue;
        double e = depth_of(&b, x, y) - fall;
        assert_true(s.normal[2] > 0.99f);
        assert_true(e < 0.1 && e > -0.1 - ORL_GROUND_CUT * 8 * scene.nb[0] / -d[2]);
        through++;
    }
    assert_true(through > 100);
    scene.bmap = whole;
    scene.ground_albedo = NULL;
    free(gap);
    free(b.block);
}

/* Ground bricks left out: rays that fall into the hole meet the ground plane's colour, at the plane or at the section of the bricks behind it, and never those bricks' inside. */
static void test_hole(void **state)
{
    (void)state;
    enum { X0 = 1, X1 = 3, Y0 = 0, Y1 = 2, Z = (int)(SYNTH_GROUND / 8) };
    static uint8_t colour[ORL_GROUND_SIDE * ORL_GROUND_SIDE][3];
    int32_t *whole = (int32_t *)scene.bmap, *holed = map_without((int[3]){ X0, Y0, Z }, (int[3]){ X1, Y1, Z + 1 });
    for (int i = 0; i < ORL_GROUND_SIDE * ORL_GROUND_SIDE; i++) memcpy(colour[i], (uint8_t[3]){ 10, 200, 30 }, 3);
    orl_camera cam = synth_camera(160, 120, 45);
    orl_pose pose = synth_look(&scene, eye, target);
    scene.bmap = holed;
    scene.ground_albedo = colour[0];
    for (int low = 0; low < 2; low++) {     /* the plane where the ground is; the plane lower, so that sections stand out of it */
        scene.ground[0] = (float)SYNTH_GROUND - 1.2f * (float)low;
        built b;
        int fell = 0, section = 0;
        build(&b, &cam, &pose, 1, 2);
        for (int y = 0; y < cam.h; y++) for (int x = 0; x < cam.w; x++) {
            orl_sample s;
            double n[3], d[3], t = look(&b, x, y, &s, d, n), px = (eye[0] + t * d[0]) / 8, py = (eye[1] + t * d[1]) / 8;
            if (t <= 0 || n[2] < 1 || enters_below(eye, d) || px < X0 + 0.02 || px > X1 - 0.02 || py < Y0 + 0.02 || py > Y1 - 0.02) continue;
            double e = depth_of(&b, x, y) - t, most = 1.2 * low / -d[2];
            assert_true(s.albedo[1] > 0.6f && s.albedo[0] < 0.01f);
            assert_true(s.normal[2] > 0.999f);
            assert_true(e > -0.1 && e < most + 0.1);
            fell++;
            section += e < most - 0.1;
        }
        assert_true(fell > 200);
        assert_true(!low || section > 10);
        free(b.block);
    }
    scene.bmap = whole;

    /* an eye beside the box sees the ground before the solid's side */
    double beside[3] = { -30, 32, SYNTH_GROUND + 10 }, middle[3] = { 32, 32, SYNTH_GROUND };
    built b;
    int before = 0;
    pose = synth_look(&scene, beside, middle);
    scene.ground[0] = (float)SYNTH_GROUND;
    build(&b, &cam, &pose, 1, 2);
    for (int y = 0; y < cam.h; y++) for (int x = 0; x < cam.w; x++) {
        orl_sample s;
        orl_view_sample(&b.v, x, y, &s);
        double t = s.dir[2] < -0.01 ? -10 / s.dir[2] : 0;
        if (t <= 0 || beside[0] + t * s.dir[0] > -0.5) continue;
        assert_true(s.albedo[1] > 0.6f && s.albedo[0] < 0.01f && s.normal[2] > 0.999f);
        assert_true(fabs(depth_of(&b, x, y) - t) < 0.1);
        before++;
    }
    assert_true(before > 1000);
    free(b.block);
    scene.ground_albedo = NULL;
    free(holed);
}

static void test_threads(void **state)
{
    (void)state;
    orl_camera cam = synth_camera(75, 61, 70);      /* odd sizes: padding */
    cam.model = ORL_CAM_SIMPLE_RADIAL;
    cam.k1 = -0.05;
    orl_pose pose = synth_look(&scene, eye, target);
    built a, b;
    build(&a, &cam, &pose, 2, 1);
    build(&b, &cam, &pose, 2, 3);
    size_t planes = (size_t)((uint8_t *)a.v.sky - (uint8_t *)a.block);
    assert_memory_equal(a.block, b.block, planes);
    free(a.block);
    free(b.block);
}

/* Pixels that are wanted are as in the whole view, whatever else is wanted; the others hold sky. */
static void test_some(void **state)
{
    (void)state;
    enum { W = 83, H = 50 };
    static uint8_t wanted[W * H];
    orl_camera cam = synth_camera(W, H, 40);
    orl_pose pose = synth_look(&scene, eye, target);
    built all, some;
    build(&all, &cam, &pose, 2, 1);
    build(&some, &cam, &pose, 2, 1);
    for (int i = 0; i < W * H; i++) wanted[i] = (uint8_t)(i % 7 == 0 || (i / W > 20 && i % W < 30));
    assert_int_equal(orl_view_build_some(&scene, &cam, &pose, 2, wanted, NULL, 3, some.block, some.bytes, &some.v), ORL_OK);
    for (int y = 0; y < H; y++) for (int x = 0; x < W; x++) {
        orl_sample a, b;
        orl_view_sample(&all.v, x, y, &a);
        orl_view_sample(&some.v, x, y, &b);
        if (wanted[y * W + x]) assert_memory_equal(&a, &b, sizeof a);
        else assert_true(b.cov == 0 && depth_of(&some, x, y) > 4000);
    }
    free(all.block);
    free(some.block);
}

/* Fixed shading against orl_light_shade on the same samples, over lights from dim to dazzling. */
static void test_shading(void **state)
{
    (void)state;
    orl_camera cam = synth_camera(131, 90, 75);
    orl_pose pose = synth_look(&scene, eye, target);
    built b;
    build(&b, &cam, &pose, 2, 1);
    void *lb = aligned_alloc(64, orl_view_light_need());
    uint8_t *rgb = malloc((size_t)cam.w * 3 * (size_t)cam.h + 64);
    assert_non_null(lb);
    assert_non_null(rgb);
    for (int i = 0; i < 8; i++) {
        float code[ORL_CODE];
        memcpy(code, scene.light.prior_mean, sizeof code);
        code[ORL_C_SUN_AZ] = -3 + 1.3f * (float)i;
        code[ORL_C_SUN_EL] = 0.1f + 0.17f * (float)i;
        for (int c = 0; c < 3; c++) code[ORL_C_SUN_RGB + c] = -1.5f + 0.7f * (float)i - 0.1f * (float)c;
        for (int k = 0; k < ORL_SHADOW_DIM; k++) code[ORL_C_SHADOW + k] = 0.6f * (float)((i * k) % 5) - 1.2f;
        for (int k = 0; k < 9; k++) code[ORL_C_TONE + k] = 0.03f * (float)((k * 7 + i) % 5 - 2);
        for (int k = 0; k < 3; k++) code[ORL_C_TONE + 9 + k] = 0.02f * (float)(k - 1);
        orl_light light;
        orl_light_decode(&scene.light, code, &light);
        orl_view_light *l = orl_view_light_make(&b.v, &light, lb, orl_view_light_need());
        assert_non_null(l);
        memset(rgb, 0xa5, (size_t)cam.w * 3 * (size_t)cam.h + 64);
        if (i & 1) orl_view_trace_sun(&b.v, &light, 0, cam.h, ORL_CPU_REF, 1);
        orl_view_shade(&b.v, l, orl_cpu_detect(), 0, 40, rgb, (size_t)cam.w * 3);
        orl_view_shade(&b.v, l, ORL_CPU_REF, 40, cam.h, rgb + (size_t)cam.w * 3 * 40, (size_t)cam.w * 3);
        for (int k = 0; k < 64; k++) assert_int_equal(rgb[(size_t)cam.w * 3 * (size_t)cam.h + (size_t)k], 0xa5);
        double sum = 0, worst = 0, bias = 0;
        for (int y = 0; y < cam.h; y++) for (int x = 0; x < cam.w; x++) {
            orl_sample s;
            float want[3];
            orl_view_sample(&b.v, x, y, &s);
            orl_light_shade(&light, &s, want);
            for (int c = 0; c < 3; c++) {
                double e = rgb[((size_t)y * (size_t)cam.w + (size_t)x) * 3 + (size_t)c] - 255 * fmin(fmax(want[c], 0), 1);
                sum += fabs(e);
                bias += e;
                worst = fmax(worst, fabs(e));
            }
        }
        double n = 3.0 * cam.w * cam.h;
        print_message("light %d: mean error %.3f, bias %.3f, worst %.2f of 255\n", i, sum / n, bias / n, worst);
        assert_true(sum / n < 0.6 && fabs(bias / n) < 0.2 && worst < 4);
    }
    free(lb);
    free(rgb);
    free(b.block);
}

static void test_degenerate(void **state)
{
    (void)state;
    orl_camera cam = synth_camera(32, 24, 60);
    orl_pose pose = synth_look(&scene, eye, target), bad;
    size_t need = orl_view_need(32, 24);
    void *block = aligned_alloc(64, need);
    assert_non_null(block);
    orl_view v, was;
    memset(&v, 0x33, sizeof v);
    was = v;
    for (int i = 0; i < 12; i++) {
        bad = pose;
        *(i < 9 ? &bad.R[i] : &bad.t[i - 9]) = i & 1 ? NAN : INFINITY;
        assert_int_equal(orl_view_build(&scene, &cam, &bad, 1, 1, block, need, &v), ORL_E_DEGENERATE);
    }
    memset(bad.R, 0, sizeof bad.R);
    memset(bad.t, 0, sizeof bad.t);
    assert_int_equal(orl_view_build(&scene, &cam, &bad, 1, 1, block, need, &v), ORL_E_DEGENERATE);
    assert_int_equal(orl_view_build(&scene, &cam, &pose, 1, 1, block, need - 64, &v), ORL_E_MEMORY);
    assert_int_equal(orl_view_build(&scene, &cam, &pose, 4, 1, block, need, &v), ORL_E_RANGE);
    orl_scene sky = { .light = scene.light };
    assert_int_equal(orl_view_build(&sky, &cam, &pose, 1, 1, block, need, &v), ORL_E_DEGENERATE);
    assert_memory_equal(&v, &was, sizeof v);
    free(block);

    const double looks[][6] = {
        { 32, 32, 18, 60, 32, 18 },             /* inside the sphere */
        { 32, 32, -40, 32, 40, 20 },            /* below the ground */
        { -100, -100, 40, -200, -200, 60 },     /* outside, looking away */
        { 32, 32, 47.9999, 32, 33, 20 },        /* on the box's face */
        { 0, 0, 0, 64, 64, 48 }, { 8, 8, 30, 8, 60, 30 }, { 16, -50, 16, 16, 60, 16 },     /* corner; along brick faces */
        { 1e6, 1e6, 1e6, 32, 32, 18 },          /* very far */
    };
    for (size_t i = 0; i < sizeof looks / sizeof *looks; i++) {
        built b;
        bad = synth_look(&scene, looks[i], looks[i] + 3);
        build(&b, &cam, &bad, 2, 1);
        int covered = 0;
        for (int k = 0; k < b.v.stride * b.v.h; k++) covered += b.v.cov[k] > 0;
        if (i == 2) assert_int_equal(covered, 0);
        if (i == 1) assert_true(covered > 300);     /* the ground's back is a surface, not a hole */
        free(b.block);
    }
}

/* Where the ball's shadow falls: traced against analytic, whatever the horizons say; and where no sun is traced. */
static void test_sun(void **state)
{
    (void)state;
    orl_camera cam = synth_camera(160, 120, 45);
    orl_pose pose = synth_look(&scene, eye, target);
    built b;
    float code[ORL_CODE];
    orl_light light;
    memcpy(code, scene.light.prior_mean, sizeof code);
    code[ORL_C_SUN_AZ] = 0.3f;
    code[ORL_C_SUN_EL] = 0.6f;
    orl_light_decode(&scene.light, code, &light);
    build(&b, &cam, &pose, 1, 1);
    size_t all = (size_t)b.v.stride * (size_t)b.v.h;
    int8_t *at_once = malloc(all);
    orl_view_trace_sun(&b.v, &light, 0, cam.h, orl_cpu_detect(), 3);
    memcpy(at_once, b.v.fix, all);
    for (int y = cam.h - 1; y >= 0; y--) orl_view_trace_sun(&b.v, &light, y, y + 1, ORL_CPU_REF, 1);
    assert_memory_equal(at_once, b.v.fix, all);
    free(at_once);
    int seen = 0, dark = 0, wrong = 0;
    for (int y = 0; y < cam.h; y++) for (int x = 0; x < cam.w; x++) {
        orl_sample s;
        double n[3], d[3], t = look(&b, x, y, &s, d, n), sun[3], o[3], cosine = 0, far[3];
        if (t <= 0 || s.cov < 1 || fabs(depth_of(&b, x, y) - t) > 0.5) continue;
        for (int a = 0; a < 3; a++) {
            sun[a] = light.sun_dir[a];
            o[a] = eye[a] + t * d[a] + 1.5 * n[a];
            cosine += n[a] * sun[a];
        }
        int lit = cosine > 0 && analytic(o, sun, far) < 0;
        float v = orl_light_sun_visibility(&light, &s);
        assert_true(v < 0.02f || v > 0.98f);
        seen++;
        dark += !lit;
        wrong += lit != (v > 0.5f);
    }
    print_message("%d pixels, %d without sun, %d wrong\n", seen, dark, wrong);
    assert_true(seen > 4000 && dark > seen / 20 && wrong < seen / 50);
    size_t n = (size_t)b.v.stride * (size_t)b.v.h;
    int8_t *zero = calloc(n, 1);
    light.sun_dir[2] = -0.1f;                   /* under the horizon: the horizons tell */
    orl_view_trace_sun(&b.v, &light, 0, cam.h, ORL_CPU_REF, 1);
    assert_memory_equal(b.v.fix, zero, n);
    orl_scene open = scene;
    open.lite = NULL;                           /* a scene in which nothing hides the sun */
    light.sun_dir[2] = 0.5f;
    b.v.scene = &open;
    orl_view_trace_sun(&b.v, &light, 0, cam.h, ORL_CPU_REF, 1);
    assert_memory_equal(b.v.fix, zero, n);
    free(zero);
    free(b.block);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_depth_and_normal), cmocka_unit_test(test_coverage), cmocka_unit_test(test_hole), cmocka_unit_test(test_gap), cmocka_unit_test(test_threads), cmocka_unit_test(test_some), cmocka_unit_test(test_shading), cmocka_unit_test(test_sun), cmocka_unit_test(test_degenerate),
    };
    return cmocka_run_group_tests(tests, setup, teardown);
}
