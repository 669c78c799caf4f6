/* `oriel bench`: run time beside error and beside memcpy of the same bytes, on a scene's own views and clip. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include "oriel/cpu.h"
#include "oriel/light.h"
#include "oriel/source.h"
#include "runtime/baked.h"
#include "runtime/commands.h"
#include "runtime/kernels/shade.h"
#include "oriel/widen.h"

static const char HELP[] =
    "Usage: oriel bench (--scene FILE --pose FILE | --view FILE | --convert | --mlp) [OPTION]...\n"
    "Run time against error: views, kernels beside memcpy of the bytes that they move, and the stages of a camera loop. One thread; best of several runs; ratios are taken in one run.\n\n"
    "  --scene FILE     scene file made by oriel-train\n"
    "  --pose FILE      the camera; a second line, where there is one, is the wide view\n"
    "  --view FILE      instead of both: baked views; nothing is marched\n"
    "  --convert        alone: conversion of every camera format to RGB, on made-up pictures\n"
    "  --mlp            alone: the int8 network beside the machine's peak and, where it is built in, XNNPACK\n"
    "  --source SOURCE  as of run: also the stages of `oriel run` on these pictures\n"
    "  --frames N       of them; all\n"
    "  --widen F        field of view, times the camera's; 1.8 if the pose file has no second line\n"
    "  --size WxH       size of the wide picture\n"
    "  --json           one object a row\n"
    "  --help           this text\n\n"
    "Columns: milliseconds; times memcpy of as many bytes, reads and writes counted on both sides; dB against the float model on the same view.\n";

enum { RUNS = 9 };
static const char *const VARIANT[] = {
#define NAME(n) #n,
    ORL_KERNEL_VARIANTS(NAME)
#undef NAME
};
enum { VARIANTS = sizeof VARIANT / sizeof *VARIANT };

typedef struct {
    const char *scene, *baked, *source;
    orl_view_request view;
    int frames, json, convert, mlp;
} options;

/* ---- rows */

/* NAN, 0: the row has none. */
typedef struct { const char *name, *variant; double seconds, error_db; size_t bytes; } row;

/* Seconds of a memcpy that reads and writes `bytes` in all, the best of a few. NAN without memory. */
static double copy_seconds(size_t bytes)
{
    size_t n = bytes / 2;
    uint8_t *a = malloc(n + 1), *b = malloc(n + 1);
    double best = NAN;
    for (int i = 0; a && b && i < RUNS; i++) {
        memset(a, i, n);
        double t = orl_seconds();
        memcpy(b, a, n);
        __asm__ volatile("" : : "r"(b) : "memory");
        t = orl_seconds() - t;
        best = t < best || isnan(best) ? t : best;
    }
    free(a);
    free(b);
    return best;
}

static void say(const options *o, const row *r)
{
    double ratio = r->bytes ? r->seconds / copy_seconds(r->bytes) : NAN;
    if (o->json) {
        printf("{\"name\": \"%s%s%s\", \"seconds\": %.6g", r->name, r->variant ? " " : "", r->variant ? r->variant : "", r->seconds);
        if (r->bytes) printf(", \"bytes\": %zu", r->bytes);
        if (isfinite(ratio)) printf(", \"ratio\": %.3g, \"against\": \"memcpy\"", ratio);
        if (isfinite(r->error_db)) printf(", \"error_db\": %.2f", r->error_db);
        printf("}\n");
    } else {
        printf("%-28s %-8s %10.3f ms", r->name, r->variant ? r->variant : "", 1e3 * r->seconds);
        if (isfinite(ratio)) printf("  %7.2f x memcpy of %.1f MB", ratio, (double)r->bytes * 1e-6);
        if (isfinite(r->error_db)) printf("  %6.2f dB", r->error_db);
        printf("\n");
    }
    fflush(stdout);
}

static void say_convert(void *o, const char *name, const char *variant, double seconds, size_t bytes) { say(o, &(row){ name, variant, seconds, NAN, bytes }); }

/* ---- kernels on a view */

