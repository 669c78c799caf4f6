/* Picture sources of the camera loop: small callback structs, opened by `SCHEME:WHAT`. */
#ifndef ORIEL_SOURCE_H
#define ORIEL_SOURCE_H
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include "oriel/error.h"

typedef enum { ORL_PIX_MONO, ORL_PIX_420, ORL_PIX_422, ORL_PIX_444, ORL_PIX_RGB } orl_pixels;
typedef struct { int w, h; orl_pixels pixels; int full_range; int fps_num, fps_den; } orl_source_info;
typedef struct { const uint8_t *plane[3]; size_t stride[3]; } orl_frame;    /* Y, U, V; RGB: plane[0] interleaved. Valid until the next call. */

typedef struct orl_source orl_source;
typedef struct {
    int (*next)(orl_source *s, orl_frame *out);
    void (*close)(orl_source *s);
} orl_source_ops;
struct orl_source { const orl_source_ops *ops; orl_source_info info; long frame; };     /* frame: pictures handed out or lost so far */

/* `replay:PATH`: a folder of JPEG or PNG files in the order of their names, else a Y4M stream (`replay:-` reads it from standard input). */
orl_err orl_source_open(const char *spec, orl_source **out);
/* Y4M, 8 bit 4:2:0, 4:2:2, 4:4:4 or mono, progressive, at most 2^26 pixels. Untrusted input is safe. Takes f over, also on failure; name stands in messages. */
orl_err orl_source_y4m(FILE *f, const char *name, orl_source **out);
orl_err orl_source_folder(const char *dir, orl_source **out);
/* 1: a picture; 0: the end; -1: this picture is lost (orl_error_text() names it), the next call goes on behind it. Y4M allocates nothing here; a folder's decoder library does. */
int orl_source_next(orl_source *s, orl_frame *out);
void orl_source_close(orl_source *s);       /* NULL is fine */

/* Rows [y0, y1) as RGB, BT.601 (Y4M names no matrix), chroma repeated. Integer, rounded to nearest: this C is the specification. */
void orl_frame_to_rgb(const orl_source_info *info, const orl_frame *f, int y0, int y1, uint8_t *rgb, size_t row_bytes);
#endif
