/* The sinks there are. */
#ifndef RUNTIME_SINK_H
#define RUNTIME_SINK_H
#include "oriel/sink.h"
orl_err orl_sink_files(const char *where, int w, int h, orl_sink **out);
orl_err orl_sink_hash(int w, int h, orl_sink **out);
orl_err orl_sink_y4m(const char *path, int w, int h, int fps_num, int fps_den, orl_sink **out);
#endif
