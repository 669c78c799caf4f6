/* Tones to choose from (oriel/relight.h): affine maps of display colour, by name or from a file. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "oriel/image.h"
#include "oriel/relight.h"

#define LIMIT 16.0f                     /* no photo's tone is near */
enum { MAX_BYTES = 1 << 16 };

const char ORL_TONE_PRESETS[] = "neutral, warm, cool, faded, mono, contrast";

/* Rows of [A b]. faded: four fifths of the saturation, a fifth of the contrast gone, blacks lifted; mono: Rec. 709 luma. */
static const struct { const char *name; float m[3][4]; } PRESET[] = {
    { "neutral", { { 1, 0, 0, 0 }, { 0, 1, 0, 0 }, { 0, 0, 1, 0 } } },
    { "warm", { { 1.04f, 0.03f, 0, 0.005f }, { 0.02f, 0.98f, 0, 0 }, { 0, 0.04f, 0.84f, 0 } } },
    { "cool", { { 0.91f, 0.02f, 0, 0 }, { 0, 0.98f, 0.02f, 0 }, { 0, 0.03f, 1.04f, 0.005f } } },
    { "faded", { { 0.691f, 0.117f, 0.012f, 0.115f }, { 0.035f, 0.773f, 0.012f, 0.110f }, { 0.035f, 0.117f, 0.668f, 0.120f } } },
    { "mono", { { 0.2126f, 0.7152f, 0.0722f, 0 }, { 0.2126f, 0.7152f, 0.0722f, 0 }, { 0.2126f, 0.7152f, 0.0722f, 0 } } },
    { "contrast", { { 1.28f, 0, 0, -0.13f }, { 0, 1.28f, 0, -0.13f }, { 0, 0, 1.28f, -0.13f } } },
};

static void set(const float m[3][4], orl_tone *out)
{
    for (int r = 0; r < 3; r++) {
        memcpy(out->a[r], m[r], sizeof out->a[r]);
        out->b[r] = m[r][3];
    }
}

static orl_err parse(const char *path, char *text, orl_tone *out)
{
    float m[3][4];
    int n = 0;
    for (char *c = text; (c = strchr(c, '#')); ) while (*c && *c != '\n') *c++ = ' ';
    for (char *word = strtok(text, " \t\r\n,;"); word; word = strtok(NULL, " \t\r\n,;"), n++) {
        char *end;
        float v = strtof(word, &end);
        if (n == 12) return orl_fail(ORL_E_FORMAT, "%s: more than 12 numbers", path);
        if (end == word || *end || !(v >= -LIMIT && v <= LIMIT)) return orl_fail(ORL_E_FORMAT, "%s: number %d, '%.40s': not a number in %g..%g", path, n + 1, word, (double)-LIMIT, (double)LIMIT);
        m[n / 4][n % 4] = v;
    }
    if (n < 12) return orl_fail(ORL_E_FORMAT, "%s: %d numbers, not 12 (three rows of A and b)", path, n);
    set((const float (*)[4])m, out);
    return ORL_OK;
}

orl_err orl_tone_find(const char *name, orl_tone *out)
{
    uint8_t *bytes;
    size_t n;
    for (size_t i = 0; i < sizeof PRESET / sizeof *PRESET; i++)
        if (!strcmp(name, PRESET[i].name)) {
            set(PRESET[i].m, out);
            return ORL_OK;
        }
    FILE *f = fopen(name, "rb");
    if (!f) return orl_fail(ORL_E_IO, "--tone %s: no such file, and no preset (%s)", name, ORL_TONE_PRESETS);
    fclose(f);
    orl_err e = orl_file_read(name, MAX_BYTES, &bytes, &n);
    if (e) return e;
    e = memchr(bytes, 0, n) ? orl_fail(ORL_E_FORMAT, "%s: not a text of 12 numbers", name) : parse(name, (char *)bytes, out);
    free(bytes);
    return e;
}
