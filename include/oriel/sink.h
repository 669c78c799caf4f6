/* Where the camera loop's pictures go: small callback structs, opened by `SCHEME:WHAT`. */
#ifndef ORIEL_SINK_H
#define ORIEL_SINK_H
#include <stddef.h>
#include <stdint.h>
#include "oriel/error.h"

typedef struct orl_sink orl_sink;
typedef struct {
    orl_err (*put)(orl_sink *s, const uint8_t *rgb, size_t row_bytes);
    orl_err (*close)(orl_sink *s, char *line, size_t cap);
} orl_sink_ops;
struct orl_sink { const orl_sink_ops *ops; int w, h; long frame; };

/* `files:DIR` or `files:DIR/PATTERN` with one %d or %0Nd (default %06d.png; counted from 0), `hash:`, `y4m:FILE` (4:2:0, BT.601 limited range; `-` is standard output). */
orl_err orl_sink_open(const char *spec, int w, int h, int fps_num, int fps_den, orl_sink **out);
orl_err orl_sink_put(orl_sink *s, const uint8_t *rgb, size_t row_bytes);
/* Flushes and frees. line (may be NULL) receives what the sink has to say, "" if nothing: the hash sink's result. */
orl_err orl_sink_close(orl_sink *s, char *line, size_t cap);

/* The hash sink's function: 64 bits over the rows' bytes in order, eight at a time as little-endian words (a row's tail padded with zeros). Start with ORL_HASH_START. */
#define ORL_HASH_START 0x9e3779b97f4a7c15u
uint64_t orl_hash_row(uint64_t h, const uint8_t *bytes, size_t n);
/* A row pair to 4:2:0 (second row may equal the first): y0, y1 w bytes, u, v (w + 1) / 2 bytes. */
void orl_rgb_to_420(const uint8_t *rgb0, const uint8_t *rgb1, int w, uint8_t *y0, uint8_t *y1, uint8_t *u, uint8_t *v);
#endif
