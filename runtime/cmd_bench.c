/* `oriel bench`: run time beside error and beside memcpy of the same bytes, on a scene's own views and clip. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include "oriel/cpu.h"
#include "oriel/light.h"
#include "oriel/parallel.h"
#include "oriel/source.h"
#include "runtime/baked.h"
#include "runtime/bench.h"
#include "runtime/commands.h"

static const char HELP[] =
    "Usage: oriel bench (--scene FILE --pose FILE | --view FILE | all three | --convert | --mlp) [OPTION]...\n"
    "Run time against error: quality settings, kernels beside memcpy of the bytes that they move, what is skipped, and the stages of a new pose and of a camera loop.\n"
    "One thread, a new pose also on all cores; best of several runs; ratios are taken in one run.\n\n"
    "  --scene FILE     scene file made by oriel-train\n"
    "  --pose FILE      the camera; a second line, where there is one, is the wide view\n"
    "  --view FILE      instead of both, or beside them: baked views of that camera\n"
    "  --reference FILE picture that settings are compared with, PNG or linear EXR (oriel-train bench --scene makes\n"
    "                   it from the float model); otherwise 16 rays a pixel in float, of a baked view alone its own\n"
    "                   pixels in float\n"
    "  --light N        light of the Nth training photo; 0\n"
    "  --svg FILE       settings as a plot, error over time\n"
    "  --convert        alone: conversion of every camera format to RGB, on made-up pictures\n"
    "  --mlp            alone: the int8 network beside the machine's peak and, where it is built in, XNNPACK\n"
    "  --source SOURCE  as of run: also the stages of a new pose's first picture and of `oriel run` on these pictures\n"
    "  --frames N       of them; all\n"
    "  --widen F        field of view, times the camera's; 1.8 if the pose file has no second line\n"
    "  --size WxH       size of the wide picture\n"
    "  --json           one object a row\n"
    "  --help           this text\n\n"
    "Columns: milliseconds; times memcpy of as many bytes, reads and writes counted on both sides; dB against the float model on the same view, or what the row says.\n";

const char *const orl_bench_variant[ORL_BENCH_VARIANTS] = {
#define NAME(n) #n,
    ORL_KERNEL_VARIANTS(NAME)
#undef NAME
};
enum { RUNS = ORL_BENCH_RUNS };

typedef struct {
    const char *scene, *baked, *source, *reference, *svg;
    orl_view_request view;
    int frames, light, convert, mlp;
    orl_bench bench;
} options;

/* ---- rows */

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

void orl_bench_put(const orl_bench *b, const orl_bench_row *r)
{
    const double ratio = r->bytes ? r->seconds / copy_seconds(r->bytes) : NAN, saved = 1 - r->seconds / r->without;
    if (b->json) {
        printf("{\"name\": \"%s%s%s\", \"seconds\": %.6g", r->name, r->variant ? " " : "", r->variant ? r->variant : "", r->seconds);
        if (isfinite(r->once)) printf(", \"once_seconds\": %.6g", r->once);
        if (isfinite(r->without)) printf(", \"without_seconds\": %.6g, \"saved\": %.3f", r->without, saved);
        if (isfinite(r->change_db)) printf(", \"identical\": false, \"change_db\": %.2f", r->change_db);
        else if (!isnan(r->change_db)) printf(", \"identical\": true");
        if (r->bytes) printf(", \"bytes\": %zu", r->bytes);
        if (isfinite(ratio)) printf(", \"ratio\": %.3g, \"against\": \"memcpy\"", ratio);
        if (!isnan(r->error_db)) printf(", \"error_db\": %.2f", fmin(r->error_db, ORL_BENCH_SAME_DB));
        if (r->error_of) {
            printf(", \"error_of\": ");
            orl_json_string(r->error_of);
        }
        printf("}\n");
    } else {
        printf("%-44s %-8s %10.3f ms", r->name, r->variant ? r->variant : "", 1e3 * r->seconds);
        if (isfinite(r->once)) printf(", %9.3f once", 1e3 * r->once);
        if (isfinite(r->without)) printf(", %9.3f without: %.3f saved, %.0f %%", 1e3 * r->without, 1e3 * (r->without - r->seconds), 100 * saved);
        if (isfinite(r->change_db)) printf("; %.2f dB from it", r->change_db);
        else if (!isnan(r->change_db)) printf("; the same picture");
        if (isfinite(ratio)) printf("  %7.2f x memcpy of %.1f MB", ratio, (double)r->bytes * 1e-6);
        if (!isnan(r->error_db)) printf("  %6.2f dB", fmin(r->error_db, ORL_BENCH_SAME_DB));
        if (r->error_of) printf(" from %s", r->error_of);
        printf("\n");
    }
    fflush(stdout);
}

