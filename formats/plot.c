/* Plots (oriel/plot.h). */
#include "oriel/plot.h"
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "oriel/image.h"

void orl_text_add(orl_text *t, const char *fmt, ...)
{
    va_list ap;
    va_start(ap, fmt);
    int n = vsnprintf(NULL, 0, fmt, ap);
    va_end(ap);
    if (n < 0 || t->failed) { t->failed = 1; return; }
    if (t->n + (size_t)n + 1 > t->cap) {
        size_t cap = 2 * (t->n + (size_t)n) + 4096;
        char *s = realloc(t->s, cap);
        if (!s) { t->failed = 1; return; }
        t->s = s;
        t->cap = cap;
    }
    va_start(ap, fmt);
    vsnprintf(t->s + t->n, (size_t)n + 1, fmt, ap);
    va_end(ap);
    t->n += (size_t)n;
}

void orl_text_escape(orl_text *t, const char *s)
{
    for (; *s; s++) {
        const char *e = *s == '&' ? "&amp;" : *s == '<' ? "&lt;" : *s == '>' ? "&gt;" : *s == '"' ? "&quot;" : *s == '\'' ? "&#39;" : NULL;
        if (e) orl_text_add(t, "%s", e);
        else if ((unsigned char)*s >= 32) orl_text_add(t, "%c", *s);
    }
}

orl_err orl_text_write(const orl_text *t, const char *path) { return t->failed ? orl_fail(ORL_E_MEMORY, "%s: no memory for it", path) : orl_file_write(path, t->s ? t->s : "", t->n); }

void orl_text_free(orl_text *t)
{
    free(t->s);
    *t = (orl_text){ 0 };
}

/* 10^e: exact up to 22, and its inverse rounded once. */
static double ten_to(int e)
{
    double v = 1;
    for (int i = e < 0 ? -e : e; i > 0; i--) v *= 10;
    return e < 0 ? 1 / v : v;
}

double orl_plot_ticks(double lo, double hi, int most, double *first)
{
    double raw = (hi - lo) / most, ten = ten_to((int)floor(log10(raw))), step = ten;
    for (int k = 0; step < raw * (1 - 1e-9) && k < 3; k++) step = ten * (k == 0 ? 2 : k == 1 ? 5 : 10);
    *first = floor(lo / step + 1e-9) * step;
    return step;
}

/* ---- the plot */

enum { LEFT = 56, RIGHT = 16, TOP = 34, BOTTOM = 46 };
static const char *const COLOURS[] = { "#2563eb", "#d9730d", "#0f9d78", "#9d4edd", "#c2255c", "#64748b" };

typedef struct { orl_text *out; const orl_plot_style *st; double x0, x1, y0, y1, pw, ph; } canvas;     /* ranges: of logarithms where an axis has them */

static double on_axis(double v, int log) { return log ? log10(v) : v; }
static double at_x(const canvas *c, double v) { return LEFT + c->pw * (v - c->x0) / (c->x1 - c->x0); }
static double at_y(const canvas *c, double v) { return TOP + c->ph * (c->y1 - v) / (c->y1 - c->y0); }
static int shown(const orl_plot_series *s, int i, const orl_plot_style *st) { return isfinite(s->x[i]) && isfinite(s->y[i]) && (!st->log_x || s->x[i] > 0) && (!st->log_y || s->y[i] > 0); }

static void widen(double *lo, double *hi, double least)         /* a range that is a point */
{
    if (*hi - *lo >= 1e-9 * fmax(1, fabs(*lo))) return;
    *lo -= least;
    *hi += least;
}

static void find_ranges(canvas *c, const orl_plot_series *series, int n)
{
    const orl_plot_style *st = c->st;
    c->x0 = c->y0 = INFINITY;
    c->x1 = c->y1 = -INFINITY;
    for (int k = 0; k < n; k++)
        for (int i = 0; i < series[k].n; i++) {
            if (!shown(&series[k], i, st)) continue;
            double x = on_axis(series[k].x[i], st->log_x), y = on_axis(series[k].y[i], st->log_y);
            c->x0 = fmin(c->x0, x); c->x1 = fmax(c->x1, x);
            c->y0 = fmin(c->y0, y); c->y1 = fmax(c->y1, y);
        }
    if (!(c->x0 <= c->x1)) { c->x0 = c->y0 = 0; c->x1 = c->y1 = 1; }
    widen(&c->x0, &c->x1, st->log_x ? 0.3 : fmax(fabs(c->x0), 1) * 0.1);
    widen(&c->y0, &c->y1, st->log_y ? 0.3 : fmax(fabs(c->y0), 1) * 0.1);
    if (st->no_lines && st->key_above) c->y1 += 0.2 * (c->y1 - c->y0);         /* marks may stand anywhere: room for the key */
    if (st->log_x) { c->x0 -= 0.03 * (c->x1 - c->x0); c->x1 += 0.03 * (c->x1 - c->x0); }
}

