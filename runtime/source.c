/* Sources: opening by specification, and the check of what they hand out. */
#include "oriel/source.h"
#include <errno.h>
#include <string.h>
#include <sys/stat.h>

orl_err orl_source_open(const char *spec, orl_source **out)
{
    if (!strncmp(spec, "raw:", 4)) return orl_source_raw(spec + 4, out);
    if (strncmp(spec, "replay:", 7)) return orl_fail(ORL_E_UNSUPPORTED, "source %s: this build knows replay:PATH and raw:FORMAT:WxH:PATH", spec);
    const char *path = spec + 7;
    struct stat st;
    if (!strcmp(path, "-")) return orl_source_y4m(stdin, "standard input", out);
    if (!*path) return orl_fail(ORL_E_RANGE, "source %s: no path", spec);
    if (stat(path, &st)) return orl_fail(ORL_E_IO, "%s: %s", path, strerror(errno));
    if (S_ISDIR(st.st_mode)) return orl_source_folder(path, out);
    FILE *f = fopen(path, "rb");
    return f ? orl_source_y4m(f, path, out) : orl_fail(ORL_E_IO, "%s: %s", path, strerror(errno));
}

int orl_source_next(orl_source *s, orl_frame *out)
{
    orl_frame f = { { NULL }, { 0 }, { 0 } };
    int got = s->ops->next(s, &f);
    if (got > 0 && orl_frame_check(&s->info, &f)) {
        char why[200];
        snprintf(why, sizeof why, "%s", orl_error_text());
        orl_fail(ORL_E_FORMAT, "picture %ld: %s", s->frame, why);
        got = -1;
    }
    if (got > 0) *out = f;
    s->frame += got != 0;
    return got;
}

void orl_source_close(orl_source *s) { if (s) s->ops->close(s); }
