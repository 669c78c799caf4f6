/* Skies that the decoder of light.h learns from: parametric ones made here, panoramas reduced by the trainer; and the fit of decoder and prior to them. */
#ifndef ORIEL_SKY_H
#define ORIEL_SKY_H
#include "oriel/light.h"

typedef struct {
    float log_env[ORL_ENV][3];      /* ln radiance, sun-relative, sun left out */
    float sun_el, ln_sun[3];        /* radians; ln irradiance at normal incidence */
} orl_sky;

/* Sky number `index` of an endless fixed sequence: CIE general sky (ISO 15469) with the chromaticities of Preetham et al. 1999, Rayleigh and aerosol extinction of the sun, noise clouds, and
 * sun elevations of 2 to 75 degrees; exposed as a camera would (see below). */
void orl_sky_parametric(uint32_t index, orl_sky *out);
/* ln of the sun's irradiance at normal incidence behind a clear atmosphere, elevation 0 to pi/2, turbidity about 2 (clear) to 16; outside of the atmosphere it is about 1. */
void orl_sky_beam(float elevation, float turbidity, float ln_sun[3]);
/* Scales sky and sun so that a white horizontal surface is displayed at exp(ln_exposure) (1 = white), and shifts red and blue by -+ warmth (ln). */
void orl_sky_expose(orl_sky *s, float ln_exposure, float warmth);
/* Standard normal and uniform [0, 1) numbers that depend on (index, what) alone. */
float orl_sky_uniform(uint32_t index, uint32_t what);
float orl_sky_normal(uint32_t index, uint32_t what);
/* Decoder (clipped mean, principal components scaled so that z has unit variance), joint Gaussian prior, neutral sky generator, ground 0.25. n >= 16. ORL_E_MEMORY. */
orl_err orl_sky_fit(const orl_sky *skies, size_t n, orl_light_model *out);
/* Best z for a sky (least squares over solid angle), and the rms of ln radiance that remains; z = NULL: of the mean alone. */
float orl_sky_project(const orl_light_model *m, const orl_sky *s, float z[ORL_ENV_DIM]);
/* The light model of a .oriel file: one made by `oriel-train sky`, or any scene's. */
orl_err orl_sky_load(const char *path, orl_light_model *out);
#endif