static void x_tick(const canvas *c, double v, double shown, int line)
{
    double x = at_x(c, v);
    if (line) orl_text_add(c->out, "<path d=\"M%.1f %dV%.1f\" stroke=\"#f1f5f9\"/>", x, TOP, TOP + c->ph);
    orl_text_add(c->out, "<text x=\"%.1f\" y=\"%d\" text-anchor=\"middle\">%.6g</text>\n", x, c->st->h - BOTTOM + 18, shown);
}

static void y_tick(const canvas *c, double v, double shown)
{
    double y = at_y(c, v);
    orl_text_add(c->out, "<path d=\"M%d %.1fH%d\" stroke=\"#e2e8f0\"/><text x=\"%d\" y=\"%.1f\" text-anchor=\"end\">%.6g</text>\n", LEFT, y, c->st->w - RIGHT, LEFT - 8, y + 4, shown);
}

/* 1, 2, 5 times powers of ten; the powers alone on a long axis, none on one that is too long. y: else x. */
static void log_ticks(const canvas *c, int y)
{
    double lo = y ? c->y0 : c->x0, hi = y ? c->y1 : c->x1, wide = hi - lo;
    for (int d = (int)floor(lo); d <= (int)ceil(hi) && wide < 40; d++)
        for (int m = 1; m <= 5; m += m == 1 ? 1 : 3) {
            double v = d + log10(m);
            if (v < lo - 1e-9 || v > hi + 1e-9 || (m > 1 && wide > (y ? 2 : 3))) continue;
            if (y) y_tick(c, v, m * ten_to(d));
            else x_tick(c, v, m * ten_to(d), 1);
        }
}

/* Ranges grow to whole steps in y. */
static void add_axes(canvas *c)
{
    double tick, step;
    if (c->st->log_y) {
        c->y0 = floor(c->y0 + 1e-9);
        c->y1 = ceil(c->y1 - 1e-9);
        log_ticks(c, 1);
    } else {
        step = orl_plot_ticks(c->y0, c->y1, 6, &tick);
        c->y0 = tick;
        c->y1 = ceil(c->y1 / step - 1e-9) * step;
        for (double v = c->y0; v <= c->y1 + 0.5 * step; v += step) y_tick(c, v, fabs(v) < 1e-9 * step ? 0 : v);
    }
    if (c->st->log_x) {
        log_ticks(c, 0);
    } else {
        step = orl_plot_ticks(c->x0, c->x1, 8, &tick);
        for (double v = tick; v <= c->x1 + 1e-6 * step; v += step) if (v >= c->x0 - 1e-6 * step) x_tick(c, v, fabs(v) < 1e-9 * step ? 0 : v, 0);
    }
    orl_text_add(c->out, "<path d=\"M%d %dV%.1fH%d\" fill=\"none\" stroke=\"#94a3b8\"/>\n", LEFT, TOP, TOP + c->ph, c->st->w - RIGHT);
}

static double point_x(const canvas *c, const orl_plot_series *s, int i) { return at_x(c, on_axis(s->x[i], c->st->log_x)); }
static double point_y(const canvas *c, const orl_plot_series *s, int i) { return at_y(c, on_axis(s->y[i], c->st->log_y)); }

static void add_line(const canvas *c, const orl_plot_series *s, const char *colour)
{
    const orl_plot_style *st = c->st;
    const char *go = "M";
    if (!st->no_lines) {
        orl_text_add(c->out, "<path fill=\"none\" stroke=\"%s\" stroke-width=\"2\" stroke-linejoin=\"round\" d=\"", colour);
        for (int i = 0; i < s->n; i++) {
            if (!shown(s, i, st)) continue;
            orl_text_add(c->out, "%s%.1f %.1f", go, point_x(c, s, i), point_y(c, s, i));
            go = "L";
        }
        orl_text_add(c->out, "\"/>\n");
    }
    for (int i = 0; st->dots && i < s->n; i++)
        if (shown(s, i, st)) orl_text_add(c->out, "<circle cx=\"%.1f\" cy=\"%.1f\" r=\"3.5\" fill=\"%s\"><title>%.4g, %.4g</title></circle>\n", point_x(c, s, i), point_y(c, s, i), colour, s->x[i], s->y[i]);
}

/* ---- labels of points */

enum { BOXES = 256 };
typedef struct { double x0, y0, x1, y1; } box;
typedef struct { box at[BOXES]; int n; } taken;

static void take(taken *t, box b) { if (t->n < BOXES) t->at[t->n++] = b; }

/* How much of a box is taken already or hangs over the plot's edge. */
static double in_the_way(const canvas *c, const taken *t, const box *b)
{
    double sum = 1e3 * (fmax(LEFT - b->x0, 0) + fmax(b->x1 - (LEFT + c->pw), 0) + fmax(TOP - b->y0, 0) + fmax(b->y1 - (TOP + c->ph), 0));
    for (int i = 0; i < t->n; i++) sum += fmax(fmin(b->x1, t->at[i].x1) - fmax(b->x0, t->at[i].x0), 0) * fmax(fmin(b->y1, t->at[i].y1) - fmax(b->y0, t->at[i].y0), 0);
    return sum;
}

