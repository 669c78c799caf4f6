/* Normals drawn to the directions that walls face (oriel/facing.h). Plain IEEE arithmetic: the same bits everywhere. */
#include "oriel/facing.h"
#include <math.h>
#include <string.h>

float orl_facing_near(const orl_facings *f, const float n[3], float to[3])
{
    int best = -1;
    float c = 1 - 0.5f * ORL_FACING_REACH;
    for (int k = 0; k < f->n; k++) {
        const float *d = f->dir[k];
        float dot = n[0] * d[0] + n[1] * d[1] + n[2] * d[2];
        best = dot > c ? k : best;
        c = dot > c ? dot : c;
    }
    if (best < 0) return 0;
    memcpy(to, f->dir[best], sizeof f->dir[best]);
    float w = 1 - 2 * (1 - (c < 1 ? c : 1)) / ORL_FACING_REACH;
    return w * w;
}

void orl_facing_turn(const orl_facings *f, float n[3])
{
    float to[3], w = orl_facing_near(f, n, to);
    if (!(w > 0)) return;
    for (int a = 0; a < 3; a++) n[a] += w * (to[a] - n[a]);
    float len = 1 / sqrtf(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);    /* at most 40 degrees between the two: never near 0 */
    for (int a = 0; a < 3; a++) n[a] *= len;
}
