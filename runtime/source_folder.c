/* Folder source: the .jpg, .jpeg and .png files of a folder as one recording, in the order of their names (bytes compared). All must have the size of the first that can be read;
 * one that cannot be read or differs in size is a lost picture. */
#include <dirent.h>
#include <errno.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include "oriel/image.h"
#include "oriel/source.h"

typedef struct {
    orl_source base;
    char dir[1024];
    struct dirent **names;
    int count, at;
    orl_image picture;
} folder;

static void folder_close(orl_source *s)
{
    folder *f = (folder *)s;
    for (int i = 0; i < f->count; i++) free(f->names[i]);
    free(f->names);
    orl_image_free(&f->picture);
    free(f);
}

static orl_err load(folder *f, int i, orl_image *out)
{
    char path[2048];
    snprintf(path, sizeof path, "%s/%s", f->dir, f->names[i]->d_name);
    orl_err e = orl_image_read(path, 3, out);
    if (!e && out->c != 3) {
        orl_image_free(out);
        e = orl_fail(ORL_E_FORMAT, "%s: not a colour picture", path);
    }
    return e;
}

static int folder_next(orl_source *s, orl_frame *out)
{
    folder *f = (folder *)s;
    orl_image im;
    if (f->at >= f->count) return 0;
    int i = f->at++;
    if (load(f, i, &im)) return -1;
    if (im.w != s->info.w || im.h != s->info.h) {
        orl_fail(ORL_E_FORMAT, "%s/%s: %d x %d pixels where the recording has %d x %d", f->dir, f->names[i]->d_name, im.w, im.h, s->info.w, s->info.h);
        orl_image_free(&im);
        return -1;
    }
    orl_image_free(&f->picture);
    f->picture = im;
    orl_frame_layout(&s->info, im.px, out);
    return 1;
}

static int is_picture(const struct dirent *d)
{
    const char *dot = strrchr(d->d_name, '.');
    return d->d_name[0] != '.' && dot && (!strcasecmp(dot, ".jpg") || !strcasecmp(dot, ".jpeg") || !strcasecmp(dot, ".png"));
}

static int by_name(const struct dirent **a, const struct dirent **b) { return strcmp((*a)->d_name, (*b)->d_name); }

orl_err orl_source_folder(const char *dir, orl_source **out)
{
    static const orl_source_ops OPS = { folder_next, folder_close };
    folder *f = calloc(1, sizeof *f);
    if (!f) return orl_fail(ORL_E_MEMORY, "%s: no memory", dir);
    f->base.ops = &OPS;
    snprintf(f->dir, sizeof f->dir, "%s", dir);
    f->count = scandir(dir, &f->names, is_picture, by_name);
    orl_err e = ORL_OK;
    if (f->count < 0) {
        f->count = 0;
        e = orl_fail(ORL_E_IO, "%s: %s", dir, strerror(errno));
    } else if (!f->count) {
        e = orl_fail(ORL_E_RANGE, "%s: no .jpg, .jpeg or .png files", dir);
    } else {
        orl_image im = { 0 };
        int i = 0;
        while (i < f->count && (e = load(f, i, &im))) i++;      /* if none can be read, the last one's message stands */
        f->base.info = (orl_source_info) { .w = im.w, .h = im.h, .pixels = ORL_PIX_RGB, .full_range = 1, .fps_num = 25, .fps_den = 1 };
        orl_image_free(&im);
    }
    if (e) folder_close(&f->base);
    else *out = &f->base;
    return e;
}
