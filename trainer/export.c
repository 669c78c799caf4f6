/* Quantises the trained model into the scene file: SDF to 1/32 cell, base colour to 8-bit square roots, openness and horizons to 8 bits, shadow features to int8 with power-of-two scales; then rounds these to the finest
 * steps with which the file is not larger than FILE_MOST. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "trainer/checkpoint.h"
#include "trainer/used.h"

#define FILE_MOST 4000000       /* bytes */

/* Steps from none to coarse, each for a file a tenth or so smaller: of distances and their growth, green, red and blue, openness and horizons, shadow features, green and the rest beyond the bricks. */
static const uint8_t STEPS[][8] = {
    { 1, 0, 1, 1, 1, 1, 1, 1 }, { 1, 32, 2, 2, 2, 1, 1, 1 }, { 2, 16, 3, 4, 3, 1, 2, 2 }, { 2, 24, 3, 5, 4, 2, 2, 2 },
    { 2, 32, 4, 6, 5, 2, 2, 2 }, { 2, 40, 4, 6, 6, 2, 2, 2 }, { 2, 40, 5, 7, 6, 2, 2, 2 }, { 2, 64, 6, 9, 8, 3, 2, 2 },
    { 3, 40, 7, 11, 9, 3, 3, 4 }, { 3, 48, 8, 13, 10, 3, 3, 4 }, { 3, 64, 9, 15, 11, 4, 3, 4 }, { 4, 56, 11, 18, 13, 4, 4, 6 },
    { 4, 64, 12, 20, 14, 5, 4, 6 }, { 4, 96, 14, 24, 18, 6, 6, 8 }, { 5, 96, 16, 28, 22, 7, 6, 8 }, { 6, 112, 20, 34, 26, 8, 8, 8 },
};

static uint8_t quant8(float v) { return (uint8_t)(!(v > 0) ? 0 : v >= 1 ? 255 : (int)(v * 255.0f + 0.5f)); }      /* what is no number becomes 0, here and below */

static void shadow_scales(const surface *surf, const stage2 *s2, float scale[ORL_SHADOW_DIM])
{
    float top[ORL_SHADOW_DIM] = { 0 };
    (void)surf;
    const grid *g = &s2->shadow;
    for (size_t i = 0; i < g->nverts; i++) {
        if (!g->live[i / GRID_TILE]) continue;
        for (int k = 0; k < ORL_SHADOW_DIM; k++) top[k] = fmaxf(top[k], fabsf(g->p[i * ORL_SHADOW_DIM + (size_t)k]));
    }
    for (int k = 0; k < ORL_SHADOW_DIM; k++) {
        scale[k] = 1.0f / 128;
        while (top[k] > 127 * scale[k] && scale[k] < 1) scale[k] *= 2;
    }
}

/* Base colour of the ground: texels as in SCENE.md 4.8, each the mean of a few places in it. */
static void ground_texels(const surface *surf, const stage2 *s2, uint8_t (*out)[3])
{
    enum { SUB = 4 };
    for (int t = 0; t < ORL_GROUND_SIDE * ORL_GROUND_SIDE; t++) {
        float sum[3] = { 0 };
        for (int k = 0; k < SUB * SUB; k++) {
            orl_sample q;
            float x[3] = { 0 }, at[2] = { (float)(t % ORL_GROUND_SIDE) + ((float)(k % SUB) + 0.5f) / SUB, (float)(t / ORL_GROUND_SIDE) + ((float)(k / SUB) + 0.5f) / SUB };
            for (int c = 0; c < 2; c++) x[c] = (float)surf->f.dims[c] * (3 * at[c] / ORL_GROUND_SIDE - 1);
            stage2_ground_sample(s2, x, &q);
            for (int c = 0; c < 3; c++) sum[c] += q.albedo[c];
        }
        for (int c = 0; c < 3; c++) out[t][c] = quant8(sqrtf(sum[c] / (SUB * SUB)));
    }
}

static void backdrop_texels(const surface *surf, const stage2 *s2, uint8_t (*out)[4])
{
    for (int t = 0; t < ORL_BACK_TEXELS; t++) {
        float rgb[3];
        stage2_backdrop_texel(s2, t, rgb);
        for (int c = 0; c < 3; c++) out[t][c] = quant8(sqrtf(rgb[c]));
        out[t][3] = surf->opacity[t];
    }
}

/* Writes by these steps, or only tells the size. */
static orl_err pack(const char *path, orl_scene *sc, const uint8_t *q, int write, size_t *bytes)
{
    const orl_pack_step beyond = { { q[6], q[7] }, 0 }, step[ORL_PACKED] = { [ORL_PACK_SDF] = { { q[0], 1 }, q[1] }, [ORL_PACK_ALBEDO] = { { q[2], q[3] }, 0 }, [ORL_PACK_LITE] = { { q[4], q[4] }, 0 },
        [ORL_PACK_SHADOW] = { { q[5], 1 }, 0 }, [ORL_PACK_GROUND] = beyond, [ORL_PACK_BACK] = beyond };
    memcpy(sc->step, step, sizeof step);
    orl_err e = used_mark(sc);
    if (!e) e = write ? orl_scene_write(path, sc, bytes) : orl_scene_size(path, sc, bytes);
    used_free(sc);
    return e;
}

