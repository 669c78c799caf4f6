/* `oriel extend`: one photo of a known place, widened in its own light. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "oriel/cpu.h"
#include "runtime/commands.h"
#include "oriel/widen.h"

static const char HELP[] =
    "Usage: oriel extend --scene FILE (--pose FILE | --colmap DIR) [OPTION]... PHOTO -o WIDE\n"
    "Widen one photo (JPEG or PNG) of the place in its own light; WIDE is a .png or .jpg file.\n\n"
    "  --scene FILE     scene file made by oriel-train\n"
    "  --pose FILE      the photo's camera; a second line, where there is one, is the wide view wanted\n"
    "  --colmap DIR     or: a SCENE folder or COLMAP model that holds the photo's camera by its file name\n"
    "  --widen F        field of view, times the photo's (focal length / F); 1.8\n"
    "  --size WxH       size of the wide picture; the photo's scale, at most 4096 pixels\n"
    "  --mask FILE      picture of the photo's size, nonzero where people stand: they do not take part in finding the light\n"
    "  --no-blend       the render alone\n"
    "  --quick          rays through pixels' corners, which neighbours share, instead of four a pixel: softer, in half the time\n"
    "  --report         light found and time of each stage, on standard output\n"
    "  --threads N      0: one per core\n"
    "  --cpu NAME       auto, ref, avx2, avx512, neon, dotprod\n"
    "  --help           this text\n";

typedef struct {
    const char *scene, *out, *mask, *photo;
    orl_view_request view;
    int no_blend, quick, report, threads;
    unsigned cpu;
} options;

static int parse(int argc, char **argv, options *o)
{
    static const struct option TABLE[] = {
        { "scene", required_argument, NULL, 's' }, { "pose", required_argument, NULL, 'p' }, { "colmap", required_argument, NULL, 'c' }, { "widen", required_argument, NULL, 'w' },
        { "size", required_argument, NULL, 'z' }, { "mask", required_argument, NULL, 'm' }, { "no-blend", no_argument, NULL, 'b' }, { "quick", no_argument, NULL, 'q' }, { "report", no_argument, NULL, 'r' },
        { "threads", required_argument, NULL, 't' }, { "cpu", required_argument, NULL, 'u' }, { "output", required_argument, NULL, 'o' }, { "help", no_argument, NULL, 'h' }, { 0 } };
    int first = 1;
    orl_err e = ORL_OK;
    for (int c; !e && (c = orl_option_next(argc, argv, TABLE, &first)) != -1; ) {
        if (orl_option_view(c, &o->view, &e)) continue;
        switch (c) {
        case 's': o->scene = optarg; break;
        case 'm': o->mask = optarg; break;
        case 'b': o->no_blend = 1; break;
        case 'q': o->quick = 1; break;
        case 'r': o->report = 1; break;
        case 't': e = orl_option_int("--threads", optarg, 0, 64, &o->threads); break;
        case 'u': e = orl_cpu_from_name(optarg, &o->cpu); break;
        case 'o': o->out = optarg; break;
        case 'h': printf("%s", HELP); return -1;
        default: return ORL_EXIT_USAGE;
        }
    }
    if (e) return ORL_EXIT_USAGE;
    if (argc - optind == 1) o->photo = argv[optind];
    if (!o->photo || !o->scene || !o->out || !o->view.pose == !o->view.colmap) {
        orl_fail(ORL_E_RANGE, "wanted are one PHOTO, --scene, -o, and one of --pose and --colmap");
        return ORL_EXIT_USAGE;
    }
    return ORL_EXIT_DONE;
}

static void report(const orl_widen *w, const double *t)
{
    static const char *const STATUS[] = { "converged", "stopped at its iterations", "degenerate" };
    const orl_adapt_result *r = &w->fit;
    const float *s = w->light->sun_dir;
    printf("adaptation  %s after %d iterations, %d runs, rms %.4f, inliers %.3f, cost %.4f\n", STATUS[r->status], r->iterations, w->starts, (double)r->rms, (double)r->inliers, (double)r->cost);
    printf("sun         azimuth %.1f, elevation %.1f degrees, direction %.3f %.3f %.3f, irradiance %.3f %.3f %.3f\n", (double)r->code[ORL_C_SUN_AZ] * 57.29578,
           (double)r->code[ORL_C_SUN_EL] * 57.29578, (double)s[0], (double)s[1], (double)s[2], (double)w->light->sun_rgb[0], (double)w->light->sun_rgb[1], (double)w->light->sun_rgb[2]);
    printf("seconds     read %.3f, views and light %.3f, render %.3f, write %.3f\n", t[1] - t[0], t[2] - t[1], t[3] - t[2], t[4] - t[3]);
}

static orl_err extend(const options *o)
{
    orl_scene scene = { 0 };
    orl_image photo = { 0 }, mask = { 0 }, wide = { 0 };
    orl_view_pose from, to;
    orl_widen w;
    void *block = NULL;
    double t[5] = { orl_seconds() };
    orl_err e = orl_place_open(o->scene, &scene);
    if (e) return e;
    if ((e = orl_image_read(o->photo, 3, &photo))) goto done;
    if ((e = orl_views_find(&o->view, o->photo, photo.w, photo.h, &from, &to))) goto done;
    if (o->mask) {
        if ((e = orl_image_read(o->mask, 1, &mask))) goto done;
        if (mask.w != photo.w || mask.h != photo.h) {
            e = orl_fail(ORL_E_FORMAT, "%s: %d x %d pixels, the photo has %d x %d", o->mask, mask.w, mask.h, photo.w, photo.h);
            goto done;
        }
    }
    orl_widen_config c = { .scene = &scene, .photo = from.cam, .wide = to.cam, .photo_pose = from.pose, .wide_pose = to.pose, .mask = mask.px, .blend = !o->no_blend, .quick = o->quick, .no_skip = ORL_SKIP_SAME,      /* one picture */
                           .threads = o->threads, .cpu = o->cpu };
    size_t need = orl_widen_need(&c);
    block = orl_widen_block(need);
    if ((e = block ? orl_image_alloc(&wide, to.cam.w, to.cam.h, 3) : orl_fail(ORL_E_MEMORY, "no memory for a view of %d x %d", to.cam.w, to.cam.h))) goto done;
    t[1] = orl_seconds();
    if ((e = orl_widen_start(&c, photo.px, block, need, &w))) goto done;
    t[2] = orl_seconds();
    if (w.fit.status == ORL_ADAPT_DEGENERATE) {
        e = orl_fail(ORL_E_DEGENERATE, "%s: nothing in it tells the light (wrong pose, or all masked)", o->photo);
        goto done;
    }
    if ((e = orl_widen_render(&w, photo.px, wide.px))) goto done;
    t[3] = orl_seconds();
    if ((e = orl_image_write(o->out, &wide))) goto done;
    t[4] = orl_seconds();
    if (o->report) report(&w, t);
done:
    free(block);
    orl_image_free(&photo);
    orl_image_free(&mask);
    orl_image_free(&wide);
    orl_scene_close(&scene);
    return e;
}

int orl_cmd_extend(int argc, char **argv)
{
    options o = { .view.otherwise = 1.8, .cpu = orl_cpu_detect() };
    int code = parse(argc, argv, &o);
    if (code) return code < 0 ? ORL_EXIT_DONE : code;
    return extend(&o) ? ORL_EXIT_FAILED : ORL_EXIT_DONE;
}
