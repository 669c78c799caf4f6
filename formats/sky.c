/* Parametric skies and the decoder fitted to skies (include/oriel/sky.h). Units: radiance such that a white horizontal surface under a typical exposure has E / pi = 1.
 * Sources: CIE S 011 / ISO 15469 (luminance), Preetham, Shirley, Smits 1999 (chromaticity), Kasten 1965 (air mass), Angstrom's law (aerosol).
 * Not modelled: twilight, the moon, haze near the horizon beyond what the CIE gradation gives. */
#include "oriel/sky.h"
#include <math.h>
#include <pthread.h>
#include <stdlib.h>
#include <string.h>
#include "oriel/math.h"
#include "oriel/scene.h"

#define PI 3.14159265f
enum { DIM = 3 * ORL_ENV, DEFAULT_SKIES = 256, JOINT = 4 + ORL_ENV_DIM };    /* JOINT: sun elevation, ln sun RGB, z */

static float clampf(float x, float lo, float hi) { return x > lo ? x < hi ? x : hi : lo; }

/* ---- numbers by index ---- */

static uint64_t mix(uint64_t x)                 /* splitmix64 */
{
    x += 0x9e3779b97f4a7c15u;
    x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9u;
    x = (x ^ (x >> 27)) * 0x94d049bb133111ebu;
    return x ^ (x >> 31);
}

float orl_sky_uniform(uint32_t index, uint32_t what) { return (float)(mix((uint64_t)index << 32 | what) >> 40) * (1.0f / 16777216); }

float orl_sky_normal(uint32_t index, uint32_t what)
{
    float u = orl_sky_uniform(index, what ^ 0x80000000u), v = orl_sky_uniform(index, what ^ 0xc0000000u);
    return sqrtf(-2 * orl_logf(u + 1e-7f)) * orl_cosf(2 * PI * v);
}

/* ---- parametric sky ---- */

/* The fifteen CIE types: gradation a, b; indicatrix c, d, e; then, from Kittler and Darula's statistics, the diffuse share of the extraterrestrial irradiance, the turbidity of the
 * direct beam (0: hidden), and how clear (blue) it is. */
static const struct { float a, b, c, d, e, diffuse, turbidity, clear; } TYPE[15] = {
    { 4.0f, -0.70f, 0, -1.0f, 0, 0.15f, 0, 0 },         { 4.0f, -0.70f, 2, -1.5f, 0.15f, 0.18f, 0, 0 },      { 1.1f, -0.8f, 0, -1.0f, 0, 0.20f, 0, 0 },
    { 1.1f, -0.8f, 2, -1.5f, 0.15f, 0.25f, 0, 0.1f },   { 0, -1.0f, 0, -1.0f, 0, 0.28f, 0, 0.1f },           { 0, -1.0f, 2, -1.5f, 0.15f, 0.32f, 16, 0.3f },
    { 0, -1.0f, 5, -2.5f, 0.30f, 0.36f, 12, 0.5f },     { 0, -1.0f, 10, -3.0f, 0.45f, 0.38f, 10, 0.6f },     { -1.0f, -0.55f, 2, -1.5f, 0.15f, 0.28f, 12, 0.5f },
    { -1.0f, -0.55f, 5, -2.5f, 0.30f, 0.33f, 9, 0.7f }, { -1.0f, -0.55f, 10, -3.0f, 0.45f, 0.30f, 4.5f, 0.9f }, { -1.0f, -0.32f, 10, -3.0f, 0.45f, 0.15f, 2.5f, 1 },
    { -1.0f, -0.32f, 16, -3.0f, 0.30f, 0.20f, 4.5f, 1 }, { -1.0f, -0.15f, 16, -3.0f, 0.30f, 0.22f, 5, 1 },   { -1.0f, -0.15f, 24, -2.8f, 0.15f, 0.22f, 4, 1 },
};

/* Perez's form with coefficients A..E: angle to the zenith by its cosine, angle to the sun g. */
static float perez(const float k[5], float cos_z, float g, float cos_g)
{
    return (1 + k[0] * orl_expf(k[1] / (cos_z > 0.02f ? cos_z : 0.02f))) * (1 + k[2] * orl_expf(k[3] * g) + k[4] * cos_g * cos_g);
}

