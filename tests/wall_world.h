/* The tiny synthetic world of the trainer's tests. */
#ifndef TESTS_WALL_WORLD_H
#define TESTS_WALL_WORLD_H
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "trainer/world.h"

/* Two cameras look along +y at a wall in a 32^3 box; the upper part of the photos is sky. */
static inline void make_world(world *w)
{
    memset(w, 0, sizeof *w);
    snprintf(w->title, sizeof w->title, "wall");
    w->frame = (frame){ .R = { 1, 0, 0, 0, 1, 0, 0, 0, 1 }, .scale = 1, .dims = { 32, 32, 32 }, .ground = { 2 } };
    w->nphotos = 2;
    w->photos = calloc(2, sizeof *w->photos);
    w->obs = calloc(64, sizeof *w->obs);
    w->points = calloc(32, sizeof *w->points);
    for (int k = 0; k < 2; k++) {
        world_photo *p = &w->photos[k];
        double f = 24;
        orl_camera_from_params(&p->cam, ORL_CAM_SIMPLE_PINHOLE, 24, 24, (double[]){ f, 12, 12 }, 3);
        p->centre[0] = 12 + 8 * k; p->centre[1] = 1; p->centre[2] = 12;
        memcpy(p->axes, (double[9]){ 1, 0, 0, 0, 0, 1, 0, -1, 0 }, sizeof p->axes);   /* camera x -> x, y -> -z, z -> y */
        uint8_t rgb[24 * 24 * 3], sky[24 * 24];
        for (int i = 0; i < 24 * 24; i++) {
            sky[i] = i < 24 * 6 ? 255 : 0;
            for (int a = 0; a < 3; a++) rgb[3 * i + a] = (uint8_t)((i * 37 + a * 91 + k * 50) % 256);
        }
        assert_int_equal(world_photo_fill(p, 24, 24, rgb, sky, 0), ORL_OK);
        p->obs_begin = (uint32_t)k * 16;
        p->obs_count = 16;
    }
    for (int i = 0; i < 16; i++) {
        w->points[i] = (world_point){ { 6.0f + (float)(i % 4) * 5, 20, 6.0f + (float)(i / 4) * 3 }, 1 };
        for (int k = 0; k < 2; k++) {
            double uv[2] = { 0, 0 };
            world_project(&w->photos[k], w->points[i].x, uv, NULL);
            w->obs[w->nobs++] = (world_obs){ (float)uv[0], (float)uv[1], (uint32_t)i };
        }
    }
    for (uint32_t i = 0; i < 32; i++) w->obs[i].point = i % 16;
    w->npoints = 16;
}
#endif
