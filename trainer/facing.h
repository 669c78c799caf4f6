/* Finding the directions that a place's walls face (oriel/facing.h) in the normals of stereo points. */
#ifndef TRAINER_FACING_H
#define TRAINER_FACING_H
#include "oriel/facing.h"
#include "trainer/stereo.h"

/* Up, down, and walls at right angles to each other: no more than stand out. n = 0 where there are too few points. */
void facings_find(const stereo *st, orl_facings *out);
/* Turns the points' normals towards the directions that they are near. */
void facings_square(const orl_facings *f, stereo *st);
#endif
