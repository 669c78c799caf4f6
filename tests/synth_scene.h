/* A small analytic scene in memory for tests: a sphere that stands in a ground plane, exact SDF in bricks, smooth base colour in textures, light and shadow vertices, the default light model, two codes.
 *
 *   orl_scene s;
 *   synth_scene_make(&s, 8, 8, 6);                      64 x 64 x 48 cells; arrays are malloc'd, orl_scene_write takes it as it is
 *   orl_camera cam = synth_camera(96, 64, 60);          pinhole, horizontal field of view in degrees
 *   orl_pose pose = synth_look(&s, eye, target);        both in grid cells; world is 1/20 of a cell, y down, z forward, moved
 *   synth_scene_free(&s);
 *
 * Everything is a polynomial or a triangle wave in double, so that it repeats on every machine. */
#ifndef TESTS_SYNTH_SCENE_H
#define TESTS_SYNTH_SCENE_H
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "oriel/camera.h"
#include "oriel/scene.h"

#define SYNTH_GROUND 10.3           /* height of the ground plane, cells */
#define SYNTH_SCALE 20.0            /* cells per world unit */

static inline void synth_sphere(const orl_scene *s, double centre[3], double *radius)
{
    uint32_t least = s->nb[0] < s->nb[1] ? s->nb[0] : s->nb[1];
    if (s->nb[2] < least) least = s->nb[2];
    *radius = 2.0 * least;
    centre[0] = 4.0 * s->nb[0];
    centre[1] = 4.0 * s->nb[1];
    centre[2] = SYNTH_GROUND + 0.8 * *radius;
}

/* Exact outside, in cells; positive = free. */
static inline double synth_distance(const orl_scene *s, const double p[3])
{
    double c[3], r;
    synth_sphere(s, c, &r);
    double d = sqrt((p[0] - c[0]) * (p[0] - c[0]) + (p[1] - c[1]) * (p[1] - c[1]) + (p[2] - c[2]) * (p[2] - c[2])) - r, g = p[2] - SYNTH_GROUND;
    return d < g ? d : g;
}

static inline double synth_wave(double x)   /* triangle wave in 0..1, period 2 */
{
    x = x - 2 * floor(x / 2);
    return x < 1 ? x : 2 - x;
}

static inline void synth_scene_free(orl_scene *s)
{
    free((void *)s->bmap);
    free((void *)s->sdf);
    free((void *)s->skin);
    free((void *)s->albedo);
    free((void *)s->lite);
    free((void *)s->shadow);
    free((void *)s->codes);
    memset(s, 0, sizeof *s);
}

static inline void synth_colour(const double p[3], uint8_t rgb[3])
{
    rgb[0] = (uint8_t)(120 + 100 * synth_wave(p[0] / 17));
    rgb[1] = (uint8_t)(110 + 90 * synth_wave(p[1] / 13));
    rgb[2] = (uint8_t)(100 + 80 * synth_wave((p[0] + p[2]) / 29));
}

/* Faces that the surface in the brick at o looks at; at least one. */
static inline unsigned synth_faces(const orl_scene *s, const double o[3])
{
    unsigned mask = 0;
    for (int i = 0; i < 512; i++) {
        double p[3] = { o[0] + i % 8 + 0.5, o[1] + i / 8 % 8 + 0.5, o[2] + i / 64 + 0.5 };
        int32_t grad[3];
        if (fabs(synth_distance(s, p)) > 1) continue;
        for (int a = 0; a < 3; a++) {
            double q[3] = { p[0], p[1], p[2] }, r[3] = { p[0], p[1], p[2] };
            q[a] += 2;
            r[a] -= 2;
            grad[a] = (int32_t)(4096 * (synth_distance(s, q) - synth_distance(s, r)));
        }
        mask |= 1u << orl_skin_face(63, grad);
    }
    return mask ? mask : 1;
}

