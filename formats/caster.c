/* Casters (oriel/caster.h). A ray upwards is lowest where it enters a box: the box stops it if that is under its top. */
#include "oriel/caster.h"

/* Narrows [t0, t1] to where |o + t d| < half; 0: nowhere. */
static int clip(double o, double d, double half, double *t0, double *t1)
{
    if (d > -1e-9 && d < 1e-9) return o > -half && o < half;
    double a = (-half - o) / d, b = (half - o) / d, in = a < b ? a : b, out = a < b ? b : a;
    if (!(in <= out)) return 0;                 /* no number */
    if (in > *t0) *t0 = in;
    if (out < *t1) *t1 = out;
    return *t0 < *t1;
}

int orl_casters_hide(const orl_casters *c, const double o[3], const double d[3], double far)
{
    for (int i = 0; i < c->n; i++) {
        const orl_caster *b = &c->box[i];
        double x = o[0] - b->centre[0], y = o[1] - b->centre[1], u = b->axis[0], v = b->axis[1], t0 = 0, t1 = far;
        if (clip(u * x + v * y, u * d[0] + v * d[1], b->half[0], &t0, &t1) && clip(u * y - v * x, u * d[1] - v * d[0], b->half[1], &t0, &t1) && o[2] + t0 * d[2] < b->top) return 1;
    }
    return 0;
}