/* Linear sRGB of unit luminance. */
static void chroma(float x, float y, float rgb[3])
{
    float X = x / y, Z = (1 - x - y) / y;
    rgb[0] = clampf(3.2406f * X - 1.5372f - 0.4986f * Z, 0.02f, 4);
    rgb[1] = clampf(-0.9689f * X + 1.8758f + 0.0415f * Z, 0.02f, 4);
    rgb[2] = clampf(0.0557f * X - 0.2040f + 1.0570f * Z, 0.02f, 4);
}

/* Value noise on the plane of the clouds, three octaves, 0..1. */
static float noise(uint32_t index, float x, float y)
{
    float sum = 0, amp = 0.57f;
    for (uint32_t o = 0; o < 3; o++, amp *= 0.5f, x *= 2.1f, y *= 2.1f) {
        float fx = x + 512, fy = y + 512;
        uint32_t i = (uint32_t)fx, j = (uint32_t)fy;
        fx -= (float)i;
        fy -= (float)j;
        fx *= fx * (3 - 2 * fx);
        fy *= fy * (3 - 2 * fy);
        uint32_t k = 0x10000u * (o + 1) + i * 97 + j * 7919;
        float a = orl_sky_uniform(index, k), b = orl_sky_uniform(index, k + 97), c = orl_sky_uniform(index, k + 7919), d = orl_sky_uniform(index, k + 97 + 7919);
        sum += amp * (a + fx * (b - a) + fy * (c - a + fx * (a - b - c + d)));
    }
    return sum;
}

static void direction(int w, float d[3], float *area)
{
    const float step = PI / 16;
    int row = w / ORL_ENV_COLS;
    float el = PI / 2 - ((float)row + 0.5f) * step, az = -PI + ((float)(w % ORL_ENV_COLS) + 0.5f) * step;
    d[0] = orl_cosf(el) * orl_cosf(az);
    d[1] = orl_cosf(el) * orl_sinf(az);
    d[2] = orl_sinf(el);
    *area = step * (orl_sinf(PI / 2 - (float)row * step) - orl_sinf(PI / 2 - (float)(row + 1) * step));
}

void orl_sky_beam(float el, float turbidity, float ln_sun[3])
{
    /* Wavelengths of R, G, B in um; ozone at 0.35 cm */
    static const float LAMBDA[3] = { 0.61f, 0.55f, 0.465f }, OZONE[3] = { 0.044f, 0.030f, 0.004f }, SUN[3] = { 1.05f, 1.0f, 0.94f };
    float mass = 1 / (orl_sinf(el) + 0.15f * orl_powf(el * (180 / PI) + 3.885f, -1.253f));
    for (int c = 0; c < 3; c++) {
        float rayleigh = 0.008735f * orl_powf(LAMBDA[c], -4.08f), aerosol = (0.04608f * turbidity - 0.04586f) * orl_powf(LAMBDA[c], -1.3f);
        ln_sun[c] = orl_logf(SUN[c]) - mass * (rayleigh + aerosol + OZONE[c]);
    }
}

