/* Plots (plot.h), and `oriel-train plot`, which draws a table. */
#include "trainer/plot.h"
#include <getopt.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "oriel/image.h"
#include "trainer/commands.h"
#include "trainer/table.h"

void text_add(text *t, const char *fmt, ...)
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

void text_escape(text *t, const char *s)
{
    for (; *s; s++) {
        const char *e = *s == '&' ? "&amp;" : *s == '<' ? "&lt;" : *s == '>' ? "&gt;" : *s == '"' ? "&quot;" : *s == '\'' ? "&#39;" : NULL;
        if (e) text_add(t, "%s", e);
        else if ((unsigned char)*s >= 32) text_add(t, "%c", *s);
    }
}

orl_err text_write(const text *t, const char *path) { return t->failed ? orl_fail(ORL_E_MEMORY, "%s: no memory for it", path) : orl_file_write(path, t->s ? t->s : "", t->n); }

void text_free(text *t)
{
    free(t->s);
    *t = (text){ 0 };
}

double plot_ticks(double lo, double hi, int most, double *first)
{
    double raw = (hi - lo) / most, ten = pow(10, floor(log10(raw))), step = ten;
    for (int k = 0; step < raw * (1 - 1e-9) && k < 3; k++) step = ten * (k == 0 ? 2 : k == 1 ? 5 : 10);
    *first = floor(lo / step + 1e-9) * step;
    return step;
}

enum { LEFT = 56, RIGHT = 16, TOP = 34, BOTTOM = 46 };
static const char *const COLOURS[] = { "#2563eb", "#d9730d", "#0f9d78", "#9d4edd", "#c2255c", "#64748b" };

typedef struct { text *out; const plot_style *st; double x0, x1, y0, y1, pw, ph; } canvas;     /* ranges: of logarithms where an axis has them */

static double on_axis(double v, int log) { return log ? log10(v) : v; }
static double at_x(const canvas *c, double v) { return LEFT + c->pw * (v - c->x0) / (c->x1 - c->x0); }
static double at_y(const canvas *c, double v) { return TOP + c->ph * (c->y1 - v) / (c->y1 - c->y0); }
static int shown(const plot_series *s, int i, const plot_style *st) { return isfinite(s->x[i]) && isfinite(s->y[i]) && (!st->log_x || s->x[i] > 0) && (!st->log_y || s->y[i] > 0); }

static void widen(double *lo, double *hi, double least)         /* a range that is a point */
{
    if (*hi - *lo >= 1e-9 * fmax(1, fabs(*lo))) return;
    *lo -= least;
    *hi += least;
}

static void find_ranges(canvas *c, const plot_series *series, int n)
{
    const plot_style *st = c->st;
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
    if (st->log_x) { c->x0 -= 0.03 * (c->x1 - c->x0); c->x1 += 0.03 * (c->x1 - c->x0); }
}

static void x_tick(const canvas *c, double v, double shown, int line)
{
    double x = at_x(c, v);
    if (line) text_add(c->out, "<path d=\"M%.1f %dV%.1f\" stroke=\"#f1f5f9\"/>", x, TOP, TOP + c->ph);
    text_add(c->out, "<text x=\"%.1f\" y=\"%d\" text-anchor=\"middle\">%.6g</text>\n", x, c->st->h - BOTTOM + 18, shown);
}

static void y_tick(const canvas *c, double v, double shown)
{
    double y = at_y(c, v);
    text_add(c->out, "<path d=\"M%d %.1fH%d\" stroke=\"#e2e8f0\"/><text x=\"%d\" y=\"%.1f\" text-anchor=\"end\">%.6g</text>\n", LEFT, y, c->st->w - RIGHT, LEFT - 8, y + 4, shown);
}

/* 1, 2, 5 times powers of ten; the powers alone on a long axis, none on one that is too long. y: else x. */
static void log_ticks(const canvas *c, int y)
{
    double lo = y ? c->y0 : c->x0, hi = y ? c->y1 : c->x1, wide = hi - lo;
    for (int d = (int)floor(lo); d <= (int)ceil(hi) && wide < 40; d++)
        for (int m = 1; m <= 5; m += m == 1 ? 1 : 3) {
            double v = d + log10(m);
            if (v < lo - 1e-9 || v > hi + 1e-9 || (m > 1 && wide > (y ? 2 : 3))) continue;
            if (y) y_tick(c, v, m * pow(10, d));
            else x_tick(c, v, m * pow(10, d), 1);
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
        step = plot_ticks(c->y0, c->y1, 6, &tick);
        c->y0 = tick;
        c->y1 = ceil(c->y1 / step - 1e-9) * step;
        for (double v = c->y0; v <= c->y1 + 0.5 * step; v += step) y_tick(c, v, fabs(v) < 1e-9 * step ? 0 : v);
    }
    if (c->st->log_x) {
        log_ticks(c, 0);
    } else {
        step = plot_ticks(c->x0, c->x1, 8, &tick);
        for (double v = tick; v <= c->x1 + 1e-6 * step; v += step) if (v >= c->x0 - 1e-6 * step) x_tick(c, v, fabs(v) < 1e-9 * step ? 0 : v, 0);
    }
    text_add(c->out, "<path d=\"M%d %dV%.1fH%d\" fill=\"none\" stroke=\"#94a3b8\"/>\n", LEFT, TOP, TOP + c->ph, c->st->w - RIGHT);
}

