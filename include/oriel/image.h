/* Images in memory and on disk. Interleaved rows, top-left first, no padding. */
#ifndef ORIEL_IMAGE_H
#define ORIEL_IMAGE_H
#include <stddef.h>
#include <stdint.h>
#include "oriel/error.h"

typedef struct { int w, h, c; uint8_t *px; } orl_image;    /* c = 1, 3 or 4; display-referred (sRGB) 0..255 unless said otherwise */
typedef struct { int w, h, c; float *px; } orl_imagef;     /* stated by the user: linear or sRGB in [0,1] */

#define ORL_IMAGE_MAX_SIDE 65535
#define ORL_IMAGEF_MAX_CHANNELS 24

orl_err orl_image_alloc(orl_image *out, int w, int h, int c);      /* zeroed; ORL_E_RANGE on bad size */
orl_err orl_imagef_alloc(orl_imagef *out, int w, int h, int c);
void orl_image_free(orl_image *im);                                /* idempotent; zeroes the struct */
void orl_imagef_free(orl_imagef *im);

/* Area-averaged resize (box filter over the exact footprint), down or up; each channel apart. Output allocated here. */
orl_err orl_image_resize_area(const orl_image *in, int w, int h, orl_image *out);
orl_err orl_imagef_resize_area(const orl_imagef *in, int w, int h, orl_imagef *out);
/* Size with the given long side, aspect kept, rounded to nearest, at least 1. Never enlarges. */
void orl_size_long_side(int w, int h, int long_side, int *ow, int *oh);
orl_err orl_image_to_float(const orl_image *in, orl_imagef *out);  /* /255 */
orl_err orl_image_from_float(const orl_imagef *in, orl_image *out);/* clamp, *255, round half up; NaN -> 0 */

/* Files by ending: .png (libpng), .jpg/.jpeg (libjpeg-turbo, EXIF orientation honoured on read, quality 95 on write), each present if built with it. Reading yields c = 3 (colour) or 1 if want_c == 1.
 * Writing goes to a temporary file, fsync, rename. */
orl_err orl_image_read(const char *path, int want_c, orl_image *out);
orl_err orl_image_write(const char *path, const orl_image *im);
/* Linear RGB of a float picture: .exr (below), or else Radiance's RGBE (flat, old and new run lengths; -Y H +X W; at most 2^28 pixels), told by its first bytes. Files may be hostile. */
orl_err orl_imagef_read(const char *path, orl_imagef *out);
/* OpenEXR through its C core API (scan lines, half or float, any channel order). channels: e.g. "RGB", "Y"; missing channel -> ORL_E_FORMAT. Linear values, NaN/inf -> 0 / 65504. */
orl_err orl_exr_read(const char *path, const char *channels, orl_imagef *out);
/* names: c comma-separated channel names, e.g. "R,G,B" or "albedo.R,albedo.G,albedo.B,Z". Half float, ZIP; the other one 32-bit float. */
orl_err orl_exr_write(const char *path, const orl_imagef *im, const char *names);
orl_err orl_exr_write_float(const char *path, const orl_imagef *im, const char *names);
/* Comma-separated list of what this build reads and writes, e.g. "png,jpeg,exr". */
const char *orl_image_formats(void);

/* Atomic file: bytes to path.tmp<pid>, fsync, rename. */
orl_err orl_file_write(const char *path, const void *bytes, size_t n);
/* The last half of that for a file written to tmp by other means: fsync, rename; tmp is gone in any case. */
orl_err orl_file_replace(const char *tmp, const char *path);
/* Whole file into malloc'd memory, with a 0 behind its n bytes; ORL_E_RANGE above max bytes. */
orl_err orl_file_read(const char *path, size_t max, uint8_t **bytes, size_t *n);
/* CRC-32 (that of zlib and PNG) of n bytes, going on from crc; 0 to begin with. */
uint32_t orl_crc32(const void *bytes, size_t n, uint32_t crc);
#endif
