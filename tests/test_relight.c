/* Re-lighting by panoramas: the sun is found, moved with its energy, and seen where it stands; layers add up to the picture; tones do what their matrices say; the day's sun rises in the
 * east; frames of a clip allocate nothing and do not depend on threads. */
#include "tests/scratch.h"
#include <math.h>
#include "oriel/sink.h"
#include "oriel/relight.h"
#include "oriel/widen.h"
#include "tests/allocations.h"
#include "tests/synth_scene.h"

enum { W = 96, H = 64, SKY_W = 512, SKY_H = 256 };
#define RAD (3.14159265358979 / 180)
#define NEAR(a, b, eps) do { double a_ = (a), b_ = (b); if (!(fabs(a_ - b_) <= (eps))) fail_msg("%s is %g, not %g", #a, a_, b_); } while (0)

/* A flat Radiance file: a sky of one colour with a disc of radius 1.5 degrees at (az, el) in its place. Returns the disc's solid angle. */
static double put_sky(const char *path, double az, double el, const float sky[3], const float disc[3])
{
    static uint8_t b[200 + SKY_W * SKY_H * 4];
    size_t n = (size_t)sprintf((char *)b, "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y %d +X %d\n", SKY_H, SKY_W);
    double area = 0;
    for (int y = 0; y < SKY_H; y++)
        for (int x = 0; x < SKY_W; x++, n += 4) {
            double pe = (0.5 - (y + 0.5) / SKY_H) * 180 * RAD, pa = (0.5 - (x + 0.5) / SKY_W) * 360 * RAD;
            double c = sin(pe) * sin(el * RAD) + cos(pe) * cos(el * RAD) * cos(pa - az * RAD);
            const float *rgb = c > cos(1.5 * RAD) ? disc : sky;
            int e;
            if (rgb == disc) area += 2 * M_PI / SKY_W * M_PI / SKY_H * cos(pe);
            frexp(fmax(rgb[0], fmax(rgb[1], rgb[2])), &e);
            for (int k = 0; k < 3; k++) b[n + (size_t)k] = (uint8_t)fmin(255, ldexp((double)rgb[k], 8 - e) + 0.5);
            b[n + 3] = (uint8_t)(e + 128);
        }
    put_bytes(path, b, n);
    return area;
}

static const float BLUE[3] = { 0.25f, 0.5f, 1.0f }, SUN[3] = { 1600, 1200, 800 };

static double wrap(double a) { return remainder(a, 2 * M_PI); }

static void sun_is_found(void **state)
{
    (void)state;
    static const double PLACE[][2] = { { 0, 30 }, { 90, 45 }, { -120, 10 }, { 179.5, 60 }, { 30, 85 } };
    orl_panorama *p = malloc(sizeof *p);
    for (size_t k = 0; k < sizeof PLACE / sizeof *PLACE; k++) {
        double az = PLACE[k][0], el = PLACE[k][1], area = put_sky(at("s.hdr"), az, el, BLUE, SUN);
        ok(orl_panorama_open(at("s.hdr"), p));
        assert_true(p->has_sun);
        NEAR(wrap((double)p->az - az * RAD) * cos(el * RAD), 0, 0.3 * RAD);
        NEAR((double)p->el, el * RAD, 0.3 * RAD);
        for (int c = 0; c < 3; c++) {
            NEAR((double)p->rest[c], (double)BLUE[c], 0.01);
            NEAR((double)p->rgb[c] / ((double)SUN[c] * area), 1, 0.02);
        }
        p->turn = 1;
        orl_sun s = orl_panorama_sun(p);
        NEAR(wrap((double)(s.az - p->az) - 1), 0, 1e-5);
        assert_true(s.el == p->el && s.sky == 1 && !s.moved && !memcmp(s.rgb, p->rgb, sizeof s.rgb));
        orl_panorama_close(p);
        orl_panorama_close(p);
    }
    put_sky(at("grey.hdr"), 0, 30, BLUE, BLUE);
    ok(orl_panorama_open(at("grey.hdr"), p));
    assert_true(!p->has_sun && p->rgb[0] == 0 && p->rgb[1] == 0 && p->rgb[2] == 0);
    orl_panorama_close(p);
    failed(orl_panorama_open(at("none.hdr"), p), ORL_E_IO, at("none.hdr"), NULL);
    assert_null(p->map.px);
    put_text(at("small.hdr"), "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 1\nabcd");
    failed(orl_panorama_open(at("small.hdr"), p), ORL_E_RANGE, at("small.hdr"), "1 x 1", NULL);
    free(p);
}

