/* Which texels and light vertices of a scene anything can look at: those of the cells that its surface passes through. The others need no bytes in the file (oriel/scene.h, texel_used and light_used). */
#ifndef TRAINER_USED_H
#define TRAINER_USED_H
#include "oriel/scene.h"

/* From bmap, sdf, skin and steps of s, whose texel_used and light_used it sets to malloc'd marks. Where there is no ground they stay NULL: there, cuts of the solid are looked at too. */
orl_err used_mark(orl_scene *s);
void used_free(orl_scene *s);
#endif