static void say(const options *o, const char *name, double seconds) { orl_bench_put(&o->bench, &(orl_bench_row){ ORL_BENCH_ROW, .name = name, .seconds = seconds }); }
static void say_convert(void *o, const char *name, const char *variant, double seconds, size_t bytes)
{
    orl_bench_put(&((options *)o)->bench, &(orl_bench_row){ ORL_BENCH_ROW, .name = name, .variant = variant, .seconds = seconds, .bytes = bytes });
}

/* ---- kernels on a view */

void orl_bench_float(const orl_view *v, const orl_light *l, uint8_t *rgb)
{
    for (int i = 0; i < v->w * v->h; i++) {
        orl_sample s;
        float c[3];
        orl_view_sample(v, i % v->w, i / v->w, &s);
        orl_light_shade(l, &s, c);
        for (int k = 0; k < 3; k++) rgb[3 * i + k] = (uint8_t)(c[k] > 0 ? c[k] < 1 ? c[k] * 255 + 0.5f : 255 : 0);
    }
}

double orl_bench_psnr(const uint8_t *a, const uint8_t *b, size_t n)
{
    double sum = 0;
    for (size_t i = 0; i < n; i++) sum += (double)(a[i] - b[i]) * (a[i] - b[i]);
    return sum > 0 ? 10 * log10(255.0 * 255 * (double)n / sum) : INFINITY;
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
        say(o, "tables of a light", tables);
        if (!v->ceiling) say(o, "sun, traced", sun);
        orl_bench_float(v, l, want);
    }
    for (int k = 0; !e && k < ORL_BENCH_VARIANTS; k++) {
        unsigned cpu;
        double shade = INFINITY, laid = INFINITY;
        if (orl_cpu_from_name(orl_bench_variant[k], &cpu)) continue;
        for (int i = 0; i < RUNS; i++) {
            double a = orl_seconds();
            orl_view_shade(v, t, cpu, 0, v->h, rgb, 3 * (size_t)v->w);
            shade = fmin(shade, orl_seconds() - a);
        }
        double error_db = orl_bench_psnr(rgb, want, 3 * n);
        for (int i = 0; i < RUNS; i++) {
            double a = orl_seconds();
            orl_blend_apply(blend, photo, rgb, cpu, 1);
            laid = fmin(laid, orl_seconds() - a);
        }
        orl_bench_row r = { ORL_BENCH_ROW, .name = "sun, shade, tone", .variant = orl_bench_variant[k], .seconds = shade, .bytes = surfaces(v) * (3 + 3 + 1 + (v->ceiling ? 4 : 3) + ORL_SHADOW_DIM) + padded + 3 * n };
        r.error_db = error_db;
        orl_bench_put(&o->bench, &r);
        orl_bench_put(&o->bench, &(orl_bench_row){ ORL_BENCH_ROW, .name = "blend", .variant = orl_bench_variant[k], .seconds = laid, .bytes = photo_bytes + n * (3 + 3 + 2) });
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
    static const char *const NAME[] = { "view, 1 ray a pixel", "view, 4 rays a pixel", "view, rays through corners" };
    for (int ss = ORL_RAYS_MIDDLE; !e && ss <= ORL_RAYS_CORNERS; ss++) {
        orl_view v;
        double a = orl_seconds();
        e = orl_view_build(s, &to->cam, &to->pose, ss, 1, block, need, &v);
        if (!e) say(o, NAME[ss - 1], orl_seconds() - a);
    }
    free(block);
    return e;
}

