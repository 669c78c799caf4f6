/* The sun's course over a day (oriel/relight.h), and what the air leaves of it. */
#include <math.h>
#include "oriel/math.h"
#include "oriel/sky.h"
#include "oriel/relight.h"

#define PI 3.14159265f
#define DEG (PI / 180)
#define TURBIDITY 3.0f                  /* a clear day */
#define LOWEST (10 * DEG)               /* a panorama's sun counts as this high at least: what haze took from one on the horizon is not known well enough to be given back */
#define DUSK 0.035f                     /* the sky's share that stays when the sun is on the horizon: the sine of 2 degrees, where formats/sky.c begins too */

static float clampf(float x, float lo, float hi) { return x > lo ? x < hi ? x : hi : lo; }
static float declination(const orl_day *d) { return 23.45f * DEG * orl_sinf(2 * PI * (float)(284 + d->day) / 365); }

orl_err orl_day_rise(const orl_day *d, float *rise)
{
    float dec = declination(d), lat = (float)d->latitude * DEG, up = orl_sinf(lat) * orl_sinf(dec), swing = orl_cosf(lat) * orl_cosf(dec);
    if (up + swing <= 0) return orl_fail(ORL_E_DEGENERATE, "--day %g,%d: the sun does not rise there that day", d->latitude, d->day);
    *rise = up >= swing ? -PI : -(PI / 2 + orl_asinf(up / swing));
    return ORL_OK;
}

orl_sun orl_day_sun(const orl_day *d, float hour, const orl_panorama *p)
{
    float dec = declination(d), lat = (float)d->latitude * DEG, own = clampf(p->el, LOWEST, PI / 2), now[3], then[3];
    float s = orl_sinf(lat) * orl_sinf(dec) + orl_cosf(lat) * orl_cosf(dec) * orl_cosf(hour);
    float west = orl_cosf(dec) * orl_sinf(hour), south = orl_sinf(lat) * orl_cosf(dec) * orl_cosf(hour) - orl_cosf(lat) * orl_sinf(dec);
    orl_sun sun = { .el = clampf(orl_asinf(s), 0, PI / 2), .moved = 1 };
    sun.az = d->north + orl_atan2f(west, -south);       /* from north, counter-clockwise: by the west */
    orl_sky_beam(sun.el, TURBIDITY, now);
    orl_sky_beam(own, TURBIDITY, then);
    for (int k = 0; k < 3; k++) sun.rgb[k] = p->rgb[k] * orl_expf(now[k] - then[k]);
    sun.sky = clampf(s, DUSK, 1) / orl_sinf(own);
    return sun;
}
