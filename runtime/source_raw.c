/* Raw source: pictures of one size and format as a camera stores them, one behind the other, with no header: the specification says what they are (oriel/source.h). */
#include <errno.h>
#include <stdlib.h>
#include <string.h>
#include "oriel/source.h"

enum { SIDE_MAX = 16384, PIXELS_MAX = 1 << 26, FPS_MAX = 1000 };

typedef struct {
    orl_source base;
    FILE *f;
    char name[256];
    uint8_t *picture;
    size_t bytes;
    int ended;
} raw;

static void raw_close(orl_source *s)
{
    raw *r = (raw *)s;
    if (r->f && r->f != stdin) fclose(r->f);
    free(r->picture);
    free(r);
}

static int raw_next(orl_source *s, orl_frame *out)
{
    raw *r = (raw *)s;
    if (r->ended) return 0;
    size_t got = fread(r->picture, 1, r->bytes, r->f);
    r->ended = got < r->bytes;
    if (!got && !ferror(r->f)) return 0;
    if (r->ended) {
        orl_fail(ORL_E_FORMAT, "%s: picture %ld: the file ends after %zu of its %zu bytes", r->name, s->frame, got, r->bytes);
        return -1;
    }
    orl_frame_layout(&s->info, r->picture, out);
    return 1;
}

/* FORMAT[,709][,full], then WxH[@FPS]: colons cut both off. */
static orl_err parse(const char *spec, char *format, char *size, orl_source_info *out)
{
    orl_source_info i = { .fps_num = 25, .fps_den = 1 };
    char *word = strtok_r(format, ",", &format);
    i.pixels = word ? orl_pixels_from_name(word) : ORL_PIX_COUNT;
    if (i.pixels == ORL_PIX_COUNT) return orl_fail(ORL_E_UNSUPPORTED, "source raw:%.100s: no pixel format that is read (mono, i420, i422, i444, rgb24, bgr24, nv12, nv21, yuyv, uyvy)", spec);
    while ((word = strtok_r(NULL, ",", &format))) {
        if (!strcmp(word, "709")) i.matrix = ORL_MATRIX_709;
        else if (!strcmp(word, "full")) i.full_range = 1;
        else return orl_fail(ORL_E_UNSUPPORTED, "source raw:%.100s: '%.20s' is neither 709 nor full", spec, word);
    }
    int at = 0, more = 0;
    if (sscanf(size, "%5dx%5d%n", &i.w, &i.h, &at) != 2 || (size[at] && (sscanf(size + at, "@%4d%n", &i.fps_num, &more) != 1 || size[at + more]))
        || i.w < 1 || i.h < 1 || i.w > SIDE_MAX || i.h > SIDE_MAX || i.w * i.h > PIXELS_MAX || i.fps_num < 1 || i.fps_num > FPS_MAX)
        return orl_fail(ORL_E_RANGE, "source raw:%.100s: '%s' is not WIDTHxHEIGHT[@FPS], sides in 1..%d, 2^26 pixels and %d a second at most", spec, size, SIDE_MAX, FPS_MAX);
    *out = i;
    return ORL_OK;
}

orl_err orl_source_raw(const char *spec, orl_source **out)
{
    static const orl_source_ops OPS = { raw_next, raw_close };
    const char *second = strchr(spec, ':'), *path = second ? strchr(second + 1, ':') : NULL;
    char format[32], size[32];
    if (!path || !path[1] || second - spec >= (long)sizeof format || path - second > (long)sizeof size)
        return orl_fail(ORL_E_RANGE, "source raw:%.100s: wanted is raw:FORMAT[,709][,full]:WxH[@FPS]:PATH", spec);
    snprintf(format, sizeof format, "%.*s", (int)(second - spec), spec);
    snprintf(size, sizeof size, "%.*s", (int)(path - second - 1), second + 1);
    path++;
    raw *r = calloc(1, sizeof *r);
    if (!r) return orl_fail(ORL_E_MEMORY, "source raw: no memory");
    r->base.ops = &OPS;
    snprintf(r->name, sizeof r->name, "%s", strcmp(path, "-") ? path : "standard input");
    orl_err e = parse(spec, format, size, &r->base.info);
    if (!e && !(r->f = strcmp(path, "-") ? fopen(path, "rb") : stdin)) e = orl_fail(ORL_E_IO, "%s: %s", path, strerror(errno));
    if (!e) {
        orl_frame sizes;
        r->bytes = orl_frame_layout(&r->base.info, NULL, &sizes);
        r->picture = malloc(r->bytes);
        if (!r->picture) e = orl_fail(ORL_E_MEMORY, "%s: no memory for pictures of %d x %d", path, r->base.info.w, r->base.info.h);
    }
    if (e) raw_close(&r->base);
    else *out = &r->base;
    return e;
}