void orl_sky_parametric(uint32_t index, orl_sky *out)
{
    /* 1: sky type (the sequence goes through all), sun elevation, turbidity, cloud cover */
    uint32_t type = index % 15, n = index;
    float el = (2 + 73 * orl_sky_uniform(n, 1)) * (PI / 180), sz = orl_sinf(el), cz = orl_cosf(el), theta = PI / 2 - el;
    float T = clampf((TYPE[type].turbidity > 0 ? TYPE[type].turbidity : 6) * orl_expf(0.2f * orl_sky_normal(n, 2)), 2, 14), Tc = T < 6 ? T : 6;
    float cover = type >= 5 && orl_sky_uniform(n, 3) < 0.6f ? 0.1f + 0.6f * orl_sky_uniform(n, 4) : 0;

    /* 2: direct beam */
    float beam[3];
    orl_sky_beam(el, T, out->ln_sun);
    float hidden = type < 5 ? 3 + 4 * orl_sky_uniform(n, 5) : cover > 0 && orl_sky_uniform(n, 6) < cover ? 1 + 4 * orl_sky_uniform(n, 7) : 0;
    for (int c = 0; c < 3; c++) {
        out->ln_sun[c] -= hidden;
        beam[c] = orl_expf(out->ln_sun[c]) * sz;
    }
    out->sun_el = el;

    /* 3: sky: CIE luminance, Preetham chromaticity on clear types, near neutral on covered ones */
    const float L[5] = { TYPE[type].a, TYPE[type].b, TYPE[type].c, TYPE[type].d, TYPE[type].e };
    const float X[5] = { -0.0193f * Tc - 0.2592f, -0.0665f * Tc + 0.0008f, -0.0004f * Tc + 0.2125f, -0.0641f * Tc - 0.8989f, -0.0033f * Tc + 0.0452f };
    const float Y[5] = { -0.0167f * Tc - 0.2608f, -0.0950f * Tc + 0.0092f, -0.0079f * Tc + 0.2102f, -0.0441f * Tc - 1.6537f, -0.0109f * Tc + 0.0529f };
    float t1 = theta, t2 = t1 * t1, t3 = t2 * t1;
    float xz = Tc * Tc * (0.0017f * t3 - 0.0037f * t2 + 0.0021f * t1) + Tc * (-0.0290f * t3 + 0.0638f * t2 - 0.0320f * t1 + 0.0039f) + 0.1169f * t3 - 0.2120f * t2 + 0.0605f * t1 + 0.2589f;
    float yz = Tc * Tc * (0.0028f * t3 - 0.0061f * t2 + 0.0032f * t1) + Tc * (-0.0421f * t3 + 0.0897f * t2 - 0.0415f * t1 + 0.0052f) + 0.1535f * t3 - 0.2676f * t2 + 0.0667f * t1 + 0.2669f;
    float px = xz / perez(X, 1, theta, sz), py = yz / perez(Y, 1, theta, sz);
    float grey[3], sum = 0, drift = 6 * orl_sky_uniform(n, 8);
    chroma(0.3127f - 0.012f * orl_sky_uniform(n, 9), 0.3290f - 0.010f * orl_sky_uniform(n, 9), grey);
    for (int w = 0; w < ORL_ENV; w++) {
        float d[3], area, rgb[3];
        direction(w, d, &area);
        float cos_g = clampf(d[0] * cz + d[2] * sz, -1, 1), g = PI / 2 - orl_asinf(cos_g);
        float lum = perez(L, d[2], g, cos_g);
        chroma(clampf(px * perez(X, d[2], g, cos_g), 0.2f, 0.5f), clampf(py * perez(Y, d[2], g, cos_g), 0.2f, 0.5f), rgb);
        for (int c = 0; c < 3; c++) out->log_env[w][c] = lum * (grey[c] + TYPE[type].clear * (rgb[c] - grey[c]));
        sum += lum * d[2] * area;
    }
    float scale = TYPE[type].diffuse * orl_expf(0.2f * orl_sky_normal(n, 10)) * sz / sum, mean = TYPE[type].diffuse * sz / PI;

    /* 4: clouds, lit by beam and sky; brighter towards the sun, dark below when thick */
    for (int w = 0; w < ORL_ENV; w++) {
        float d[3], area, alpha = 0, forward = 0;
        direction(w, d, &area);
        if (cover > 0) {
            float far = 1.6f / (d[2] + 0.25f), v = noise(n, d[0] * far + drift, d[1] * far);
            alpha = clampf((v - (0.75f - 0.6f * cover)) * 5, 0, 0.95f);
            forward = 0.5f + 0.9f * orl_expf(-2.5f * (1 - (d[0] * cz + d[2] * sz)));
        }
        for (int c = 0; c < 3; c++) {
            float cloud = mean * 0.8f + 0.6f * beam[c] / PI * forward;
            out->log_env[w][c] = orl_logf(out->log_env[w][c] * scale * (1 - alpha) + alpha * cloud + 1e-6f);
        }
    }
    orl_sky_expose(out, 0.7f * orl_sky_normal(n, 11), 0.12f * orl_sky_normal(n, 12));
}

