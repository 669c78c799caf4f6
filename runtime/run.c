/* The camera loop. Fixed camera: the views are built once, then every frame is converted, its light found from the last one's, and the wide picture re-lit, blended and handed on.
 * A frame that is lost is named and the last wide picture repeated. Nothing allocates after the first frame (picture decoders and encoders of folder sources and files sinks apart). */
#include "runtime/run.h"
#include <stdio.h>
#include <time.h>
#include <unistd.h>
#include "oriel/parallel.h"
#include "runtime/commands.h"

typedef struct { const orl_source_info *info; const orl_frame *frame; unsigned cpu; uint8_t *rgb; } conversion;

static void convert(void *user, int begin, int end)
{
    conversion *c = user;
    orl_frame_to_rgb(c->info, c->frame, c->cpu, begin, end, c->rgb, (size_t)c->info->w * 3);
}

static void wait_until(double start, long frame, const orl_source_info *i)
{
    double left = start + (double)frame * i->fps_den / i->fps_num - orl_seconds();
    if (left <= 0) return;
    struct timespec t = { (time_t)left, (long)((left - (double)(time_t)left) * 1e9) };
    nanosleep(&t, NULL);
}

orl_err orl_run_loop(orl_widen *w, orl_source *source, orl_sink *sink, const orl_run_options *o, uint8_t *photo, uint8_t *wide, orl_run_figures *out)
{
    orl_run_figures f = { 0 };
    orl_frame frame;
    double start = orl_seconds(), told = start, t[5];
    int got, terminal = isatty(STDERR_FILENO), have = 0;
    long good = 0;
    orl_err e = ORL_OK;
    while (!e && (!o->frames || f.frames < o->frames)) {
        t[0] = orl_seconds();
        if (!(got = orl_source_next(source, &frame))) break;
        if (got < 0) {
            f.lost++;
            fprintf(stderr, "oriel run: %s: %s\n", orl_error_text(), have ? "the last picture stands" : "left out");
            if (!have) continue;
            e = orl_sink_put(sink, wide, (size_t)w->wide.w * 3);
            f.frames++;
            continue;
        }
        conversion c = { &source->info, &frame, w->config.cpu, photo };
        orl_parallel(w->config.threads, source->info.h, 32, convert, &c);
        t[1] = orl_seconds();
        if (!w->adapted || good % o->adapt_every == 0) e = orl_widen_adapt(w, photo);
        good++;
        t[2] = orl_seconds();
        if (!e) e = orl_widen_render(w, photo, wide);
        t[3] = orl_seconds();
        if (o->realtime) wait_until(start, f.frames, &source->info);
        if (!e) e = orl_sink_put(sink, wide, (size_t)w->wide.w * 3);
        t[4] = orl_seconds();
        if (e) break;
        have = 1;
        f.frames++;
        for (int k = 0; k < 4; k++) f.seconds[k] += t[k + 1] - t[k];
        if (terminal && t[4] > told + 1) {
            told = t[4];
            fprintf(stderr, "\r%ld pictures, %.1f a second, rms %.4f ", f.frames, (double)f.frames / (told - start), (double)w->fit.rms);
        }
    }
    if (terminal) fprintf(stderr, "\r\033[K");
    f.total = orl_seconds() - start;
    if (!e && !have) e = orl_fail(ORL_E_FORMAT, "the source holds no picture that can be read");
    *out = f;
    return e;
}
