/* The directions that a place's walls, floors and ceilings face. Buildings are mostly square: a noisy normal near such a direction most likely has it (the Manhattan world of Coughlan and
 * Yuille, ICCV 1999, each direction found for itself). Grid frame. */
#ifndef ORIEL_FACING_H
#define ORIEL_FACING_H

enum { ORL_FACINGS = 10 };              /* up, down, and the walls of two square plans */
#define ORL_FACING_REACH 0.468f         /* square of the chord that 40 degrees span: farther from all directions a normal stays as it is */

typedef struct { int n; float dir[ORL_FACINGS][3]; } orl_facings;       /* unit; n = 0: none is known */

/* How surely a face with unit normal n has one of the directions, 0..1, and which (to; untouched where 0): w = (1 - d^2 / REACH)^2, d the chord to the nearest. NaN: 0. */
float orl_facing_near(const orl_facings *f, const float n[3], float to[3]);
/* Turns a unit normal towards the direction that it is near: n + w (to - n), made unit. */
void orl_facing_turn(const orl_facings *f, float n[3]);
#endif
