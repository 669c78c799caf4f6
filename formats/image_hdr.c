/* Radiance pictures (.hdr, .pic): shared exponents (RGBE), scan lines flat or in the old or new run lengths, top row first (-Y H +X W), to linear float. No library: the format is small.
 * A header's EXPOSURE and COLORCORR are passed over, as viewers do: values are those of the file. Source: Ward, "Real Pixels", Graphics Gems II; Radiance's file format notes. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "formats/codec.h"

enum { MAX_PIXELS = 1 << 28 };          /* 23170 x 11585: what a header may ask memory for */

/* The next line of the header, without its end; what is longer than the text is cut. 0 at the end of the bytes. */
static int next_line(const uint8_t **p, const uint8_t *end, char *text, size_t cap)
{
    const uint8_t *nl = memchr(*p, '\n', (size_t)(end - *p));
    if (!nl) return 0;
    size_t n = (size_t)(nl - *p);
    while (n && ((*p)[n - 1] == '\r' || (*p)[n - 1] == ' ')) n--;
    n = n < cap - 1 ? n : cap - 1;
    memcpy(text, *p, n);
    text[n] = 0;
    *p = nl + 1;
    return 1;
}

/* New runs: four components one after another; a count above 128 repeats one byte count - 128 times, another is followed by so many bytes. NULL: cut short, or beyond the line. */
static const uint8_t *components(const uint8_t *p, const uint8_t *end, int w, uint8_t (*row)[4])
{
    for (int c = 0; c < 4; c++)
        for (int x = 0; x < w; ) {
            if (end - p < 2) return NULL;
            int n = *p++, repeat = n > 128;
            if (repeat) n -= 128;
            if (n < 1 || n > w - x || (!repeat && n > end - p)) return NULL;
            for (; n; n--, p += !repeat) row[x++][c] = *p;
            p += repeat;
        }
    return p;
}

/* Flat pixels, and old runs: 1 1 1 n repeats the pixel before n times; further ones in a row count 256 times as much each. */
static const uint8_t *pixels(const uint8_t *p, const uint8_t *end, int w, uint8_t (*row)[4])
{
    for (int x = 0, shift = 0; x < w; p += 4) {
        if (end - p < 4) return NULL;
        if (p[0] != 1 || p[1] != 1 || p[2] != 1) {
            memcpy(row[x++], p, 4);
            shift = 0;
            continue;
        }
        int n = shift > 16 ? w : p[3] << shift;
        if (!x || n > w - x) return NULL;
        for (; n; n--, x++) memcpy(row[x], row[x - 1], 4);
        shift += 8;
    }
    return p;
}

static const uint8_t *scan_line(const uint8_t *p, const uint8_t *end, int w, uint8_t (*row)[4])
{
    if (w < 8 || w > 32767 || end - p < 4 || p[0] != 2 || p[1] != 2 || p[2] > 127) return pixels(p, end, w, row);
    return (p[2] << 8 | p[3]) == w ? components(p + 4, end, w, row) : NULL;
}

static void to_float(uint8_t (*row)[4], int w, float *out)
{
    for (int x = 0; x < w; x++) {
        float unit = row[x][3] ? ldexpf(1, row[x][3] - 136) : 0;
        for (int c = 0; c < 3; c++) out[3 * x + c] = (float)row[x][c] * unit;
    }
}

/* To the first byte behind the header. */
static orl_err header(const char *path, const uint8_t **p, const uint8_t *end, int *w, int *h)
{
    char text[128];
    int format = 0, used = 0;
    if (!next_line(p, end, text, sizeof text) || strncmp(text, "#?", 2)) return orl_fail(ORL_E_FORMAT, "%s: not a Radiance picture", path);
    for (;;) {
        if (!next_line(p, end, text, sizeof text)) return orl_fail(ORL_E_FORMAT, "%s: the header has no end", path);
        if (!*text) break;
        if (strncmp(text, "FORMAT=", 7)) continue;
        if (strcmp(text + 7, "32-bit_rle_rgbe")) return orl_fail(ORL_E_UNSUPPORTED, "%s: FORMAT %.60s, only 32-bit_rle_rgbe is read", path, text + 7);
        format = 1;
    }
    if (!format) return orl_fail(ORL_E_FORMAT, "%s: the header has no FORMAT", path);
    if (!next_line(p, end, text, sizeof text)) return orl_fail(ORL_E_FORMAT, "%s: the header has no size", path);
    if (sscanf(text, "-Y %9d +X %9d%n", h, w, &used) == 2 && used && !text[used]) return ORL_OK;
    used = 0;
    if (sscanf(text, "%*1[-+]%*1[XY] %*9d %*1[-+]%*1[XY] %*9d%n", &used) == 0 && used && !text[used]) return orl_fail(ORL_E_UNSUPPORTED, "%s: orientation %.60s, only -Y H +X W is read", path, text);
    return orl_fail(ORL_E_FORMAT, "%s: the line of the size is not -Y H +X W", path);
}

orl_err codec_hdr_read(const char *path, const uint8_t *bytes, size_t n, orl_imagef *out)
{
    const uint8_t *p = bytes, *end = bytes + n;
    orl_imagef o = { 0 };
    int w, h;
    orl_err e = header(path, &p, end, &w, &h);
    if (e) return e;
    if (w < 1 || h < 1 || w > ORL_IMAGE_MAX_SIDE || h > ORL_IMAGE_MAX_SIDE || (int64_t)w * h > MAX_PIXELS) return orl_fail(ORL_E_RANGE, "%s: size %d x %d", path, w, h);
    if ((end - p) / (w > 1 ? 8 : 4) < h) return orl_fail(ORL_E_FORMAT, "%s: size %d x %d, but only %zu bytes of scan lines", path, w, h, (size_t)(end - p));     /* a line is a pixel and a run at least */
    uint8_t (*row)[4] = malloc((size_t)w * sizeof *row);
    e = row ? orl_imagef_alloc(&o, w, h, 3) : orl_fail(ORL_E_MEMORY, "%s: no memory", path);
    for (int y = 0; !e && y < h; y++) {
        if (!(p = scan_line(p, end, w, row))) e = orl_fail(ORL_E_FORMAT, "%s: scan line %d is cut short or runs beyond its end", path, y);
        else to_float(row, w, o.px + (size_t)y * (size_t)w * 3);
    }
    free(row);
    if (e) { orl_imagef_free(&o); return e; }
    *out = o;
    return ORL_OK;
}
