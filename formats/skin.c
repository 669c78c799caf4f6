/* Base colour out of a brick's textures (oriel/skin.h). */
#include "oriel/skin.h"

unsigned orl_skin_mask(uint32_t entry) { return entry & 63; }
uint32_t orl_skin_first(uint32_t entry) { return entry >> 6; }
uint32_t orl_skin_texture(uint32_t entry, int face) { return orl_skin_first(entry) + (uint32_t)__builtin_popcount(orl_skin_mask(entry) & ((1u << face) - 1)); }

int orl_skin_face(unsigned mask, const int32_t grad[3])
{
    int best = -1;
    int32_t most = 0;
    for (int f = 0; f < ORL_SKIN_FACES; f++) {
        int32_t g = f & 1 ? -grad[f >> 1] : grad[f >> 1];
        if (mask >> f & 1 && (best < 0 || g > most)) { best = f; most = g; }
    }
    return best;
}

void orl_skin_colour(const uint8_t *texture, int face, const int32_t at[3], uint32_t rgb[3])
{
    int a = face >> 1, axis[2] = { (a + 1) % 3, (a + 2) % 3 }, first = 0;
    uint32_t f[2];
    for (int k = 1; k >= 0; k--) {
        int32_t q = at[axis[k]], t = (q < 0 ? 0 : q > 8 << 12 ? 8 << 12 : q) * ORL_SKIN_PER_CELL, i = t >> 12;
        i = i > ORL_SKIN_SIDE - 2 ? ORL_SKIN_SIDE - 2 : i;
        f[k] = (uint32_t)(t - (i << 12)) >> 4;
        first = first * ORL_SKIN_SIDE + i;
    }
    const uint8_t *v = texture + 3 * first, *next = v + 3 * ORL_SKIN_SIDE;
    const uint32_t w[4] = { (256 - f[0]) * (256 - f[1]), f[0] * (256 - f[1]), (256 - f[0]) * f[1], f[0] * f[1] };       /* sum to 2^16 */
    for (int c = 0; c < 3; c++) {
        uint32_t sum = w[0] * v[c] * v[c] + w[1] * v[c + 3] * v[c + 3] + w[2] * next[c] * next[c] + w[3] * next[c + 3] * next[c + 3];      /* at most 2^16 x 255^2 < 2^32 */
        rgb[c] = (uint32_t)(((uint64_t)sum * 66051) >> 32);     /* 65535 / 65025 */
    }
}
