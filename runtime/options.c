/* What the sub-commands' command lines share: numbers, sizes, and the views they ask for. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include "oriel/colmap.h"
#include "runtime/commands.h"

enum { WIDE_MAX = 4096 };

int orl_option_next(int argc, char **argv, const struct option *table, int *first)
{
    if (*first) {
        optind = 0;             /* getopt starts afresh, also for a second call in one process */
        opterr = 0;
        *first = 0;
    }
    int was = optind ? optind : 1, c = getopt_long(argc, argv, ":o:", table, NULL);
    if (c == '?') orl_fail(ORL_E_RANGE, "unknown option %s", was < argc ? argv[was] : "");
    if (c == ':') orl_fail(ORL_E_RANGE, "%s needs a value", argv[optind - 1]);
    return c == ':' ? '?' : c;
}

orl_err orl_option_real(const char *option, const char *text, double lo, double hi, double *out)
{
    char *end;
    double v = strtod(text, &end);
    if (end == text || *end || !(v >= lo && v <= hi)) return orl_fail(ORL_E_RANGE, "%s %s: not a number in %g..%g", option, text, lo, hi);
    *out = v;
    return ORL_OK;
}

orl_err orl_option_int(const char *option, const char *text, int lo, int hi, int *out)
{
    char *end;
    long v = strtol(text, &end, 10);
    if (end == text || *end || v < lo || v > hi) return orl_fail(ORL_E_RANGE, "%s %s: not a whole number in %d..%d", option, text, lo, hi);
    *out = (int)v;
    return ORL_OK;
}

orl_err orl_option_size(const char *option, const char *text, int *w, int *h)
{
    int a, b, used = 0;
    if (sscanf(text, "%5dx%5d%n", &a, &b, &used) != 2 || text[used] || a < 8 || b < 8 || a > 16384 || b > 16384)
        return orl_fail(ORL_E_RANGE, "%s %s: not WIDTHxHEIGHT with sides in 8..16384", option, text);
    *w = a;
    *h = b;
    return ORL_OK;
}

int orl_option_view(int c, orl_view_request *v, orl_err *e)
{
    switch (c) {
    case 'p': v->pose = optarg; return 1;
    case 'c': v->colmap = optarg; return 1;
    case 'w': *e = orl_option_real("--widen", optarg, 0.1, 20, &v->widen); return 1;
    case 'z': *e = orl_option_size("--size", optarg, &v->w, &v->h); return 1;
    }
    return 0;
}

void orl_json_string(const char *s)
{
    putchar('"');
    for (; *s; s++) {
        if (*s == '"' || *s == '\\') printf("\\%c", *s);
        else if ((unsigned char)*s < 32 || (unsigned char)*s > 126) printf("\\u%04x", (unsigned char)*s);
        else putchar(*s);
    }
    putchar('"');
}

double orl_seconds(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

orl_err orl_place_open(const char *path, orl_scene *out)
{
    orl_scene s;
    orl_err e = orl_scene_open(path, &s);
    if (e) return e;
    if (!s.nbricks) {
        orl_scene_close(&s);
        return orl_fail(ORL_E_FORMAT, "%s: it holds no surface to render", path);
    }
    *out = s;
    return ORL_OK;
}

static const char *last_part(const char *path)
{
    const char *slash = strrchr(path, '/');
    return slash ? slash + 1 : path;
}

static int from_model(const orl_colmap *m, const char *name, orl_view_pose *out)
{
    for (uint32_t i = 0; i < m->nimages; i++) {
        if (strcmp(last_part(m->images[i].name), last_part(name))) continue;
        memset(out, 0, sizeof *out);
        snprintf(out->name, sizeof out->name, "%.127s", last_part(name));
        out->cam = m->cameras[m->images[i].camera];
        out->pose = m->images[i].pose;
        return 1;
    }
    return 0;
}

/* dir: a SCENE folder or a sparse model; test cameras that stand apart count too. */
static orl_err from_colmap(const char *dir, const char *name, orl_view_pose *out)
{
    static const char *const PLACES[] = { "", "/sparse/0", "/sparse", "/sparse_test/0", "/dense/sparse" };
    int models = 0;
    for (size_t i = 0; i < sizeof PLACES / sizeof *PLACES; i++) {
        static const char *const FILES[] = { "images.bin", "images.txt" };
        char path[2048], file[2100];
        int there = 0;
        snprintf(path, sizeof path, "%s%s", dir, PLACES[i]);
        for (int k = 0; k < 2 && !there; k++) {
            snprintf(file, sizeof file, "%s/%s", path, FILES[k]);
            FILE *f = fopen(file, "rb");
            there = f != NULL;
            if (f) fclose(f);
        }
        if (!there) continue;
        orl_colmap m;
        orl_err e = orl_colmap_read(path, NULL, NULL, &m);
        if (e) return e;
        int found = from_model(&m, name, out);
        orl_colmap_free(&m);
        if (found) return ORL_OK;
        models++;
    }
    return models ? orl_fail(ORL_E_RANGE, "%s: no camera named %s", dir, last_part(name)) : orl_fail(ORL_E_IO, "%s: no COLMAP model here", dir);
}

orl_err orl_camera_fit(orl_camera *c, const char *name, int w, int h)
{
    if (c->w == w && c->h == h) return ORL_OK;
    if (fabs((double)c->w * h - (double)c->h * w) > 1.5 * (c->w > c->h ? w > h ? w : h : h > w ? h : w))
        return orl_fail(ORL_E_FORMAT, "%s: %d x %d pixels do not have the shape of its camera, %d x %d", name, w, h, c->w, c->h);
    *c = orl_camera_resized(c, w, h);
    return ORL_OK;
}

orl_err orl_views_find(const orl_view_request *q, const char *name, int w, int h, orl_view_pose *photo, orl_view_pose *wide)
{
    orl_view_pose v[2];
    int count = 1;
    orl_err e = q->pose ? orl_posefile_read(q->pose, v, 2, &count) : from_colmap(q->colmap, name, v);
    if (e) return e;
    if (count < 1) return orl_fail(ORL_E_FORMAT, "%s: no view in it", q->pose);
    orl_camera *c = &v[0].cam;
    if (w && (e = orl_camera_fit(c, name, w, h))) return e;
    if (count < 2 || q->widen > 0) {
        double f = q->widen > 0 ? q->widen : q->otherwise;
        int ww = q->w, wh = q->h;
        if (!ww) orl_size_long_side((int)(c->w * f + 0.5), (int)(c->h * f + 0.5), WIDE_MAX, &ww, &wh);
        v[1] = v[0];
        v[1].cam = orl_camera_widened(c, f, ww, wh);
    } else if (q->w) {
        v[1].cam = orl_camera_resized(&v[1].cam, q->w, q->h);
    }
    *photo = v[0];
    *wide = v[1];
    return ORL_OK;
}
