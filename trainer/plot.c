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

static int shown(const plot_series *s, int i, const plot_style *st) { return isfinite(s->x[i]) && isfinite(s->y[i]) && (!st->log_x || s->x[i] > 0); }

enum { LEFT = 56, RIGHT = 16, TOP = 34, BOTTOM = 46 };
static const char *const COLOURS[] = { "#2563eb", "#d9730d", "#0f9d78", "#9d4edd", "#c2255c", "#64748b" };

void plot_svg(text *out, const plot_series *series, int n, const plot_style *st)
{
    double x0 = INFINITY, x1 = -INFINITY, y0 = INFINITY, y1 = -INFINITY, tick;
    for (int k = 0; k < n; k++)
        for (int i = 0; i < series[k].n; i++) {
            if (!shown(&series[k], i, st)) continue;
            double x = st->log_x ? log10(series[k].x[i]) : series[k].x[i], y = series[k].y[i];
            x0 = fmin(x0, x); x1 = fmax(x1, x);
            y0 = fmin(y0, y); y1 = fmax(y1, y);
        }
    if (!(x0 <= x1)) { x0 = y0 = 0; x1 = y1 = 1; }
    if (x1 - x0 < 1e-9 * fmax(1, fabs(x0))) { double d = st->log_x ? 0.3 : fmax(fabs(x0), 1) * 0.1; x0 -= d; x1 += d; }
    if (y1 - y0 < 1e-9 * fmax(1, fabs(y0))) { double d = fmax(fabs(y0), 1) * 0.1; y0 -= d; y1 += d; }
    if (st->log_x) { x0 -= 0.03 * (x1 - x0); x1 += 0.03 * (x1 - x0); }
    double step = plot_ticks(y0, y1, 6, &tick), pw = st->w - LEFT - RIGHT, ph = st->h - TOP - BOTTOM;
    y0 = tick;
    y1 = ceil(y1 / step - 1e-9) * step;
#define PX(v) (LEFT + pw * ((v) - x0) / (x1 - x0))
#define PY(v) (TOP + ph * (y1 - (v)) / (y1 - y0))
    text_add(out, "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 %d %d\" role=\"img\" font-family=\"system-ui,-apple-system,'Segoe UI',sans-serif\" font-size=\"12\" fill=\"#475569\">\n<title>", st->w, st->h);
    text_escape(out, st->title ? st->title : "plot");
    text_add(out, "</title>\n<rect width=\"%d\" height=\"%d\" fill=\"#fff\"/>\n", st->w, st->h);
    for (double v = y0; v <= y1 + 0.5 * step; v += step)
        text_add(out, "<path d=\"M%d %.1fH%d\" stroke=\"#e2e8f0\"/><text x=\"%d\" y=\"%.1f\" text-anchor=\"end\">%.6g</text>\n", LEFT, PY(v), st->w - RIGHT, LEFT - 8, PY(v) + 4, fabs(v) < 1e-9 * step ? 0 : v);
    if (st->log_x) {
        double wide = x1 - x0;
        for (int d = (int)floor(x0); d <= (int)ceil(x1) && wide < 40; d++)
            for (int m = 1; m <= 5; m += m == 1 ? 1 : 3) {
                double v = d + log10(m);
                if (v < x0 || v > x1 || (m > 1 && wide > 3)) continue;
                text_add(out, "<path d=\"M%.1f %dV%.1f\" stroke=\"#f1f5f9\"/><text x=\"%.1f\" y=\"%d\" text-anchor=\"middle\">%.6g</text>\n", PX(v), TOP, TOP + ph, PX(v), st->h - BOTTOM + 18, m * pow(10, d));
            }
    } else {
        double xs = plot_ticks(x0, x1, 8, &tick);
        for (double v = tick; v <= x1 + 1e-6 * xs; v += xs)
            if (v >= x0 - 1e-6 * xs) text_add(out, "<text x=\"%.1f\" y=\"%d\" text-anchor=\"middle\">%.6g</text>\n", PX(v), st->h - BOTTOM + 18, fabs(v) < 1e-9 * xs ? 0 : v);
    }
    text_add(out, "<path d=\"M%d %dV%.1fH%d\" fill=\"none\" stroke=\"#94a3b8\"/>\n", LEFT, TOP, TOP + ph, st->w - RIGHT);
    for (int k = 0; k < n; k++) {
        const char *colour = COLOURS[k % (int)(sizeof COLOURS / sizeof *COLOURS)], *go = "M";
        text_add(out, "<path fill=\"none\" stroke=\"%s\" stroke-width=\"2\" stroke-linejoin=\"round\" d=\"", colour);
        for (int i = 0; i < series[k].n; i++) {
            if (!shown(&series[k], i, st)) continue;
            double x = st->log_x ? log10(series[k].x[i]) : series[k].x[i];
            text_add(out, "%s%.1f %.1f", go, PX(x), PY(series[k].y[i]));
            go = "L";
        }
        text_add(out, "\"/>\n");
        for (int i = 0; st->dots && i < series[k].n; i++) {
            if (!shown(&series[k], i, st)) continue;
            double x = st->log_x ? log10(series[k].x[i]) : series[k].x[i];
            text_add(out, "<circle cx=\"%.1f\" cy=\"%.1f\" r=\"3.5\" fill=\"%s\"><title>%.4g, %.4g</title></circle>\n", PX(x), PY(series[k].y[i]), colour, series[k].x[i], series[k].y[i]);
        }
        if (n < 2) continue;
        double lx = LEFT + 12 + pw * 0.55, ly = TOP + ph - 14 - 17.0 * (n - 1 - k);     /* bottom right: curves that rise leave room there */
        text_add(out, "<path d=\"M%.1f %.1fh18\" stroke=\"%s\" stroke-width=\"3\"/><text x=\"%.1f\" y=\"%.1f\" fill=\"#1e293b\" stroke=\"#fff\" stroke-width=\"3\" paint-order=\"stroke\">", lx, ly - 4, colour, lx + 25, ly);
        text_escape(out, series[k].name);
        text_add(out, "</text>\n");
    }
    if (st->title) {
        text_add(out, "<text x=\"%d\" y=\"20\" font-size=\"14\" font-weight=\"600\" fill=\"#1e293b\">", LEFT);
        text_escape(out, st->title);
        text_add(out, "</text>\n");
    }
    if (st->x_label) {
        text_add(out, "<text x=\"%.1f\" y=\"%d\" text-anchor=\"middle\">", LEFT + pw / 2, st->h - 8);
        text_escape(out, st->x_label);
        text_add(out, "</text>\n");
    }
    if (st->y_label) {
        text_add(out, "<text transform=\"translate(14 %.1f)rotate(-90)\" text-anchor=\"middle\">", TOP + ph / 2);
        text_escape(out, st->y_label);
        text_add(out, "</text>\n");
    }
    text_add(out, "</svg>\n");
#undef PX
#undef PY
}