/* An even sky gives an even map; a bright wedge stands in the columns that its azimuth says, for any sun and any turn; the sun itself is not in the map. */
static void map_of_the_sky(void **state)
{
    (void)state;
    orl_panorama *p = malloc(sizeof *p);
    static float env[ORL_ENV][3], again[ORL_ENV][3];
    put_sky(at("s.hdr"), 40, 30, BLUE, SUN);
    ok(orl_panorama_open(at("s.hdr"), p));
    orl_sun s = orl_panorama_sun(p);
    s.sky = 0.5f;
    orl_panorama_env(p, &s, env);
    for (int i = 0; i < ORL_ENV; i++) for (int k = 0; k < 3; k++) NEAR((double)env[i][k], 0.5 * (double)BLUE[k], 0.01);
    for (int r = 0; r < ORL_ENV_ROWS; r++)
        for (int x = 0; x < ORL_PANORAMA_BINS; x++) {
            double az = (0.5 - (x + 0.5) / ORL_PANORAMA_BINS) * 360;
            for (int k = 0; k < 3; k++) p->ring[r][x][k] = fabs(wrap((az - 100) * RAD)) < 5 * RAD ? (float)(r + 1) : 0;
        }
    for (int turn = -200; turn <= 200; turn += 50) {
        p->turn = (float)(turn * RAD);
        s = (orl_sun){ .az = (float)((turn + 40) * RAD), .el = 0.5f, .sky = 1 };         /* the wedge is 60 degrees further on than this sun */
        orl_panorama_env(p, &s, turn == -200 ? env : again);
        if (turn > -200) for (int i = 0; i < ORL_ENV; i++) NEAR((double)again[i][0], (double)env[i][0], 0.05 * (i / 32 + 1));
        for (int r = 0; r < ORL_ENV_ROWS; r++) {
            double sum = 0, where = 0;
            for (int c = 0; c < ORL_ENV_COLS; c++) {
                double v = (double)again[r * ORL_ENV_COLS + c][1];
                if (turn == -200) v = (double)env[r * ORL_ENV_COLS + c][1];
                sum += v;
                where += v * (-180 + (c + 0.5) * 360 / ORL_ENV_COLS);
            }
            NEAR(sum * 360 / ORL_ENV_COLS, 10 * (r + 1), 0.5 * (r + 1));
            NEAR(where / sum, 60, 0.5);
        }
    }
    orl_panorama_close(p);
    free(p);
}

static void look(const orl_panorama *p, const orl_sun *s, double az, double el, float rgb[3])
{
    orl_panorama_look(p, s, (const float[]){ (float)(cos(el) * cos(az)), (float)(cos(el) * sin(az)), (float)sin(el) }, rgb);
}

static void sun_is_seen_where_it_stands(void **state)
{
    (void)state;
    orl_panorama *p = malloc(sizeof *p);
    float rgb[3];
    put_sky(at("s.hdr"), -60, 50, BLUE, SUN);
    ok(orl_panorama_open(at("s.hdr"), p));
    p->turn = 0.7f;
    orl_sun own = orl_panorama_sun(p), moved = own;
    look(p, &own, (double)own.az, (double)own.el, rgb);
    for (int k = 0; k < 3; k++) NEAR((double)rgb[k] / (double)SUN[k], 1, 0.02);
    moved.az += 2;
    moved.el = 0.2f;
    moved.moved = 1;
    moved.sky = 0.5f;
    for (int k = 0; k < 3; k++) moved.rgb[k] *= k == 2 ? 0.25f : 0.5f;
    look(p, &moved, (double)own.az, (double)own.el, rgb);           /* gone from where it was */
    for (int k = 0; k < 3; k++) NEAR((double)rgb[k], 0.5 * (double)BLUE[k], 0.01);
    look(p, &moved, (double)moved.az, (double)moved.el, rgb);
    for (int k = 0; k < 3; k++) NEAR((double)rgb[k] / (double)SUN[k], k == 2 ? 0.25 : 0.5, 0.02);
    double disc = 0, whole = 0;                                     /* as large as it was */
    for (int i = 0; i < 200; i++)
        for (int j = 0; j < 200; j++) {
            double e = (double)moved.el + (i - 99.5) * 0.0005, a = (double)moved.az + (j - 99.5) * 0.0005 / cos(e);
            look(p, &moved, a, e, rgb);
            disc += (double)rgb[0] * 0.0005 * 0.0005;
            whole += 0.5 * (double)BLUE[0] * 0.0005 * 0.0005;
        }
    NEAR((disc - whole) / (0.5 * (double)p->rgb[0]), 1, 0.03);
    for (int y = -1; y <= 1; y++)                                   /* a spot 3 degrees to the sun's left goes along on its left */
        for (int x = -1; x <= 1; x++) {
            int px = (int)((0.5 - (-60 + 3 / cos(50 * RAD)) / 360) * SKY_W) + x, py = (int)((0.5 - 50.0 / 180) * SKY_H) + y;
            for (int k = 0; k < 3; k++) p->map.px[(py * SKY_W + px) * 3 + k] = 500;
        }
    look(p, &moved, (double)moved.az + 3 * RAD / cos(0.2), 0.2, rgb);
    NEAR((double)rgb[0], 250, 20);
    look(p, &moved, (double)moved.az - 3 * RAD / cos(0.2), 0.2, rgb);
    NEAR((double)rgb[0], 0.5 * (double)BLUE[0], 0.01);
    orl_panorama_close(p);
    free(p);
}

