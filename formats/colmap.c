/* COLMAP sparse models (include/oriel/colmap.h). Both readers go through one cursor with a sticky error: parse straight through, test once. */
#include "oriel/colmap.h"
#include <inttypes.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include "oriel/image.h"

#define MAX_FILE ((size_t)4 << 30)

typedef struct {
    char path[1100];
    uint8_t *buf;
    size_t n, at;
    int text, bad;
    char why[96];
} cursor;

typedef struct { uint32_t id; int keep; orl_camera cam; } raw_camera;
typedef struct { uint64_t id; uint32_t index; } point_id;
typedef void (*warn_fn)(void *, const char *);

static void spoil(cursor *c, const char *why)
{
    if (!c->bad) snprintf(c->why, sizeof c->why, "%s", why);
    c->bad = 1;
}

static uint64_t get(cursor *c, size_t bytes, const char *field)
{
    uint64_t v = 0;
    if (c->bad || c->n - c->at < bytes) { spoil(c, field); return 0; }
    for (size_t i = 0; i < bytes; i++) v |= (uint64_t)c->buf[c->at + i] << (8 * i);
    c->at += bytes;
    return v;
}

static double get_f64(cursor *c, const char *field)
{
    uint64_t v = get(c, 8, field);
    double d;
    memcpy(&d, &v, 8);
    return d;
}

/* Count of records of at least `size` bytes: must fit into what remains. */
static uint64_t get_count(cursor *c, size_t bytes, size_t size, const char *field)
{
    uint64_t v = get(c, bytes, field);
    if (!c->bad && v > (c->n - c->at) / size) { spoil(c, field); return 0; }
    return v;
}

/* Text: next line that is no comment; NULL at the end. Lines are cut out of the buffer in place. empty: an empty line counts. */
static char *next_line(cursor *c, int empty)
{
    while (c->at < c->n) {
        char *s = (char *)c->buf + c->at, *e = memchr(s, '\n', c->n - c->at);
        size_t len = e ? (size_t)(e - s) : c->n - c->at;
        c->at += len + (e != NULL);
        s[len] = 0;
        if (len && s[len - 1] == '\r') s[len - 1] = 0;
        if (*s == '#' || (!empty && s[strspn(s, " \t")] == 0)) continue;
        return s;
    }
    return NULL;
}

static double word_num(cursor *c, char **s, const char *field)
{
    char *e;
    double v = strtod(*s, &e);
    if (e == *s) spoil(c, field);
    *s = e;
    return v;
}

/* Whole number of a text field in 0..max. */
static uint32_t word_int(cursor *c, char **s, uint32_t max, const char *field)
{
    double v = word_num(c, s, field);
    if (!(v >= 0 && v <= max)) { spoil(c, field); return 0; }
    return (uint32_t)v;
}

/* Image side as an int; what does not fit becomes 65536, which no camera accepts. */
static int side(uint64_t v) { return v > 65536 ? 65536 : (int)v; }

static orl_err open_part(cursor *c, const char *dir, const char *part, int *found)
{
    struct stat st;
    memset(c, 0, sizeof *c);
    *found = 1;
    for (c->text = 0; c->text < 2; c->text++) {
        snprintf(c->path, sizeof c->path, "%s/%s.%s", dir, part, c->text ? "txt" : "bin");
        if (!stat(c->path, &st)) return orl_file_read(c->path, MAX_FILE, &c->buf, &c->n);
    }
    *found = 0;
    return ORL_OK;
}

static void say(warn_fn warn, void *user, const char *fmt, ...)
{
    char line[700];
    va_list ap;
    va_start(ap, fmt);
    vsnprintf(line, sizeof line, fmt, ap);
    va_end(ap);
    if (warn) warn(user, line);
}

static void *grow(void *p, size_t count, size_t *cap, size_t size)
{
    if (count < *cap) return p;
    size_t n = *cap ? 2 * *cap : 64;
    void *q = realloc(p, n * size);
    if (q) *cap = n;
    return q;
}

static orl_err cursor_error(const cursor *c) { return orl_fail(ORL_E_FORMAT, "%s: %s at byte %zu", c->path, c->why, c->at); }

