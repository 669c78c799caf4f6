/* Fuzz target: the Y4M parser and the colour conversion behind it. With -DFUZZ_MAIN a plain program that replays files. */
#include <stdlib.h>
#include "oriel/cpu.h"
#include "oriel/source.h"

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t n)
{
    orl_source *s;
    orl_frame f;
    FILE *m = n ? fmemopen((void *)bytes, n, "rb") : NULL;
    if (!m || orl_source_y4m(m, "fuzz", &s)) return 0;
    size_t row = (size_t)s->info.w * 3;
    uint8_t *rgb = malloc(row * (size_t)s->info.h);
    for (int got; rgb && (got = orl_source_next(s, &f)); )
        if (got > 0) orl_frame_to_rgb(&s->info, &f, orl_cpu_detect(), 0, s->info.h, rgb, row);
    free(rgb);
    orl_source_close(s);
    return 0;
}

#ifdef FUZZ_MAIN
#include "tests/fuzz/replay.h"

static void replay(const uint8_t *bytes, size_t n) { LLVMFuzzerTestOneInput(bytes, n); }
#endif
