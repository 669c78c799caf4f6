/* Pictures as sources hand them out: how their planes lie, whether they are whole, and the conversion to RGB. */
#include <string.h>
#include "runtime/kernels/convert.h"

enum { PLANES = 3, SIDE_MAX = 65535 };

/* bytes: of a pixel in the first plane, for which the width is rounded up to a multiple of `group`; chroma: of a sample in the others; sx, sy: log2 of the pixels that it stands for. */
static const struct { const char *name; int planes, bytes, group, chroma, sx, sy; } LAYOUT[ORL_PIX_COUNT] = {
    [ORL_PIX_MONO] = { "mono", 1, 1, 1, 0, 0, 0 }, [ORL_PIX_420] = { "i420", 3, 1, 1, 1, 1, 1 }, [ORL_PIX_422] = { "i422", 3, 1, 1, 1, 1, 0 }, [ORL_PIX_444] = { "i444", 3, 1, 1, 1, 0, 0 },
    [ORL_PIX_RGB] = { "rgb24", 1, 3, 1, 0, 0, 0 }, [ORL_PIX_BGR] = { "bgr24", 1, 3, 1, 0, 0, 0 }, [ORL_PIX_NV12] = { "nv12", 2, 1, 1, 2, 1, 1 }, [ORL_PIX_NV21] = { "nv21", 2, 1, 1, 2, 1, 1 },
    [ORL_PIX_YUYV] = { "yuyv", 1, 2, 2, 0, 0, 0 }, [ORL_PIX_UYVY] = { "uyvy", 1, 2, 2, 0, 0, 0 },
};

const char *orl_pixels_name(orl_pixels p) { return LAYOUT[p].name; }

orl_pixels orl_pixels_from_name(const char *name)
{
    int p = 0;
    while (p < ORL_PIX_COUNT && strcmp(name, LAYOUT[p].name)) p++;
    return (orl_pixels)p;
}

/* Bytes of w pixels in a row of plane k. */
static size_t row_size(orl_pixels p, int k, int w)
{
    int sx = LAYOUT[p].sx, group = LAYOUT[p].group;
    return k ? (size_t)LAYOUT[p].chroma * (size_t)((w + sx) >> sx) : (size_t)LAYOUT[p].bytes * (size_t)((w + group - 1) / group * group);
}

static size_t rows(const orl_source_info *i, int k)
{
    int sy = k ? LAYOUT[i->pixels].sy : 0;
    return (size_t)((i->h + sy) >> sy);
}

size_t orl_frame_layout(const orl_source_info *info, const uint8_t *base, orl_frame *out)
{
    size_t total = 0;
    *out = (orl_frame) { { NULL }, { 0 }, { 0 } };
    for (int k = 0; k < LAYOUT[info->pixels].planes; k++) {
        out->plane[k] = base ? base + total : NULL;
        out->stride[k] = row_size(info->pixels, k, info->w);
        out->bytes[k] = out->stride[k] * rows(info, k);
        total += out->bytes[k];
    }
    return total;
}

orl_err orl_frame_check(const orl_source_info *i, const orl_frame *f)
{
    if (i->w < 1 || i->h < 1 || i->w > SIDE_MAX || i->h > SIDE_MAX) return orl_fail(ORL_E_RANGE, "%d x %d is no size of a picture", i->w, i->h);
    if ((unsigned)i->pixels >= ORL_PIX_COUNT) return orl_fail(ORL_E_UNSUPPORTED, "pixel format %d is not known", (int)i->pixels);
    for (int k = 0; k < LAYOUT[i->pixels].planes; k++) {
        size_t row = row_size(i->pixels, k, i->w), more = rows(i, k) - 1;
        if (!f->plane[k]) return orl_fail(ORL_E_RANGE, "%s plane %d is missing", LAYOUT[i->pixels].name, k);
        if (f->stride[k] < row) return orl_fail(ORL_E_RANGE, "%s plane %d: rows lie %zu bytes apart, %d pixels take %zu", LAYOUT[i->pixels].name, k, f->stride[k], i->w, row);
        if (f->bytes[k] < row || (more && (f->bytes[k] - row) / more < f->stride[k]))
            return orl_fail(ORL_E_RANGE, "%s plane %d: %zu bytes do not hold %zu rows, %zu bytes apart", LAYOUT[i->pixels].name, k, f->bytes[k], more + 1, f->stride[k]);
    }
    return ORL_OK;
}

void orl_frame_to_rgb(const orl_source_info *info, const orl_frame *f, unsigned cpu, int y0, int y1, uint8_t *rgb, size_t row_bytes)
{
    const orl_pixels px = info->pixels;
    const int planes = LAYOUT[px].planes, whole = info->w / ORL_CONVERT_STEP * ORL_CONVERT_STEP, rest = info->w - whole;
    uint8_t in[PLANES][4 * ORL_CONVERT_STEP] = { { 0 } }, out[3 * ORL_CONVERT_STEP];
    const uint8_t *const padded[PLANES] = { in[0], in[1], in[2] };
    orl_convert_kernels kernels;
    orl_yuv_tab t;
    orl_convert_kernels_init(&kernels, cpu);
    orl_yuv_table(info, &t);
    for (int y = y0; y < y1; y++) {
        const uint8_t *p[PLANES];
        uint8_t *o = rgb + (size_t)y * row_bytes;
        for (int k = 0; k < PLANES; k++) p[k] = k < planes ? f->plane[k] + (size_t)(k ? y >> LAYOUT[px].sy : y) * f->stride[k] : p[0];
        kernels.row[px](p, &t, whole, o);
        if (!rest) continue;
        for (int k = 0; k < planes; k++) {
            size_t from = row_size(px, k, whole);
            memcpy(in[k], p[k] + from, row_size(px, k, info->w) - from);
        }
        kernels.row[px](padded, &t, ORL_CONVERT_STEP, out);
        memcpy(o + 3 * whole, out, 3 * (size_t)rest);
    }
}
