/* Marks of what can be seen (used.h). A ray hits where the trilinear SDF is 0, in a cell whose vertices have both signs; when they are rounded, none moves by more than the step allows. There it reads the texels of a
 * face of its brick over that cell, and the light vertices around it. What bricks share is marked in all of them. */
#include "trainer/used.h"
#include <stdlib.h>

static int passes(const int8_t *v, int slack)
{
    int lo = 127, hi = -128;
    for (int k = 0; k < 8; k++) {
        int x = v[(k & 1) + 9 * (k >> 1 & 1) + 81 * (k >> 2)];
        lo = x < lo ? x : lo;
        hi = x > hi ? x : hi;
    }
    return lo <= slack && hi >= -slack;
}

/* Marks [lo, hi] of the block of the brick at q, and what others have of it. face: of a texture, else -1; side: vertices along each axis of the block. */
static void mark(const orl_scene *s, uint8_t *marks, const int q[3], int face, const int side[3], const int lo[3], const int hi[3])
{
    for (int k = 0; k < 27; k++) {
        int o[3] = { k % 3 - 1, k / 3 % 3 - 1, k / 9 - 1 }, at[3], from[3], to[3], inside = face < 0 || !o[2];
        for (int a = 0; a < 3; a++) {
            int axis = face < 0 ? a : ((face >> 1) + 1 + a) % 3, shift = o[a] * (side[a] - 1);
            at[axis] = q[axis] + o[a];
            inside &= at[axis] >= 0 && at[axis] < (int)s->nb[axis];
            from[a] = lo[a] - shift > 0 ? lo[a] - shift : 0;
            to[a] = hi[a] - shift < side[a] ? hi[a] - shift : side[a] - 1;
        }
        int32_t b = inside ? s->bmap[((size_t)at[2] * s->nb[1] + (size_t)at[1]) * s->nb[0] + (size_t)at[0]] : -1;
        if (b < 0 || (face >= 0 && !(orl_skin_mask(s->skin[b]) >> face & 1))) continue;
        uint8_t *m = marks + (size_t)(side[0] * side[1] * side[2]) * (face < 0 ? (size_t)b : orl_skin_texture(s->skin[b], face));
        for (int z = from[2]; z <= to[2]; z++) for (int y = from[1]; y <= to[1]; y++) for (int x = from[0]; x <= to[0]; x++) m[x + side[0] * (y + side[1] * z)] = 1;
    }
}

orl_err used_mark(orl_scene *s)
{
    static const int TEXTURE[3] = { ORL_SKIN_SIDE, ORL_SKIN_SIDE, 1 }, LIGHT[3] = { ORL_LITE_V, ORL_LITE_V, ORL_LITE_V };
    if (!s->ground_albedo) return ORL_OK;
    uint8_t *texels = calloc((size_t)s->ntextures * ORL_SKIN_TEXELS + 1, 1), *lights = calloc((size_t)s->nbricks * ORL_LITE_VERTS + 1, 1);
    if (!texels || !lights) {
        free(texels);
        free(lights);
        return orl_fail(ORL_E_MEMORY, "no memory for marks of %u textures", s->ntextures);
    }
    size_t places = (size_t)s->nb[0] * s->nb[1] * s->nb[2];
    int slack = 2 * s->step[ORL_PACK_SDF].step[0];
    for (size_t i = 0; i < places; i++) {
        int32_t b = s->bmap[i];
        int q[3] = { (int)(i % s->nb[0]), (int)(i / s->nb[0] % s->nb[1]), (int)(i / s->nb[0] / s->nb[1]) };
        if (b < 0) continue;
        for (int k = 0; k < 512; k++) {
            int c[3] = { k % 8, k / 8 % 8, k / 64 }, lo[3], hi[3];
            if (!passes(s->sdf + (size_t)b * ORL_BRICK_VERTS + c[0] + 9 * (c[1] + 9 * c[2]), slack)) continue;
            for (int a = 0; a < 3; a++) hi[a] = (lo[a] = c[a] / 4) + 1;
            mark(s, lights, q, -1, LIGHT, lo, hi);
            for (int f = 0; f < ORL_SKIN_FACES; f++) {
                if (!(orl_skin_mask(s->skin[b]) >> f & 1)) continue;
                for (int a = 0; a < 2; a++) hi[a] = (lo[a] = ORL_SKIN_PER_CELL * c[((f >> 1) + 1 + a) % 3]) + ORL_SKIN_PER_CELL;
                lo[2] = hi[2] = 0;
                mark(s, texels, q, f, TEXTURE, lo, hi);
            }
        }
    }
    s->texel_used = texels;
    s->light_used = lights;
    return ORL_OK;
}

void used_free(orl_scene *s)
{
    free((void *)s->texel_used);
    free((void *)s->light_used);
    s->texel_used = s->light_used = NULL;
}
