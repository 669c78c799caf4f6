/* Y4M sink: 4:2:0, BT.601 limited range, chroma averaged over its 2 x 2 pixels. A stream: a run that is cut short leaves whole pictures and perhaps a part of one. */
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "runtime/sink.h"

typedef struct {
    orl_sink base;
    FILE *f;
    char name[256];
    uint8_t *picture;
    size_t bytes;
} y4m;

void orl_rgb_to_420(const uint8_t *rgb0, const uint8_t *rgb1, int w, uint8_t *y0, uint8_t *y1, uint8_t *u, uint8_t *v)
{
    for (int x = 0; x < w; x++) {
        const uint8_t *a = rgb0 + 3 * (size_t)x, *b = rgb1 + 3 * (size_t)x;
        y0[x] = (uint8_t)((16829 * a[0] + 33039 * a[1] + 6416 * a[2] + 0x108000) >> 16);
        y1[x] = (uint8_t)((16829 * b[0] + 33039 * b[1] + 6416 * b[2] + 0x108000) >> 16);
    }
    for (int x = 0; x < w; x += 2) {
        size_t i = 3 * (size_t)x, k = x + 1 < w ? i + 3 : i;
        int r = rgb0[i] + rgb0[k] + rgb1[i] + rgb1[k], g = rgb0[i + 1] + rgb0[k + 1] + rgb1[i + 1] + rgb1[k + 1], b = rgb0[i + 2] + rgb0[k + 2] + rgb1[i + 2] + rgb1[k + 2];
        u[x / 2] = (uint8_t)((-9714 * r - 19070 * g + 28784 * b + 0x2020000) >> 18);
        v[x / 2] = (uint8_t)((28784 * r - 24103 * g - 4681 * b + 0x2020000) >> 18);
    }
}

static orl_err y4m_put(orl_sink *s, const uint8_t *rgb, size_t row_bytes)
{
    y4m *o = (y4m *)s;
    size_t w = (size_t)s->w, cw = (w + 1) / 2, luma = w * (size_t)s->h;
    uint8_t *u = o->picture + luma, *v = u + cw * (((size_t)s->h + 1) / 2);
    for (int y = 0; y < s->h; y += 2, u += cw, v += cw) {
        int y2 = y + 1 < s->h ? y + 1 : y;
        orl_rgb_to_420(rgb + (size_t)y * row_bytes, rgb + (size_t)y2 * row_bytes, s->w, o->picture + (size_t)y * w, o->picture + (size_t)y2 * w, u, v);
    }
    if (fwrite("FRAME\n", 1, 6, o->f) != 6 || fwrite(o->picture, 1, o->bytes, o->f) != o->bytes)
        return orl_fail(ORL_E_IO, "%s: picture %ld: %s", o->name, s->frame, strerror(errno));
    return ORL_OK;
}

static orl_err y4m_close(orl_sink *s, char *line, size_t cap)
{
    (void)line; (void)cap;
    y4m *o = (y4m *)s;
    orl_err e = fflush(o->f) ? orl_fail(ORL_E_IO, "%s: %s", o->name, strerror(errno)) : ORL_OK;
    if (o->f != stdout && fclose(o->f) && !e) e = orl_fail(ORL_E_IO, "%s: %s", o->name, strerror(errno));
    free(o->picture);
    free(o);
    return e;
}

orl_err orl_sink_y4m(const char *path, int w, int h, int fps_num, int fps_den, orl_sink **out)
{
    static const orl_sink_ops OPS = { y4m_put, y4m_close };
    int to_stdout = !strcmp(path, "-");
    const char *name = to_stdout ? "standard output" : path;
    if (!*path) return orl_fail(ORL_E_RANGE, "sink y4m: no file");
    y4m *o = calloc(1, sizeof *o);
    size_t bytes = (size_t)w * (size_t)h + 2 * (((size_t)w + 1) / 2) * (((size_t)h + 1) / 2);
    uint8_t *picture = malloc(bytes);
    orl_err e = o && picture ? ORL_OK : orl_fail(ORL_E_MEMORY, "sink y4m: no memory");
    if (!e) {
        *o = (y4m) { .base = { &OPS, w, h, 0 }, .f = to_stdout ? stdout : fopen(path, "wb"), .picture = picture, .bytes = bytes };
        snprintf(o->name, sizeof o->name, "%s", name);
        if (!o->f) e = orl_fail(ORL_E_IO, "%s: %s", name, strerror(errno));
        else if (fprintf(o->f, "YUV4MPEG2 W%d H%d F%d:%d Ip A1:1 C420jpeg\n", w, h, fps_num, fps_den) < 0) e = orl_fail(ORL_E_IO, "%s: %s", name, strerror(errno));
    }
    if (e) {
        if (o && o->f && o->f != stdout) fclose(o->f);
        free(o); free(picture);
        return e;
    }
    *out = &o->base;
    return ORL_OK;
}
