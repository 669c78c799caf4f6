/* Names of what is skipped (skips.h). */
#include "runtime/skips.h"
#include <stdlib.h>
#include <string.h>

const struct orl_skip orl_skip_list[ORL_SKIPS] = {
    { "photo", ORL_SKIP_PHOTO }, { "sky", ORL_SKIP_SKY }, { "shadow", ORL_SKIP_SHADOW }, { "same", ORL_SKIP_SAME }, { "empty", ORL_SKIP_EMPTY }, { "light", ORL_SKIP_LIGHT } };

orl_err orl_skips_parse(const char *text, unsigned *out)
{
    unsigned bits = text ? 0 : ORL_SKIP_ALL;
    for (size_t n; text; text = text[n] ? text + n + 1 : NULL) {
        int k = 0;
        n = strcspn(text, ",");
        while (k < ORL_SKIPS && (strlen(orl_skip_list[k].name) != n || strncmp(orl_skip_list[k].name, text, n))) k++;
        if (k == ORL_SKIPS) return orl_fail(ORL_E_RANGE, "--no-skip: %.*s is none of photo, sky, shadow, same, empty, light", (int)n, text);
        bits |= orl_skip_list[k].bit;
    }
    *out = bits;
    return ORL_OK;
}

orl_err orl_skips_crowd(orl_scene *s, int32_t **bmap)
{
    size_t n = (size_t)s->nb[0] * s->nb[1] * s->nb[2];
    if (!(*bmap = malloc(n * sizeof **bmap + 1))) return orl_fail(ORL_E_MEMORY, "no memory for a map of %zu bricks", n);
    for (size_t i = 0; i < n; i++) (*bmap)[i] = s->bmap[i] < 0 ? -1 : s->bmap[i];
    s->bmap = *bmap;
    return ORL_OK;
}