/* ---- a scene ---- */

typedef struct { orl_scene scene; orl_view view; orl_panorama *sky; orl_relight *r; void *block; } stage;

static void stage_make(stage *s, int even)      /* even: nothing hides the sun, base colour aside */
{
    const double eye[3] = { 6, -14, 26 }, target[3] = { 34, 34, 20 };
    synth_scene_make(&s->scene, 8, 8, 6);
    uint8_t *lite = (uint8_t *)s->scene.lite;
    if (even) for (size_t i = 0; i < (size_t)s->scene.nbricks * ORL_LITE_VERTS * ORL_LITE_BYTES; i++) if (i % ORL_LITE_BYTES) lite[i] = 0;
    orl_camera cam = synth_camera(W, H, 70);
    orl_pose pose = synth_look(&s->scene, eye, target);
    size_t need = orl_view_need(W, H);
    s->block = orl_widen_block(need);
    ok(orl_view_build(&s->scene, &cam, &pose, 2, 2, s->block, need, &s->view));
    put_sky(at("s.hdr"), 40, 35, BLUE, SUN);
    s->sky = malloc(sizeof *s->sky);
    s->r = malloc(sizeof *s->r);
    ok(orl_panorama_open(at("s.hdr"), s->sky));
}

static void stage_free(stage *s)
{
    orl_panorama_close(s->sky);
    free(s->sky);
    free(s->r);
    free(s->block);
    synth_scene_free(&s->scene);
}

static orl_sun sun_at(const stage *s, double az, double el)
{
    orl_sun sun = orl_panorama_sun(s->sky);
    sun.az = (float)(az * RAD);
    sun.el = (float)(el * RAD);
    sun.moved = 1;
    return sun;
}