static orl_err read_cameras(cursor *c, warn_fn warn, void *user, raw_camera **out, size_t *count)
{
    raw_camera *v = NULL;
    size_t n = 0, cap = 0;
    uint64_t left = c->text ? UINT64_MAX : get_count(c, 8, 24, "camera count");
    char *line = NULL;
    while (!c->bad && left-- && (!c->text || (line = next_line(c, 0)))) {
        double p[12];
        raw_camera r = { 0 };
        int model, np, w, h;
        if (c->text) {
            char name[32];
            int used = 0;
            long long tw, th;
            r.id = word_int(c, &line, UINT32_MAX, "camera id");
            if (sscanf(line, "%31s %lld %lld%n", name, &tw, &th, &used) != 3) { spoil(c, "camera line"); break; }
            w = side((uint64_t)tw);
            h = side((uint64_t)th);
            model = orl_camera_model_from_name(name);
            np = orl_camera_param_count(model);
            line += used;
            if (np < 0) { free(v); return orl_fail(ORL_E_UNSUPPORTED, "%s: camera %" PRIu32 ": model %s is not supported", c->path, r.id, name); }
            for (int i = 0; i < np; i++) p[i] = word_num(c, &line, "camera parameter");
        } else {
            r.id = (uint32_t)get(c, 4, "camera id");
            model = (int)get(c, 4, "camera model");
            w = side(get(c, 8, "camera width"));
            h = side(get(c, 8, "camera height"));
            np = orl_camera_param_count(model);
            if (!c->bad && np < 0) { free(v); return orl_fail(ORL_E_UNSUPPORTED, "%s: camera %" PRIu32 ": model %d is not supported", c->path, r.id, model); }
            for (int i = 0; i < np; i++) p[i] = get_f64(c, "camera parameter");
        }
        if (c->bad) break;
        r.keep = orl_camera_from_params(&r.cam, model, w, h, p, np) == ORL_OK;
        for (size_t i = 0; i < n; i++) if (v[i].id == r.id) { free(v); return orl_fail(ORL_E_FORMAT, "%s: camera %" PRIu32 " is there twice", c->path, r.id); }
        if (!r.keep) say(warn, user, "%s: camera %" PRIu32 " is left out: %s", c->path, r.id, orl_error_text());
        raw_camera *q = grow(v, n, &cap, sizeof *v);
        if (!q) { free(v); return orl_fail(ORL_E_MEMORY, "%s: no memory", c->path); }
        v = q;
        v[n++] = r;
    }
    if (c->bad) { free(v); return cursor_error(c); }
    *out = v;
    *count = n;
    return ORL_OK;
}

static int by_point_id(const void *a, const void *b)
{
    uint64_t x = ((const point_id *)a)->id, y = ((const point_id *)b)->id;
    return (x > y) - (x < y);
}

static int by_point(const void *a, const void *b)
{
    uint64_t x = ((const orl_colmap_point *)a)->id, y = ((const orl_colmap_point *)b)->id;
    return (x > y) - (x < y);
}

static orl_err read_points(cursor *c, orl_colmap_point **out, size_t *count)
{
    orl_colmap_point *v = NULL;
    size_t n = 0, cap = 0;
    uint64_t left = c->text ? UINT64_MAX : get_count(c, 8, 51, "point count");
    char *line = NULL;
    while (!c->bad && left-- && (!c->text || (line = next_line(c, 0)))) {
        orl_colmap_point r;
        memset(&r, 0, sizeof r);
        if (c->text) {
            r.id = strtoull(line, &line, 10);
            for (int a = 0; a < 3; a++) r.xyz[a] = word_num(c, &line, "point position");
            for (int a = 0; a < 3; a++) r.rgb[a] = (uint8_t)word_int(c, &line, 255, "point colour");
            r.error_px = (float)word_num(c, &line, "point error");
            for (char *e; strtol(line, &e, 10), e != line; line = e) r.track_length++;
            r.track_length /= 2;
        } else {
            r.id = get(c, 8, "point id");
            for (int a = 0; a < 3; a++) r.xyz[a] = get_f64(c, "point position");
            for (int a = 0; a < 3; a++) r.rgb[a] = (uint8_t)get(c, 1, "point colour");
            r.error_px = (float)get_f64(c, "point error");
            uint64_t track = get_count(c, 8, 8, "point track length");
            r.track_length = (uint32_t)track;
            c->at += track * 8;
        }
        if (c->bad) break;
        if (!isfinite(r.xyz[0]) || !isfinite(r.xyz[1]) || !isfinite(r.xyz[2])) continue;
        if (!isfinite(r.error_px) || r.error_px < 0) r.error_px = 0;
        orl_colmap_point *q = grow(v, n, &cap, sizeof *v);
        if (!q) { free(v); return orl_fail(ORL_E_MEMORY, "%s: no memory", c->path); }
        v = q;
        v[n++] = r;
    }
    if (c->bad) { free(v); return cursor_error(c); }
    if (n) qsort(v, n, sizeof *v, by_point);
    for (size_t i = 1; i < n; i++) if (v[i].id == v[i - 1].id) { orl_err e = orl_fail(ORL_E_FORMAT, "%s: point %" PRIu64 " is there twice", c->path, v[i].id); free(v); return e; }
    *out = v;
    *count = n;
    return ORL_OK;
}

