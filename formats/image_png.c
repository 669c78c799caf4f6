/* PNG through libpng's simplified interface: bounded, no longjmp of ours. */
#include <stdlib.h>
#include <string.h>
#include "formats/codec.h"
#ifdef ORL_HAVE_PNG
#include <png.h>

/* Whether the chunks reach IEND: the simplified reader stops behind the last pixel and would take a file that is cut there. */
static int has_end(const uint8_t *b, size_t n)
{
    for (size_t i = 8; n - i >= 12;) {
        size_t len = (size_t)b[i] << 24 | (size_t)b[i + 1] << 16 | (size_t)b[i + 2] << 8 | b[i + 3];
        if (len > n - i - 12) break;
        if (!memcmp(b + i + 4, "IEND", 4)) return 1;
        i += 12 + len;
    }
    return 0;
}

orl_err codec_png_read(const char *path, const uint8_t *bytes, size_t n, int c, orl_image *out)
{
    png_image im = { .version = PNG_IMAGE_VERSION };
    orl_image o = { 0 };
    if (!png_image_begin_read_from_memory(&im, bytes, n)) return orl_fail(ORL_E_FORMAT, "%s: %s", path, im.message);
    orl_err e = ORL_OK;
    im.format = PNG_FORMAT_RGB;
    if (im.width > ORL_IMAGE_MAX_SIDE || im.height > ORL_IMAGE_MAX_SIDE) e = orl_fail(ORL_E_RANGE, "%s: %u x %u pixels", path, im.width, im.height);
    if (!e) e = orl_image_alloc(&o, (int)im.width, (int)im.height, 3);
    png_color black = { 0, 0, 0 };
    if (!e && (!png_image_finish_read(&im, &black, o.px, 0, NULL))) e = orl_fail(ORL_E_FORMAT, "%s: %s", path, im.message);
    if (!e && !has_end(bytes, n)) e = orl_fail(ORL_E_FORMAT, "%s: cut short", path);
    png_image_free(&im);
    if (e) { orl_image_free(&o); return e; }
    if (c == 1) {                               /* JPEG's grey; libpng's own turns dark colours black */
        size_t pixels = (size_t)o.w * (size_t)o.h;
        for (size_t i = 0; i < pixels; i++) o.px[i] = (uint8_t)((299 * o.px[3 * i] + 587 * o.px[3 * i + 1] + 114 * o.px[3 * i + 2] + 500) / 1000);
        o.c = 1;
    }
    *out = o;
    return ORL_OK;
}

orl_err codec_png_write(const char *path, const orl_image *in)
{
    static const png_uint_32 FORMAT[5] = { 0, PNG_FORMAT_GRAY, 0, PNG_FORMAT_RGB, PNG_FORMAT_RGBA };
    png_image im = { .version = PNG_IMAGE_VERSION, .width = (png_uint_32)in->w, .height = (png_uint_32)in->h };
    png_alloc_size_t n = 0;
    if (in->c != 1 && in->c != 3 && in->c != 4) return orl_fail(ORL_E_UNSUPPORTED, "%s: PNG of %d channels", path, in->c);
    im.format = FORMAT[in->c];
    if (!png_image_write_get_memory_size(im, n, 0, in->px, 0, NULL)) return orl_fail(ORL_E_FORMAT, "%s: %s", path, im.message);
    void *bytes = malloc(n);
    if (!bytes) return orl_fail(ORL_E_MEMORY, "%s: no memory", path);
    orl_err e = ORL_OK;
    if (!png_image_write_to_memory(&im, bytes, &n, 0, in->px, 0, NULL)) e = orl_fail(ORL_E_FORMAT, "%s: %s", path, im.message);
    if (!e) e = orl_file_write(path, bytes, n);
    free(bytes);
    return e;
}
#endif
