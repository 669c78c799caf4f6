/* Part of `oriel bench`: what every quality setting costs and how far it is from an exact picture, as rows and as a plot. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "oriel/cpu.h"
#include "oriel/plot.h"
#include "runtime/bench.h"
#include "runtime/commands.h"

enum { BAND = 16, HALVES = 2 };         /* rows of the exact picture made at a time; sizes tried, each half as wide as the one before */
static const char EXACT[] = "16 rays a pixel, in float";

/* ---- the exact picture */

/* Four rays in each quarter of a pixel, each quarter traced to the sun and shaded in float, then averaged: nothing else the runtime does is denser. */
static orl_err make_exact(const orl_bench_place *p, uint8_t *rgb)
{
    const int w = p->cam->w;
    size_t need = orl_view_need(2 * w, 2 * BAND);
    void *block = orl_widen_block(need);
    orl_err e = block ? ORL_OK : orl_fail(ORL_E_MEMORY, "no memory for views of %d x %d", 2 * w, 2 * BAND);
    for (int y0 = 0; !e && y0 < p->cam->h; y0 += BAND) {
        orl_camera fine = orl_camera_resized(p->cam, 2 * w, 2 * p->cam->h);
        orl_view v;
        fine.h = 2 * (p->cam->h - y0 < BAND ? p->cam->h - y0 : BAND);
        fine.cy -= 2 * y0;
        if ((e = orl_view_build(p->scene, &fine, p->pose, 2, 0, block, need, &v))) break;
        orl_view_trace_sun(&v, p->light, 0, v.h, orl_cpu_detect(), 0);
        for (int i = 0; i < w * v.h / 2; i++) {
            float sum[3] = { 0 };
            for (int k = 0; k < 4; k++) {
                orl_sample s;
                float c[3];
                orl_view_sample(&v, 2 * (i % w) + (k & 1), 2 * (i / w) + (k >> 1), &s);
                orl_light_shade(p->light, &s, c);
                for (int q = 0; q < 3; q++) sum[q] += 0.25f * c[q];
            }
            uint8_t *to = rgb + 3 * ((size_t)y0 * (size_t)w + (size_t)i);
            for (int q = 0; q < 3; q++) to[q] = (uint8_t)(sum[q] > 0 ? sum[q] < 1 ? sum[q] * 255 + 0.5f : 255 : 0);
        }
    }
    free(block);
    return e;
}

/* ---- one setting */

typedef struct {
    orl_bench *b;
    const orl_camera *cam;              /* at full size */
    const orl_light *light;
    const uint8_t *exact; const char *of;
    void *tables;
    uint8_t *rgb, *full;                /* a picture as rendered; at full size */
} desk;

/* Bilinear, for pictures that were rendered smaller. */
static const uint8_t *at_full_size(const desk *d, int w, int h)
{
    const int W = d->cam->w, H = d->cam->h;
    if (w == W && h == H) return d->rgb;
    for (int y = 0; y < H; y++)
        for (int x = 0; x < W; x++) {
            double u = fmin(fmax((x + 0.5) * w / W - 0.5, 0), w - 1), v = fmin(fmax((y + 0.5) * h / H - 0.5, 0), h - 1);
            int i = u < w - 1 ? (int)u : w > 1 ? w - 2 : 0, j = v < h - 1 ? (int)v : h > 1 ? h - 2 : 0, right = w > 1 ? 3 : 0;
            const uint8_t *a = d->rgb + 3 * ((size_t)j * (size_t)w + (size_t)i), *b = h > 1 ? a + 3 * (size_t)w : a;
            for (int c = 0; c < 3; c++) {
                double top = a[c] + (u - i) * (a[c + right] - a[c]), low = b[c] + (u - i) * (b[c + right] - b[c]);
                d->full[3 * ((size_t)y * (size_t)W + (size_t)x) + (size_t)c] = (uint8_t)(top + (v - j) * (low - top) + 0.5);
            }
        }
    return d->full;
}

static void add_point(orl_bench *b, int series, const char *label, double seconds, double db)
{
    if (b->points == ORL_BENCH_POINTS) return;
    orl_bench_point *p = &b->point[b->points++];
    *p = (orl_bench_point){ .series = series, .ms = 1e3 * seconds, .db = db };
    snprintf(p->label, sizeof p->label, "%s", label);
}