/* One texture: the colour where the line through each texel enters the surface, near the brick at o. */
static inline void synth_texture(const orl_scene *s, const double o[3], int face, uint8_t *texel)
{
    int a = face >> 1, out = face & 1 ? -1 : 1;
    for (int t = 0; t < ORL_SKIN_TEXELS; t++) {
        double p[3], at = 4, far = 1e9, before = -1;
        p[(a + 1) % 3] = o[(a + 1) % 3] + (double)(t % ORL_SKIN_SIDE) / ORL_SKIN_PER_CELL;
        p[(a + 2) % 3] = o[(a + 2) % 3] + (double)(t / ORL_SKIN_SIDE) / ORL_SKIN_PER_CELL;
        for (int k = -16; k <= 48; k++) {
            double h = out > 0 ? 8 - k / 4.0 : k / 4.0, off = h < 0 ? -h : h > 8 ? h - 8 : 0;
            p[a] = o[a] + h;
            double d = synth_distance(s, p);
            if (d <= 0 && before > 0 && off < far) { far = off; at = h + out * 0.25 * d / (d - before); }
            before = d;
        }
        p[a] = o[a] + at;
        synth_colour(p, texel + 3 * t);
    }
}

static inline void synth_scene_make(orl_scene *s, uint32_t nbx, uint32_t nby, uint32_t nbz)
{
    memset(s, 0, sizeof *s);
    s->nb[0] = nbx; s->nb[1] = nby; s->nb[2] = nbz;
    size_t total = (size_t)nbx * nby * nbz, n = 0;
    int32_t *map = malloc(total * sizeof *map);
    /* which bricks hold the surface */
    for (int pass = 0; pass < 2; pass++) {
        int8_t *sdf = NULL;
        uint8_t *alb = NULL, *lite = NULL;
        uint32_t *skin = NULL;
        int8_t *sh = NULL;
        if (pass) {
            s->sdf = sdf = malloc(n * ORL_BRICK_VERTS + 2);
            s->skin = skin = malloc((n + 1) * sizeof *skin);
            s->albedo = alb = malloc(n * ORL_SKIN_FACES * ORL_SKIN_TEXELS * 3 + 1);
            s->lite = lite = malloc(n * ORL_LITE_VERTS * ORL_LITE_BYTES + 1);
            s->shadow = sh = malloc(n * ORL_LITE_VERTS * ORL_SHADOW_DIM + 1);
        }
        for (size_t b = 0; b < total; b++) {
            double o[3] = { 8.0 * (double)(b % nbx), 8.0 * (double)(b / nbx % nby), 8.0 * (double)(b / nbx / nby) }, lo = 1e9, hi = -1e9;
            if (pass && map[b] < 0) continue;
            for (int v = 0; v < ORL_BRICK_VERTS; v++) {
                double p[3] = { o[0] + v % 9, o[1] + v / 9 % 9, o[2] + v / 81 }, d = synth_distance(s, p);
                lo = d < lo ? d : lo;
                hi = d > hi ? d : hi;
                if (!pass) continue;
                size_t at = (size_t)map[b] * ORL_BRICK_VERTS + (size_t)v;
                double q = floor(d * ORL_SDF_UNIT + 0.5);
                sdf[at] = (int8_t)(q > 127 ? 127 : q < -128 ? -128 : q);
            }
            if (!pass) { map[b] = lo < 0 && hi > 0 ? (int32_t)n++ : -1; continue; }
            unsigned faces = synth_faces(s, o);
            skin[map[b]] = s->ntextures << 6 | faces;
            for (int f = 0; f < ORL_SKIN_FACES; f++) if (faces >> f & 1) synth_texture(s, o, f, alb + (size_t)s->ntextures++ * ORL_SKIN_TEXELS * 3);
            for (int v = 0; v < ORL_LITE_VERTS; v++) {
                double p[3] = { o[0] + 4 * (v % 3), o[1] + 4 * (v / 3 % 3), o[2] + 4 * (v / 9) };
                size_t at = (size_t)map[b] * ORL_LITE_VERTS + (size_t)v;
                lite[at * ORL_LITE_BYTES] = (uint8_t)(130 + 120 * synth_wave((p[1] + p[2]) / 40));
                for (int k = 0; k < ORL_HORIZON; k++) lite[at * ORL_LITE_BYTES + 1 + (size_t)k] = (uint8_t)(150 * synth_wave(k / 4.0 + p[0] / 50));
                for (int k = 0; k < ORL_SHADOW_DIM; k++) sh[at * ORL_SHADOW_DIM + (size_t)k] = (int8_t)(240 * synth_wave((p[0] + p[1] * (k - 3)) / 60 + k) - 120);
            }
        }
    }
    /* Chebyshev distance to the nearest brick: one sweep forward, one back over the 26 neighbours is exact for this metric */
    for (size_t b = 0; b < total; b++) if (map[b] < 0) map[b] = -127;
    for (size_t i = 0; i < 2 * total; i++) {
        size_t b = i < total ? i : 2 * total - 1 - i;
        int q[3] = { (int)(b % nbx), (int)(b / nbx % nby), (int)(b / nbx / nby) };
        for (int k = 0; map[b] < -1 && k < 27; k++) {
            int c[3] = { q[0] + k % 3 - 1, q[1] + k / 3 % 3 - 1, q[2] + k / 9 - 1 };
            if (c[0] < 0 || c[1] < 0 || c[2] < 0 || c[0] >= (int)nbx || c[1] >= (int)nby || c[2] >= (int)nbz) continue;
            int32_t d = map[((size_t)c[2] * nby + (size_t)c[1]) * nbx + (size_t)c[0]];
            d = d >= 0 ? -1 : d - 1;
            if (d > map[b]) map[b] = d;
        }
    }
    s->bmap = map;
    s->nbricks = (uint32_t)n;
    s->cell_world = (float)(1 / SYNTH_SCALE);
    const double rot[9] = { 1, 0, 0, 0, 0, 1, 0, -1, 0 }, move[3] = { 30, 20, 15 };
    for (int r = 0; r < 3; r++) {
        for (int c = 0; c < 3; c++) s->world_to_grid[4 * r + c] = SYNTH_SCALE * rot[3 * r + c];
        s->world_to_grid[4 * r + 3] = move[r];
    }
    for (int k = 0; k < ORL_SHADOW_DIM; k++) s->shadow_scale[k] = k & 1 ? 1.0f / 64 : 1.0f / 128;
    orl_light_model_default(&s->light);
    float *codes = malloc(2 * ORL_CODE * sizeof *codes);
    for (int c = 0; c < 3; c++) {
        s->light.sky_mean[c] = (float)(180 + 20 * c) / 255;
        s->light.sky_std[c] = (float)(30 + c) / 255;
    }
    for (int k = 0; k < ORL_CODE; k++) {
        codes[k] = s->light.prior_mean[k];
        codes[ORL_CODE + k] = s->light.prior_mean[k] + 0.01f * (float)(k % 5);
    }
    s->codes = codes;
    s->ncodes = 2;
    strcpy(s->title, "synthetic");
}