static int point_index(const point_id *ids, size_t n, uint64_t id)
{
    point_id key = { id, 0 };
    const point_id *f = n ? bsearch(&key, ids, n, sizeof *ids, by_point_id) : NULL;
    return f ? (int)f->index : -1;
}

typedef struct { orl_colmap_image *im; size_t n, cap; orl_colmap_obs *obs; size_t nobs, obs_cap; } image_list;

static int add_obs(image_list *l, float x, float y, int point)
{
    orl_colmap_obs *o = grow(l->obs, l->nobs, &l->obs_cap, sizeof *o);
    if (!o) return 0;
    l->obs = o;
    l->obs[l->nobs++] = isfinite(x) && isfinite(y) ? (orl_colmap_obs){ x, y, point } : (orl_colmap_obs){ 0, 0, -1 };
    return 1;
}

static orl_err read_images(cursor *c, const raw_camera *cams, size_t ncams, const point_id *ids, size_t nids, warn_fn warn, void *user, image_list *l)
{
    uint64_t left = c->text ? UINT64_MAX : get_count(c, 8, 73, "image count");
    char *line = NULL;
    while (!c->bad && left-- && (!c->text || (line = next_line(c, 0)))) {
        orl_colmap_image im;
        double q[4], t[3];
        uint32_t cam_id;
        memset(&im, 0, sizeof im);
        size_t obs0 = l->nobs;
        if (c->text) {
            im.id = word_int(c, &line, UINT32_MAX, "image id");
            for (int i = 0; i < 4; i++) q[i] = word_num(c, &line, "image quaternion");
            for (int i = 0; i < 3; i++) t[i] = word_num(c, &line, "image translation");
            cam_id = word_int(c, &line, UINT32_MAX, "image camera");
            line += strspn(line, " \t");
            if (c->bad || strlen(line) >= sizeof im.name || !*line) { spoil(c, "image name"); break; }
            snprintf(im.name, sizeof im.name, "%.255s", line);
            char *pts = next_line(c, 1);
            for (char *e; pts; pts = e) {
                float x = strtof(pts, &e);
                if (e == pts) { if (pts[strspn(pts, " \t")]) spoil(c, "image observation"); break; }
                float y = strtof(e, &pts);
                if (pts == e) { spoil(c, "image observation"); break; }
                long long id = strtoll(pts, &e, 10);
                if (e == pts) { spoil(c, "image observation"); break; }
                if (!add_obs(l, x, y, id < 0 ? -1 : point_index(ids, nids, (uint64_t)id))) return orl_fail(ORL_E_MEMORY, "%s: no memory", c->path);
            }
        } else {
            im.id = (uint32_t)get(c, 4, "image id");
            for (int i = 0; i < 4; i++) q[i] = get_f64(c, "image quaternion");
            for (int i = 0; i < 3; i++) t[i] = get_f64(c, "image translation");
            cam_id = (uint32_t)get(c, 4, "image camera");
            size_t k = 0;
            for (;;) {
                char ch = (char)get(c, 1, "image name");
                if (c->bad || !ch) break;
                if (k + 1 >= sizeof im.name) { spoil(c, "image name"); break; }
                im.name[k++] = ch;
            }
            if (!k) spoil(c, "image name");
            uint64_t n = get_count(c, 8, 24, "observation count");
            for (uint64_t i = 0; i < n && !c->bad; i++) {
                float x = (float)get_f64(c, "observation"), y = (float)get_f64(c, "observation");
                uint64_t id = get(c, 8, "observation");
                if (!add_obs(l, x, y, id == UINT64_MAX ? -1 : point_index(ids, nids, id))) return orl_fail(ORL_E_MEMORY, "%s: no memory", c->path);
            }
        }
        if (c->bad) break;
        im.camera = -1;
        for (size_t i = 0; i < ncams; i++) if (cams[i].id == cam_id) im.camera = (int)i;
        const char *why = im.camera < 0 ? "its camera is missing" : !cams[im.camera].keep ? "its camera is absurd" : NULL;
        if (!why && orl_pose_from_quat(&im.pose, q, t)) why = orl_error_text();
        if (why) {
            say(warn, user, "%s: image %s is left out: %s", c->path, im.name, why);
            l->nobs = obs0;
            continue;
        }
        im.obs_begin = (uint32_t)obs0;
        im.obs_count = (uint32_t)(l->nobs - obs0);
        orl_colmap_image *v = grow(l->im, l->n, &l->cap, sizeof *v);
        if (!v) return orl_fail(ORL_E_MEMORY, "%s: no memory", c->path);
        l->im = v;
        l->im[l->n++] = im;
    }
    return c->bad ? cursor_error(c) : ORL_OK;
}

