/* The room of the backdrop (oriel/backdrop.h). */
#include "oriel/backdrop.h"

int orl_backdrop_place(const orl_backdrop *b, const double middle[2], const float ground[3], const double x[3], double uv[2])
{
    double q[2], over = x[2] - ((double)ground[0] + (double)ground[1] * x[0] + (double)ground[2] * x[1]);
    for (int a = 0; a < 2; a++) q[a] = (x[a] - middle[a]) / (double)b->half[a];
    int axis = (q[0] < 0 ? -q[0] : q[0]) < (q[1] < 0 ? -q[1] : q[1]), wall = 2 * axis + (q[axis] < 0);
    double along = (q[1 - axis] + 1) / 2, up = over / (double)b->height;
    along = along > 0 ? along < 1 ? along : 1 : 0;              /* NaN -> 0 */
    if (!(up < 1)) return 0;
    uv[0] = wall * ORL_BACK_WALL + along * (ORL_BACK_WALL - 1e-6);
    uv[1] = up > 0 ? up * ORL_BACK_ROWS : 0;
    return 1;
}

int orl_backdrop_meet(const orl_backdrop *b, const double middle[2], const float ground[3], const double o[3], const double d[3], double *t, double uv[2])
{
    double out = 1e12, x[3];
    int axis = -1;
    if (!(b->height > 0)) return 0;
    for (int a = 0; a < 2; a++) {
        double far = d[a] > 1e-9 || d[a] < -1e-9 ? (middle[a] + (d[a] > 0 ? (double)b->half[a] : -(double)b->half[a]) - o[a]) / d[a] : 1e12;
        if (far < out) { out = far; axis = a; }
    }
    if (axis < 0 || !(out > 0)) return 0;
    for (int a = 0; a < 3; a++) x[a] = o[a] + out * d[a];
    double beside = (x[1 - axis] - middle[1 - axis]) / (double)b->half[1 - axis];
    if (!(beside >= -1 && beside <= 1) || !orl_backdrop_place(b, middle, ground, x, uv)) return 0;
    *t = out;
    return 1;
}

void orl_backdrop_normal(double u, float n[3])
{
    int wall = (int)u / ORL_BACK_WALL;
    n[0] = n[1] = 0;
    n[wall >> 1] = wall & 1 ? 0.70710678f : -0.70710678f;
    n[2] = 0.70710678f;
}

void orl_backdrop_texels(const double uv[2], uint32_t *first, uint32_t share[4])
{
    int wall = (int)uv[0] / ORL_BACK_WALL, at[2];
    const int side[2] = { ORL_BACK_WALL, ORL_BACK_ROWS };
    const double q[2] = { uv[0] - wall * ORL_BACK_WALL - 0.5, uv[1] - 0.5 };
    uint32_t w[2];
    for (int a = 0; a < 2; a++) {
        double p = q[a] > 0 ? q[a] < side[a] - 1 ? q[a] : side[a] - 1 : 0;
        at[a] = p < side[a] - 2 ? (int)p : side[a] - 2;
        w[a] = (uint32_t)((p - at[a]) * 16 + 0.5);
    }
    *first = (uint32_t)(at[1] * ORL_BACK_COLS + wall * ORL_BACK_WALL + at[0]);
    share[0] = (16 - w[0]) * (16 - w[1]);
    share[1] = w[0] * (16 - w[1]);
    share[2] = (16 - w[0]) * w[1];
    share[3] = w[0] * w[1];
}
