/* The camera loop, apart from its command line, so that tests can bring their own source and sink. */
#ifndef RUNTIME_RUN_H
#define RUNTIME_RUN_H
#include "oriel/sink.h"
#include "oriel/source.h"
#include "oriel/widen.h"

typedef struct { long frames; int adapt_every, realtime; } orl_run_options;      /* frames 0: until the source ends */
typedef struct { long frames, lost; double total, seconds[4]; } orl_run_figures;                        /* read, adapt, render, emit; sums over all pictures */
/* photo and wide: tight RGB of the source's and the wide view's size. ORL_E_FORMAT if the source held no picture at all. Lost pictures are named on standard error. */
orl_err orl_run_loop(orl_widen *w, orl_source *source, orl_sink *sink, const orl_run_options *o, uint8_t *photo, uint8_t *wide, orl_run_figures *out);
#endif