void orl_sky_expose(orl_sky *s, float ln_exposure, float warmth)
{
    float up = 0, sz = clampf(orl_sinf(s->sun_el), 0, 1);
    for (int w = 0; w < ORL_ENV; w++) {
        float d[3], area;
        direction(w, d, &area);
        up += (orl_expf(s->log_env[w][0]) + orl_expf(s->log_env[w][1]) + orl_expf(s->log_env[w][2])) * d[2] * area;
    }
    for (int c = 0; c < 3; c++) up += orl_expf(s->ln_sun[c]) * sz;
    float shift = ln_exposure - orl_logf(up / (3 * PI));
    for (int c = 0; c < 3; c++) {
        float by = shift + (c == 0 ? warmth : c == 2 ? -warmth : 0);
        for (int w = 0; w < ORL_ENV; w++) s->log_env[w][c] = clampf(s->log_env[w][c] + by, -12, 12);
        s->ln_sun[c] = clampf(s->ln_sun[c] + by, -6, 6);            /* -6: no sun to speak of */
    }
}

/* ---- fit ---- */

/* Square root of an entry's share of the sky, 1 on average. */
static void entry_weights(float weight[ORL_ENV])
{
    for (int w = 0; w < ORL_ENV; w++) {
        float d[3], area;
        direction(w, d, &area);
        weight[w] = sqrtf(area * (ORL_ENV / (2 * PI)));
    }
}

/* Inverse of a small positive definite matrix by Cholesky and unit columns. */
static void invert(int n, const double a[JOINT][JOINT], double inv[JOINT][JOINT])
{
    double l[JOINT][JOINT] = { { 0 } };
    for (int i = 0; i < n; i++)
        for (int j = 0; j <= i; j++) {
            double s = a[i][j];
            for (int k = 0; k < j; k++) s -= l[i][k] * l[j][k];
            l[i][j] = i == j ? sqrt(s > 1e-9 ? s : 1e-9) : s / l[j][j];
        }
    for (int c = 0; c < n; c++) {
        double x[JOINT];
        for (int i = 0; i < n; i++) {
            x[i] = i == c;
            for (int k = 0; k < i; k++) x[i] -= l[i][k] * x[k];
            x[i] /= l[i][i];
        }
        for (int i = n - 1; i >= 0; i--) {
            for (int k = i + 1; k < n; k++) x[i] -= l[k][i] * x[k];
            x[i] /= l[i][i];
            inv[i][c] = x[i];
        }
    }
}

/* Entries clipped to 2.5 deviations around the mean, twice: what one odd roof or lamp does to a direction stays small. Leaves x centred and weighted. */
static void centre(float *x, size_t n, const float weight[ORL_ENV], float (*mean)[3])
{
    for (int e = 0; e < DIM; e++) {
        double m = 0;
        for (int pass = 0; pass < 3; pass++) {
            double s = 0, q = 0;
            for (size_t i = 0; i < n; i++) { double v = x[i * DIM + (size_t)e]; s += v; q += v * v; }
            m = s / (double)n;
            double dev = sqrt(fmax(q / (double)n - m * m, 0)) * 2.5 + 1e-6;
            if (pass < 2) for (size_t i = 0; i < n; i++) x[i * DIM + (size_t)e] = clampf(x[i * DIM + (size_t)e], (float)(m - dev), (float)(m + dev));
        }
        mean[e / 3][e % 3] = (float)m;
        for (size_t i = 0; i < n; i++) x[i * DIM + (size_t)e] = (x[i * DIM + (size_t)e] - (float)m) * weight[e / 3];
    }
}

/* Leading eigenvectors v (n x ORL_ENV_DIM, unit columns) of the Gram matrix by orthogonal iteration; some columns more than wanted make the last ones settle. */
static void leading(const float *gram, size_t n, double *v, double *tmp)
{
    enum { K = ORL_ENV_DIM + 4, ROUNDS = 40 };
    for (size_t i = 0; i < n * K; i++) v[i] = orl_sky_uniform((uint32_t)(i / K), 0x5eed0000u + (uint32_t)(i % K)) - 0.5f;
    for (int r = 0; r < ROUNDS; r++) {
        for (size_t i = 0; i < n; i++) {
            double s[K] = { 0 };
            for (size_t j = 0; j < n; j++) for (int k = 0; k < K; k++) s[k] += gram[i * n + j] * v[j * K + (size_t)k];
            memcpy(tmp + i * K, s, sizeof s);
        }
        for (size_t k = 0; k < K; k++) {
            for (size_t q = 0; q < k; q++) {
                double d = 0;
                for (size_t i = 0; i < n; i++) d += tmp[i * K + k] * tmp[i * K + q];
                for (size_t i = 0; i < n; i++) tmp[i * K + k] -= d * tmp[i * K + q];
            }
            double len = 0;
            for (size_t i = 0; i < n; i++) len += tmp[i * K + k] * tmp[i * K + k];
            double inv = len > 1e-30 ? 1 / sqrt(len) : 0;
            for (size_t i = 0; i < n; i++) tmp[i * K + k] *= inv;
        }
        memcpy(v, tmp, n * K * sizeof *v);
    }
    for (size_t i = 0; i < n; i++) memmove(v + i * ORL_ENV_DIM, v + i * K, ORL_ENV_DIM * sizeof *v);
}

