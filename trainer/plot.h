/* Small line plots as SVG, and the growing text that they and the report are written to. */
#ifndef TRAINER_PLOT_H
#define TRAINER_PLOT_H
#include <stddef.h>
#include "oriel/error.h"

typedef struct { char *s; size_t n, cap; int failed; } text;     /* zeroed: empty; s may be NULL while n is 0 */
void text_add(text *t, const char *fmt, ...) __attribute__((format(printf, 2, 3)));
void text_escape(text *t, const char *s);       /* for HTML and XML, also inside quotes */
/* The text to a file (temporary file, fsync, rename); ORL_E_MEMORY if any of it was lost. */
orl_err text_write(const text *t, const char *path);
void text_free(text *t);

typedef struct { const char *name; const double *x, *y; int n; } plot_series;   /* in drawing order; points that are not finite, or not positive on a logarithmic axis, are left out */
typedef struct { const char *title, *x_label, *y_label; int log_x, log_y, dots, key_above, w, h; } plot_style;   /* labels may be NULL; dots: a mark on each point; key_above: the key at the top; w, h: units of the view box */
/* An <svg> element. Ticks at 1, 2, 5 times powers of ten; a key if there are several series. */
void plot_svg(text *out, const plot_series *series, int n, const plot_style *style);
/* Ticks that cover [lo, hi] with at most `most` steps: step and the first one at or below lo. */
double plot_ticks(double lo, double hi, int most, double *first);
#endif
