/* `oriel bench --convert`: the conversion kernels beside memcpy of the bytes that they move, on made-up pictures of two camera sizes. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include "runtime/commands.h"
#include "runtime/kernels/convert.h"

enum { RUNS = 40 };

orl_err orl_bench_convert(orl_bench_say *say, void *user)
{
    static const int SIZE[][2] = { { 640, 480 }, { 1920, 1080 } };
    static const char *const VARIANT[] = {
#define NAME(n) n,
        ORL_CONVERT_VARIANTS(NAME)
#undef NAME
    };
    for (size_t s = 0; s < sizeof SIZE / sizeof *SIZE; s++)
        for (int p = 0; p < ORL_PIX_COUNT; p++) {
            orl_source_info info = { .w = SIZE[s][0], .h = SIZE[s][1], .pixels = (orl_pixels)p };
            size_t n = (size_t)info.w * (size_t)info.h;
            orl_frame f;
            char name[64];
            uint8_t *rgb = calloc(n, 3), *in = malloc(3 * n);       /* no format takes more */
            size_t bytes = 3 * n + orl_frame_layout(&info, in, &f);
            for (size_t i = 0; in && i < 3 * n; i++) in[i] = (uint8_t)(i * 2654435761u >> 13);
            snprintf(name, sizeof name, "convert %s, %d x %d", orl_pixels_name(info.pixels), info.w, info.h);
            for (size_t v = 0; rgb && in && v < sizeof VARIANT / sizeof *VARIANT; v++) {
                unsigned cpu;
                double best = INFINITY, spent = 0;
                if (orl_cpu_from_name(VARIANT[v], &cpu) || (info.pixels == ORL_PIX_RGB && v)) continue;      /* RGB is copied by all */
                for (int i = 0; i < RUNS && (i < 3 || spent < 0.05); i++) {
                    double a = orl_seconds();
                    orl_frame_to_rgb(&info, &f, cpu, 0, info.h, rgb, 3 * (size_t)info.w);
                    a = orl_seconds() - a;
                    best = fmin(best, a);
                    spent += a;
                }
                say(user, name, VARIANT[v], best, bytes);
            }
            free(rgb);
            free(in);
            if (!rgb || !in) return orl_fail(ORL_E_MEMORY, "no memory for pictures of %d x %d", info.w, info.h);
        }
    return ORL_OK;
}
