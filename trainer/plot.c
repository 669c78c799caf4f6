/* `oriel-train plot`: a table as SVG. */
#include <getopt.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "oriel/image.h"
#include "oriel/plot.h"
#include "trainer/commands.h"
#include "trainer/table.h"

enum { MOST_SERIES = 32 };
typedef struct { orl_plot_series series[MOST_SERIES]; int n; char *x_label, *y_label; } table;

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
    orl_plot_style style = { .dots = 1, .w = 760, .h = 440 };
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
    orl_text svg = { 0 };
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
        orl_plot_svg(&svg, t.series, t.n, &style);
        e = orl_text_write(&svg, output);
    }
    if (e) fprintf(stderr, "oriel-train: %s\n", orl_error_text());
    orl_text_free(&svg);
    free(file);
    free(bytes);
    free(room);
    return e ? 1 : 0;
}