/* Mean and precision of the codes from the skies' suns and their z = sqrt(n) v. */
static void prior(const orl_sky *skies, size_t n, const double *v, orl_light_model *out)
{
    double mean[JOINT] = { 0 }, cov[JOINT][JOINT] = { { 0 } }, prec[JOINT][JOINT];
    for (int pass = 0; pass < 2; pass++)
        for (size_t i = 0; i < n; i++) {
            double x[JOINT] = { skies[i].sun_el, skies[i].ln_sun[0], skies[i].ln_sun[1], skies[i].ln_sun[2] };
            for (int k = 0; k < ORL_ENV_DIM; k++) x[4 + k] = sqrt((double)n) * v[i * ORL_ENV_DIM + (size_t)k];
            for (int a = 0; a < JOINT; a++) {
                if (pass == 0) mean[a] += x[a] / (double)n;
                else for (int b = 0; b < JOINT; b++) cov[a][b] += (x[a] - mean[a]) * (x[b] - mean[b]) / (double)n;
            }
        }
    for (int a = 0; a < JOINT; a++) cov[a][a] += a == 0 ? 0.05 * 0.05 : 0.15 * 0.15;    /* no photo obeys the models exactly */
    invert(JOINT, (const double (*)[JOINT])cov, prec);
    for (int k = 0; k < ORL_CODE; k++) out->prior_prec[k][k] = 1;
    out->prior_prec[ORL_C_SUN_AZ][ORL_C_SUN_AZ] = 1e-4f;
    for (int k = 0; k < ORL_TONE_DIM; k++) out->prior_prec[ORL_C_TONE + k][ORL_C_TONE + k] = k < 9 ? 1 / (0.15f * 0.15f) : 1 / (0.08f * 0.08f);
    for (int a = 0; a < JOINT; a++) {
        out->prior_mean[ORL_C_SUN_EL + a] = a < 4 ? (float)mean[a] : 0;                 /* codes 1..12 in this order */
        for (int b = 0; b < JOINT; b++) out->prior_prec[ORL_C_SUN_EL + a][ORL_C_SUN_EL + b] = (float)(0.5 * (prec[a][b] + prec[b][a]));
    }
}

/* What needs no skies; sky generator in encoded colour: white at the horizon, blue above. */
static void neutral(orl_light_model *out)
{
    static const float HORIZON[3] = { 0.84f, 0.89f, 0.94f }, ZENITH[3] = { 0.36f, 0.55f, 0.82f };
    memset(out, 0, sizeof *out);
    for (int c = 0; c < 3; c++) {
        out->ground[c] = 0.25f;
        out->sky_gen[0][c][0] = HORIZON[c];
        out->sky_gen[0][c][3] = ZENITH[c] - HORIZON[c];
    }
}

