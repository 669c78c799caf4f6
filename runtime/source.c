/* Sources: opening by specification, and the colour conversion they share. */
#include "oriel/source.h"
#include <errno.h>
#include <string.h>
#include <sys/stat.h>

orl_err orl_source_open(const char *spec, orl_source **out)
{
    if (strncmp(spec, "replay:", 7)) return orl_fail(ORL_E_UNSUPPORTED, "source %s: this build knows replay:PATH", spec);
    const char *path = spec + 7;
    struct stat st;
    if (!strcmp(path, "-")) return orl_source_y4m(stdin, "standard input", out);
    if (!*path) return orl_fail(ORL_E_RANGE, "source %s: no path", spec);
    if (stat(path, &st)) return orl_fail(ORL_E_IO, "%s: %s", path, strerror(errno));
    if (S_ISDIR(st.st_mode)) return orl_source_folder(path, out);
    FILE *f = fopen(path, "rb");
    return f ? orl_source_y4m(f, path, out) : orl_fail(ORL_E_IO, "%s: %s", path, strerror(errno));
}

int orl_source_next(orl_source *s, orl_frame *out)
{
    int got = s->ops->next(s, out);
    s->frame += got != 0;
    return got;
}

void orl_source_close(orl_source *s) { if (s) s->ops->close(s); }

static inline uint8_t clamp8(int v) { return (uint8_t)(v < 0 ? 0 : v > 255 ? 255 : v); }

void orl_frame_to_rgb(const orl_source_info *info, const orl_frame *f, int y0, int y1, uint8_t *rgb, size_t row_bytes)
{
    /* Q14: Y, V to R, U to G, V to G, U to B */
    static const int LIMITED[5] = { 19077, 26149, 6419, 13320, 33050 }, FULL[5] = { 16384, 22970, 5638, 11700, 29032 };
    const int *k = info->full_range ? FULL : LIMITED, black = info->full_range ? 0 : 16;
    int sx = info->pixels == ORL_PIX_420 || info->pixels == ORL_PIX_422, sy = info->pixels == ORL_PIX_420;
    for (int y = y0; y < y1; y++) {
        uint8_t *o = rgb + (size_t)y * row_bytes;
        const uint8_t *py = f->plane[0] + (size_t)y * f->stride[0];
        if (info->pixels == ORL_PIX_RGB) {
            memcpy(o, py, (size_t)info->w * 3);
        } else if (info->pixels == ORL_PIX_MONO) {
            for (int x = 0; x < info->w; x++, o += 3) o[0] = o[1] = o[2] = clamp8(((py[x] - black) * k[0] + 8192) >> 14);
        } else {
            const uint8_t *pu = f->plane[1] + (size_t)(y >> sy) * f->stride[1], *pv = f->plane[2] + (size_t)(y >> sy) * f->stride[2];
            for (int x = 0; x < info->w; x++, o += 3) {
                int l = (py[x] - black) * k[0] + 8192, u = pu[x >> sx] - 128, v = pv[x >> sx] - 128;
                o[0] = clamp8((l + k[1] * v) >> 14);
                o[1] = clamp8((l - k[2] * u - k[3] * v) >> 14);
                o[2] = clamp8((l + k[4] * u) >> 14);
            }
        }
    }
}
