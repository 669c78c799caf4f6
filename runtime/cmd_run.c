/* `oriel run`: every picture of a fixed camera, widened. */
#include <stdio.h>
#include <stdlib.h>
#include "oriel/cpu.h"
#include "oriel/image.h"
#include "runtime/baked.h"
#include "runtime/commands.h"
#include "runtime/run.h"
#include "runtime/skips.h"

static const char HELP[] =
    "Usage: oriel run (--scene FILE --pose FILE | --view FILE) --source SOURCE --sink SINK [OPTION]...\n"
    "Widen every picture of a fixed camera.\n\n"
    "  --scene FILE       scene file made by oriel-train\n"
    "  --pose FILE        the camera; a second line, where there is one, is the wide view wanted\n"
    "  --view FILE        instead of both: the views as `oriel bake` made them; nothing is marched then\n"
    "  --source SOURCE    replay:PATH (Y4M file, - for standard input, or a folder of pictures),\n"
    "                     raw:FORMAT[,709][,full]:WxH[@FPS]:PATH (as a camera stores them: yuyv, uyvy, nv12, nv21,\n"
    "                     i420, i422, i444, mono, rgb24, bgr24; BT.601 of limited range unless told otherwise)\n"
    "  --sink SINK        files:DIR[/PATTERN], hash:, y4m:FILE (- for standard output)\n"
    "  --widen F          field of view, times the camera's; 1.8 if the pose file has no second line\n"
    "  --size WxH         size of the wide picture\n"
    "  --frames N         stop after N pictures\n"
    "  --adapt-every N    find the light in every Nth picture; 1\n"
    "  --no-blend         the render alone\n"
    "  --no-skip[=LIST]   do also what is skipped, all of it or of photo,sky,shadow,same,empty,light: the same\n"
    "                     picture, later; but for light, which is not looked for where nothing changed: nearly the same\n"
    "  --realtime         hold back to the source's frame rate\n"
    "  --report           pictures, time of each stage, on standard error\n"
    "  --threads N        0: one per core\n"
    "  --cpu NAME         auto, ref, avx2, avx512, neon, dotprod\n"
    "  --help             this text\n";

typedef struct {
    const char *scene, *baked, *source, *sink;
    orl_view_request view;
    orl_run_options run;
    int no_blend, report, threads;
    unsigned no_skip, cpu;
} options;

static int parse(int argc, char **argv, options *o)
{
    static const struct option TABLE[] = {
        { "scene", required_argument, NULL, 's' }, { "pose", required_argument, NULL, 'p' }, { "view", required_argument, NULL, 'v' }, { "source", required_argument, NULL, 'S' }, { "sink", required_argument, NULL, 'D' },
        { "widen", required_argument, NULL, 'w' }, { "size", required_argument, NULL, 'z' }, { "frames", required_argument, NULL, 'n' }, { "adapt-every", required_argument, NULL, 'a' },
        { "no-blend", no_argument, NULL, 'b' }, { "no-skip", optional_argument, NULL, 'k' }, { "realtime", no_argument, NULL, 'T' }, { "report", no_argument, NULL, 'r' }, { "threads", required_argument, NULL, 't' },
        { "cpu", required_argument, NULL, 'u' }, { "help", no_argument, NULL, 'h' }, { 0 } };
    int first = 1, n = 0;
    orl_err e = ORL_OK;
    for (int c; !e && (c = orl_option_next(argc, argv, TABLE, &first)) != -1; ) {
        if (orl_option_view(c, &o->view, &e)) continue;
        switch (c) {
        case 's': o->scene = optarg; break;
        case 'v': o->baked = optarg; break;
        case 'S': o->source = optarg; break;
        case 'D': o->sink = optarg; break;
        case 'n': e = orl_option_int("--frames", optarg, 1, 1 << 30, &n); o->run.frames = n; break;
        case 'a': e = orl_option_int("--adapt-every", optarg, 1, 1 << 30, &o->run.adapt_every); break;
        case 'b': o->no_blend = 1; break;
        case 'k': e = orl_skips_parse(optarg, &o->no_skip); break;
        case 'T': o->run.realtime = 1; break;
        case 'r': o->report = 1; break;
        case 't': e = orl_option_int("--threads", optarg, 0, 64, &o->threads); break;
        case 'u': e = orl_cpu_from_name(optarg, &o->cpu); break;
        case 'h': printf("%s", HELP); return -1;
        default:
            if (c == 'o') orl_fail(ORL_E_RANGE, "unknown option -o");
            return ORL_EXIT_USAGE;
        }
    }
    if (e) return ORL_EXIT_USAGE;
    if (argc != optind || (o->baked ? o->scene || o->view.pose : !o->scene || !o->view.pose) || !o->source || !o->sink) {
        orl_fail(ORL_E_RANGE, "wanted are --source, --sink, and either --view or both --scene and --pose");
        return ORL_EXIT_USAGE;
    }
    if (o->baked && (o->view.w || o->view.widen > 0)) {
        orl_fail(ORL_E_RANGE, "--widen and --size are settled when a view is baked");
        return ORL_EXIT_USAGE;
    }
    return ORL_EXIT_DONE;
}

