/* The light model that trainer and runtime share: codes -> light -> colour of a surface or sky sample (design: Zhao, Yang et al., MM 2022, eq. 5-9, with sun and sky apart).
 *
 * Scene frame: right-handed, z up, x and y horizontal. Azimuth = atan2(y, x), elevation = asin(z), radians.
 *
 * Code vector (float, ORL_CODE entries):
 *   l_e  [0] sun azimuth, [1] sun elevation, [2..4] ln of the sun's irradiance at normal incidence (R, G, B), [5..12] sky decoder code z, [13..16] sky generator's own code
 *   l_s  [17..24] shadow code        l_t  [25..33] A - I row-major, [34..36] b
 *
 * Environment: 16 x 32 equirectangular; only the 8 upper rows are sky (ORL_ENV = 8 * 32 directions); row r centre elevation = 90 - (r + 0.5) * 180 / 16 degrees;
 * column c centre azimuth relative to the sun = -180 + (c + 0.5) * 360 / 32 degrees. L(w) = exp(clamp(mean(w) + sum_k z_k basis_k(w), -12, 12)), W / m^2 / sr in arbitrary units, sun left out.
 *   E_sky(n)    = sum_w L(w) max(0, n.w) dOmega(w)            sun-relative frame; F.n + |n_a| G_a(n_b / n_a, n_c / n_a), a the greatest component of n,
 *                 F = sum_w L(w) w dOmega(w) / 2, G_a a quadratic B-spline fitted to the even half sum_w L(w) |n.w| dOmega(w) / 2 on a cube's face; not below 0; zero for a zero normal;
 *                 within 0.5 % of its peak over the sphere, 0.03 % rms
 *   E_sun(n)    = exp(sun_rgb) max(0, n.s)
 *   E_ground(n) = ground * (E_sky(up) + E_sun(up)) * (1 - n_z) / 2
 *   s           = sigmoid(ORL_SHADOW_BIAS + sum_k l_s[k] phi_k)
 *   V           = clamp(smoothstep((elevation_sun - horizon(azimuth_sun)) / ORL_SUN_SOFT + 0.5) + fix, 0, 1), horizon linear between 16 azimuths i * 2 pi / 16; fix takes V to a traced sun's
 *   c           = albedo / pi * s (V E_sun + open E_sky + E_ground)            linear; s = 0.73 where neither code nor features speak, so that it can brighten and darken
 *   e           = encode(c), the sRGB transfer extended above 1 by its own power law, argument clamped to [0, ORL_LINEAR_MAX]
 *   sky         e_sky(v) = sum_j q_j M_j Y(v_rel), q = (1, sun elevation, z[8], own[4]), M_j 3 x 9, Y = (1, x, y, z, xy, yz, zx, x^2 - y^2, 3 z^2 - 1), v_rel = v turned by -sun azimuth about z
 *   pixel       rgb = (I + A') (cov * e + (1 - cov) * e_sky) + b                 display-referred, NOT clamped
 * All arithmetic is plain IEEE float with oriel/math.h's own exp, log, sin, cos, atan2, so that results repeat on every machine. */
#ifndef ORIEL_LIGHT_H
#define ORIEL_LIGHT_H
#include <stddef.h>
#include <stdint.h>
#include "oriel/error.h"

enum {
    ORL_C_SUN_AZ = 0, ORL_C_SUN_EL = 1, ORL_C_SUN_RGB = 2, ORL_C_ENV = 5, ORL_C_SKY = 13, ORL_C_SHADOW = 17, ORL_C_TONE = 25, ORL_CODE = 37,
    ORL_ENV_DIM = 8, ORL_SKY_DIM = 4, ORL_SHADOW_DIM = 8, ORL_TONE_DIM = 12,
    ORL_ENV_ROWS = 8, ORL_ENV_COLS = 32, ORL_ENV = 256,
    ORL_IRR_XY = 10, ORL_IRR_Z = 14, ORL_IRR = 3 + 2 * ORL_IRR_XY * ORL_IRR_XY + ORL_IRR_Z * ORL_IRR_Z,      /* F; G on the faces x, y, z */
    ORL_HORIZON = 16,
    ORL_SKY_Q = 14, ORL_SKY_Y = 9,
};
#define ORL_SHADOW_BIAS 1.0f
#define ORL_SUN_SOFT    0.08f   /* radians */
#define ORL_LINEAR_MAX  16.0f

