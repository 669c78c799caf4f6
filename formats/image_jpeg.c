/* JPEG through libjpeg-turbo; EXIF orientation is honoured on reading. Accurate integer DCT, so that decoded pixels are the same on every machine. */
#include <setjmp.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "formats/codec.h"
#ifdef ORL_HAVE_JPEG
#include <jpeglib.h>

typedef struct { struct jpeg_error_mgr mgr; jmp_buf jump; char text[JMSG_LENGTH_MAX]; int warnings; } jpeg_fault;

static void on_error(j_common_ptr c)
{
    jpeg_fault *f = (jpeg_fault *)c->err;
    c->err->format_message(c, f->text);
    longjmp(f->jump, 1);
}

static void on_message(j_common_ptr c, int level)
{
    jpeg_fault *f = (jpeg_fault *)c->err;
    if (level >= 0) return;
    if (!f->warnings++) c->err->format_message(c, f->text);
}

/* Orientation tag (0x0112) of the first EXIF block; 1 if there is none or it is broken. */
static int exif_orientation(const uint8_t *b, size_t n)
{
    for (size_t i = 2; i + 4 <= n && b[i] == 0xff;) {
        size_t len = (size_t)b[i + 2] << 8 | b[i + 3];
        if (b[i + 1] == 0xda || len < 2 || i + 2 + len > n) break;
        const uint8_t *t = b + i + 10;
        if (b[i + 1] == 0xe1 && len >= 16 && !memcmp(b + i + 4, "Exif\0\0", 6)) {
            size_t m = len - 8;                 /* bytes of the TIFF block */
            int le = t[0] == 'I';
#define U16(o) ((uint32_t)(le ? t[o] | t[(o) + 1] << 8 : t[o] << 8 | t[(o) + 1]))
#define U32(o) (le ? U16(o) | U16((o) + 2) << 16 : U16(o) << 16 | U16((o) + 2))
            uint32_t at = U32(4);
            if (at > m || m - at < 2) return 1;
            uint32_t count = U16(at);
            for (uint32_t k = 0; k < count && m - at >= 2 + 12 * ((size_t)k + 1); k++) {
                uint32_t o = at + 2 + 12 * k;
                if (U16(o) == 0x0112) { uint32_t v = U16(o + 8); return v >= 1 && v <= 8 ? (int)v : 1; }
            }
            return 1;
        }
        i += 2 + len;
    }
    return 1;
}

static orl_err turn(orl_image *im, int orientation)
{
    if (orientation == 1) return ORL_OK;
    orl_image o;
    int swap = orientation >= 5, w = im->w, h = im->h;
    orl_err e = orl_image_alloc(&o, swap ? h : w, swap ? w : h, im->c);
    if (e) return e;
    for (int y = 0; y < o.h; y++)
        for (int x = 0; x < o.w; x++) {
            int a = swap ? y : x, b = swap ? x : y; /* stored column and row, before mirroring */
            if (orientation == 2 || orientation == 3 || orientation == 7 || orientation == 8) a = w - 1 - a;
            if (orientation == 3 || orientation == 4 || orientation == 6 || orientation == 7) b = h - 1 - b;
            memcpy(o.px + ((size_t)y * (size_t)o.w + (size_t)x) * (size_t)o.c, im->px + ((size_t)b * (size_t)w + (size_t)a) * (size_t)o.c, (size_t)o.c);
        }
    orl_image_free(im);
    *im = o;
    return ORL_OK;
}

orl_err codec_jpeg_read(const char *path, const uint8_t *bytes, size_t n, int c, orl_image *out)
{
    struct jpeg_decompress_struct d;
    jpeg_fault f;
    orl_image o = { 0 };
    orl_image *volatile keep = &o;
    memset(&d, 0, sizeof d);
    memset(&f, 0, sizeof f);
    d.err = jpeg_std_error(&f.mgr);
    f.mgr.error_exit = on_error;
    f.mgr.emit_message = on_message;
    if (setjmp(f.jump)) {
        jpeg_destroy_decompress(&d);
        orl_image_free(keep);
        return orl_fail(ORL_E_FORMAT, "%s: %s", path, f.text);
    }
    jpeg_create_decompress(&d);
    jpeg_mem_src(&d, bytes, (unsigned long)n);
    jpeg_read_header(&d, TRUE);
    d.out_color_space = c == 1 ? JCS_GRAYSCALE : JCS_RGB;
    d.dct_method = JDCT_ISLOW;
    jpeg_start_decompress(&d);
    if (orl_image_alloc(&o, (int)d.output_width, (int)d.output_height, c)) { jpeg_destroy_decompress(&d); return ORL_E_RANGE; }
    while (d.output_scanline < d.output_height) {
        JSAMPROW row = o.px + (size_t)d.output_scanline * (size_t)o.w * (size_t)c;
        jpeg_read_scanlines(&d, &row, 1);
    }
    jpeg_finish_decompress(&d);
    jpeg_destroy_decompress(&d);
    if (f.warnings) {                           /* cut short or garbled: libjpeg fills with grey, we would rather say so */
        orl_image_free(&o);
        return orl_fail(ORL_E_FORMAT, "%s: %s", path, f.text);
    }
    orl_err e = turn(&o, exif_orientation(bytes, n));
    if (e) { orl_image_free(&o); return e; }
    *out = o;
    return ORL_OK;
}

orl_err codec_jpeg_write(const char *path, const orl_image *im)
{
    struct jpeg_compress_struct c;
    jpeg_fault f;
    unsigned char *bytes = NULL;
    unsigned long n = 0;
    if (im->c != 1 && im->c != 3) return orl_fail(ORL_E_UNSUPPORTED, "%s: JPEG of %d channels", path, im->c);
    memset(&c, 0, sizeof c);
    memset(&f, 0, sizeof f);
    c.err = jpeg_std_error(&f.mgr);
    f.mgr.error_exit = on_error;
    if (setjmp(f.jump)) {
        jpeg_destroy_compress(&c);
        free(bytes);
        return orl_fail(ORL_E_FORMAT, "%s: %s", path, f.text);
    }
    jpeg_create_compress(&c);
    jpeg_mem_dest(&c, &bytes, &n);
    c.image_width = (JDIMENSION)im->w;
    c.image_height = (JDIMENSION)im->h;
    c.input_components = im->c;
    c.in_color_space = im->c == 1 ? JCS_GRAYSCALE : JCS_RGB;
    jpeg_set_defaults(&c);
    jpeg_set_quality(&c, 95, TRUE);
    c.dct_method = JDCT_ISLOW;
    jpeg_start_compress(&c, TRUE);
    while (c.next_scanline < c.image_height) {
        JSAMPROW row = im->px + (size_t)c.next_scanline * (size_t)im->w * (size_t)im->c;
        jpeg_write_scanlines(&c, &row, 1);
    }
    jpeg_finish_compress(&c);
    jpeg_destroy_compress(&c);
    orl_err e = orl_file_write(path, bytes, n);
    free(bytes);
    return e;
}
#endif