static int by_name(const void *a, const void *b) { return strcmp(((const orl_colmap_image *)a)->name, ((const orl_colmap_image *)b)->name); }

orl_err orl_colmap_read(const char *dir, warn_fn warn, void *user, orl_colmap *out)
{
    cursor cc, ci, cp;
    raw_camera *cams = NULL;
    orl_colmap_point *pts = NULL;
    point_id *ids = NULL;
    image_list l = { 0 };
    size_t ncams = 0, npts = 0;
    orl_colmap m = { 0 };
    int has_c, has_i, has_p;
    memset(&ci, 0, sizeof ci);
    memset(&cp, 0, sizeof cp);
    orl_err e = open_part(&cc, dir, "cameras", &has_c);
    if (!e) e = open_part(&ci, dir, "images", &has_i);
    if (!e) e = open_part(&cp, dir, "points3D", &has_p);
    if (!e && (!has_c || !has_i)) e = orl_fail(ORL_E_IO, "%s: no COLMAP model (cameras and images, .bin or .txt) here", dir);
    if (!e) e = read_cameras(&cc, warn, user, &cams, &ncams);
    if (!e && has_p) e = read_points(&cp, &pts, &npts);
    if (!e && !(ids = malloc((npts + 1) * sizeof *ids))) e = orl_fail(ORL_E_MEMORY, "%s: no memory", dir);
    for (size_t i = 0; !e && i < npts; i++) ids[i] = (point_id){ pts[i].id, (uint32_t)i };
    if (!e) e = read_images(&ci, cams, ncams, ids, npts, warn, user, &l);
    if (!e && l.n) qsort(l.im, l.n, sizeof *l.im, by_name);
    for (size_t i = 1; !e && i < l.n; i++) if (!strcmp(l.im[i].name, l.im[i - 1].name)) e = orl_fail(ORL_E_FORMAT, "%s: image %s is there twice", ci.path, l.im[i].name);
    if (!e) {
        m.cameras = calloc(ncams + 1, sizeof *m.cameras);
        m.points = calloc(npts + 1, sizeof *m.points);
        if (!m.cameras || !m.points) e = orl_fail(ORL_E_MEMORY, "%s: no memory", dir);
    }
    if (!e) {
        for (size_t i = 0; i < ncams; i++) m.cameras[i] = cams[i].cam;
        for (size_t i = 0; i < npts; i++) m.points[i] = pts[i];
        m.ncameras = (uint32_t)ncams;
        m.npoints = (uint32_t)npts;
        m.images = l.im;
        m.nimages = (uint32_t)l.n;
        m.obs = l.obs;
        m.nobs = (uint32_t)l.nobs;
        *out = m;
    } else {
        free(m.cameras);
        free(m.points);
        free(l.im);
        free(l.obs);
    }
    free(cc.buf);
    free(ci.buf);
    free(cp.buf);
    free(cams);
    free(pts);
    free(ids);
    return e;
}

void orl_colmap_free(orl_colmap *m)
{
    free(m->cameras);
    free(m->images);
    free(m->obs);
    free(m->points);
    memset(m, 0, sizeof *m);
}

/* Text model: one growing buffer per file, written at once. */
typedef struct { char *s; size_t n, cap; int bad; } text;

