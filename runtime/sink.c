/* Sinks: opening by specification. */
#include "runtime/sink.h"
#include <stdio.h>
#include <string.h>

orl_err orl_sink_open(const char *spec, int w, int h, int fps_num, int fps_den, orl_sink **out)
{
    if (!strncmp(spec, "files:", 6)) return orl_sink_files(spec + 6, w, h, out);
    if (!strcmp(spec, "hash:")) return orl_sink_hash(w, h, out);
    if (!strncmp(spec, "y4m:", 4)) return orl_sink_y4m(spec + 4, w, h, fps_num, fps_den, out);
    return orl_fail(ORL_E_UNSUPPORTED, "sink %s: this build knows files:DIR, hash: and y4m:FILE", spec);
}

orl_err orl_sink_put(orl_sink *s, const uint8_t *rgb, size_t row_bytes)
{
    orl_err e = s->ops->put(s, rgb, row_bytes);
    s->frame++;
    return e;
}

orl_err orl_sink_close(orl_sink *s, char *line, size_t cap)
{
    if (line && cap) line[0] = 0;
    return s ? s->ops->close(s, line, line ? cap : 0) : ORL_OK;
}