static void layers_add_up(void **state)
{
    (void)state;
    stage s;
    stage_make(&s, 0);
    orl_sun sun = sun_at(&s, 40, 35), other = sun_at(&s, 130, 20);
    orl_layers a, b;
    int surface = 0, sky = 0, edge = 0, moved = 0;
    orl_relight_init(&s.view, &s.scene.light, s.sky, &sun, s.r);
    for (int i = 0; i < W * H; i++) {
        orl_relight_pixel(s.r, i % W, i / W, &a);
        surface += a.cov == 1;
        sky += a.cov == 0;
        edge += a.cov > 0 && a.cov < 1;
        assert_true(a.shadow >= 0 && a.shadow <= 1);
        for (int c = 0; c < 3; c++) {
            double want = (double)a.cov * (double)a.albedo[c] * (double)a.irradiance[c] / M_PI + (double)a.sky[c];
            NEAR((double)a.rgb[c], want, 1e-5 * want);
            if (a.cov == 1) assert_true(a.sky[c] == 0 && a.irradiance[c] > 0);
            if (a.cov == 0) assert_true(a.irradiance[c] == 0 && a.albedo[c] == 0 && a.normal[c] == 0 && a.rgb[c] == a.sky[c] && a.shadow == 0);
        }
        if (a.cov > 0) NEAR((double)(a.normal[0] * a.normal[0] + a.normal[1] * a.normal[1] + a.normal[2] * a.normal[2]), 1, 1e-4);
    }
    assert_true(surface > W * H / 4 && sky > 20 && edge > 20);
    /* Irradiance is what the light model's equation says, shadow is its V s, and both follow the sun. */
    orl_relight *r2 = malloc(sizeof *r2);
    orl_relight_init(&s.view, &s.scene.light, s.sky, &other, r2);
    for (int i = 0; i < W * H; i++) {
        orl_sample p;
        float e[3];
        memset(&p, 0, sizeof p);
        orl_view_sample(&s.view, i % W, i / W, &p);
        orl_relight_pixel(s.r, i % W, i / W, &a);
        orl_relight_pixel(r2, i % W, i / W, &b);
        if (a.cov < 1) continue;
        moved += fabsf(a.shadow - b.shadow) > 0.2f;
        const orl_light *l = &s.r->light;
        double x = (double)ORL_SHADOW_BIAS, sh, cosine = 0;
        for (int k = 0; k < ORL_SHADOW_DIM; k++) x += (double)(l->code[ORL_C_SHADOW + k] * p.phi[k]);
        sh = 1 / (1 + exp(-x));
        NEAR((double)a.shadow, sh * (double)orl_light_sun_visibility(l, &p), 1e-5);
        orl_light_esky(l, p.normal, e);
        for (int k = 0; k < 3; k++) cosine += (double)(p.normal[k] * l->sun_dir[k]);
        for (int c = 0; c < 3; c++) {
            double want = ((double)a.shadow * (double)l->sun_rgb[c] * fmax(cosine, 0) + sh * ((double)(p.open * e[c]) + 0.5 * (1 - (double)p.normal[2]) * (double)l->eground[c])) / (double)s.r->level;
            NEAR((double)a.irradiance[c] / want, 1, 1e-4);
        }
    }
    assert_true(moved > W * H / 20);
    free(r2);
    stage_free(&s);
}

/* With the sun mirrored about the line of sight, the bright side of the sphere is the other one. */
static void mirrored_sun_changes_sides(void **state)
{
    (void)state;
    stage s;
    double side[2][2] = { { 0 } }, facing = atan2(48, 28) / RAD;
    stage_make(&s, 1);
    for (int k = 0; k < 2; k++) {
        orl_sun sun = sun_at(&s, facing + (k ? -110 : 110), 15);        /* behind the camera, to its left, then to its right */
        orl_layers l;
        orl_relight_init(&s.view, &s.scene.light, s.sky, &sun, s.r);
        for (int y = 0; y < H; y++)
            for (int x = 0; x < W; x++) {
                orl_relight_pixel(s.r, x, y, &l);
                if (l.cov < 1 || l.normal[2] > 0.9f) continue;          /* the ground is the same on both sides */
                side[k][x >= W / 2] += (double)l.irradiance[1] / (W * H);
            }
    }
    print_message("figure: left, right: %.4f %.4f and %.4f %.4f\n", side[0][0], side[0][1], side[1][0], side[1][1]);
    assert_true(side[0][0] > 1.3 * side[0][1]);
    assert_true(side[1][1] > 1.3 * side[1][0]);
    stage_free(&s);
}

