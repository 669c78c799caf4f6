/* Files sink: one picture file a frame, DIR/PATTERN with the frame's number, format by ending. The folder is made if it is not there. */
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include "oriel/image.h"
#include "runtime/sink.h"

typedef struct {
    orl_sink base;
    char head[1024], tail[256];         /* path before and after the number */
    int digits;
    uint8_t *rows;
} files;

static orl_err files_put(orl_sink *s, const uint8_t *rgb, size_t row_bytes)
{
    files *f = (files *)s;
    char path[2048];
    size_t row = (size_t)s->w * 3;
    for (int y = 0; y < s->h; y++) memcpy(f->rows + (size_t)y * row, rgb + (size_t)y * row_bytes, row);
    snprintf(path, sizeof path, "%s%0*ld%s", f->head, f->digits, s->frame, f->tail);
    orl_image im = { s->w, s->h, 3, f->rows };
    return orl_image_write(path, &im);
}

static orl_err files_close(orl_sink *s, char *line, size_t cap)
{
    (void)line; (void)cap;
    free(((files *)s)->rows);
    free(s);
    return ORL_OK;
}

/* Splits PATTERN at its one %d or %0Nd. */
static orl_err split(files *f, const char *dir, const char *pattern)
{
    const char *p = strchr(pattern, '%'), *q = p ? p + 1 : NULL;
    int digits = 0;
    if (p && *q == '0' && q[1] >= '1' && q[1] <= '9') {
        digits = q[1] - '0';
        q += 2;
    }
    if (!p || *q != 'd' || strchr(q, '%')) return orl_fail(ORL_E_RANGE, "sink files: pattern '%s' needs one %%d or %%0Nd", pattern);
    int head = snprintf(f->head, sizeof f->head, "%s/%.*s", dir, (int)(p - pattern), pattern), tail = snprintf(f->tail, sizeof f->tail, "%s", q + 1);
    if (head >= (int)sizeof f->head || tail >= (int)sizeof f->tail) return orl_fail(ORL_E_RANGE, "sink files: the path is too long");
    f->digits = digits;
    return ORL_OK;
}

orl_err orl_sink_files(const char *where, int w, int h, orl_sink **out)
{
    static const orl_sink_ops OPS = { files_put, files_close };
    const char *slash = strrchr(where, '/'), *last = slash ? slash + 1 : where;
    int given = strchr(last, '%') != NULL;
    char dir[1024];
    if (!*where) return orl_fail(ORL_E_RANGE, "sink files: no folder");
    if (!given) snprintf(dir, sizeof dir, "%s", where);
    else snprintf(dir, sizeof dir, "%.*s", slash ? (int)(slash - where) : 1, slash ? where : ".");
    files *f = calloc(1, sizeof *f);
    uint8_t *rows = malloc((size_t)w * (size_t)h * 3);
    orl_err e = f && rows ? split(f, dir, given ? last : "%06d.png") : orl_fail(ORL_E_MEMORY, "sink files: no memory");
    if (!e && *dir && mkdir(dir, 0777) && errno != EEXIST) e = orl_fail(ORL_E_IO, "%s: cannot make the folder: %s", dir, strerror(errno));
    if (e) {
        free(f); free(rows);
        return e;
    }
    f->rows = rows;
    f->base = (orl_sink) { &OPS, w, h, 0 };
    *out = &f->base;
    return ORL_OK;
}
