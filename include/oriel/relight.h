/* Re-lighting a view by a panorama, in float: the light of a sun's place, layers of a pixel, pictures for display, and what a user may do to them (tone, a day's course of the sun).
 * Geometry is the view's and stays; only orl_relight_set changes from frame to frame. Nothing here allocates. Same bits for any number of threads. */
#ifndef ORIEL_RELIGHT_H
#define ORIEL_RELIGHT_H
#include "oriel/view.h"
#include "oriel/panorama.h"

typedef struct {
    orl_view *view;
    const orl_light_model *model;
    const orl_panorama *sky;
    float level;                        /* panorama's units -> light's */
    orl_sun sun;
    orl_light light;
} orl_relight;

/* One pixel; linear, in the panorama's units. rgb = cov * albedo * irradiance / pi + sky. Without surface (cov 0) albedo, normal, irradiance and shadow are 0. */
typedef struct {
    float rgb[3], albedo[3], normal[3]; /* normal: scene frame, unit */
    float irradiance[3];                /* of sun, sky and ground, shadows in it */
    float shadow;                       /* the sun's visibility times the learned shadow, 0..1 */
    float sky[3];                       /* what the surface does not cover of it */
    float cov;
} orl_layers;

typedef struct { float a[3][3], b[3]; } orl_tone;       /* rgb = A e + b on sRGB-encoded colour */

/* level: such that a white floor under this sun is displayed at about 1, the middle of the light model's range. Then as orl_relight_set. */
void orl_relight_init(orl_view *view, const orl_light_model *model, const orl_panorama *sky, const orl_sun *sun, orl_relight *out);
void orl_relight_set(orl_relight *r, const orl_sun *sun);
/* Then the sun is traced for the view's pixels (else the scene's horizons tell where it shines). */
void orl_relight_trace(orl_relight *r, int threads);
void orl_relight_pixel(const orl_relight *r, int x, int y, orl_layers *out);
/* The picture, linear; work: [h][w][3]. */
void orl_relight_linear(const orl_relight *r, int threads, float *linear);
/* For display: 8-bit sRGB of gain * linear, toned, tight rows. */
void orl_relight_display(const orl_relight *r, int threads, const float *linear, float gain, const orl_tone *tone, uint8_t *rgb);
/* 95th percentile of the surface's luminance; scratch: [h][w]. 0 where no pixel is all surface. */
float orl_relight_bright(const orl_relight *r, const float *linear, float *scratch);

/* A preset's name, or a file of 12 numbers: the rows of [A b], # begins a comment. ORL_E_IO, ORL_E_FORMAT, ORL_E_RANGE name the file. */
orl_err orl_tone_find(const char *name, orl_tone *out);
extern const char ORL_TONE_PRESETS[];   /* "neutral, warm, ..." */

/* A day at a latitude (degrees, north positive): declination by Cooper 1969, no refraction. Hour angles: 0 is noon, radians. */
typedef struct { double latitude; int day; float north; } orl_day;      /* day of the year, 1..366; north: its azimuth in the scene frame, radians */
/* From sunrise to -rise; pi where the sun does not set. ORL_E_DEGENERATE where it does not rise. */
orl_err orl_day_rise(const orl_day *d, float *rise);
/* The panorama's sun where the day has it at an hour: its energy by the air mass it shines through, relative to its own place in the panorama; the sky's radiance goes with the sine of the elevation. */
orl_sun orl_day_sun(const orl_day *d, float hour, const orl_panorama *p);
#endif