/* A pose never seen, from the first picture of a clip. */
static orl_err new_pose(const options *o, const orl_scene *s, const orl_view_pose *from, const orl_view_pose *to)
{
    orl_source *source;
    orl_frame f;
    orl_err e = orl_source_open(o->source, &source);
    if (e) return e;
    uint8_t *photo = malloc((size_t)source->info.w * (size_t)source->info.h * 3);
    if (!photo || orl_source_next(source, &f) != 1) e = photo ? orl_fail(ORL_E_FORMAT, "%s: no picture", o->source) : orl_fail(ORL_E_MEMORY, "no memory for a picture");
    if (!e) orl_frame_to_rgb(&source->info, &f, orl_cpu_detect(), 0, source->info.h, photo, (size_t)source->info.w * 3);
    for (int quick = 0; !e && quick < 2; quick++)
        for (int n = 1; !e && n; n = n == 1 && orl_cores() > 1 ? orl_cores() : 0) {
            static const char *const STAGE[] = { "views", "light", "sun", "picture", "first picture" };
            char name[48], threads[24];
            orl_pose_seconds t;
            if ((e = orl_bench_pose(s, from, to, photo, quick, n, &t))) break;
            snprintf(threads, sizeof threads, "%d %s", n, n == 1 ? "thread" : "threads");
            const double seconds[] = { t.views, t.light, t.sun, t.picture, t.all };
            for (int k = 0; k < 5; k++) {
                snprintf(name, sizeof name, "new pose%s: %s", quick ? ", quick" : "", STAGE[k]);
                orl_bench_put(&o->bench, &(orl_bench_row){ ORL_BENCH_ROW, .name = name, .variant = threads, .seconds = seconds[k] });
            }
        }
    free(photo);
    orl_source_close(source);
    return e;
}

/* ---- the camera loop */

enum { CONVERT, COLD, WARM, RENDER, STAGES };