typedef struct {
    float env_mean[ORL_ENV][3];                 /* ln radiance */
    float env_basis[ORL_ENV_DIM][ORL_ENV][3];
    float sky_gen[ORL_SKY_Q][3][ORL_SKY_Y];
    float ground[3];                            /* diffuse albedo of the ground, 0..1 */
    float prior_mean[ORL_CODE];                 /* Gaussian prior of the codes; azimuth has precision ~0 */
    float prior_prec[ORL_CODE][ORL_CODE];       /* inverse covariance, symmetric positive semidefinite */
    float sky_mean[3], sky_std[3];              /* what skies look like in this place's photos: sRGB, 0..1; std 0: not known */
} orl_light_model;

/* One pixel's surface and direction, all that light needs. */
typedef struct {
    float albedo[3];                /* linear, 0..1 */
    float normal[3];                /* unit, scene frame */
    float open;                     /* sky openness 0..1 */
    float horizon[ORL_HORIZON];     /* elevation in radians, 0..pi/2, of what hides the sun in each azimuth */
    float fix;                      /* what the visibility of a traced sun has over the horizon's, -1..1; 0: not traced */
    float phi[ORL_SHADOW_DIM];      /* shadow features */
    float cov;                      /* 1 surface, 0 sky */
    float dir[3];                   /* unit view direction, from the camera outwards, scene frame */
    float rgb[3];                   /* observed, sRGB 0..1 (adaptation and training only) */
    float weight;                   /* of the observation, 0 = leave out */
} orl_sample;

/* A decoded light, ready to shade. */
typedef struct {
    float code[ORL_CODE];
    float sun_dir[3], sun_rgb[3];               /* unit; irradiance at normal incidence */
    float sin_az, cos_az;
    float env[ORL_ENV][3];                      /* radiance, sun-relative */
    float esky[ORL_IRR][4];                     /* F and G of E_sky, R, G, B, 0 */
    float up[3], eground[3];                    /* E_sky + E_sun of level ground; ground times that */
    float sky_m[3][ORL_SKY_Y];
    float tone_a[3][3], tone_b[3];              /* A = I + A' */
} orl_light;

void orl_light_decode(const orl_light_model *m, const float code[ORL_CODE], orl_light *out);
/* From a user's environment instead of the code: radiance env[8*32][3] in the sun-relative frame and a sun; tone, shadow and sky codes come from code. */
void orl_light_from_env(const orl_light_model *m, const float env[ORL_ENV][3], const float code[ORL_CODE], orl_light *out);
void orl_light_esky(const orl_light *l, const float n[3], float e[3]);
float orl_light_sun_visibility(const orl_light *l, const orl_sample *s);        /* V above */
float orl_light_shadow(const orl_light *l, const orl_sample *s);                /* s above */
void orl_light_irradiance(const orl_light *l, const orl_sample *s, float e[3]); /* c pi / albedo above: sun, sky and ground, shadows in it */
float orl_light_encode(float linear);           /* e(c) above */
float orl_light_decode_srgb(float encoded);     /* its inverse, clamped to [0, ORL_LINEAR_MAX] */
void orl_light_shade(const orl_light *l, const orl_sample *s, float rgb[3]);
/* Also J[c][k] = d rgb[c] / d code[k]; sky decoder terms by the tables below. scratch: orl_light_jac_decode's output for this light. */
typedef struct {
    float desky[ORL_IRR][ORL_ENV_DIM][3];           /* d esky / d z_k */
    float dground[ORL_ENV_DIM][3];                  /* d eground / d z_k */
    const orl_light_model *model;
} orl_light_jac;
void orl_light_jac_decode(const orl_light_model *m, const orl_light *l, orl_light_jac *out);
void orl_light_shade_jac(const orl_light *l, const orl_light_jac *jl, const orl_sample *s, float rgb[3], float J[3][ORL_CODE]);
/* Reverse mode for training: given d_rgb, adds to the gradients (any may be NULL) of albedo, phi, ground, sky_m. */
void orl_light_shade_back(const orl_light_model *m, const orl_light *l, const orl_sample *s, const float d_rgb[3],
                          float d_albedo[3], float d_phi[ORL_SHADOW_DIM], float d_ground[3], float d_sky_m[3][ORL_SKY_Y]);
/* Octahedral map of the full sphere and back: how views number normals. */
void orl_oct_dir(float u, float v, float dir[3]);       /* u, v in [-1, 1] */
void orl_oct_uv(const float dir[3], float uv[2]);

/* The decoder shipped with the program (parametric skies alone), and a file of its own made by `oriel-train sky` (a .oriel with only the sky sections). Fills env_*, ground, prior_*; sky_gen gets a neutral blue-to-white start. */
void orl_light_model_default(orl_light_model *out);
#endif
