/* SCENE folders (include/oriel/dataset.h): which photos there are, which train, and where their cameras and masks come from. */
#include "oriel/dataset.h"
#include <dirent.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

typedef void (*warn_fn)(void *, const char *);

/* The C++ side (photo.cpp): decodes with OpenImageIO, EXIF orientation applied. turned: the orientation swapped the sides. */
orl_err photo_decode(const char *path, int channels, orl_image *out, int *turned);

static int exists(const char *path) { struct stat st; return !stat(path, &st); }

static void say(warn_fn warn, void *user, const char *fmt, ...)
{
    char line[700];
    va_list ap;
    va_start(ap, fmt);
    vsnprintf(line, sizeof line, fmt, ap);
    va_end(ap);
    if (warn) warn(user, line);
}

/* split.tsv (or NeRF-W's file): columns found by their heading. */
typedef struct { char *text; int name, split; } split;

enum { FIELDS = 8 };

/* Cuts the line at *p into fields and steps behind it; 0 at the end. */
static int next_row(const char **p, const char **f, size_t *fl)
{
    const char *line = *p, *end = line + strcspn(line, "\n");
    int n = 0;
    if (!*line) return 0;
    for (const char *q = line; n < FIELDS && q <= end; q += fl[n++] + 1) {
        f[n] = q;
        fl[n] = strcspn(q, "\t\r\n");
    }
    *p = end + (*end == '\n');
    return n;
}

static int is(const char *f, size_t n, const char *word) { return n == strlen(word) && !memcmp(f, word, n); }

/* Finds the columns; 0 if a heading lacks. */
static int split_columns(split *s)
{
    const char *p = s->text, *f[FIELDS];
    size_t fl[FIELDS];
    s->name = s->split = -1;
    for (int i = next_row(&p, f, fl); i--;) {
        if (is(f[i], fl[i], "filename")) s->name = i;
        if (is(f[i], fl[i], "split")) s->split = i;
    }
    return s->name >= 0 && s->split >= 0;
}

/* Returns 1 test, 0 train, -1 not listed, -2 neither (NeRF-W leaves the split of photos empty that it does not use). */
static int split_of(const split *s, const char *name)
{
    if (!s->text) return 0;
    const char *p = s->text, *f[FIELDS];
    size_t fl[FIELDS];
    next_row(&p, f, fl);
    for (int n; (n = next_row(&p, f, fl));)
        if (n > s->name && n > s->split && is(f[s->name], fl[s->name], name)) return is(f[s->split], fl[s->split], "test") ? 1 : is(f[s->split], fl[s->split], "train") ? 0 : -2;
    return -1;
}

static int is_tsv(const struct dirent *e) { size_t n = strlen(e->d_name); return n > 4 && !strcmp(e->d_name + n - 4, ".tsv"); }
static int by_tsv(const struct dirent **a, const struct dirent **b)
{
    int x = strcmp((*a)->d_name, "split.tsv") != 0, y = strcmp((*b)->d_name, "split.tsv") != 0;
    return x != y ? x - y : strcmp((*a)->d_name, (*b)->d_name);
}

/* The first *.tsv of the folder, then of the one above, that names a photo of the model; split.tsv comes before others. The folder's own split.tsv must be sound. */
static orl_err load_split(const char *dir, const orl_colmap *m, warn_fn warn, void *user, split *out)
{
    orl_err e = ORL_OK;
    for (int up = 0; up < 2; up++) {
        char folder[1100], path[1400];
        struct dirent **list = NULL;
        snprintf(folder, sizeof folder, "%s%s", dir, up ? "/.." : "");
        int n = scandir(folder, &list, is_tsv, by_tsv);
        for (int i = 0; i < n; i++) {
            int own = !up && !strcmp(list[i]->d_name, "split.tsv");
            snprintf(path, sizeof path, "%s/%s", folder, list[i]->d_name);
            free(list[i]);
            split s = { 0 };
            size_t bytes;
            if (e || out->text) continue;
            e = orl_file_read(path, 64 << 20, (uint8_t **)&s.text, &bytes);
            if (!e && !split_columns(&s)) e = orl_fail(ORL_E_FORMAT, "%s: its first line lacks the column `filename` or `split`", path);
            int listed = 0;
            for (uint32_t k = 0; !e && !listed && k < m->nimages; k++) listed = split_of(&s, m->images[k].name) != -1;
            if (own && !e && !listed) say(warn, user, "%s: names no photo of the model, ignored", path);
            if (listed) *out = s;
            else free(s.text);
            if (!own) e = ORL_OK;
        }
        free(list);
    }
    return e;
}

/* A name that would lead out of the folder of photos. */
static int strays(const char *name)
{
    for (const char *s = name; s; s = strchr(s, '/'), s += s != NULL) if (!strncmp(s, "..", 2) && (s[2] == '/' || !s[2])) return 1;
    return 0;
}