static void display_tones(void **state)
{
    (void)state;
    static const char *const NAME[] = { "neutral", "warm", "cool", "faded", "mono", "contrast" };
    stage s;
    orl_tone t, first;
    static uint8_t rgb[W * H * 3], plain[W * H * 3];
    float *linear = malloc(W * H * 3 * sizeof *linear);
    stage_make(&s, 0);
    orl_sun sun = orl_panorama_sun(s.sky);
    orl_relight_init(&s.view, &s.scene.light, s.sky, &sun, s.r);
    seed_print();
    for (int i = 0; i < W * H * 3; i++) linear[i] = (float)(uniform(0, 1) * uniform(0, 1.5));
    for (size_t k = 0; k < sizeof NAME / sizeof *NAME; k++) {
        int differ = 0;
        assert_non_null(strstr(ORL_TONE_PRESETS, NAME[k]));
        ok(orl_tone_find(NAME[k], &t));
        orl_relight_display(s.r, 2, linear, 0.7f, &t, k ? rgb : plain);
        for (int i = 0; i < W * H; i++) {
            double e[3];
            for (int c = 0; c < 3; c++) {
                double v = 0.7 * (double)linear[3 * i + c];
                e[c] = v <= 0.0031308 ? 12.92 * v : 1.055 * pow(v, 1 / 2.4) - 0.055;
            }
            for (int c = 0; c < 3; c++) {
                double want = (double)t.b[c], got = k ? rgb[3 * i + c] : plain[3 * i + c];
                for (int j = 0; j < 3; j++) want += (double)t.a[c][j] * e[j];
                NEAR(got, 255 * fmin(fmax(want, 0), 1), 0.51);
            }
            if (k == 4) assert_true(rgb[3 * i] == rgb[3 * i + 1] && rgb[3 * i] == rgb[3 * i + 2]);
            if (k) differ += memcmp(rgb + 3 * i, plain + 3 * i, 3) != 0;
        }
        if (k) assert_true(differ > W * H / 2);
        /* greys: warm ones are redder than blue, cool ones bluer than red */
        double grey[3];
        for (int c = 0; c < 3; c++) grey[c] = (double)(0.5f * (t.a[c][0] + t.a[c][1] + t.a[c][2]) + t.b[c]);
        if (k == 1) assert_true(grey[0] > grey[2] + 0.03);
        if (k == 2) assert_true(grey[2] > grey[0] + 0.03);
        if (k == 0 || k >= 3) NEAR(grey[0], 0.5, 0.06);
    }
    ok(orl_tone_find("neutral", &first));
    put_text(at("t.txt"), "# rows of A and b\n1 0 0 0.25\n0, 1, 0, -.5 # green\n1e-1 0 .9 0");
    ok(orl_tone_find(at("t.txt"), &t));
    assert_true(t.a[0][0] == 1 && t.b[0] == 0.25f && t.a[1][1] == 1 && t.b[1] == -0.5f && t.a[2][0] == 0.1f && t.a[2][2] == 0.9f && t.b[2] == 0);
    static const struct { const char *text, *says; } BAD[] = {
        { "", "0 numbers" }, { "1 2 3 4 5 6 7 8 9 10 11", "11 numbers" }, { "1 2 3 4 5 6 7 8 9 10 11 12 13", "more than 12" }, { "1 2 x 4", "number 3, 'x'" }, { "1 nan", "number 2" },
        { "1 2 3 17", "number 4" }, { "inf", "number 1" }, { "1 2 3 4 5 6 7 8 9 10 11 #12", "11 numbers" },
    };
    t = first;
    for (size_t k = 0; k < sizeof BAD / sizeof *BAD; k++) {
        put_text(at("bad.txt"), BAD[k].text);
        failed(orl_tone_find(at("bad.txt"), &t), ORL_E_FORMAT, at("bad.txt"), BAD[k].says, NULL);
    }
    put_bytes(at("bad.txt"), "1 2\0 3", 6);
    failed(orl_tone_find(at("bad.txt"), &t), ORL_E_FORMAT, at("bad.txt"), "text", NULL);
    failed(orl_tone_find("sepia", &t), ORL_E_IO, "sepia", "neutral, warm", NULL);
    failed(orl_tone_find(scratch, &t), ORL_E_IO, scratch, NULL);
    assert_memory_equal(&t, &first, sizeof t);
    free(linear);
    stage_free(&s);
}