static inline orl_camera synth_camera(int w, int h, double fov_degrees)
{
    double f = w / (2 * tan(fov_degrees * 3.14159265358979 / 360));
    return (orl_camera){ .model = ORL_CAM_PINHOLE, .w = w, .h = h, .fx = f, .fy = f, .cx = w / 2.0, .cy = h / 2.0 };
}

static inline orl_pose synth_look(const orl_scene *s, const double eye[3], const double target[3])
{
    double m[9], f[3], r[3], len = 0, rl;       /* rows of m: right, down, forward in the grid frame */
    for (int a = 0; a < 3; a++) { f[a] = target[a] - eye[a]; len += f[a] * f[a]; }
    for (int a = 0; a < 3; a++) f[a] /= sqrt(len);
    r[0] = f[1]; r[1] = -f[0]; r[2] = 0;
    rl = sqrt(r[0] * r[0] + r[1] * r[1]);
    if (rl < 1e-9) { r[0] = 1; rl = 1; }
    for (int a = 0; a < 3; a++) { m[a] = r[a] / rl; m[6 + a] = f[a]; }
    m[3] = f[1] * m[2] - f[2] * m[1]; m[4] = f[2] * m[0] - f[0] * m[2]; m[5] = f[0] * m[1] - f[1] * m[0];   /* down = forward x right */
    orl_pose p;
    double world[3];
    for (int c = 0; c < 3; c++) {
        world[c] = 0;
        for (int k = 0; k < 3; k++) world[c] += s->world_to_grid[4 * k + c] * (eye[k] - s->world_to_grid[4 * k + 3]) / (SYNTH_SCALE * SYNTH_SCALE);
    }
    for (int i = 0; i < 3; i++) {
        for (int c = 0; c < 3; c++) {
            p.R[3 * i + c] = 0;
            for (int k = 0; k < 3; k++) p.R[3 * i + c] += m[3 * i + k] * s->world_to_grid[4 * k + c] / SYNTH_SCALE;
        }
        p.t[i] = -(p.R[3 * i] * world[0] + p.R[3 * i + 1] * world[1] + p.R[3 * i + 2] * world[2]);
    }
    return p;
}
#endif