static int by_image(const void *a, const void *b) { return strcmp(((const orl_colmap_image *)a)->name, ((const orl_colmap_image *)b)->name); }
static int has_image(const orl_colmap *m, const char *name)
{
    orl_colmap_image key;
    snprintf(key.name, sizeof key.name, "%s", name);
    return m->nimages && bsearch(&key, m->images, m->nimages, sizeof key, by_image);
}

static int by_name(const void *a, const void *b) { return strcmp(((const orl_photo *)a)->name, ((const orl_photo *)b)->name); }

/* Folder of the photos and of the model, for the layouts that we know. */
static orl_err find_layout(const char *dir, char *photos, char *sparse, size_t cap)
{
    static const char *const BASE[] = { "", "/dense" }, *const PHOTOS[] = { "photos", "images" }, *const SPARSE[] = { "sparse/0", "sparse" };
    char probe[1200];
    photos[0] = sparse[0] = 0;
    for (int b = 0; b < 2; b++)
        for (int i = 0; i < 2; i++) {
            snprintf(probe, sizeof probe, "%s%s/%s", dir, BASE[b], PHOTOS[i]);
            if (!photos[0] && exists(probe)) snprintf(photos, cap, "%.*s", (int)cap - 1, probe);
            for (int k = 0; k < 2; k++) {
                snprintf(probe, sizeof probe, "%s%s/%s/cameras.%s", dir, BASE[b], SPARSE[i], k ? "txt" : "bin");
                if (!sparse[0] && exists(probe)) snprintf(sparse, cap, "%s%s/%s", dir, BASE[b], SPARSE[i]);
            }
        }
    if (!photos[0]) return orl_fail(ORL_E_IO, "%s: no photos/ or images/ folder", dir);
    if (!sparse[0]) return orl_fail(ORL_E_IO, "%s: no COLMAP model in sparse/0 or sparse", dir);
    return ORL_OK;
}

orl_err orl_dataset_open(const char *dir, warn_fn warn, void *user, orl_dataset *out)
{
    orl_dataset d = { 0 };
    orl_colmap m = { 0 }, t = { 0 };
    split sp = { 0 };
    char photos[1024], sparse[1024], path[2048];
    struct stat st;
    char trimmed[1024];
    snprintf(trimmed, sizeof trimmed, "%s", dir);
    while (strlen(trimmed) > 1 && trimmed[strlen(trimmed) - 1] == '/') trimmed[strlen(trimmed) - 1] = 0;
    dir = trimmed;
    if (stat(dir, &st) || !S_ISDIR(st.st_mode)) return orl_fail(ORL_E_IO, "%s: no such folder", dir);
    orl_err e = find_layout(dir, photos, sparse, sizeof photos);
    if (e) return e;
    snprintf(d.dir, sizeof d.dir, "%s", dir);
    const char *slash = strrchr(dir, '/');
    snprintf(d.name, sizeof d.name, "%.127s", slash ? slash + 1 : dir);
    if ((e = orl_colmap_read(sparse, warn, user, &m))) return e;
    snprintf(path, sizeof path, "%s/sparse_test/0", dir);
    if (exists(path) && (e = orl_colmap_read(path, warn, user, &t))) goto done;
    if ((e = load_split(dir, &m, warn, user, &sp))) goto done;
    d.photos = calloc((size_t)m.nimages + t.nimages + 1, sizeof *d.photos);
    d.obs = calloc((size_t)m.nobs + 1, sizeof *d.obs);
    d.points = calloc((size_t)m.npoints + 1, sizeof *d.points);
    uint32_t *track = calloc((size_t)m.npoints + 1, sizeof *track), *where = calloc((size_t)m.npoints + 1, sizeof *where);
    if (!d.photos || !d.obs || !d.points || !track || !where) { free(track); free(where); e = orl_fail(ORL_E_MEMORY, "%s: no memory", dir); goto done; }
    for (int k = 0; k < 2; k++) {
        const orl_colmap *c = k ? &t : &m;
        for (uint32_t i = 0; i < c->nimages; i++) {
            const orl_colmap_image *im = &c->images[i];
            orl_photo *p = &d.photos[d.nphotos];
            memset(p, 0, sizeof *p);
            int which = k ? 1 : split_of(&sp, im->name);
            if (!k && has_image(&t, im->name)) continue;    /* a test camera kept apart: must not train */
            if (strays(im->name)) { say(warn, user, "%s: leads out of the folder, skipped", im->name); continue; }
            snprintf(p->name, sizeof p->name, "%s", im->name);
            if ((size_t)snprintf(p->path, sizeof p->path, "%s/%s", photos, im->name) >= sizeof p->path || !exists(p->path)) {
                say(warn, user, "%s: camera without photo, skipped", im->name);
                continue;
            }
            if (which < 0) { say(warn, user, "%s: neither train nor test in the split file, skipped", im->name); continue; }
            p->test = which;
            p->cam = c->cameras[im->camera];
            p->pose = im->pose;
            char stem[256];
            snprintf(stem, sizeof stem, "%s", im->name);
            char *dot = strrchr(stem, '.');
            if (dot) *dot = 0;
            if ((size_t)snprintf(p->mask, sizeof p->mask, "%s/masks/%s.png", dir, stem) >= sizeof p->mask || !exists(p->mask)) p->mask[0] = 0;
            if (!p->test) {
                p->obs_begin = d.nobs;
                p->obs_count = im->obs_count;
                for (uint32_t j = 0; j < im->obs_count; j++) {
                    orl_colmap_obs o = c->obs[im->obs_begin + j];
                    if (o.point >= 0 && where[o.point] != d.nphotos + 1) {  /* where: the last photo that saw it; a photo may see a point twice */
                        where[o.point] = d.nphotos + 1;
                        track[o.point]++;
                    }
                    d.obs[d.nobs++] = o;
                }
            }
            d.nphotos++;
        }
    }
    for (uint32_t i = 0; i < m.npoints; i++) {
        where[i] = UINT32_MAX;
        if (track[i] < 2) continue;
        where[i] = d.npoints;
        d.points[d.npoints] = m.points[i];
        d.points[d.npoints++].track_length = track[i];
    }
    for (uint32_t i = 0; i < d.nobs; i++) if (d.obs[i].point >= 0) d.obs[i].point = where[d.obs[i].point] == UINT32_MAX ? -1 : (int32_t)where[d.obs[i].point];
    free(track);
    free(where);
    if (d.nphotos) qsort(d.photos, d.nphotos, sizeof *d.photos, by_name);
    DIR *dp = opendir(photos);
    for (struct dirent *en; dp && (en = readdir(dp));) {
        snprintf(path, sizeof path, "%s/%s", photos, en->d_name);
        if (en->d_name[0] == '.' || stat(path, &st) || S_ISDIR(st.st_mode)) continue;
        if (!has_image(&m, en->d_name) && !has_image(&t, en->d_name)) say(warn, user, "%s: photo without camera, skipped", en->d_name);
    }
    if (dp) closedir(dp);
    if (!d.nphotos) e = orl_fail(ORL_E_FORMAT, "%s: no photo has a camera", dir);
done:
    orl_colmap_free(&m);
    orl_colmap_free(&t);
    free(sp.text);
    if (e) { orl_dataset_free(&d); return e; }
    *out = d;
    return ORL_OK;
}

