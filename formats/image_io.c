/* Image files by their ending (include/oriel/image.h). */
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include "formats/codec.h"

#define MAX_BYTES ((size_t)1 << 30)

static int is(const char *path, const char *ending)
{
    size_t n = strlen(path), m = strlen(ending);
    return n > m && !strcasecmp(path + n - m, ending);
}

orl_err orl_image_read(const char *path, int want_c, orl_image *out)
{
    uint8_t *bytes;
    size_t n;
    int c = want_c == 1 ? 1 : 3;
    orl_err e = orl_file_read(path, MAX_BYTES, &bytes, &n);
    if (e) return e;
    int png = n >= 8 && !memcmp(bytes, "\x89PNG", 4), jpeg = n >= 3 && !memcmp(bytes, "\xff\xd8\xff", 3);
    e = png || jpeg ? orl_fail(ORL_E_UNSUPPORTED, "%s: this build reads %s", path, orl_image_formats()) : orl_fail(ORL_E_FORMAT, "%s: neither PNG nor JPEG", path);
#ifdef ORL_HAVE_PNG
    if (png) e = codec_png_read(path, bytes, n, c, out);
#endif
#ifdef ORL_HAVE_JPEG
    if (jpeg) e = codec_jpeg_read(path, bytes, n, c, out);
#endif
    (void)c;
    (void)out;
    free(bytes);
    return e;
}

orl_err orl_imagef_read(const char *path, orl_imagef *out)
{
    uint8_t *bytes;
    size_t n;
    if (is(path, ".exr")) return orl_exr_read(path, "RGB", out);
    orl_err e = orl_file_read(path, MAX_BYTES, &bytes, &n);
    if (e) return e;
    if (n >= 2 && !memcmp(bytes, "#?", 2)) e = codec_hdr_read(path, bytes, n, out);
    else e = orl_fail(ORL_E_FORMAT, "%s: neither OpenEXR (.exr) nor Radiance (#?)", path);
    free(bytes);
    return e;
}

orl_err orl_image_write(const char *path, const orl_image *im)
{
#ifdef ORL_HAVE_PNG
    if (is(path, ".png")) return codec_png_write(path, im);
#endif
#ifdef ORL_HAVE_JPEG
    if (is(path, ".jpg") || is(path, ".jpeg")) return codec_jpeg_write(path, im);
#endif
    (void)im;
    (void)is;
    return orl_fail(ORL_E_UNSUPPORTED, "%s: this build writes %s", path, orl_image_formats());
}

const char *orl_image_formats(void)
{
    static const char list[] = ""               /* each with a comma before it; the first is left away */
#ifdef ORL_HAVE_PNG
                               ",png"
#endif
#ifdef ORL_HAVE_JPEG
                               ",jpeg"
#endif
#ifdef ORL_HAVE_EXR
                               ",exr"
#endif
        ;
    return list + (list[0] == ',');
}
