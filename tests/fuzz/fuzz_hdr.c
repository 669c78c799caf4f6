/* Fuzz target: the reader of Radiance pictures. With -DFUZZ_MAIN a plain program that replays files: whole, cut at lengths all over the file, and with single bytes changed. */
#include <stdlib.h>
#include <string.h>
#include "formats/codec.h"

static volatile float sink;

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t n);
int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t n)
{
    orl_imagef im;
    if (codec_hdr_read("fuzz", bytes, n, &im)) return 0;
    float sum = 0;                                      /* whatever is accepted can be walked */
    for (size_t i = 0, m = (size_t)im.w * (size_t)im.h * 3; i < m; i++) sum += im.px[i];
    sink = sum;
    orl_imagef_free(&im);
    return 0;
}

#ifdef FUZZ_MAIN
#include "tests/fuzz/replay.h"

/* A copy of exactly n bytes, so that a sanitizer sees a read beyond them. */
static void once(const uint8_t *bytes, size_t n, size_t at, int change)
{
    uint8_t *b = malloc(n ? n : 1);
    if (!b) exit(1);
    memcpy(b, bytes, n);
    if (at < n) b[at] ^= (uint8_t)change;
    LLVMFuzzerTestOneInput(b, n);
    free(b);
}

static void replay(const uint8_t *bytes, size_t n)
{
    size_t step = n / 1000 + 1;
    once(bytes, n, n, 0);
    for (size_t k = 0; k < n; k += k < 200 ? 1 : step) {
        once(bytes, k, k, 0);
        for (int bit = 0; bit < 8; bit++) once(bytes, n, k, 1 << bit);
        once(bytes, n, k, 255);
    }
}
#endif