static void put(text *t, const char *fmt, ...)
{
    va_list ap;
    for (;;) {
        va_start(ap, fmt);
        int k = t->s ? vsnprintf(t->s + t->n, t->cap - t->n, fmt, ap) : (int)t->cap;
        va_end(ap);
        if (t->s && k >= 0 && (size_t)k < t->cap - t->n) { t->n += (size_t)k; return; }
        size_t cap = t->cap ? 2 * t->cap : 1 << 16;
        char *s = t->bad ? NULL : realloc(t->s, cap);
        if (!s) { t->bad = 1; return; }
        t->s = s;
        t->cap = cap;
    }
}

static orl_err put_file(text *t, const char *dir, const char *name)
{
    char path[4200];
    snprintf(path, sizeof path, "%s/%s", dir, name);
    orl_err e = t->bad ? orl_fail(ORL_E_MEMORY, "%s: no memory", path) : orl_file_write(path, t->s, t->n);
    free(t->s);
    memset(t, 0, sizeof *t);
    return e;
}

typedef struct { int32_t point; uint32_t image, index; } track_entry;
static int by_track(const void *a, const void *b)
{
    const track_entry *x = a, *y = b;
    if (x->point != y->point) return x->point < y->point ? -1 : 1;
    return (x->image > y->image) - (x->image < y->image);
}

orl_err orl_colmap_write_text(const char *dir, const orl_colmap *m)
{
    text t = { 0 };
    put(&t, "# CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]\n");
    for (uint32_t i = 0; i < m->ncameras; i++) {
        const orl_camera *c = &m->cameras[i];
        put(&t, "%u %s %d %d", i + 1, orl_camera_model_name(c->model), c->w, c->h);
        if (c->model == ORL_CAM_PINHOLE || c->model == ORL_CAM_OPENCV) put(&t, " %.17g %.17g", c->fx, c->fy);
        else put(&t, " %.17g", c->fx);
        put(&t, " %.17g %.17g", c->cx, c->cy);
        if (c->model >= ORL_CAM_SIMPLE_RADIAL) put(&t, " %.17g", c->k1);
        if (c->model >= ORL_CAM_RADIAL) put(&t, " %.17g", c->k2);
        if (c->model == ORL_CAM_OPENCV) put(&t, " %.17g %.17g", c->p1, c->p2);
        put(&t, "\n");
    }
    orl_err e = put_file(&t, dir, "cameras.txt");
    if (e) return e;
    track_entry *track = malloc(((size_t)m->nobs + 1) * sizeof *track);
    if (!track) return orl_fail(ORL_E_MEMORY, "%s: no memory", dir);
    size_t n = 0;
    put(&t, "# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, then POINTS2D[] as (X, Y, POINT3D_ID)\n");
    for (uint32_t i = 0; i < m->nimages; i++) {
        const orl_colmap_image *im = &m->images[i];
        double q[4];
        orl_pose_to_quat(&im->pose, q);
        put(&t, "%u %.17g %.17g %.17g %.17g %.17g %.17g %.17g %d %s\n", im->id, q[0], q[1], q[2], q[3], im->pose.t[0], im->pose.t[1], im->pose.t[2], im->camera + 1, im->name);
        for (uint32_t k = 0; k < im->obs_count; k++) {
            const orl_colmap_obs *o = &m->obs[im->obs_begin + k];
            put(&t, "%s%.9g %.9g %d", k ? " " : "", (double)o->x, (double)o->y, o->point < 0 ? -1 : o->point + 1);
            if (o->point >= 0) track[n++] = (track_entry){ o->point, im->id, k };
        }
        put(&t, "\n");
    }
    if ((e = put_file(&t, dir, "images.txt"))) { free(track); return e; }
    if (n) qsort(track, n, sizeof *track, by_track);
    put(&t, "# POINT3D_ID X Y Z R G B ERROR TRACK[] as (IMAGE_ID, POINT2D_IDX)\n");
    size_t at = 0;
    for (uint32_t i = 0; i < m->npoints; i++) {
        const orl_colmap_point *p = &m->points[i];
        put(&t, "%u %.17g %.17g %.17g %d %d %d %.9g", i + 1, p->xyz[0], p->xyz[1], p->xyz[2], p->rgb[0], p->rgb[1], p->rgb[2], (double)p->error_px);
        for (; at < n && track[at].point == (int32_t)i; at++) put(&t, " %u %u", track[at].image, track[at].index);
        put(&t, "\n");
    }
    free(track);
    return put_file(&t, dir, "points3D.txt");
}