static void day(void **state)
{
    (void)state;
    orl_panorama *p = calloc(1, sizeof *p);
    float rise;
    p->el = (float)(50 * RAD);
    p->has_sun = 1;
    for (int k = 0; k < 3; k++) p->rgb[k] = 3;
    static const struct { double lat; int day; double hours, noon; } CASE[] = {     /* hours of sun, elevation at noon; geometric, without refraction */
        { 0, 81, 12, 90 }, { 52, 81, 12, 38 }, { -35, 81, 12, 55 }, { 41.9, 172, 15.04, 71.55 }, { 41.9, 355, 8.96, 24.65 }, { -41.9, 355, 15.04, 71.55 }, { 70, 172, 24, 43.45 },
    };
    for (size_t k = 0; k < sizeof CASE / sizeof *CASE; k++) {
        orl_day d = { CASE[k].lat, CASE[k].day, 0.3f };
        ok(orl_day_rise(&d, &rise));
        NEAR((double)rise * -24 / M_PI, CASE[k].hours, 0.05);
        orl_sun noon = orl_day_sun(&d, 0, p), dawn = orl_day_sun(&d, rise, p), dusk = orl_day_sun(&d, -rise, p), earlier = dawn;
        NEAR((double)noon.el, CASE[k].noon * RAD, 0.1 * RAD);
        if (CASE[k].lat > 30) NEAR(fabs(wrap((double)(noon.az - d.north))), M_PI, 1e-3);      /* in the south */
        if (CASE[k].lat < -30) NEAR(wrap((double)(noon.az - d.north)), 0, 1e-3);
        if (CASE[k].hours < 24) {
            NEAR((double)dawn.el, 0, 1e-3);
            assert_true(sin((double)(dawn.az - d.north)) < -0.5 && sin((double)(dusk.az - d.north)) > 0.5);      /* counter-clockwise from north: east is -90, west 90 */
            NEAR(wrap((double)(dawn.az - d.north)), -wrap((double)(dusk.az - d.north)), 1e-3);
        }
        if (CASE[k].day == 81) NEAR(sin((double)(dawn.az - d.north)), -1, 1e-3);      /* due east at an equinox */
        for (int i = 1; i <= 20; i++) {          /* higher is brighter and less red */
            orl_sun s = orl_day_sun(&d, rise * (float)(1 - i / 20.0), p);
            assert_true(s.moved && s.el > earlier.el && s.rgb[0] > earlier.rgb[0] && s.sky >= earlier.sky);
            assert_true(s.rgb[0] > 1e-6f && s.rgb[2] / s.rgb[0] > earlier.rgb[2] / earlier.rgb[0]);
            if (s.el < p->el) assert_true(s.rgb[1] < p->rgb[1] && s.sky < 1); else assert_true(s.rgb[1] >= p->rgb[1] && s.sky >= 1);
            earlier = s;
        }
    }
    failed(orl_day_rise(&(orl_day){ 80, 355, 0 }, &rise), ORL_E_DEGENERATE, "--day 80,355", NULL);
    failed(orl_day_rise(&(orl_day){ -90, 172, 0 }, &rise), ORL_E_DEGENERATE, "--day", NULL);
    free(p);
}

/* Frames of a day: one hash for any number of threads, and nothing allocated after the first. */
static void frames(void **state)
{
    (void)state;
    enum { FRAMES = 5 };
    stage s;
    static uint8_t rgb[3][FRAMES][W * H * 3];
    float *linear = malloc(W * H * 3 * sizeof *linear), rise;
    orl_day d = { 45, 150, 0 };
    orl_tone t;
    stage_make(&s, 0);
    ok(orl_tone_find("warm", &t));
    ok(orl_day_rise(&d, &rise));
    for (int threads = 1; threads <= 3; threads++) {
        orl_sink *sink;
        long was = 0;
        orl_sun noon = orl_day_sun(&d, 0, s.sky);
        char spec[100];
        snprintf(spec, sizeof spec, "y4m:%s", at("d.y4m"));
        ok(orl_sink_open(spec, W, H, 25, 1, &sink));
        orl_relight_init(&s.view, &s.scene.light, s.sky, &noon, s.r);
        for (int i = 0; i < FRAMES; i++) {
            orl_sun sun = orl_day_sun(&d, rise * (float)(1 - (2 * i + 1.0) / FRAMES), s.sky);
            orl_relight_set(s.r, &sun);
            orl_relight_linear(s.r, threads, linear);
            orl_relight_display(s.r, threads, linear, 1, &t, rgb[threads - 1][i]);
            ok(orl_sink_put(sink, rgb[threads - 1][i], W * 3));
            if (i == 0) was = allocations;
        }
        if (COUNTING) assert_int_equal(allocations, was);
        ok(orl_sink_close(sink, NULL, 0));
        assert_memory_equal(rgb[threads - 1], rgb[0], sizeof rgb[0]);
    }
    for (int i = 1; i < FRAMES; i++) assert_true(memcmp(rgb[0][i], rgb[0][i - 1], sizeof rgb[0][0]) != 0);
    free(linear);
    stage_free(&s);
}

#define TEST(f) cmocka_unit_test_setup_teardown(f, scratch_make, scratch_remove)
int main(void)
{
    const struct CMUnitTest tests[] = {
        TEST(sun_is_found), TEST(map_of_the_sky), TEST(sun_is_seen_where_it_stands), TEST(layers_add_up), TEST(mirrored_sun_changes_sides), TEST(display_tones), TEST(day), TEST(frames),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