static void add_line(const canvas *c, const plot_series *s, const char *colour)
{
    const plot_style *st = c->st;
    const char *go = "M";
    text_add(c->out, "<path fill=\"none\" stroke=\"%s\" stroke-width=\"2\" stroke-linejoin=\"round\" d=\"", colour);
    for (int i = 0; i < s->n; i++) {
        if (!shown(s, i, st)) continue;
        text_add(c->out, "%s%.1f %.1f", go, at_x(c, on_axis(s->x[i], st->log_x)), at_y(c, on_axis(s->y[i], st->log_y)));
        go = "L";
    }
    text_add(c->out, "\"/>\n");
    for (int i = 0; st->dots && i < s->n; i++)
        if (shown(s, i, st))
            text_add(c->out, "<circle cx=\"%.1f\" cy=\"%.1f\" r=\"3.5\" fill=\"%s\"><title>%.4g, %.4g</title></circle>\n", at_x(c, on_axis(s->x[i], st->log_x)), at_y(c, on_axis(s->y[i], st->log_y)), colour, s->x[i],
                     s->y[i]);
}

/* The series' names, in two columns where they are many. Bottom right: curves that rise leave room there; top right for those that fall. */
static void add_key(const canvas *c, const plot_series *series, int n)
{
    int columns = n > 4 ? 2 : 1, rows = (n + columns - 1) / columns;
    for (int k = 0; k < n; k++) {
        const char *colour = COLOURS[k % (int)(sizeof COLOURS / sizeof *COLOURS)];
        double x = LEFT + 12 + c->pw * (columns == 1 || k >= rows ? 0.55 : 0.05), y = c->st->key_above ? TOP + 14 + 17.0 * (k % rows) : TOP + c->ph - 10 - 17.0 * (rows - 1 - k % rows);
        text_add(c->out, "<path d=\"M%.1f %.1fh18\" stroke=\"%s\" stroke-width=\"3\"/><text x=\"%.1f\" y=\"%.1f\" fill=\"#1e293b\" stroke=\"#fff\" stroke-width=\"3\" paint-order=\"stroke\">", x, y - 4, colour, x + 25, y);
        text_escape(c->out, series[k].name);
        text_add(c->out, "</text>\n");
    }
}

static void add_text(const canvas *c, const char *attributes, const char *s)
{
    if (!s) return;
    text_add(c->out, "<text %s>", attributes);
    text_escape(c->out, s);
    text_add(c->out, "</text>\n");
}

void plot_svg(text *out, const plot_series *series, int n, const plot_style *st)
{
    canvas c = { .out = out, .st = st, .pw = st->w - LEFT - RIGHT, .ph = st->h - TOP - BOTTOM };
    char at[120];
    find_ranges(&c, series, n);
    text_add(out, "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 %d %d\" role=\"img\">\n<title>", st->w, st->h);
    text_escape(out, st->title ? st->title : "plot");
    text_add(out, "</title>\n<g font-family=\"system-ui,-apple-system,'Segoe UI',sans-serif\" font-size=\"12\" fill=\"#475569\">\n<rect width=\"%d\" height=\"%d\" fill=\"#fff\"/>\n", st->w, st->h);
    add_axes(&c);
    for (int k = 0; k < n; k++) add_line(&c, &series[k], COLOURS[k % (int)(sizeof COLOURS / sizeof *COLOURS)]);
    if (n > 1) add_key(&c, series, n);
    snprintf(at, sizeof at, "x=\"%d\" y=\"20\" font-size=\"14\" font-weight=\"600\" fill=\"#1e293b\"", LEFT);
    add_text(&c, at, st->title);
    snprintf(at, sizeof at, "x=\"%.1f\" y=\"%d\" text-anchor=\"middle\"", LEFT + c.pw / 2, st->h - 8);
    add_text(&c, at, st->x_label);
    snprintf(at, sizeof at, "transform=\"translate(14 %.1f)rotate(-90)\" text-anchor=\"middle\"", TOP + c.ph / 2);
    add_text(&c, at, st->y_label);
    text_add(out, "</g>\n</svg>\n");
}

