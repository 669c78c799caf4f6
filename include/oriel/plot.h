/* Small plots as SVG, and the growing text that they and the report are written to. Figures for people: not bound to give the same bytes everywhere. */
#ifndef ORIEL_PLOT_H
#define ORIEL_PLOT_H
#include <stddef.h>
#include "oriel/error.h"

typedef struct { char *s; size_t n, cap; int failed; } orl_text;     /* zeroed: empty; s may be NULL while n is 0 */
void orl_text_add(orl_text *t, const char *fmt, ...) __attribute__((format(printf, 2, 3)));
void orl_text_escape(orl_text *t, const char *s);       /* for HTML and XML, also inside quotes */
/* The text to a file (temporary file, fsync, rename); ORL_E_MEMORY if any of it was lost. */
orl_err orl_text_write(const orl_text *t, const char *path);
void orl_text_free(orl_text *t);

typedef struct { const char *name; const double *x, *y; int n; } orl_plot_series;   /* in drawing order; points that are not finite, or not positive on a logarithmic axis, are left out */
typedef struct {
    const char *title, *x_label, *y_label;      /* may be NULL */
    int log_x, log_y;
    int dots, no_lines;                         /* a mark on each point; the marks alone */
    const char *const *const *labels;           /* [series][point], written beside points where there is room; all, a series' or a point's may be NULL */
    int key_above;                              /* the key at the top */
    int w, h;                                   /* units of the view box */
} orl_plot_style;
/* An <svg> element. Ticks at 1, 2, 5 times powers of ten; a key if there are several series. */
void orl_plot_svg(orl_text *out, const orl_plot_series *series, int n, const orl_plot_style *style);
/* Ticks that cover [lo, hi] with at most `most` steps: step and the first one at or below lo. */
double orl_plot_ticks(double lo, double hi, int most, double *first);
#endif
