/* Y4M source: a header line `YUV4MPEG2 W… H… F… C…`, then pictures of a fixed size, each behind a line `FRAME…`. The stream is hostile: lengths are bounded, a picture whose header
 * is not there is given up and the stream searched for the next `FRAME`, a stream that ends within a picture loses that picture. Interlaced, alpha and deeper streams are refused. */
#include <stdlib.h>
#include <string.h>
#include "oriel/source.h"

enum { HEADER_MAX = 1024, FRAME_LINE_MAX = 256, SIDE_MAX = 16384, PIXELS_MAX = 1 << 26 };

typedef struct {
    orl_source base;
    FILE *f;
    char name[256];
    uint8_t *picture;
    size_t bytes;
    int found, ended;           /* found: the search for a lost picture's successor already read its `FRAME` */
} y4m;

static void y4m_close(orl_source *s)
{
    y4m *y = (y4m *)s;
    if (y->f && y->f != stdin) fclose(y->f);
    free(y->picture);
    free(y);
}

/* Up to and without the newline; -1 if there is none within cap - 1 bytes. */
static int read_line(FILE *f, char *line, int cap)
{
    for (int n = 0; n < cap; n++) {
        int c = getc(f);
        if (c == EOF) return -1;
        if (c == '\n') {
            line[n] = 0;
            return n;
        }
        line[n] = (char)c;
    }
    return -1;
}

static int lost(y4m *y, const char *what)
{
    orl_fail(ORL_E_FORMAT, "%s: picture %ld: %s", y->name, y->base.frame, what);
    return -1;
}

/* read: the n bytes that were read where a FRAME line should stand; they may hold the beginning of the next one. */
static int search(y4m *y, const char *read, size_t n, const char *what)
{
    static const char MAGIC[] = "FRAME";
    int k = 0, c = 0;
    for (size_t i = 0; i < n; i++) k = read[i] == MAGIC[k] ? k + 1 : read[i] == 'F';
    while (k < 5 && (c = getc(y->f)) != EOF) k = c == MAGIC[k] ? k + 1 : c == 'F';
    y->found = k == 5;
    y->ended = k < 5;
    return lost(y, what);
}

static int y4m_next(orl_source *s, orl_frame *out)
{
    y4m *y = (y4m *)s;
    char line[FRAME_LINE_MAX];
    if (y->ended) return 0;
    if (!y->found) {
        size_t n = fread(line, 1, 5, y->f);
        if (n < 5) {
            y->ended = 1;
            return n || ferror(y->f) ? lost(y, "the stream ends within the picture's header") : 0;
        }
        if (memcmp(line, "FRAME", 5)) return search(y, line, 5, "no FRAME line");
    }
    y->found = 0;
    int after = getc(y->f);
    char c = (char)after;
    if (after != '\n' && (after != ' ' || read_line(y->f, line, sizeof line) < 0)) return search(y, &c, after != EOF, "broken FRAME line");
    if (fread(y->picture, 1, y->bytes, y->f) != y->bytes) {
        y->ended = 1;
        return lost(y, "the stream ends within the picture");
    }
    orl_frame_layout(&s->info, y->picture, out);
    return 1;
}

/* Digits alone, 1..max; the first byte that is none goes to *end. */
static int number(const char *s, const char **end, int max)
{
    long v = 0;
    const char *p = s;
    while (*p >= '0' && *p <= '9' && v <= max) v = 10 * v + (*p++ - '0');
    *end = p;
    return p == s || v < 1 || v > max ? -1 : (int)v;
}