/* By the finest steps with which the file is small enough; by the coarsest if there are none. */
static orl_err write_within(const char *path, orl_scene *sc, size_t *bytes)
{
    size_t fine = 0, coarse = sizeof STEPS / sizeof *STEPS - 1, size;
    orl_err e = ORL_OK;
    while (!e && fine < coarse) {
        size_t k = (fine + coarse) / 2;
        e = pack(path, sc, STEPS[k], 0, &size);
        if (!e && size > FILE_MOST) fine = k + 1; else coarse = k;
    }
    return e ? e : pack(path, sc, STEPS[fine], 1, bytes);
}

orl_err export_scene(const char *path, const surface *surf, const stage2 *s2, const char *title, size_t *bytes)
{
    orl_scene sc = { 0 };
    const frame *f = &surf->f;
    for (int a = 0; a < 3; a++) {
        sc.nb[a] = (uint32_t)surf->nb[a];
        for (int b = 0; b < 3; b++) sc.world_to_grid[4 * a + b] = f->scale * f->R[3 * a + b];
        sc.world_to_grid[4 * a + 3] = f->offset[a];
    }
    sc.cell_world = (float)(1.0 / f->scale);
    sc.nbricks = surf->nbricks;
    sc.light = s2->light;
    snprintf(sc.title, sizeof sc.title, "%s", title);
    size_t n = surf->nbricks;
    uint8_t (*ground)[3] = malloc((size_t)ORL_GROUND_SIDE * ORL_GROUND_SIDE * sizeof *ground);
    uint8_t (*back)[4] = malloc((size_t)ORL_BACK_TEXELS * sizeof *back);
    int8_t *sdf = malloc(n * ORL_BRICK_VERTS + 1), *shadow = malloc(n * ORL_LITE_VERTS * ORL_SHADOW_DIM + 1);
    uint8_t *albedo = malloc((size_t)s2->skin.n * ORL_SKIN_TEXELS * 3 + 1), *lite = malloc(n * ORL_LITE_VERTS * ORL_LITE_BYTES + 1);
    orl_err e = ORL_OK;
    if (!ground || !back || !sdf || !shadow || !albedo || !lite) { e = orl_fail(ORL_E_MEMORY, "%s: no memory for %zu bricks", path, n); goto done; }
    shadow_scales(surf, s2, sc.shadow_scale);
    for (size_t i = 0; i < (size_t)surf->nb[0] * (size_t)surf->nb[1] * (size_t)surf->nb[2]; i++) {
        if (surf->bmap[i] < 0) continue;
        size_t b = (size_t)surf->bmap[i];
        int o[3] = { (int)(i % (size_t)surf->nb[0]) * 8, (int)(i / (size_t)surf->nb[0] % (size_t)surf->nb[1]) * 8, (int)(i / ((size_t)surf->nb[0] * (size_t)surf->nb[1])) * 8 };
        for (int v = 0; v < ORL_BRICK_VERTS; v++) {
            float q = surf->sdf[b * ORL_BRICK_VERTS + (size_t)v] * ORL_SDF_UNIT;
            sdf[b * ORL_BRICK_VERTS + (size_t)v] = (int8_t)(q > 127 ? 127 : q < -128 ? -128 : q == q ? (int)floorf(q + 0.5f) : 0);
        }
        for (int v = 0; v < ORL_LITE_VERTS; v++) {
            int x = o[0] / 4 + v % 3, y = o[1] / 4 + v / 3 % 3, z = o[2] / 4 + v / 9;
            const float *l = surf->lite.p + grid_at(&surf->lite, x, y, z) * 24, *p = s2->shadow.p + grid_at(&s2->shadow, x, y, z) * ORL_SHADOW_DIM;
            uint8_t *ol = lite + (b * ORL_LITE_VERTS + (size_t)v) * ORL_LITE_BYTES;
            int8_t *os = shadow + (b * ORL_LITE_VERTS + (size_t)v) * ORL_SHADOW_DIM;
            ol[0] = quant8(l[0]);
            for (int k = 0; k < ORL_HORIZON; k++) ol[1 + k] = quant8(l[1 + k] * (1 / 1.5707963f));
            for (int k = 0; k < ORL_SHADOW_DIM; k++) {
                float q = floorf(p[k] / sc.shadow_scale[k] + 0.5f);
                os[k] = (int8_t)(q > 127 ? 127 : q < -127 ? -127 : q == q ? q : 0);
            }
        }
    }
    for (size_t i = 0; i < (size_t)s2->skin.n * ORL_SKIN_TEXELS; i++) for (size_t c = 0; c < 3; c++) albedo[3 * i + c] = quant8(sqrtf(s2->skin.texel[i][c]));
    ground_texels(surf, s2, ground);
    if (surf->back.height > 0) {
        backdrop_texels(surf, s2, back);
        sc.backdrop = surf->back;
        sc.backdrop_rgba = back[0];
    }
    memcpy(sc.ground, f->ground, sizeof sc.ground);
    sc.facings = surf->facings;
    sc.ground_albedo = ground[0];
    sc.bmap = surf->bmap;
    sc.sdf = sdf;
    sc.ntextures = s2->skin.n;
    sc.skin = s2->skin.index;
    sc.albedo = albedo;
    sc.lite = s2->opt.without & WITHOUT_VISIBILITY ? NULL : lite;
    sc.shadow = shadow;
    if (s2->codes && s2->w) {
        sc.ncodes = (uint32_t)s2->w->nphotos;
        sc.codes = &s2->codes[0][0];
    }
    e = write_within(path, &sc, bytes);
done:
    free(ground);
    free(back);
    free(sdf);
    free(shadow);
    free(albedo);
    free(lite);
    return e;
}