/* The float model on the view's own pixels, in 8 bits as the kernels write them. */
static void reference(const orl_view *v, const orl_light *l, uint8_t *rgb)
{
    for (int i = 0; i < v->w * v->h; i++) {
        orl_sample s;
        float c[3];
        orl_view_sample(v, i % v->w, i / v->w, &s);
        orl_light_shade(l, &s, c);
        for (int k = 0; k < 3; k++) rgb[3 * i + k] = (uint8_t)(c[k] > 0 ? c[k] < 1 ? c[k] * 255 + 0.5f : 255 : 0);
    }
}

static double psnr(const uint8_t *a, const uint8_t *b, size_t n)
{
    double sum = 0;
    for (size_t i = 0; i < n; i++) sum += (double)(a[i] - b[i]) * (a[i] - b[i]);
    return sum > 0 ? 10 * log10(255.0 * 255 * (double)n / sum) : 99;
}

/* Pixels in runs that have a surface: of the others' planes only coverage is read. */
static size_t surfaces(const orl_view *v)
{
    size_t n = 0;
    for (size_t i = 0; i < (size_t)v->stride * (size_t)v->h; i += ORL_KERNEL_STEP) {
        int any = 0;
        for (size_t k = 0; k < ORL_KERNEL_STEP; k++) any |= v->cov[i + k];
        n += any ? ORL_KERNEL_STEP : 0;
    }
    return n;
}

static orl_err kernels(const options *o, orl_view *v, const orl_light *l, orl_blend *blend, const uint8_t *photo, size_t photo_bytes)
{
    size_t n = (size_t)v->w * (size_t)v->h, padded = (size_t)v->stride * (size_t)v->h;
    void *block = orl_widen_block(orl_view_light_need());
    uint8_t *rgb = malloc(3 * n), *want = malloc(3 * n);
    orl_view_light *t = NULL;
    double tables = INFINITY;
    orl_err e = block && rgb && want ? ORL_OK : orl_fail(ORL_E_MEMORY, "no memory for pictures of %d x %d", v->w, v->h);
    for (int i = 0; !e && i < RUNS; i++) {
        double a = orl_seconds();
        t = orl_view_light_make(v, l, block, orl_view_light_need());
        tables = fmin(tables, orl_seconds() - a);
    }
    if (!e) {
        double a = orl_seconds();
        orl_view_trace_sun(v, l, 0, v->h, orl_cpu_detect(), 1);         /* of a baked view: for the reference */
        double sun = orl_seconds() - a;
        say(o, &(row){ "tables of a light", NULL, tables, NAN, 0 });
        if (!v->ceiling) say(o, &(row){ "sun, traced", NULL, sun, NAN, 0 });
        reference(v, l, want);
    }
    for (int k = 0; !e && k < VARIANTS; k++) {
        unsigned cpu;
        double shade = INFINITY, laid = INFINITY;
        if (orl_cpu_from_name(VARIANT[k], &cpu)) continue;
        for (int i = 0; i < RUNS; i++) {
            double a = orl_seconds();
            orl_view_shade(v, t, cpu, 0, v->h, rgb, 3 * (size_t)v->w);
            shade = fmin(shade, orl_seconds() - a);
        }
        double error_db = psnr(rgb, want, 3 * n);
        for (int i = 0; i < RUNS; i++) {
            double a = orl_seconds();
            orl_blend_apply(blend, photo, rgb, cpu, 1);
            laid = fmin(laid, orl_seconds() - a);
        }
        say(o, &(row){ "sun, shade, tone", VARIANT[k], shade, error_db, surfaces(v) * (3 + 3 + 1 + (v->ceiling ? 4 : 3) + ORL_SHADOW_DIM) + padded + 3 * n });
        say(o, &(row){ "blend", VARIANT[k], laid, NAN, photo_bytes + n * (3 + 3 + 2) });
    }
    free(block);
    free(rgb);
    free(want);
    return e;
}

/* ---- views */

