/* Reads the ablation table (ablation.h). */
#include "trainer/ablation.h"
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "oriel/image.h"
#include "trainer/table.h"

enum { MOST_BYTES = 1 << 16 };
static const char HEADING[] = "variant\tpsnr\tssim\tflip\tpsnr_full\talbedo_psnr\tsun_median_deg\trelit_psnr";

static int printable(const char *s)
{
    while (*s >= ' ' && *s <= '~') s++;
    return !*s;
}

static orl_err read_row(char *line, const char *path, int number, ablation *t)
{
    ablation_row *r = &t->row[t->n];
    char *name = table_field(&line), *f = NULL;
    if (t->n == ABLATION_ROWS) return orl_fail(ORL_E_RANGE, "%s: line %d: more than %d variants", path, number, ABLATION_ROWS);
    if (!*name || strlen(name) >= sizeof r->variant || !printable(name)) return orl_fail(ORL_E_FORMAT, "%s: line %d: a variant's name is 1 to %zu printable characters", path, number, sizeof r->variant - 1);
    strcpy(r->variant, name);
    for (int i = 0; i < t->n; i++) if (!strcmp(t->row[i].variant, name)) return orl_fail(ORL_E_FORMAT, "%s: line %d: variant %s a second time", path, number, name);
    for (int k = 0; k < ABLATION_FIGURES; k++) {
        if (!(f = table_field(&line))) return orl_fail(ORL_E_FORMAT, "%s: line %d: %d columns wanted", path, number, ABLATION_FIGURES + 1);
        if (k != ABLATION_PSNR && !strcmp(f, "-")) r->v[k] = NAN;
        else if (!table_number(f, &r->v[k]) || fabs(r->v[k]) > 1000) return orl_fail(ORL_E_FORMAT, "%s: line %d: column %d: a number within 1000 wanted", path, number, k + 2);
    }
    if (line) return orl_fail(ORL_E_FORMAT, "%s: line %d: %d columns wanted", path, number, ABLATION_FIGURES + 1);
    if (!strcmp(name, "full")) t->full = t->n;
    t->n++;
    return ORL_OK;
}

static orl_err read_rows(char *text, const char *path, ablation *t)
{
    char *line = table_line(&text);
    if (!line || strcmp(line, HEADING)) return orl_fail(ORL_E_FORMAT, "%s: line 1: not the heading of an ablation table", path);
    for (int number = 2; (line = table_line(&text)); number++) {
        orl_err e = read_row(line, path, number, t);
        if (e) return e;
    }
    return t->full < 0 ? orl_fail(ORL_E_FORMAT, "%s: line %d: ends without a variant `full` to compare with", path, t->n + 1) : ORL_OK;
}

orl_err ablation_read(const char *path, ablation *out)
{
    uint8_t *bytes = NULL;
    size_t n;
    ablation *t = calloc(1, sizeof *t);
    orl_err e = t ? orl_file_read(path, MOST_BYTES, &bytes, &n) : orl_fail(ORL_E_MEMORY, "%s: no memory", path);
    if (!e) {
        int line = 1;
        const uint8_t *zero = memchr(bytes, 0, n);
        for (const uint8_t *b = bytes; zero && b < zero; b++) line += *b == '\n';
        t->full = -1;
        e = zero ? orl_fail(ORL_E_FORMAT, "%s: line %d: a zero byte", path, line) : read_rows((char *)bytes, path, t);
    }
    if (!e) *out = *t;
    free(bytes);
    free(t);
    return e;
}
