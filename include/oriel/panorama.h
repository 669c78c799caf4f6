/* A sky to relight by: an equirectangular panorama, zenith at the top, azimuth (0.5 - u) * 360 degrees from its centre column, counter-clockwise seen from above. The sun is found and
 * cut out; the rest, eight rows of it, becomes the light model's map in the frame of any sun. Radiance and irradiance in the panorama's units. Angles in radians. */
#ifndef ORIEL_PANORAMA_H
#define ORIEL_PANORAMA_H
#include "oriel/image.h"
#include "oriel/light.h"

enum { ORL_PANORAMA_BINS = 1024 };      /* azimuths that the sunless sky is summed in */

typedef struct {
    orl_imagef map;
    float turn;                         /* scene azimuth of the centre column; the caller's to set, 0 */
    int has_sun;
    float az, el, rgb[3];               /* the sun: azimuth from the centre column, elevation, irradiance at normal incidence (0 without a sun) */
    float rest[3];                      /* radiance that stands where the sun was cut out */
    float peak[3];                      /* its brightest spot, in the panorama's own frame */
    float ring[ORL_ENV_ROWS][ORL_PANORAMA_BINS][3];     /* radiance without the sun, means over 11.25 degrees of elevation */
} orl_panorama;

/* The sun as it shines in a picture: where it stands (scene frame), its irradiance, and a factor on all radiance but its own. */
typedef struct { float az, el, rgb[3], sky; int moved; } orl_sun;

/* Reads a panorama (.exr, .hdr) and takes it apart. ORL_E_RANGE below 8 x 4 pixels; out is empty after a failure. */
orl_err orl_panorama_open(const char *path, orl_panorama *out);
void orl_panorama_close(orl_panorama *p);                               /* idempotent */
orl_sun orl_panorama_sun(const orl_panorama *p);                        /* where the panorama has it */
/* The light model's map under a sun, sun left out. */
void orl_panorama_env(const orl_panorama *p, const orl_sun *sun, float env[ORL_ENV][3]);
/* Radiance in a scene direction, the sun's disc and glow where the sun stands. */
void orl_panorama_look(const orl_panorama *p, const orl_sun *sun, const float dir[3], float rgb[3]);

float orl_luminance(const float rgb[3]);                                /* linear, Rec. 709 */
float orl_percentile(float *v, size_t n, size_t percent);              /* sorts v; 0 of nothing */
#endif