/* A view as it is, under the light, in float and by every kernel; blend with photo: or NULL. once: seconds a pose, 0: baked. */
static void measure(const desk *d, const char *name, const orl_view *v, double once, orl_blend *blend, const uint8_t *photo)
{
    size_t n = 3 * (size_t)d->cam->w * (size_t)d->cam->h;
    double least = INFINITY, db = NAN;
    char label[64];
    snprintf(label, sizeof label, "setting: %s", name);
    for (int k = -1; k < ORL_BENCH_VARIANTS; k++) {
        unsigned cpu = ORL_CPU_REF;
        double best = INFINITY, spent = 0;
        if (k < 0 ? blend != NULL : orl_cpu_from_name(orl_bench_variant[k], &cpu) != ORL_OK) continue;
        for (int i = 0; i < ORL_BENCH_RUNS && (i < 2 || spent < 0.25); i++) {
            double a = orl_seconds();
            if (k < 0) orl_bench_float(v, d->light, d->rgb);
            else orl_view_shade(v, orl_view_light_make(v, d->light, d->tables, orl_view_light_need()), cpu, 0, v->h, d->rgb, 3 * (size_t)v->w);
            if (blend) orl_blend_apply(blend, photo, d->rgb, cpu, 1);
            a = orl_seconds() - a;
            best = fmin(best, a);
            spent += a;
        }
        db = orl_bench_psnr(at_full_size(d, v->w, v->h), d->exact, n);
        orl_bench_row r = { ORL_BENCH_ROW, .name = label, .variant = k < 0 ? "float" : orl_bench_variant[k], .seconds = best };
        r.error_db = db;
        r.error_of = d->of;
        if (once > 0) r.once = once;
        orl_bench_put(d->b, &r);
        add_point(d->b, k < 0 ? ORL_BENCH_FLOAT : k, name, best, db);
        if (k >= 0) least = fmin(least, best);
    }
    if (once > 0) add_point(d->b, ORL_BENCH_POSE, name, once + least, db);
}

/* Rays and sun at one size; the view is left traced. */
static orl_err measure_rays(const desk *d, const orl_bench_place *p, int half, int ss, int only_traced, void *block, size_t need, orl_view *v)
{
    static const char *const RAYS[] = { "1 ray", "4 rays", "corners" }, *const SIZE[HALVES + 1] = { "", ", half size", ", quarter size" };
    orl_camera cam = half ? orl_camera_resized(p->cam, (p->cam->w >> half) + !(p->cam->w >> half), (p->cam->h >> half) + !(p->cam->h >> half)) : *p->cam;
    char name[48];
    double a = orl_seconds();
    orl_err e = orl_view_build(p->scene, &cam, p->pose, ss, 1, block, need, v);
    if (e) return e;
    double built = orl_seconds() - a;
    snprintf(name, sizeof name, "%s%s, horizons", RAYS[ss - 1], SIZE[half]);
    if (!only_traced) measure(d, name, v, built, NULL, NULL);
    a = orl_seconds();
    orl_view_trace_sun(v, p->light, 0, v->h, orl_cpu_detect(), 1);
    built += orl_seconds() - a;
    snprintf(name, sizeof name, "%s%s, traced", RAYS[ss - 1], SIZE[half]);
    measure(d, name, v, built, NULL, NULL);
    if (half || ss != ORL_RAYS_FOUR) return ORL_OK;
    orl_view plain = *v;
    memset(plain.phi_scale, 0, sizeof plain.phi_scale);
    if (memcmp(plain.phi_scale, v->phi_scale, sizeof plain.phi_scale)) measure(d, "4 rays, traced, no shadow features", &plain, built, NULL, NULL);
    return ORL_OK;
}

/* The view with a photo laid in that the float model took: what blending changes where nothing is to be mended. */
static orl_err measure_blend(const desk *d, const orl_bench_place *p, const orl_view *wide)
{
    size_t need = orl_view_need(p->photo_cam->w, p->photo_cam->h), blend_need = orl_blend_need(wide->w, wide->h);
    void *block = orl_widen_block(need), *blend_block = orl_widen_block(blend_need);
    uint8_t *photo = malloc(3 * (size_t)p->photo_cam->w * (size_t)p->photo_cam->h);
    orl_blend *blend = NULL;
    orl_view v;
    orl_err e = block && blend_block && photo ? orl_view_build(p->scene, p->photo_cam, p->photo_pose, 2, 0, block, need, &v) : orl_fail(ORL_E_MEMORY, "no memory for a photo of %d x %d", p->photo_cam->w, p->photo_cam->h);
    if (!e) {
        orl_view_trace_sun(&v, p->light, 0, v.h, orl_cpu_detect(), 0);
        orl_bench_float(&v, p->light, photo);
        e = orl_blend_init(p->photo_cam, p->photo_pose, p->cam, p->pose, NULL, 1, blend_block, blend_need, &blend);
        if (!e) orl_blend_layers(blend, wide->cov, (size_t)wide->stride);
    }
    if (!e) measure(d, "4 rays, traced, blended", wide, 0, blend, photo);
    free(block);
    free(blend_block);
    free(photo);
    return e;
}

static orl_err open_desk(desk *d)
{
    size_t n = 3 * (size_t)d->cam->w * (size_t)d->cam->h;
    d->tables = orl_widen_block(orl_view_light_need());
    d->rgb = malloc(n);
    d->full = malloc(n);
    return d->tables && d->rgb && d->full ? ORL_OK : orl_fail(ORL_E_MEMORY, "no memory for pictures of %d x %d", d->cam->w, d->cam->h);
}

static void close_desk(desk *d) { free(d->tables); free(d->rgb); free(d->full); }

