/* Image codecs behind orl_image_read, orl_image_write and orl_imagef_read, each present if its library is (Radiance needs none). bytes: the whole file; c: 1 or 3 channels wanted. */
#ifndef FORMATS_CODEC_H
#define FORMATS_CODEC_H
#include "oriel/image.h"
orl_err codec_png_read(const char *path, const uint8_t *bytes, size_t n, int c, orl_image *out);
orl_err codec_png_write(const char *path, const orl_image *im);
orl_err codec_jpeg_read(const char *path, const uint8_t *bytes, size_t n, int c, orl_image *out);
orl_err codec_jpeg_write(const char *path, const orl_image *im);
orl_err codec_hdr_read(const char *path, const uint8_t *bytes, size_t n, orl_imagef *out);
#endif