/* ---- command ---- */

enum { MOST_SERIES = 32 };
typedef struct { plot_series series[MOST_SERIES]; int n; char *x_label, *y_label; } table;

/* Cuts the next field off a line. */
static char *field(char **line)
{
    char *s = *line, *end = s ? strchr(s, '\t') : NULL;
    if (end) *end = 0;
    *line = end ? end + 1 : NULL;
    return s;
}

static int numeric(const char *s, double *v)
{
    char *end;
    *v = strtod(s, &end);
    return end != s && !*end && isfinite(*v);
}

/* Lines `series TAB x TAB y`, the first of which may name the axes instead. bytes: cut up here, and referred to; room: four numbers a line. */
static orl_err read_table(char *bytes, const char *path, double *room, table *t)
{
    int line = 0, n = 0, lines = 0;
    for (char *s = bytes; *s; s++) lines += *s == '\n';
    double *x = room, *y = room + lines + 1;
    int *of = (int *)(room + 2 * (lines + 1));
    for (char *s = bytes, *next; s && *s; s = next) {
        double v[2];
        int k = 0;
        if ((next = strchr(s, '\n'))) *next++ = 0;
        line++;
        if (*s && s[strlen(s) - 1] == '\r') s[strlen(s) - 1] = 0;
        if (!*s || *s == '#') continue;
        char *rest = s, *name = field(&rest), *a = field(&rest), *b = field(&rest);
        if (!a || !b || rest) return orl_fail(ORL_E_FORMAT, "%s: line %d: three columns wanted: series, x, y", path, line);
        if (!numeric(a, &v[0]) || !numeric(b, &v[1])) {
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
