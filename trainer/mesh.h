/* The surface of a scene as a mesh of quads: one vertex in each cell that the surface crosses. */
#ifndef TRAINER_MESH_H
#define TRAINER_MESH_H
#include "oriel/scene.h"

typedef struct {
    uint32_t nverts, nquads;
    float (*x)[3], (*n)[3];         /* world frame (the SCENE's COLMAP model); unit normals, into free space */
    uint8_t (*rgb)[3];              /* base colour, sRGB */
    uint32_t (*quad)[4];            /* counter-clockwise, seen from free space */
} mesh;

typedef enum { MESH_PLAIN, MESH_BASE, MESH_NORMAL } mesh_colour;

/* Naive surface nets on the bricks. Closed wherever the cells around the surface have bricks; it ends where nobody looked. ORL_E_DEGENERATE: no surface; ORL_E_MEMORY. */
orl_err mesh_build(const orl_scene *s, mesh *out);
void mesh_free(mesh *m);
/* Binary little-endian PLY. MESH_NORMAL: (normal + 1) / 2 in the scene frame (z up). */
orl_err mesh_write_ply(const char *path, const mesh *m, const orl_scene *s, mesh_colour colour);
#endif
