/* One ray against the scene's bricks, in integers (march.c). */
#ifndef RUNTIME_MARCH_H
#define RUNTIME_MARCH_H
#include "oriel/scene.h"

typedef struct {
    int64_t t;                          /* along the unit ray from its origin, cells Q16 */
    int32_t grad[3];                    /* of the SDF over +-2 cells, Q16; points into free space */
    uint32_t albedo[3];                 /* linear Q16, at most 65535 */
    uint32_t lite[ORL_LITE_BYTES];      /* file's bytes, Q16 */
    int32_t phi[ORL_SHADOW_DIM];        /* file's bytes, Q16 */
    int cut;                            /* not a surface but the solid's section, met on coming out of empty bricks: a brick that nobody saw is missing */
} orl_hit;

/* origin and unit dir in the grid frame. 0: nothing is hit, out untouched. Not finite: nothing is hit. */
int orl_march(const orl_scene *s, const double origin[3], const double dir[3], orl_hit *out);
#endif