/* Right of the point, left of it, or some lines higher or lower: the first place that is free, else the freest. */
static void add_labels(const canvas *c, const orl_plot_series *series, int n)
{
    static const int LINES[] = { 0, -1, 1, -2, 2, -3, 3 };
    taken t = { .n = 0 };
    for (int k = 0; k < n; k++) for (int i = 0; i < series[k].n; i++) if (shown(&series[k], i, c->st)) {
        double x = point_x(c, &series[k], i), y = point_y(c, &series[k], i);
        take(&t, (box){ x - 4, y - 4, x + 4, y + 4 });
    }
    for (int k = 0; k < n; k++)
        for (int i = 0; c->st->labels && c->st->labels[k] && i < series[k].n; i++) {
            const char *label = c->st->labels[k][i];
            if (!label || !*label || !shown(&series[k], i, c->st)) continue;
            double x = point_x(c, &series[k], i), y = point_y(c, &series[k], i), wide = 5.6 * (double)strlen(label), least = INFINITY;
            box best = { 0 };
            for (int q = 0; q < 2 * (int)(sizeof LINES / sizeof *LINES); q++) {
                double left = q & 1 ? x - 8 - wide : x + 8, middle = y + 13 * LINES[q / 2];
                box b = { left, middle - 6, left + wide, middle + 6 };
                double cost = in_the_way(c, &t, &b);
                if (!(cost < least)) continue;
                least = cost;
                best = b;
            }
            take(&t, best);
            orl_text_add(c->out, "<text x=\"%.1f\" y=\"%.1f\" font-size=\"11\" textLength=\"%.0f\">", best.x0, best.y1 - 2, wide);
            orl_text_escape(c->out, label);
            orl_text_add(c->out, "</text>\n");
        }
}

/* The series' names, in two columns where they are many. Bottom right: curves that rise leave room there; top right for those that fall. */
static void add_key(const canvas *c, const orl_plot_series *series, int n)
{
    int columns = n > 4 ? 2 : 1, rows = (n + columns - 1) / columns;
    for (int k = 0; k < n; k++) {
        const char *colour = COLOURS[k % (int)(sizeof COLOURS / sizeof *COLOURS)];
        double x = LEFT + 12 + c->pw * (columns == 1 || k >= rows ? 0.55 : 0.05), y = c->st->key_above ? TOP + 14 + 17.0 * (k % rows) : TOP + c->ph - 10 - 17.0 * (rows - 1 - k % rows);
        if (c->st->no_lines) orl_text_add(c->out, "<circle cx=\"%.1f\" cy=\"%.1f\" r=\"3.5\" fill=\"%s\"/>", x + 14, y - 4, colour);
        else orl_text_add(c->out, "<path d=\"M%.1f %.1fh18\" stroke=\"%s\" stroke-width=\"3\"/>", x, y - 4, colour);
        orl_text_add(c->out, "<text x=\"%.1f\" y=\"%.1f\" fill=\"#1e293b\" stroke=\"#fff\" stroke-width=\"3\" paint-order=\"stroke\">", x + 25, y);
        orl_text_escape(c->out, series[k].name);
        orl_text_add(c->out, "</text>\n");
    }
}

static void add_text(const canvas *c, const char *attributes, const char *s)
{
    if (!s) return;
    orl_text_add(c->out, "<text %s>", attributes);
    orl_text_escape(c->out, s);
    orl_text_add(c->out, "</text>\n");
}

void orl_plot_svg(orl_text *out, const orl_plot_series *series, int n, const orl_plot_style *st)
{
    canvas c = { .out = out, .st = st, .pw = st->w - LEFT - RIGHT, .ph = st->h - TOP - BOTTOM };
    char at[120];
    find_ranges(&c, series, n);
    orl_text_add(out, "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 %d %d\" role=\"img\">\n<title>", st->w, st->h);
    orl_text_escape(out, st->title ? st->title : "plot");
    orl_text_add(out, "</title>\n<g font-family=\"system-ui,-apple-system,'Segoe UI',sans-serif\" font-size=\"12\" fill=\"#475569\">\n<rect width=\"%d\" height=\"%d\" fill=\"#fff\"/>\n", st->w, st->h);
    add_axes(&c);
    for (int k = 0; k < n; k++) add_line(&c, &series[k], COLOURS[k % (int)(sizeof COLOURS / sizeof *COLOURS)]);
    add_labels(&c, series, n);
    if (n > 1) add_key(&c, series, n);
    snprintf(at, sizeof at, "x=\"%d\" y=\"20\" font-size=\"14\" font-weight=\"600\" fill=\"#1e293b\"", LEFT);
    add_text(&c, at, st->title);
    snprintf(at, sizeof at, "x=\"%.1f\" y=\"%d\" text-anchor=\"middle\"", LEFT + c.pw / 2, st->h - 8);
    add_text(&c, at, st->x_label);
    snprintf(at, sizeof at, "transform=\"translate(14 %.1f)rotate(-90)\" text-anchor=\"middle\"", TOP + c.ph / 2);
    add_text(&c, at, st->y_label);
    orl_text_add(out, "</g>\n</svg>\n");
}