static orl_err march(const options *o, const orl_scene *s, const orl_view_pose *to)
{
    size_t need = orl_view_need(to->cam.w, to->cam.h);
    void *block = orl_widen_block(need);
    orl_err e = block ? ORL_OK : orl_fail(ORL_E_MEMORY, "no memory for a view of %d x %d", to->cam.w, to->cam.h);
    for (int ss = 1; !e && ss <= 2; ss++) {
        orl_view v;
        double a = orl_seconds();
        e = orl_view_build(s, &to->cam, &to->pose, ss, 1, block, need, &v);
        if (!e) say(o, &(row){ ss == 1 ? "view, 1 ray a pixel" : "view, 4 rays a pixel", NULL, orl_seconds() - a, NAN, 0 });
    }
    free(block);
    return e;
}

/* ---- the camera loop */

enum { CONVERT, COLD, WARM, RENDER, STAGES };

static orl_err loop(const options *o, orl_widen *w, orl_source *source)
{
    double sum[STAGES] = { 0 }, most = 0;
    size_t bytes = (size_t)source->info.w * (size_t)source->info.h * 3;
    uint8_t *photo = malloc(bytes), *wide = malloc((size_t)w->wide.w * (size_t)w->wide.h * 3);
    orl_frame f;
    int n = 0, got;
    orl_err e = photo && wide ? ORL_OK : orl_fail(ORL_E_MEMORY, "no memory for pictures");
    while (!e && (!o->frames || n < o->frames) && (got = orl_source_next(source, &f))) {
        if (got < 0) continue;
        double t[4];
        t[0] = orl_seconds();
        orl_frame_to_rgb(&source->info, &f, w->config.cpu, 0, source->info.h, photo, (size_t)source->info.w * 3);
        t[1] = orl_seconds();
        e = orl_widen_adapt(w, photo);
        t[2] = orl_seconds();
        if (!e) e = orl_widen_render(w, photo, wide);
        t[3] = orl_seconds();
        sum[CONVERT] += t[1] - t[0];
        sum[n ? WARM : COLD] += t[2] - t[1];
        if (n) most = fmax(most, t[2] - t[1]);
        sum[RENDER] += t[3] - t[2];
        n++;
    }
    free(photo);
    free(wide);
    if (!e && n < 2) e = orl_fail(ORL_E_FORMAT, "%s: two pictures are wanted", o->source);
    if (e) return e;
    say(o, &(row){ "picture: convert", NULL, sum[CONVERT] / n, NAN, 0 });
    say(o, &(row){ "light: first picture", NULL, sum[COLD], NAN, 0 });
    say(o, &(row){ "light: from the last one's", NULL, sum[WARM] / (n - 1), NAN, 0 });
    say(o, &(row){ "light: the slowest of these", NULL, most, NAN, 0 });
    say(o, &(row){ "render: shade, tone, blend", NULL, sum[RENDER] / n, NAN, 0 });
    say(o, &(row){ "a picture in all", NULL, (sum[CONVERT] + sum[RENDER]) / n + sum[WARM] / (n - 1), NAN, 0 });
    return ORL_OK;
}

