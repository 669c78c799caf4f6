/* What stands on the horizon beyond the box: trees, the city. Nobody walked around it, so it is a picture on the four walls of a room around the box: opacity and base colour.
 *
 * Grid frame. The room's walls stand at middle +- half along x and y, middle = 4 nb (the box's own), and reach from the ground plane to `height` over it. Texels: u runs along the walls x+, x-, y+, y-, WALL of
 * them each, in the direction in which the other axis rises; v upwards, row 0 on the ground. */
#ifndef ORIEL_BACKDROP_H
#define ORIEL_BACKDROP_H
#include <stdint.h>

enum { ORL_BACK_WALL = 192, ORL_BACK_COLS = 4 * ORL_BACK_WALL, ORL_BACK_ROWS = 64, ORL_BACK_TEXELS = ORL_BACK_COLS * ORL_BACK_ROWS };

typedef struct { float half[2], height; } orl_backdrop;        /* cells; height 0: there is none */

/* Where the unit ray o + t d leaves the room: t > 0 and the place in texels, u in [0, COLS), v in [0, ROWS). Below the ground counts as on it (the ground itself comes first). 0: above the walls, or never in
 * the room. middle: of the box, x and y; ground: its plane (orl_scene.ground). Plain IEEE arithmetic: the same bits everywhere. */
int orl_backdrop_meet(const orl_backdrop *b, const double middle[2], const float ground[3], const double o[3], const double d[3], double *t, double uv[2]);
/* The same of a place on a wall; 0: too high. */
int orl_backdrop_place(const orl_backdrop *b, const double middle[2], const float ground[3], const double x[3], double uv[2]);
/* Normal of what stands at column u: into the room and upwards, half each. */
void orl_backdrop_normal(double u, float n[3]);
/* Texels around a place and their shares, Q8 (sum 256): those at i[0] + {0, 1, COLS, COLS + 1}; walls do not mix. */
void orl_backdrop_texels(const double uv[2], uint32_t *first, uint32_t share[4]);
#endif
