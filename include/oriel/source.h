/* Picture sources of the camera loop: small callback structs, opened by `SCHEME:WHAT`. */
#ifndef ORIEL_SOURCE_H
#define ORIEL_SOURCE_H
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include "oriel/error.h"

/* Chroma of 420 is halved both ways, of 422 in columns, rounded up: of an odd column or row the last sample stands for one pixel alone. */
typedef enum {
    ORL_PIX_MONO, ORL_PIX_420, ORL_PIX_422, ORL_PIX_444,    /* planes Y, U, V; 420 is I420 */
    ORL_PIX_RGB, ORL_PIX_BGR,                               /* bytes R G B, B G R */
    ORL_PIX_NV12, ORL_PIX_NV21,                             /* planes Y and U V, Y and V U; 420 */
    ORL_PIX_YUYV, ORL_PIX_UYVY,                             /* bytes Y U Y V, U Y V Y: two pixels; 422 */
    ORL_PIX_COUNT
} orl_pixels;
typedef enum { ORL_MATRIX_601, ORL_MATRIX_709 } orl_matrix;     /* ITU-R BT.601, BT.709 */
typedef struct { int w, h; orl_pixels pixels; int full_range; int fps_num, fps_den; orl_matrix matrix; } orl_source_info;      /* limited range: Y 16..235, U and V 16..240 */
typedef struct { const uint8_t *plane[3]; size_t stride[3], bytes[3]; } orl_frame;      /* stride: from row to row; bytes: that the plane holds. Valid until the next call. */

typedef struct orl_source orl_source;
typedef struct {
    int (*next)(orl_source *s, orl_frame *out);
    void (*close)(orl_source *s);
} orl_source_ops;
struct orl_source { const orl_source_ops *ops; orl_source_info info; long frame; };     /* frame: pictures handed out or lost so far */

/* `replay:PATH`: a folder of JPEG or PNG files in the order of their names, else a Y4M stream (`replay:-` reads it from standard input).
 * `raw:FORMAT[,709][,full]:WxH[@FPS]:PATH`: pictures as a camera stores them, one behind the other without padding (what `v4l2-ctl --stream-to` or `ffmpeg -f rawvideo` writes); FORMAT as orl_pixels_name(). */
orl_err orl_source_open(const char *spec, orl_source **out);
/* Y4M, 8 bit 4:2:0, 4:2:2, 4:4:4 or mono, progressive, at most 2^26 pixels. Untrusted input is safe. Takes f over, also on failure; name stands in messages. */
orl_err orl_source_y4m(FILE *f, const char *name, orl_source **out);
orl_err orl_source_folder(const char *dir, orl_source **out);
/* spec: what stands behind `raw:`. A file that ends within a picture loses that picture. */
orl_err orl_source_raw(const char *spec, orl_source **out);
/* 1: a picture; 0: the end; -1: this picture is lost (orl_error_text() names it, also if it fails orl_frame_check()), the next call goes on behind it. Y4M and raw allocate nothing here; a folder's decoder library does. */
int orl_source_next(orl_source *s, orl_frame *out);
void orl_source_close(orl_source *s);       /* NULL is fine */

/* "mono", "i420", "i422", "i444", "rgb24", "bgr24", "nv12", "nv21", "yuyv", "uyvy"; ORL_PIX_COUNT if it is none of these. */
const char *orl_pixels_name(orl_pixels p);
orl_pixels orl_pixels_from_name(const char *name);
/* Planes of a picture that lies at base without padding; the bytes of it all. base NULL: sizes alone. w, h: 1 .. 65535. */
size_t orl_frame_layout(const orl_source_info *info, const uint8_t *base, orl_frame *out);
/* ORL_E_RANGE unless the size is at least 1 x 1 (65535 at most), every plane is there, its rows are no shorter than the width asks, and its bytes hold all of them (the last row needs no padding). */
orl_err orl_frame_check(const orl_source_info *info, const orl_frame *f);
/* Rows [y0, y1) of a picture that passes the check as RGB. Integer, rounded to nearest, the same bytes for any cpu (orl_cpu_detect() or a subset): arithmetic in runtime/kernels/convert.h.
 * Chroma is repeated, as from samples in the middle of their pixels (JPEG, MPEG-1): where they stand at the left pixel (MPEG-2, most cameras) colour, not luma, is half a pixel to the right.
 * Y4M names no matrix and is taken for BT.601. */
void orl_frame_to_rgb(const orl_source_info *info, const orl_frame *f, unsigned cpu, int y0, int y1, uint8_t *rgb, size_t row_bytes);
#endif
