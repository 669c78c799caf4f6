/* Hash sink: one 64-bit figure over all pictures, so that any run is a regression test. Not for security. */
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include "runtime/sink.h"

typedef struct { orl_sink base; uint64_t hash; } hash;

static uint64_t mix(uint64_t h, uint64_t word)
{
    h = (h ^ word) * 0xd6e8feb86659fd93u;
    return h ^ (h >> 32);
}

uint64_t orl_hash_row(uint64_t h, const uint8_t *bytes, size_t n)
{
    for (size_t i = 0; i < n; i += 8) {
        uint64_t word = 0;
        for (size_t k = 0; k < 8 && i + k < n; k++) word |= (uint64_t)bytes[i + k] << (8 * k);
        h = mix(h, word);
    }
    return h;
}

static orl_err hash_put(orl_sink *s, const uint8_t *rgb, size_t row_bytes)
{
    hash *k = (hash *)s;
    for (int y = 0; y < s->h; y++) k->hash = orl_hash_row(k->hash, rgb + (size_t)y * row_bytes, (size_t)s->w * 3);
    return ORL_OK;
}

static orl_err hash_close(orl_sink *s, char *line, size_t cap)
{
    if (cap) snprintf(line, cap, "hash %016" PRIx64 "  %ld frames of %d x %d", ((hash *)s)->hash, s->frame, s->w, s->h);
    free(s);
    return ORL_OK;
}

orl_err orl_sink_hash(int w, int h, orl_sink **out)
{
    static const orl_sink_ops OPS = { hash_put, hash_close };
    hash *k = malloc(sizeof *k);
    if (!k) return orl_fail(ORL_E_MEMORY, "sink hash: no memory");
    *k = (hash) { { &OPS, w, h, 0 }, ORL_HASH_START };
    *out = &k->base;
    return ORL_OK;
}