void orl_dataset_free(orl_dataset *d)
{
    free(d->photos);
    free(d->obs);
    free(d->points);
    memset(d, 0, sizeof *d);
}

orl_err orl_photo_load(const orl_photo *p, int long_side, orl_image *out, orl_camera *cam)
{
    orl_image full = { 0 }, small = { 0 };
    int turned = 0, w, h;
    orl_err e = photo_decode(p->path, 3, &full, &turned);
    if (e) return e;
    if (full.w != p->cam.w || full.h != p->cam.h) {
        e = orl_fail(ORL_E_FORMAT, "%s: photo is %d x %d%s, its camera %d x %d", p->path, full.w, full.h, turned ? " (turned by EXIF)" : "", p->cam.w, p->cam.h);
        orl_image_free(&full);
        return e;
    }
    orl_size_long_side(full.w, full.h, long_side, &w, &h);
    if (w != full.w || h != full.h) {
        e = orl_image_resize_area(&full, w, h, &small);
        orl_image_free(&full);
        if (e) return e;
        full = small;
    }
    if (cam) *cam = orl_camera_resized(&p->cam, w, h);
    *out = full;
    return ORL_OK;
}

orl_err orl_photo_load_mask(const orl_photo *p, int w, int h, orl_image *out)
{
    orl_image full = { 0 }, o = { 0 };
    int turned;
    if (!p->mask[0]) return orl_fail(ORL_E_IO, "%s: no mask given", p->name);
    orl_err e = photo_decode(p->mask, 1, &full, &turned);
    if (!e && llabs((long long)full.w * p->cam.h - (long long)full.h * p->cam.w) > p->cam.w + p->cam.h)     /* smaller or larger is fine */
        e = orl_fail(ORL_E_FORMAT, "%s: mask is %d x %d, its photo %d x %d", p->mask, full.w, full.h, p->cam.w, p->cam.h);
    if (!e) e = orl_image_alloc(&o, w, h, 1);
    for (int y = 0; !e && y < h; y++)
        for (int x = 0; x < w; x++) o.px[(size_t)y * (size_t)w + (size_t)x] = full.px[(size_t)((2 * y + 1) * full.h / (2 * h)) * (size_t)full.w + (size_t)((2 * x + 1) * full.w / (2 * w))];
    orl_image_free(&full);
    if (!e) *out = o;
    return e;
}
