/* `oriel bake`: a fixed camera's views and their suns, once and for all. */
#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>
#include "runtime/baked.h"
#include "runtime/commands.h"
#include "oriel/widen.h"

static const char HELP[] =
    "Usage: oriel bake --scene FILE --pose FILE [OPTION]... -o VIEW\n"
    "Make a fixed camera's views once, for `oriel run --view VIEW`: the board then needs no scene and marches nothing.\n\n"
    "  --scene FILE   scene file made by oriel-train\n"
    "  --pose FILE    the camera; a second line, where there is one, is the wide view wanted\n"
    "  --widen F      field of view, times the camera's; 1.8 if the pose file has no second line\n"
    "  --size WxH     size of the wide picture\n"
    "  --threads N    0: one per core\n"
    "  --help         this text\n\n"
    "Some 300 rays a pixel find between which elevations a sun shines on it, in each of 16 azimuths: minutes for a view of two megapixels.\n";

typedef struct { const char *scene, *out; orl_view_request view; int threads; } options;

static int parse(int argc, char **argv, options *o)
{
    static const struct option TABLE[] = {
        { "scene", required_argument, NULL, 's' }, { "pose", required_argument, NULL, 'p' }, { "widen", required_argument, NULL, 'w' }, { "size", required_argument, NULL, 'z' },
        { "threads", required_argument, NULL, 't' }, { "help", no_argument, NULL, 'h' }, { 0 } };
    int first = 1;
    orl_err e = ORL_OK;
    for (int c; !e && (c = orl_option_next(argc, argv, TABLE, &first)) != -1; ) {
        if (orl_option_view(c, &o->view, &e)) continue;
        switch (c) {
        case 's': o->scene = optarg; break;
        case 'o': o->out = optarg; break;
        case 't': e = orl_option_int("--threads", optarg, 0, 64, &o->threads); break;
        case 'h': printf("%s", HELP); return -1;
        default: return ORL_EXIT_USAGE;
        }
    }
    if (e) return ORL_EXIT_USAGE;
    if (argc != optind || !o->scene || !o->view.pose || !o->out) {
        orl_fail(ORL_E_RANGE, "wanted are --scene, --pose and -o");
        return ORL_EXIT_USAGE;
    }
    return ORL_EXIT_DONE;
}

/* One view in memory of its own: *block and *ceiling, the caller's to free also after a failure. */
static orl_err make(const options *o, const orl_scene *s, const orl_camera *cam, const orl_pose *pose, const char *what, void **block, uint8_t **ceiling, orl_view *v)
{
    enum { BAND = 8 };
    size_t need = orl_view_need(cam->w, cam->h);
    *block = orl_widen_block(need);
    orl_err e = *block ? orl_view_build(s, cam, pose, 2, o->threads, *block, need, v) : orl_fail(ORL_E_MEMORY, "no memory for a view of %d x %d", cam->w, cam->h);
    if (e) return e;
    if (!(*ceiling = calloc((size_t)v->stride * (size_t)v->h, ORL_HORIZON))) return orl_fail(ORL_E_MEMORY, "no memory for the suns of %d x %d pixels", v->w, v->h);
    int terminal = isatty(STDERR_FILENO);
    double start = orl_seconds(), told = start;
    for (int y = 0; y < v->h; y += BAND) {
        orl_view_bake(v, y, y + BAND < v->h ? y + BAND : v->h, o->threads, *ceiling);
        double now = orl_seconds();
        if (!terminal || now < told + 0.5) continue;
        told = now;
        fprintf(stderr, "\r%s view %3d %%, %.0f s left ", what, 100 * (y + BAND) / v->h, (now - start) * (v->h - y - BAND) / (y + BAND));
    }
    if (terminal) fprintf(stderr, "\r\033[K");
    v->ceiling = *ceiling;
    v->scene = NULL;
    return ORL_OK;
}

static orl_err bake(const options *o)
{
    orl_scene scene;
    orl_view_pose pose[ORL_VIEWS];
    orl_view view[ORL_VIEWS];
    void *block[ORL_VIEWS] = { NULL };
    uint8_t *ceiling[ORL_VIEWS] = { NULL };
    size_t bytes = 0;
    double start = orl_seconds();
    orl_err e = orl_place_open(o->scene, &scene);
    if (e) return e;
    e = orl_views_find(&o->view, o->view.pose, 0, 0, &pose[0], &pose[1]);
    if (!e) {
        orl_camera small = orl_widen_small(&pose[0].cam);
        e = make(o, &scene, &small, &pose[0].pose, "photo's", &block[0], &ceiling[0], &view[0]);
    }
    if (!e) e = make(o, &scene, &pose[1].cam, &pose[1].pose, "wide", &block[1], &ceiling[1], &view[1]);
    if (!e) e = orl_baked_write(o->out, &scene, &pose[0].cam, view, &bytes);
    if (!e) printf("%s: %d x %d pixels, %.1f MB, %.1f s\n", o->out, view[1].w, view[1].h, (double)bytes * 1e-6, orl_seconds() - start);
    for (int k = 0; k < ORL_VIEWS; k++) { free(block[k]); free(ceiling[k]); }
    orl_scene_close(&scene);
    return e;
}

int orl_cmd_bake(int argc, char **argv)
{
    options o = { .view.otherwise = 1.8 };
    int code = parse(argc, argv, &o);
    if (code) return code < 0 ? ORL_EXIT_DONE : code;
    return bake(&o) ? ORL_EXIT_FAILED : ORL_EXIT_DONE;
}