/* ---- command ---- */

enum { MOST_SERIES = 32 };
typedef struct { plot_series series[MOST_SERIES]; int n; char *x_label, *y_label; } table;

/* Lines `series TAB x TAB y`, the first of which may name the axes instead. bytes: cut up here, and referred to; room: four numbers a line. */
static orl_err read_table(char *bytes, const char *path, double *room, table *t)
{
    int line = 0, n = 0, lines = 0;
    for (char *s = bytes; *s; s++) lines += *s == '\n';
    double *x = room, *y = room + lines + 1;
    int *of = (int *)(room + 2 * (lines + 1));
    for (char *s, *next = bytes; (s = table_line(&next));) {
        double v[2];
        int k = 0;
        line++;
        if (!*s || *s == '#') continue;
        char *rest = s, *name = table_field(&rest), *a = table_field(&rest), *b = table_field(&rest);
        if (!a || !b || rest) return orl_fail(ORL_E_FORMAT, "%s: line %d: three columns wanted: series, x, y", path, line);
        if (!table_number(a, &v[0]) || !table_number(b, &v[1])) {
            if (n || t->x_label) return orl_fail(ORL_E_FORMAT, "%s: line %d: x or y is no number", path, line);
            t->x_label = a;
            t->y_label = b;
            continue;
        }
        while (k < t->n && strcmp(t->series[k].name, name)) k++;
        if (k == MOST_SERIES) return orl_fail(ORL_E_RANGE, "%s: line %d: more than %d series", path, line, MOST_SERIES);
        if (k == t->n) t->series[t->n++].name = name;
        t->series[k].n++;
        of[n] = k;
        x[n] = v[0];
        y[n++] = v[1];
    }
    if (!n) return orl_fail(ORL_E_DEGENERATE, "%s: no point", path);
    double *to = room + 3 * (lines + 1);        /* each series in one piece, its lines in their order */
    for (int k = 0; k < t->n; k++) {
        t->series[k].x = to;
        for (int i = 0; i < n; i++) if (of[i] == k) *to++ = x[i];
        t->series[k].y = to;
        for (int i = 0; i < n; i++) if (of[i] == k) *to++ = y[i];
    }
    return ORL_OK;
}

static const char HELP[] =
    "Usage: oriel-train plot FILE.tsv -o FILE.svg [options]\n"
    "Draws a table of three columns (series, x, y; the first line may name the axes) as lines.\n\n"
    "  -o, --output FILE     SVG to write\n"
    "      --title TEXT\n"
    "      --log-x           logarithmic x axis\n"
    "      --help\n";

int cmd_plot(int argc, char **argv)
{
    static const struct option LONG[] = { { "output", 1, 0, 'o' }, { "title", 1, 0, 't' }, { "log-x", 0, 0, 'l' }, { "help", 0, 0, 'h' }, { 0 } };
    const char *output = NULL;
    plot_style style = { .dots = 1, .w = 760, .h = 440 };
    int c;
    while ((c = getopt_long(argc, argv, "o:h", LONG, NULL)) != -1) switch (c) {
        case 'o': output = optarg; break;
        case 't': style.title = optarg; break;
        case 'l': style.log_x = 1; break;
        case 'h': fputs(HELP, stdout); return 0;
        default: fputs(HELP, stderr); return 2;
    }
    if (optind + 1 != argc || !output) { fputs(HELP, stderr); return 2; }
    uint8_t *file = NULL;
    char *bytes = NULL;
    double *room = NULL;
    size_t n;
    table t = { 0 };
    text svg = { 0 };
    orl_err e = orl_file_read(argv[optind], 1 << 24, &file, &n);
    if (!e) {
        bytes = malloc(n + 1);
        room = malloc(5 * (n + 1) * sizeof *room);      /* no more lines than bytes */
        if (!bytes || !room) e = orl_fail(ORL_E_MEMORY, "%s: no memory", argv[optind]);
    }
    if (!e) {
        memcpy(bytes, file, n);
        bytes[n] = 0;
        e = read_table(bytes, argv[optind], room, &t);
    }
    if (!e) {
        style.x_label = t.x_label;
        style.y_label = t.y_label;
        plot_svg(&svg, t.series, t.n, &style);
        e = text_write(&svg, output);
    }
    if (e) fprintf(stderr, "oriel-train: %s\n", orl_error_text());
    text_free(&svg);
    free(file);
    free(bytes);
    free(room);
    return e ? 1 : 0;
}
