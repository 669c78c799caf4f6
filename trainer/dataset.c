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

/* split.tsv (or NeRF-W's file): columns found by their heading. Returns 1 test, 0 train, -1 not listed. */
typedef struct { char *text; } split;

static int split_of(const split *s, const char *name)
{
    if (!s->text) return 0;
    int col_name = 0, col_split = 2, row = 0;
    for (const char *p = s->text; *p; row++) {
        const char *e = strchr(p, '\n');
        size_t len = e ? (size_t)(e - p) : strlen(p);
        const char *f[8];
        size_t fl[8];
        int n = 0;
        for (const char *q = p; n < 8 && q <= p + len;) {
            size_t k = strcspn(q, "\t\r\n");
            if (k > (size_t)(p + len - q)) k = (size_t)(p + len - q);
            f[n] = q;
            fl[n++] = k;
            q += k + 1;
        }
        if (row == 0) {
            for (int i = 0; i < n; i++) {
                if (fl[i] == 8 && !strncmp(f[i], "filename", 8)) col_name = i;
                if (fl[i] == 5 && !strncmp(f[i], "split", 5)) col_split = i;
            }
        } else if (n > col_name && n > col_split && fl[col_name] == strlen(name) && !strncmp(f[col_name], name, fl[col_name])) {
            return fl[col_split] == 4 && !strncmp(f[col_split], "test", 4);
        }
        if (!e) break;
        p = e + 1;
    }
    return -1;
}

/* First *.tsv in a folder, split.tsv before others. */
static void find_tsv(const char *dir, char *out, size_t cap)
{
    snprintf(out, cap, "%s/split.tsv", dir);
    if (exists(out)) return;
    out[0] = 0;
    DIR *d = opendir(dir);
    if (!d) return;
    char best[256] = "";
    for (struct dirent *e; (e = readdir(d));) {
        size_t n = strlen(e->d_name);
        if (n > 4 && n < sizeof best && !strcmp(e->d_name + n - 4, ".tsv") && (!best[0] || strcmp(e->d_name, best) < 0)) snprintf(best, sizeof best, "%.255s", e->d_name);
    }
    closedir(d);
    if (best[0]) snprintf(out, cap, "%s/%s", dir, best);
}

static int by_name(const void *a, const void *b) { return strcmp(((const orl_photo *)a)->name, ((const orl_photo *)b)->name); }

/* Folder of the photos, of the model, and of the split, for the layouts that we know. */
static orl_err find_layout(const char *dir, char *photos, char *sparse, char *tsv, size_t cap)
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
    find_tsv(dir, tsv, cap);
    if (!tsv[0]) {
        snprintf(probe, sizeof probe, "%s/..", dir);
        find_tsv(probe, tsv, cap);              /* NeRF-W's file may lie above; it must name this folder's photos to count */
    }
    return ORL_OK;
}

orl_err orl_dataset_open(const char *dir, warn_fn warn, void *user, orl_dataset *out)
{
    orl_dataset d = { 0 };
    orl_colmap m = { 0 }, t = { 0 };
    split sp = { 0 };
    char photos[1024], sparse[1024], tsv[1024], path[2048];
    size_t bytes;
    struct stat st;
    char trimmed[1024];
    snprintf(trimmed, sizeof trimmed, "%s", dir);
    while (strlen(trimmed) > 1 && trimmed[strlen(trimmed) - 1] == '/') trimmed[strlen(trimmed) - 1] = 0;
    dir = trimmed;
    if (stat(dir, &st) || !S_ISDIR(st.st_mode)) return orl_fail(ORL_E_IO, "%s: no such folder", dir);
    orl_err e = find_layout(dir, photos, sparse, tsv, sizeof photos);
    if (e) return e;
    snprintf(d.dir, sizeof d.dir, "%s", dir);
    const char *slash = strrchr(dir, '/');
    snprintf(d.name, sizeof d.name, "%.127s", slash ? slash + 1 : dir);
    if ((e = orl_colmap_read(sparse, warn, user, &m))) return e;
    snprintf(path, sizeof path, "%s/sparse_test/0", dir);
    if (exists(path) && (e = orl_colmap_read(path, warn, user, &t))) goto done;
    if (tsv[0] && (e = orl_file_read(tsv, 64 << 20, (uint8_t **)&sp.text, &bytes))) goto done;
    if (sp.text) {                              /* a split file of another place does not count */
        int listed = 0;
        for (uint32_t i = 0; i < m.nimages; i++) listed += split_of(&sp, m.images[i].name) >= 0;
        if (!listed) { free(sp.text); sp.text = NULL; }
    }
    d.photos = calloc((size_t)m.nimages + t.nimages + 1, sizeof *d.photos);
    d.obs = calloc((size_t)m.nobs + 1, sizeof *d.obs);
    d.points = calloc((size_t)m.npoints + 1, sizeof *d.points);
    uint32_t *track = calloc((size_t)m.npoints + 1, sizeof *track), *where = malloc(((size_t)m.npoints + 1) * sizeof *where);
    if (!d.photos || !d.obs || !d.points || !track || !where) { free(track); free(where); e = orl_fail(ORL_E_MEMORY, "%s: no memory", dir); goto done; }
    for (int k = 0; k < 2; k++) {
        const orl_colmap *c = k ? &t : &m;
        for (uint32_t i = 0; i < c->nimages; i++) {
            const orl_colmap_image *im = &c->images[i];
            orl_photo *p = &d.photos[d.nphotos];
            memset(p, 0, sizeof *p);
            int which = k ? 1 : split_of(&sp, im->name);
            snprintf(p->name, sizeof p->name, "%s", im->name);
            if ((size_t)snprintf(p->path, sizeof p->path, "%s/%s", photos, im->name) >= sizeof p->path || !exists(p->path)) {
                say(warn, user, "%s: camera without photo, skipped", im->name);
                continue;
            }
            if (which < 0) { say(warn, user, "%s: not in the split file, skipped", im->name); continue; }
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
                    if (o.point >= 0) track[o.point]++;
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
        if (en->d_name[0] == '.') continue;
        orl_photo key;
        snprintf(key.name, sizeof key.name, "%s", en->d_name);
        if (!d.nphotos || !bsearch(&key, d.photos, d.nphotos, sizeof key, by_name)) say(warn, user, "%s: photo without camera, skipped", en->d_name);
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
    if (!e) e = orl_image_alloc(&o, w, h, 1);
    for (int y = 0; !e && y < h; y++)
        for (int x = 0; x < w; x++) o.px[(size_t)y * (size_t)w + (size_t)x] = full.px[(size_t)((2 * y + 1) * full.h / (2 * h)) * (size_t)full.w + (size_t)((2 * x + 1) * full.w / (2 * w))];
    orl_image_free(&full);
    if (!e) *out = o;
    return e;
}