orl_err orl_sky_fit(const orl_sky *skies, size_t n, orl_light_model *out)
{
    if (n < 16 || n > 4096) return orl_fail(ORL_E_RANGE, "sky decoder: %zu skies, 16 to 4096 needed", n);
    float *x = malloc(n * DIM * sizeof *x), *gram = malloc(n * n * sizeof *gram), weight[ORL_ENV];
    double *v = malloc(n * 2 * (ORL_ENV_DIM + 4) * sizeof *v);
    orl_err err = ORL_OK;
    if (!x || !gram || !v) { err = orl_fail(ORL_E_MEMORY, "sky decoder: no memory for %zu skies", n); goto done; }
    neutral(out);
    entry_weights(weight);
    for (size_t i = 0; i < n; i++) memcpy(x + i * DIM, skies[i].log_env, DIM * sizeof *x);
    centre(x, n, weight, out->env_mean);
    for (size_t i = 0; i < n; i++)
        for (size_t j = 0; j <= i; j++) {
            float s[8] = { 0 }, t = 0;
            for (size_t e = 0; e < DIM; e += 8) for (size_t k = 0; k < 8; k++) s[k] += x[i * DIM + e + k] * x[j * DIM + e + k];
            for (int k = 0; k < 8; k++) t += s[k];
            gram[i * n + j] = gram[j * n + i] = t;
        }
    leading(gram, n, v, v + n * (ORL_ENV_DIM + 4));
    for (int k = 0; k < ORL_ENV_DIM; k++) {
        double basis[DIM] = { 0 }, sum = 0, inv = 1 / sqrt((double)n);
        for (size_t i = 0; i < n; i++) for (int e = 0; e < DIM; e++) basis[e] += v[i * ORL_ENV_DIM + (size_t)k] * x[i * DIM + (size_t)e];
        for (int e = 0; e < DIM; e++) sum += basis[e];
        double sign = sum < 0 ? -1 : 1;                                 /* more is brighter */
        for (int e = 0; e < DIM; e++) out->env_basis[k][e / 3][e % 3] = (float)(sign * inv * basis[e] / weight[e / 3]);
        for (size_t i = 0; i < n; i++) v[i * ORL_ENV_DIM + (size_t)k] *= sign;
    }
    prior(skies, n, v, out);
done:
    free(x);
    free(gram);
    free(v);
    return err;
}

float orl_sky_project(const orl_light_model *m, const orl_sky *s, float z[ORL_ENV_DIM])
{
    float weight[ORL_ENV], rest[ORL_ENV][3];
    entry_weights(weight);
    for (int w = 0; w < ORL_ENV; w++) for (int c = 0; c < 3; c++) rest[w][c] = s->log_env[w][c] - m->env_mean[w][c];
    /* The basis is orthogonal up to rounding; three rounds of coordinate descent take care of the rest. */
    if (z) memset(z, 0, ORL_ENV_DIM * sizeof *z);
    for (int round = 0; z && round < 3; round++)
        for (int k = 0; k < ORL_ENV_DIM; k++) {
            float dot = 0, len = 1e-12f;
            for (int w = 0; w < ORL_ENV; w++)
                for (int c = 0; c < 3; c++) {
                    float b = m->env_basis[k][w][c] * weight[w] * weight[w];
                    dot += b * rest[w][c];
                    len += b * m->env_basis[k][w][c];
                }
            z[k] += dot / len;
            for (int w = 0; w < ORL_ENV; w++) for (int c = 0; c < 3; c++) rest[w][c] -= dot / len * m->env_basis[k][w][c];
        }
    float sum = 0;
    for (int w = 0; w < ORL_ENV; w++) for (int c = 0; c < 3; c++) sum += rest[w][c] * rest[w][c] * weight[w] * weight[w];
    return sqrtf(sum / DIM);
}

/* ---- default, file ---- */

static orl_light_model fresh;
static pthread_once_t fresh_once = PTHREAD_ONCE_INIT;

static void fresh_make(void)
{
    orl_sky *skies = malloc(DEFAULT_SKIES * sizeof *skies);
    for (uint32_t i = 0; skies && i < DEFAULT_SKIES; i++) orl_sky_parametric(i, &skies[i]);
    if (!skies || orl_sky_fit(skies, DEFAULT_SKIES, &fresh)) {          /* no memory: an even grey sky that only tone and sun can change */
        neutral(&fresh);
        for (int k = 0; k < ORL_CODE; k++) fresh.prior_prec[k][k] = 1;
    }
    free(skies);
}

void orl_light_model_default(orl_light_model *out)
{
    pthread_once(&fresh_once, fresh_make);
    *out = fresh;
}

orl_err orl_sky_load(const char *path, orl_light_model *out)
{
    orl_scene s;
    orl_err e = orl_scene_open(path, &s);
    if (e) return e;
    *out = s.light;
    orl_scene_close(&s);
    return ORL_OK;
}