static void measure_baked(const desk *d, const orl_view *v)
{
    orl_view as_baked = *v;
    orl_view_trace_sun(&as_baked, d->light, 0, v->h, orl_cpu_detect(), 1);         /* for the float path, which does not know ceilings */
    measure(d, "4 rays, baked", &as_baked, 0, NULL, NULL);
}

orl_err orl_bench_settings(orl_bench *b, const orl_bench_place *p)
{
    desk d = { .b = b, .cam = p->cam, .light = p->light, .exact = p->exact, .of = p->exact ? p->exact_name : EXACT };
    size_t need = orl_view_need(p->cam->w, p->cam->h);
    void *block = orl_widen_block(need);
    uint8_t *made = NULL;
    orl_view v;
    orl_err e = open_desk(&d);
    if (!e && !block) e = orl_fail(ORL_E_MEMORY, "no memory for a view of %d x %d", p->cam->w, p->cam->h);
    if (!e && !p->exact) {
        made = malloc(3 * (size_t)p->cam->w * (size_t)p->cam->h);
        e = made ? make_exact(p, made) : orl_fail(ORL_E_MEMORY, "no memory for a picture of %d x %d", p->cam->w, p->cam->h);
        d.exact = made;
    }
    for (int half = HALVES; !e && half >= 0; half--)
        for (int k = 0; !e && k < 3; k++) {         /* last the best, which is blended */
            static const int RAYS[] = { ORL_RAYS_MIDDLE, ORL_RAYS_CORNERS, ORL_RAYS_FOUR };
            if (!half || RAYS[k] != ORL_RAYS_CORNERS) e = measure_rays(&d, p, half, RAYS[k], half > 0, block, need, &v);
        }
    if (!e) e = measure_blend(&d, p, &v);
    if (!e && p->baked) measure_baked(&d, p->baked);
    free(block);
    free(made);
    close_desk(&d);
    return e;
}

orl_err orl_bench_baked(orl_bench *b, const orl_view *v, const orl_light *l, const uint8_t *exact, const char *exact_name)
{
    desk d = { .b = b, .cam = &v->cam, .light = l, .exact = exact, .of = exact ? exact_name : "its own pixels in float" };
    orl_view as_baked = *v;
    uint8_t *own = malloc(3 * (size_t)v->w * (size_t)v->h);
    orl_err e = open_desk(&d);
    if (!e && !own) e = orl_fail(ORL_E_MEMORY, "no memory for a picture of %d x %d", v->w, v->h);
    if (!e) {
        orl_view_trace_sun(&as_baked, l, 0, v->h, orl_cpu_detect(), 1);
        orl_bench_float(&as_baked, l, own);
        if (!exact) d.exact = own;
        measure_baked(&d, v);
    }
    free(own);
    close_desk(&d);
    return e;
}

/* ---- the plot */

orl_err orl_bench_plot(const orl_bench *b, const char *path, const char *title)
{
    static const char *const OTHER[] = { "float, a picture", "a new pose: view, sun, picture" };
    double x[ORL_BENCH_SERIES][ORL_BENCH_POINTS], y[ORL_BENCH_SERIES][ORL_BENCH_POINTS];
    const char *label[ORL_BENCH_SERIES][ORL_BENCH_POINTS];
    const char *const *labels[ORL_BENCH_SERIES] = { NULL };
    char name[ORL_BENCH_SERIES][48], head[160];
    orl_plot_series series[ORL_BENCH_SERIES];
    orl_text svg = { 0 };
    int n = 0, best = -1;
    for (int s = 0; s < ORL_BENCH_SERIES; s++) {
        int m = 0;
        for (int i = 0; i < b->points; i++) {
            if (b->point[i].series != s) continue;
            x[n][m] = b->point[i].ms;
            y[n][m] = b->point[i].db;
            label[n][m++] = b->point[i].label;
        }
        if (!m) continue;
        snprintf(name[n], sizeof name[n], s < ORL_BENCH_VARIANTS ? "kernels %s, a picture" : "%s", s < ORL_BENCH_VARIANTS ? orl_bench_variant[s] : OTHER[s - ORL_BENCH_VARIANTS]);
        series[n] = (orl_plot_series){ name[n], x[n], y[n], m };
        if (s < ORL_BENCH_VARIANTS) best = n;           /* the last is the fastest; the others' points stand at the same height */
        if (s == ORL_BENCH_POSE) labels[n] = label[n];
        n++;
    }
    if (best >= 0) labels[best] = label[best];
    snprintf(head, sizeof head, "%s: error over time of every setting, one thread", title);
    orl_plot_svg(&svg, series, n, &(orl_plot_style){ .title = head, .x_label = "milliseconds", .y_label = "PSNR from the reference, dB", .log_x = 1, .dots = 1, .no_lines = 1, .key_above = 1, .labels = labels, .w = 900, .h = 520 });
    orl_err e = orl_text_write(&svg, path);
    orl_text_free(&svg);
    return e;
}