static orl_err bench(const options *o)
{
    orl_scene scene = { 0 };
    orl_baked baked = { 0 };
    orl_source *source = NULL;
    orl_view_pose from, to;
    orl_widen w;
    orl_light *light = malloc(sizeof *light);
    void *block = NULL;
    size_t need = 0;
    orl_err e = !light ? orl_fail(ORL_E_MEMORY, "no memory") : o->baked ? orl_baked_open(o->baked, &baked) : orl_place_open(o->scene, &scene);
    if (!e && o->source) e = orl_source_open(o->source, &source);
    int width = source ? source->info.w : 0, height = source ? source->info.h : 0;
    if (!e) e = o->baked ? orl_baked_cameras(&baked, o->source, width, height, &from, &to) : orl_views_find(&o->view, o->source ? o->source : o->view.pose, width, height, &from, &to);
    if (!e && !o->baked) e = march(o, &scene, &to);
    if (!e) {
        orl_widen_config c = { .scene = o->baked ? &baked.scene : &scene, .baked = o->baked ? baked.view : NULL, .photo = from.cam, .wide = to.cam, .photo_pose = from.pose, .wide_pose = to.pose,
                               .blend = 1, .threads = 1, .cpu = orl_cpu_detect() };
        need = orl_widen_need(&c);
        block = orl_widen_block(need);
        e = block ? orl_widen_init(&c, block, need, &w) : orl_fail(ORL_E_MEMORY, "no memory for a view of %d x %d", to.cam.w, to.cam.h);
    }
    if (!e) {
        orl_light_decode(&w.config.scene->light, w.config.scene->ncodes ? w.config.scene->codes : w.config.scene->light.prior_mean, light);
        uint8_t *photo = calloc((size_t)from.cam.w * (size_t)from.cam.h, 3);
        e = photo ? kernels(o, &w.wide, light, w.blend, photo, 3 * (size_t)from.cam.w * (size_t)from.cam.h) : orl_fail(ORL_E_MEMORY, "no memory");
        free(photo);
    }
    if (!e && source) e = loop(o, &w, source);
    if (!e) {
        struct rusage u;
        getrusage(RUSAGE_SELF, &u);
        size_t peak = 1024 * (size_t)u.ru_maxrss, mapped = o->baked ? baked.scene.map_bytes : scene.map_bytes;
        if (o->json) printf("{\"name\": \"memory\", \"bytes\": %zu, \"file_bytes\": %zu, \"peak_bytes\": %zu, \"pixels\": %d}\n", need, mapped, peak, to.cam.w * to.cam.h);
        else printf("memory: %.1f MB for views of %d x %d and light, beside a file of %.1f MB; %.1f MB at the most\n", (double)need * 1e-6, to.cam.w, to.cam.h, (double)mapped * 1e-6, (double)peak * 1e-6);
    }
    orl_source_close(source);
    free(block);
    free(light);
    orl_scene_close(&scene);
    orl_baked_close(&baked);
    return e;
}

static int parse(int argc, char **argv, options *o)
{
    static const struct option TABLE[] = {
        { "scene", required_argument, NULL, 's' }, { "pose", required_argument, NULL, 'p' }, { "view", required_argument, NULL, 'v' }, { "source", required_argument, NULL, 'S' },
        { "frames", required_argument, NULL, 'n' }, { "widen", required_argument, NULL, 'w' }, { "size", required_argument, NULL, 'z' }, { "json", no_argument, NULL, 'j' },
        { "convert", no_argument, NULL, 'k' }, { "mlp", no_argument, NULL, 'm' }, { "help", no_argument, NULL, 'h' }, { 0 } };
    int first = 1;
    orl_err e = ORL_OK;
    for (int c; !e && (c = orl_option_next(argc, argv, TABLE, &first)) != -1; ) {
        if (orl_option_view(c, &o->view, &e)) continue;
        switch (c) {
        case 's': o->scene = optarg; break;
        case 'v': o->baked = optarg; break;
        case 'S': o->source = optarg; break;
        case 'n': e = orl_option_int("--frames", optarg, 2, 1 << 30, &o->frames); break;
        case 'm': o->mlp = 1; break;
        case 'j': o->json = 1; break;
        case 'k': o->convert = 1; break;
        case 'h': printf("%s", HELP); return -1;
        default:
            if (c == 'o') orl_fail(ORL_E_RANGE, "unknown option -o");
            return ORL_EXIT_USAGE;
        }
    }
    if (e) return ORL_EXIT_USAGE;
    const int place = o->baked || o->scene || o->view.pose || o->source, alone = o->convert + o->mlp;
    if (argc != optind || (alone ? place || alone > 1 : o->baked ? o->scene || o->view.pose || o->view.w || o->view.widen > 0 : !o->scene || !o->view.pose)) {
        orl_fail(ORL_E_RANGE, "wanted are --view, or both --scene and --pose, or --convert or --mlp alone");
        return ORL_EXIT_USAGE;
    }
    return ORL_EXIT_DONE;
}

int orl_cmd_bench(int argc, char **argv)
{
    options o = { .view.otherwise = 1.8 };
    int code = parse(argc, argv, &o);
    if (code) return code < 0 ? ORL_EXIT_DONE : code;
    return (o.mlp ? orl_bench_mlp(o.json) : o.convert ? orl_bench_convert(say_convert, &o) : bench(&o)) ? ORL_EXIT_FAILED : ORL_EXIT_DONE;
}
