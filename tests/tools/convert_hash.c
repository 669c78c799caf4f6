/* Hash of what the conversion kernels write, one line a variant that this machine has: the same on every machine. */
#include <stdio.h>
#include "runtime/kernels/convert.h"

enum { N = 320, ROUNDS = 64 };
static const char *const VARIANT[] = {
#define NAME(n) n,
    ORL_CONVERT_VARIANTS(NAME)
#undef NAME
};

static uint64_t hash(unsigned cpu)
{
    static uint8_t in[3][4 * N + ROUNDS], rgb[3 * N];
    uint64_t r = 5, h = 1469598103934665603u;
    orl_convert_kernels k;
    orl_convert_kernels_init(&k, cpu);
    for (int round = 0; round < ROUNDS; round++)
        for (int p = 0; p < ORL_PIX_COUNT; p++) {
            orl_source_info info = { .w = N, .h = 1, .pixels = (orl_pixels)p, .full_range = round & 1, .matrix = (orl_matrix)(round >> 1 & 1) };
            orl_yuv_tab t;
            orl_yuv_table(&info, &t);
            for (int c = 0; c < 3; c++)
                for (size_t i = 0; i < sizeof *in; i++) {
                    r = r * 6364136223846793005u + 1442695040888963407u;
                    in[c][i] = (uint8_t)(r >> 40 & 15 ? r >> 33 : r >> 48 & 1 ? 255 : 0);
                }
            k.row[p]((const uint8_t *const[3]) { in[0] + round, in[1] + round, in[2] + round }, &t, N, rgb);       /* every alignment */
            for (size_t i = 0; i < sizeof rgb; i++) h = (h ^ rgb[i]) * 1099511628211u;
        }
    return h;
}

int main(void)
{
    for (size_t i = 0; i < sizeof VARIANT / sizeof *VARIANT; i++) {
        unsigned cpu;
        if (!orl_cpu_from_name(VARIANT[i], &cpu)) printf("%016llx %s\n", (unsigned long long)hash(cpu), VARIANT[i]);
    }
    return 0;
}