static orl_err chroma(const char *name, const char *c, orl_pixels *out)
{
    static const struct { const char *tag; orl_pixels pixels; } KNOWN[] = {
        { "420", ORL_PIX_420 }, { "420jpeg", ORL_PIX_420 }, { "420mpeg2", ORL_PIX_420 }, { "420paldv", ORL_PIX_420 },
        { "422", ORL_PIX_422 }, { "444", ORL_PIX_444 }, { "mono", ORL_PIX_MONO },
    };
    for (size_t i = 0; i < sizeof KNOWN / sizeof *KNOWN; i++)
        if (!strcmp(c, KNOWN[i].tag)) {
            *out = KNOWN[i].pixels;
            return ORL_OK;
        }
    return orl_fail(ORL_E_UNSUPPORTED, "%s: header field C: pixel format '%.20s' is not among 420, 422, 444, mono with 8 bit", name, c);
}

static orl_err parse(const char *name, char *line, orl_source_info *out)
{
    orl_source_info i = { .pixels = ORL_PIX_420, .fps_num = 25, .fps_den = 1 };
    const char *end;
    if (strncmp(line, "YUV4MPEG2", 9) || (line[9] && line[9] != ' ')) return orl_fail(ORL_E_FORMAT, "%s: not a Y4M stream", name);
    char *rest = line + 9;
    for (char *tag; (tag = strtok_r(rest, " ", &rest)); ) {
        const char *v = tag + 1;
        orl_err e = ORL_OK;
        if (*tag == 'W' || *tag == 'H') {
            int n = number(v, &end, SIDE_MAX);
            if (n < 0 || *end) return orl_fail(ORL_E_RANGE, "%s: header field %c: '%.20s' is not in 1..%d", name, *tag, v, SIDE_MAX);
            *(*tag == 'W' ? &i.w : &i.h) = n;
        } else if (*tag == 'F') {
            int num = number(v, &end, 1000000), den = num > 0 && *end == ':' ? number(end + 1, &end, 1000000) : -1;
            if (num > 0 && den > 0 && !*end) {
                i.fps_num = num;
                i.fps_den = den;
            } else if (strcmp(v, "0:0")) {      /* 0:0: unknown */
                return orl_fail(ORL_E_RANGE, "%s: header field F: '%.20s' is no frame rate", name, v);
            }
        } else if (*tag == 'C') {
            e = chroma(name, v, &i.pixels);
        } else if (*tag == 'I' && *v != 'p' && *v != '?') {
            e = orl_fail(ORL_E_UNSUPPORTED, "%s: header field I: interlaced streams are not read", name);
        } else if (!strcmp(tag, "XCOLORRANGE=FULL")) {
            i.full_range = 1;
        }
        if (e) return e;
    }
    if (!i.w || !i.h || (long)i.w * i.h > PIXELS_MAX) return orl_fail(ORL_E_RANGE, "%s: header fields W, H: %d x %d is no size that is read", name, i.w, i.h);
    *out = i;
    return ORL_OK;
}

orl_err orl_source_y4m(FILE *f, const char *name, orl_source **out)
{
    static const orl_source_ops OPS = { y4m_next, y4m_close };
    char line[HEADER_MAX];
    orl_err e = ORL_OK;
    y4m *y = calloc(1, sizeof *y);
    if (!y) {
        if (f != stdin) fclose(f);
        return orl_fail(ORL_E_MEMORY, "%s: no memory", name);
    }
    y->base.ops = &OPS;
    y->f = f;
    snprintf(y->name, sizeof y->name, "%s", name);
    if (read_line(f, line, sizeof line) < 0) e = orl_fail(ORL_E_FORMAT, "%s: not a Y4M stream (no header line within %d bytes)", name, HEADER_MAX);
    if (!e) e = parse(name, line, &y->base.info);
    if (!e) {
        orl_frame sizes;
        y->bytes = orl_frame_layout(&y->base.info, NULL, &sizes);
        y->picture = malloc(y->bytes);
        if (!y->picture) e = orl_fail(ORL_E_MEMORY, "%s: no memory for pictures of %d x %d", name, y->base.info.w, y->base.info.h);
    }
    if (e) y4m_close(&y->base);
    else *out = &y->base;
    return e;
}