/* first: the source's first picture, tight RGB. */
static orl_err loop(const options *o, orl_widen *w, orl_source *source, uint8_t *first)
{
    double sum[STAGES] = { 0 }, most = 0;
    size_t bytes = (size_t)source->info.w * (size_t)source->info.h * 3;
    uint8_t *photo = malloc(bytes), *wide = malloc((size_t)w->wide.w * (size_t)w->wide.h * 3);
    orl_frame f;
    int n = 0, stayed = 0, got;
    orl_err e = photo && wide ? ORL_OK : orl_fail(ORL_E_MEMORY, "no memory for pictures");
    while (!e && (!o->frames || n < o->frames) && (got = orl_source_next(source, &f))) {
        if (got < 0) continue;
        double t[4];
        t[0] = orl_seconds();
        orl_frame_to_rgb(&source->info, &f, w->config.cpu, 0, source->info.h, photo, (size_t)source->info.w * 3);
        t[1] = orl_seconds();
        if (!n) memcpy(first, photo, bytes);
        e = orl_widen_adapt(w, photo);
        stayed += w->same > 0;
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
    say(o, "picture: convert", sum[CONVERT] / n);
    say(o, "light: first picture", sum[COLD]);
    say(o, "light: from the last one's", sum[WARM] / (n - 1));
    say(o, "light: the slowest of these", most);
    say(o, "render: shade, tone, blend", sum[RENDER] / n);
    say(o, "a picture in all", (sum[CONVERT] + sum[RENDER]) / n + sum[WARM] / (n - 1));
    if (o->bench.json) printf("{\"name\": \"light: stayed\", \"pictures\": %d, \"of\": %d}\n", stayed, n);
    else printf("%-53s %10d of %d pictures\n", "light: stayed, bit for bit", stayed, n);
    return ORL_OK;
}

/* The picture to compare with, at the wide view's size, as the kernels would write it. */
static orl_err read_exact(const char *path, int w, int h, orl_image *out)
{
    size_t n = strlen(path);
    orl_imagef linear = { 0 };
    orl_image im = { 0 };
    orl_err e = ORL_OK;
    if (n > 4 && !strcmp(path + n - 4, ".exr")) {
        if ((e = orl_imagef_read(path, &linear))) return e;
        for (size_t i = 0; i < (size_t)linear.w * (size_t)linear.h * 3; i++) linear.px[i] = orl_light_encode(linear.px[i]);
        e = orl_image_from_float(&linear, &im);
        orl_imagef_free(&linear);
    } else {
        e = orl_image_read(path, 3, &im);
    }
    if (!e && (im.w != w || im.h != h)) e = orl_fail(ORL_E_FORMAT, "%s: %d x %d pixels, the wide view has %d x %d", path, im.w, im.h, w, h);
    if (e) orl_image_free(&im);
    else *out = im;
    return e;
}

static orl_err decode_light(const options *o, const orl_scene *s, orl_light *light)
{
    if (o->light && (uint32_t)o->light >= s->ncodes) return orl_fail(ORL_E_RANGE, "--light %d: the file has the lights of %u photos", o->light, s->ncodes);
    orl_light_decode(&s->light, s->ncodes ? s->codes + (size_t)o->light * ORL_CODE : s->light.prior_mean, light);
    return ORL_OK;
}

/* Everything that stays open during the run. */
typedef struct {
    orl_scene scene;
    orl_baked baked;
    orl_source *source;
    orl_view_pose from, to;
    orl_widen w;
    orl_light light;
    orl_image exact;
    uint8_t *photo;
    void *block;
    size_t need;
} rig;

static orl_err open_all(const options *o, rig *r)
{
    orl_err e = o->baked ? orl_baked_open(o->baked, &r->baked) : ORL_OK;
    if (!e && o->scene) e = orl_place_open(o->scene, &r->scene);
    if (!e && o->source) e = orl_source_open(o->source, &r->source);
    int width = r->source ? r->source->info.w : 0, height = r->source ? r->source->info.h : 0;
    if (!e && o->baked) e = orl_baked_cameras(&r->baked, o->source, width, height, &r->from, &r->to);
    if (!e && o->scene) {
        orl_view_pose from, to;
        if ((e = orl_views_find(&o->view, o->source ? o->source : o->view.pose, width, height, &from, &to))) return e;
        const orl_camera *a = &to.cam, *b = &r->to.cam;
        if (o->baked && (a->w != b->w || a->h != b->h || fabs(a->fx - b->fx) > 1e-6 * b->fx)) return orl_fail(ORL_E_FORMAT, "%s: baked for another wide camera than that of %s", o->baked, o->view.pose);
        r->from = from;
        r->to = to;
    }
    if (!e && o->reference) e = read_exact(o->reference, r->to.cam.w, r->to.cam.h, &r->exact);
    if (!e) e = decode_light(o, o->scene ? &r->scene : &r->baked.scene, &r->light);
    size_t pixels = (size_t)r->from.cam.w * (size_t)r->from.cam.h;
    if (!e && !(r->photo = calloc(pixels, 3))) e = orl_fail(ORL_E_MEMORY, "no memory for a photo of %zu pixels", pixels);
    return e;
}

static orl_err build(const options *o, rig *r)
{
    orl_widen_config c = { .scene = o->baked ? &r->baked.scene : &r->scene, .baked = o->baked ? r->baked.view : NULL, .photo = r->from.cam, .wide = r->to.cam, .photo_pose = r->from.pose, .wide_pose = r->to.pose,
                           .blend = 1, .threads = 1, .cpu = orl_cpu_detect() };
    r->need = orl_widen_need(&c);
    r->block = orl_widen_block(r->need);
    return r->block ? orl_widen_init(&c, r->block, r->need, &r->w) : orl_fail(ORL_E_MEMORY, "no memory for a view of %d x %d", r->to.cam.w, r->to.cam.h);
}

static void memory(const options *o, const rig *r)
{
    struct rusage u;
    getrusage(RUSAGE_SELF, &u);
    size_t peak = 1024 * (size_t)u.ru_maxrss, mapped = o->baked ? r->baked.scene.map_bytes : r->scene.map_bytes;
    if (o->bench.json) printf("{\"name\": \"memory\", \"bytes\": %zu, \"file_bytes\": %zu, \"peak_bytes\": %zu, \"pixels\": %d}\n", r->need, mapped, peak, r->to.cam.w * r->to.cam.h);
    else printf("memory: %.1f MB for views of %d x %d and light, beside a file of %.1f MB; %.1f MB at the most\n", (double)r->need * 1e-6, r->to.cam.w, r->to.cam.h, (double)mapped * 1e-6, (double)peak * 1e-6);
}

static orl_err bench(options *o)
{
    rig *r = calloc(1, sizeof *r);
    if (!r) return orl_fail(ORL_E_MEMORY, "no memory");
    orl_err e = open_all(o, r);
    orl_bench_place place = { .scene = &r->scene, .cam = &r->to.cam, .photo_cam = &r->from.cam, .pose = &r->to.pose, .photo_pose = &r->from.pose, .light = &r->light, .exact = r->exact.px, .exact_name = o->reference };
    if (!e && !o->baked) e = march(o, &r->scene, &r->to);
    if (!e && !o->baked && r->source) e = new_pose(o, &r->scene, &r->from, &r->to);
    if (!e) e = build(o, r);
    r->w.config.no_skip = 0;            /* kernels on the whole view, pictures as `oriel run` makes them */
    if (!e) e = kernels(o, &r->w.wide, &r->light, r->w.blend, r->photo, 3 * (size_t)r->from.cam.w * (size_t)r->from.cam.h);
    if (!e && r->source) e = loop(o, &r->w, r->source, r->photo);
    if (!e) memory(o, r);               /* before what only a bench needs */
    place.baked = o->baked ? &r->w.wide : NULL;
    if (!e) e = o->scene ? orl_bench_settings(&o->bench, &place) : orl_bench_baked(&o->bench, &r->w.wide, &r->light, r->exact.px, o->reference);
    if (!e) e = orl_bench_skips(&o->bench, &r->w, &r->light, r->photo, o->scene ? &place : NULL, o->baked);
    if (!e && o->svg) e = orl_bench_plot(&o->bench, o->svg, o->scene ? r->scene.title : r->baked.scene.title);
    orl_source_close(r->source);
    free(r->block);
    free(r->photo);
    orl_image_free(&r->exact);
    orl_scene_close(&r->scene);
    orl_baked_close(&r->baked);
    free(r);
    return e;
}

static int parse(int argc, char **argv, options *o)
{
    static const struct option TABLE[] = {
        { "scene", required_argument, NULL, 's' }, { "pose", required_argument, NULL, 'p' }, { "view", required_argument, NULL, 'v' }, { "source", required_argument, NULL, 'S' },
        { "frames", required_argument, NULL, 'n' }, { "widen", required_argument, NULL, 'w' }, { "size", required_argument, NULL, 'z' }, { "reference", required_argument, NULL, 'r' },
        { "light", required_argument, NULL, 'l' }, { "svg", required_argument, NULL, 'g' }, { "json", no_argument, NULL, 'j' },
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
        case 'r': o->reference = optarg; break;
        case 'l': e = orl_option_int("--light", optarg, 0, 1 << 30, &o->light); break;
        case 'g': o->svg = optarg; break;
        case 'm': o->mlp = 1; break;
        case 'j': o->bench.json = 1; break;
        case 'k': o->convert = 1; break;
        case 'h': printf("%s", HELP); return -1;
        default:
            if (c == 'o') orl_fail(ORL_E_RANGE, "unknown option -o");
            return ORL_EXIT_USAGE;
        }
    }
    if (e) return ORL_EXIT_USAGE;
    const int place = o->baked || o->scene || o->view.pose || o->source || o->reference || o->svg, alone = o->convert + o->mlp;
    if (argc != optind || (alone ? place || alone > 1 : !o->scene != !o->view.pose || (!o->scene && (!o->baked || o->view.w || o->view.widen > 0)))) {
        orl_fail(ORL_E_RANGE, "wanted are --view, or both --scene and --pose, or all three, or --convert or --mlp alone");
        return ORL_EXIT_USAGE;
    }
    return ORL_EXIT_DONE;
}

int orl_cmd_bench(int argc, char **argv)
{
    options o = { .view.otherwise = 1.8 };
    int code = parse(argc, argv, &o);
    if (code) return code < 0 ? ORL_EXIT_DONE : code;
    return (o.mlp ? orl_bench_mlp(o.bench.json) : o.convert ? orl_bench_convert(say_convert, &o) : bench(&o)) ? ORL_EXIT_FAILED : ORL_EXIT_DONE;
}