static void report(const orl_run_figures *f)
{
    static const char *const STAGE[] = { "read", "adapt", "render", "emit" };
    double n = f->frames ? (double)f->frames : 1;
    fprintf(stderr, "%ld pictures, %ld lost, %.2f a second; ms a picture:", f->frames, f->lost, f->total > 0 ? n / f->total : 0);
    for (int k = 0; k < 4; k++) fprintf(stderr, " %s %.2f%s", STAGE[k], 1e3 * f->seconds[k] / n, k < 3 ? "," : "\n");
}

static orl_err run(const options *o)
{
    orl_scene scene = { 0 };
    orl_baked baked = { 0 };
    orl_source *source = NULL;
    orl_sink *sink = NULL;
    orl_view_pose from, to;
    orl_widen w;
    orl_run_figures figures = { 0 };
    orl_image photo = { 0 }, wide = { 0 };
    void *block = NULL;
    int32_t *crowded = NULL;
    char line[256] = "";
    orl_err e = o->baked ? orl_baked_open(o->baked, &baked) : orl_place_open(o->scene, &scene);
    if (e) return e;
    if ((e = orl_source_open(o->source, &source))) goto done;
    if (!o->baked && o->no_skip & ORL_SKIP_EMPTY && (e = orl_skips_crowd(&scene, &crowded))) goto done;
    const orl_source_info *i = &source->info;
    e = o->baked ? orl_baked_cameras(&baked, o->source, i->w, i->h, &from, &to) : orl_views_find(&o->view, o->source, i->w, i->h, &from, &to);
    if (e) goto done;
    orl_widen_config c = { .scene = o->baked ? &baked.scene : &scene, .baked = o->baked ? baked.view : NULL, .photo = from.cam, .wide = to.cam, .photo_pose = from.pose, .wide_pose = to.pose, .blend = !o->no_blend, .no_skip = o->no_skip,
                           .threads = o->threads, .cpu = o->cpu };
    size_t need = orl_widen_need(&c);
    block = orl_widen_block(need);
    e = block ? orl_image_alloc(&photo, i->w, i->h, 3) : orl_fail(ORL_E_MEMORY, "no memory for a view of %d x %d", to.cam.w, to.cam.h);
    if (!e) e = orl_image_alloc(&wide, to.cam.w, to.cam.h, 3);
    if (!e) e = orl_widen_init(&c, block, need, &w);
    if (!e) e = orl_sink_open(o->sink, to.cam.w, to.cam.h, i->fps_num, i->fps_den, &sink);
    if (!e) e = orl_run_loop(&w, source, sink, &o->run, photo.px, wide.px, &figures);
    if (sink) {
        orl_err last = orl_sink_close(sink, e ? NULL : line, sizeof line);
        e = e ? e : last;
    }
    if (!e && *line) printf("%s\n", line);
    if (!e && o->report) report(&figures);
done:
    orl_source_close(source);
    free(block);
    free(crowded);
    orl_image_free(&photo);
    orl_image_free(&wide);
    orl_scene_close(&scene);
    orl_baked_close(&baked);
    return e;
}

int orl_cmd_run(int argc, char **argv)
{
    options o = { .view.otherwise = 1.8, .run = { .adapt_every = 1 }, .cpu = orl_cpu_detect() };
    int code = parse(argc, argv, &o);
    if (code) return code < 0 ? ORL_EXIT_DONE : code;
    return run(&o) ? ORL_EXIT_FAILED : ORL_EXIT_DONE;
}
