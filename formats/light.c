/* The light model: codes -> environment -> colour of a sample, its derivatives for adaptation and its reverse mode for training. Equations in the header; everything is per sample
 * and without state but one constant table. Display-referred output, not clamped. */
#include "oriel/light.h"
#include <math.h>
#include <pthread.h>
#include <string.h>
#include "oriel/math.h"

#define PI 3.14159265f
enum { TEXELS = ORL_OCT * ORL_OCT, LANES = 4 };
typedef float v4 __attribute__((vector_size(16)));
typedef int32_t i4 __attribute__((vector_size(16)));

static float clampf(float x, float lo, float hi) { return x > lo ? x < hi ? x : hi : lo; }     /* NaN -> lo */
static float absf(float x) { return x < 0 ? -x : x; }

/* ---- octahedral map ---- */

void orl_oct_dir(float u, float v, float dir[3])
{
    float x = u, y = v, z = 1 - absf(u) - absf(v);
    if (z < 0) {
        x = (1 - absf(v)) * (u < 0 ? -1.0f : 1.0f);
        y = (1 - absf(u)) * (v < 0 ? -1.0f : 1.0f);
    }
    float r = 1 / sqrtf(x * x + y * y + z * z);
    dir[0] = x * r; dir[1] = y * r; dir[2] = z * r;
}

void orl_oct_uv(const float dir[3], float uv[2])
{
    float sum = absf(dir[0]) + absf(dir[1]) + absf(dir[2]);
    if (!(sum > 1e-20f)) { uv[0] = uv[1] = 0; return; }                 /* no direction: up */
    float r = 1 / sum, u = dir[0] * r, v = dir[1] * r;
    uv[0] = u; uv[1] = v;
    if (dir[2] < 0) {
        uv[0] = (1 - absf(v)) * (u < 0 ? -1.0f : 1.0f);
        uv[1] = (1 - absf(u)) * (v < 0 ? -1.0f : 1.0f);
    }
}

/* Bilinear footprint: first texel of a 2 x 2 block and its four weights. */
typedef struct { int at; float w[4]; } footprint;

static footprint oct_footprint(const float dir[3])
{
    float uv[2];
    orl_oct_uv(dir, uv);
    float x = clampf((uv[0] + 1) * (0.5f * (ORL_OCT - 1)), 0, ORL_OCT - 1), y = clampf((uv[1] + 1) * (0.5f * (ORL_OCT - 1)), 0, ORL_OCT - 1);
    int i = (int)x, j = (int)y;
    if (i > ORL_OCT - 2) i = ORL_OCT - 2;
    if (j > ORL_OCT - 2) j = ORL_OCT - 2;
    float fx = x - (float)i, fy = y - (float)j;
    return (footprint){ j * ORL_OCT + i, { (1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy } };
}

static const float UP[3] = { 0, 0, 1 };

static void fetch(const float (*t)[3], const footprint *f, float e[3])
{
    const float *a = t[f->at], *b = t[f->at + ORL_OCT];
    for (int c = 0; c < 3; c++) e[c] = f->w[0] * a[c] + f->w[1] * a[c + 3] + f->w[2] * b[c] + f->w[3] * b[c + 3];
}

/* ---- environment -> irradiance ---- */

/* transfer[block][w][lane] = max(0, n.w) dOmega(w) for texel block * LANES + lane; made once, never freed. */
static v4 transfer[TEXELS / LANES][ORL_ENV];
static pthread_once_t transfer_once = PTHREAD_ONCE_INIT;

static void transfer_make(void)
{
    for (int t = 0; t < TEXELS; t++) {
        float n[3];
        orl_oct_dir((float)(t % ORL_OCT) * (2.0f / (ORL_OCT - 1)) - 1, (float)(t / ORL_OCT) * (2.0f / (ORL_OCT - 1)) - 1, n);
        for (int w = 0; w < ORL_ENV; w++) {
            const float step = PI / 16;
            int row = w / ORL_ENV_COLS, col = w % ORL_ENV_COLS;
            float el = PI / 2 - ((float)row + 0.5f) * step, az = -PI + ((float)col + 0.5f) * (2 * PI / ORL_ENV_COLS);
            float area = (2 * PI / ORL_ENV_COLS) * (orl_sinf(PI / 2 - (float)row * step) - orl_sinf(PI / 2 - (float)(row + 1) * step));
            float cosine = orl_cosf(el) * (n[0] * orl_cosf(az) + n[1] * orl_sinf(az)) + n[2] * orl_sinf(el);
            transfer[t / LANES][w][t % LANES] = cosine > 0 ? cosine * area : 0;
        }
    }
}

static void irradiance(const float (*env)[3], float (*out)[3])
{
    pthread_once(&transfer_once, transfer_make);
    for (int b = 0; b < TEXELS / LANES; b++) {
        const v4 *t = transfer[b];
        v4 r = { 0 }, g = { 0 }, bl = { 0 };
        for (int w = 0; w < ORL_ENV; w++) {
            r += t[w] * env[w][0];
            g += t[w] * env[w][1];
            bl += t[w] * env[w][2];
        }
        for (int k = 0; k < LANES; k++) { out[b * LANES + k][0] = r[k]; out[b * LANES + k][1] = g[k]; out[b * LANES + k][2] = bl[k]; }
    }
}

/* Of a horizontal surface under sky and sun. */
static void up_irradiance(const orl_light *l, float up[3])
{
    footprint f = oct_footprint(UP);
    fetch((const float (*)[3])l->esky, &f, up);
    for (int c = 0; c < 3; c++) up[c] += l->sun_rgb[c] * clampf(l->sun_dir[2], 0, 1);
}

/* Sky generator coordinates q of the codes. */
static void sky_q(const float *code, float q[ORL_SKY_Q])
{
    q[0] = 1;
    q[1] = code[ORL_C_SUN_EL];
    memcpy(q + 2, code + ORL_C_ENV, (ORL_ENV_DIM + ORL_SKY_DIM) * sizeof *q);
}

/* All that follows from codes and env. */
static void finish(const orl_light_model *m, const float code[ORL_CODE], orl_light *l)
{
    for (int k = 0; k < ORL_CODE; k++) l->code[k] = code[k] == code[k] ? clampf(code[k], -1e3f, 1e3f) : 0;
    float az = l->code[ORL_C_SUN_AZ], el = l->code[ORL_C_SUN_EL], ce = orl_cosf(el), up[3], q[ORL_SKY_Q];
    l->sin_az = orl_sinf(az);
    l->cos_az = orl_cosf(az);
    l->sun_dir[0] = ce * l->cos_az; l->sun_dir[1] = ce * l->sin_az; l->sun_dir[2] = orl_sinf(el);
    irradiance((const float (*)[3])l->env, l->esky);
    for (int c = 0; c < 3; c++) l->sun_rgb[c] = orl_expf(clampf(l->code[ORL_C_SUN_RGB + c], -12, 12));
    up_irradiance(l, up);
    sky_q(l->code, q);
    memset(l->sky_m, 0, sizeof l->sky_m);
    for (int c = 0; c < 3; c++) {
        l->eground[c] = m->ground[c] * up[c];
        for (int j = 0; j < ORL_SKY_Q; j++) for (int y = 0; y < ORL_SKY_Y; y++) l->sky_m[c][y] += q[j] * m->sky_gen[j][c][y];
        for (int k = 0; k < 3; k++) l->tone_a[c][k] = l->code[ORL_C_TONE + 3 * c + k] + (c == k ? 1.0f : 0.0f);
        l->tone_b[c] = l->code[ORL_C_TONE + 9 + c];
    }
}

/* ln radiance before the clamp, kept apart because its derivative is zero where it is clamped. */
static float log_radiance(const orl_light_model *m, const float *z, int w, int c)
{
    float v = m->env_mean[w][c];
    for (int k = 0; k < ORL_ENV_DIM; k++) v += z[k] * m->env_basis[k][w][c];
    return v;
}

void orl_light_decode(const orl_light_model *m, const float code[ORL_CODE], orl_light *out)
{
    float z[ORL_ENV_DIM];
    for (int k = 0; k < ORL_ENV_DIM; k++) z[k] = code[ORL_C_ENV + k] == code[ORL_C_ENV + k] ? clampf(code[ORL_C_ENV + k], -1e3f, 1e3f) : 0;
    for (int w = 0; w < ORL_ENV; w++) for (int c = 0; c < 3; c++) out->env[w][c] = orl_expf(clampf(log_radiance(m, z, w, c), -12, 12));
    finish(m, code, out);
}

void orl_light_from_env(const orl_light_model *m, const float env[ORL_ENV][3], const float code[ORL_CODE], orl_light *out)
{
    for (int w = 0; w < ORL_ENV; w++) for (int c = 0; c < 3; c++) out->env[w][c] = clampf(env[w][c], 0, 1e6f);
    finish(m, code, out);
}

void orl_light_jac_decode(const orl_light_model *m, const orl_light *l, orl_light_jac *out)
{
    out->model = m;
    footprint f = oct_footprint(UP);
    float live[ORL_ENV][3], d[ORL_ENV][3], up[3];
    for (int w = 0; w < ORL_ENV; w++)
        for (int c = 0; c < 3; c++) live[w][c] = absf(log_radiance(m, l->code + ORL_C_ENV, w, c)) < 12 ? l->env[w][c] : 0;
    for (int k = 0; k < ORL_ENV_DIM; k++) {
        for (int w = 0; w < ORL_ENV; w++) for (int c = 0; c < 3; c++) d[w][c] = live[w][c] * m->env_basis[k][w][c];
        irradiance((const float (*)[3])d, out->desky[k]);
        fetch((const float (*)[3])out->desky[k], &f, up);
        for (int c = 0; c < 3; c++) out->dground[k][c] = m->ground[c] * up[c];
    }
}

/* ---- pieces of a sample ---- */

/* sRGB transfer; above 1 its power law goes on. slope: d encoded / d linear, zero where the clamp holds. Three channels at once: orl_logf's and orl_expf's own
 * arithmetic (oriel/math.h) on the range where neither needs its clamps. */
static void encode(const float linear[3], float e[3], float slope[3])
{
    const float toe = 0.0031308f;
    v4 x = { clampf(linear[0], toe, ORL_LINEAR_MAX), clampf(linear[1], toe, ORL_LINEAR_MAX), clampf(linear[2], toe, ORL_LINEAR_MAX), 1 };
    i4 u = (i4)x, k = (u - 0x3f3504f3) >> 23;     /* a product stands for << : k may be negative */
    v4 f = (v4)(u - k * 0x800000) - 1.0f, s = f / (2.0f + f), z = s * s, h = 0.5f * f * f, fe = __builtin_convertvector(k, v4);
    v4 p = ((2.0f / 9 * z + 2.0f / 7) * z + 2.0f / 5) * z + 2.0f / 3;
    v4 t = (fe * 0.693359375f + (f - (h - (s * (h + z * p) - fe * 2.12194440e-4f)))) * (1 / 2.4f);
    v4 n = (t * 1.44269504f + 12582912.0f) - 12582912.0f, r = (t - n * 0.693359375f) + n * 2.12194440e-4f;
    p = ((((1.0f / 5040 * r + 1.0f / 720) * r + 1.0f / 120) * r + 1.0f / 24) * r + 1.0f / 6) * r + 0.5f;
    v4 y = 1.055f * (((p * r) * r + r) + 1.0f) * (v4)((__builtin_convertvector(n, i4) + 127) * 0x800000), d = y / (2.4f * x);
    for (int c = 0; c < 3; c++) {
        int low = !(linear[c] > toe), nothing = !(linear[c] >= 0);
        e[c] = nothing ? 0 : low ? 12.92f * linear[c] : y[c] - 0.055f;
        slope[c] = nothing || linear[c] >= ORL_LINEAR_MAX ? 0 : low ? 12.92f : d[c];
    }
}

float orl_light_encode(float linear)
{
    float in[3] = { linear, 0, 0 }, e[3], slope[3];
    encode(in, e, slope);
    return e[0];
}

float orl_light_decode_srgb(float e)
{
    if (!(e > 0)) return 0;
    if (e <= 0.04045f) return e * (1 / 12.92f);
    float c = orl_expf(2.4f * orl_logf((e + 0.055f) * (1 / 1.055f)));
    return c < ORL_LINEAR_MAX ? c : ORL_LINEAR_MAX;
}

static void turn(const orl_light *l, const float v[3], float rel[3])      /* scene frame -> sun-relative */
{
    rel[0] = l->cos_az * v[0] + l->sin_az * v[1];
    rel[1] = l->cos_az * v[1] - l->sin_az * v[0];
    rel[2] = v[2];
}

void orl_light_esky(const orl_light *l, const float n[3], float e[3])
{
    float rel[3];
    turn(l, n, rel);
    footprint f = oct_footprint(rel);
    fetch((const float (*)[3])l->esky, &f, e);
}

/* V and its derivatives by sun azimuth and elevation. */
static float visibility(const orl_light *l, const float *horizon, float *d_az, float *d_el)
{
    const float per = ORL_HORIZON / (2 * PI);
    float a = l->code[ORL_C_SUN_AZ] * per;
    int i = (int)a - (a < (float)(int)a);                               /* floor */
    float f = a - (float)i, h0 = horizon[i & (ORL_HORIZON - 1)], h1 = horizon[(i + 1) & (ORL_HORIZON - 1)];
    float t = clampf((l->code[ORL_C_SUN_EL] - (h0 + f * (h1 - h0))) * (1 / ORL_SUN_SOFT) + 0.5f, 0, 1);
    *d_el = 6 * t * (1 - t) * (1 / ORL_SUN_SOFT);
    *d_az = -*d_el * (h1 - h0) * per;
    return t * t * (3 - 2 * t);
}

float orl_light_sun_visibility(const orl_light *l, const float horizon[ORL_HORIZON])
{
    float a, b;
    return visibility(l, horizon, &a, &b);
}

/* The surface's part of a sample with all that its derivatives need. */
typedef struct {
    float rel[3], vis, vis_az, vis_el, s, below;    /* below: share of the lower hemisphere, (1 - n_z) / 2 */
    float cosine;                                   /* n . sun, >= 0 */
    float irr[3], e[3], slope[3];                   /* irradiance; encoded colour; d e / d linear */
    footprint f;
} surface;

static void shade_surface(const orl_light *l, const orl_sample *o, surface *r)
{
    turn(l, o->normal, r->rel);
    r->f = oct_footprint(r->rel);
    float sky[3], linear[3], x = ORL_SHADOW_BIAS;
    fetch((const float (*)[3])l->esky, &r->f, sky);
    for (int k = 0; k < ORL_SHADOW_DIM; k++) x += l->code[ORL_C_SHADOW + k] * o->phi[k];
    r->s = 1 / (1 + orl_expf(-x));
    r->vis = visibility(l, o->horizon, &r->vis_az, &r->vis_el);
    float d = o->normal[0] * l->sun_dir[0] + o->normal[1] * l->sun_dir[1] + o->normal[2] * l->sun_dir[2];
    r->cosine = d > 0 ? d : 0;
    r->below = 0.5f * (1 - o->normal[2]);
    for (int c = 0; c < 3; c++) {
        r->irr[c] = r->s * (r->vis * l->sun_rgb[c] * r->cosine + o->open * sky[c] + r->below * l->eground[c]);
        linear[c] = o->albedo[c] * (1 / PI) * r->irr[c];
    }
    encode(linear, r->e, r->slope);
}

static void sky_y(const float rel[3], float y[ORL_SKY_Y])
{
    float a = rel[0], b = rel[1], c = rel[2];
    y[0] = 1; y[1] = a; y[2] = b; y[3] = c; y[4] = a * b; y[5] = b * c; y[6] = c * a; y[7] = a * a - b * b; y[8] = 3 * c * c - 1;
}

static float dot_y(const float m[ORL_SKY_Y], const float y[ORL_SKY_Y])
{
    float s = 0;
    for (int k = 0; k < ORL_SKY_Y; k++) s += m[k] * y[k];
    return s;
}

/* Untoned colour p; sf and y are filled where cov lets them through. */
static void shade_parts(const orl_light *l, const orl_sample *o, surface *sf, float rel[3], float y[ORL_SKY_Y], float p[3])
{
    p[0] = p[1] = p[2] = 0;
    if (o->cov > 0) {
        shade_surface(l, o, sf);
        for (int c = 0; c < 3; c++) p[c] = o->cov * sf->e[c];
    }
    if (o->cov < 1) {
        turn(l, o->dir, rel);
        sky_y(rel, y);
        for (int c = 0; c < 3; c++) p[c] += (1 - o->cov) * dot_y(l->sky_m[c], y);
    }
}

static void tone(const orl_light *l, const float p[3], float rgb[3])
{
    for (int c = 0; c < 3; c++) rgb[c] = l->tone_a[c][0] * p[0] + l->tone_a[c][1] * p[1] + l->tone_a[c][2] * p[2] + l->tone_b[c];
}

void orl_light_shade(const orl_light *l, const orl_sample *s, float rgb[3])
{
    surface sf;
    float rel[3], y[ORL_SKY_Y], p[3];
    shade_parts(l, s, &sf, rel, y, p);
    tone(l, p, rgb);
}

/* ---- derivatives ---- */

/* d p / d code of the surface part: by irradiance, then scaled by cov and slope. */
static void surface_jac(const orl_light *l, const orl_light_jac *jl, const orl_sample *o, const surface *r, float P[3][ORL_CODE])
{
    const float *ground = jl->model->ground, *sun = l->sun_dir;
    float ce = sqrtf(sun[0] * sun[0] + sun[1] * sun[1]);
    float sign = l->cos_az * sun[0] + l->sin_az * sun[1] < 0 ? -1.0f : 1.0f;    /* elevation beyond the zenith */
    float cos_az = r->cosine > 0 ? o->normal[1] * sun[0] - o->normal[0] * sun[1] : 0;
    float cos_el = r->cosine > 0 ? sign * ce * o->normal[2] - sun[2] * (l->cos_az * o->normal[0] + l->sin_az * o->normal[1]) : 0;
    float up = clampf(sun[2], 0, 1), up_el = sun[2] > 0 ? sign * ce : 0;
    /* The table is linear in pieces: a central difference over about half a texel is smoother than its own slope. */
    const float h = 0.05f;
    float fwd[3] = { r->rel[0] + h * r->rel[1], r->rel[1] - h * r->rel[0], r->rel[2] }, back[3] = { r->rel[0] - h * r->rel[1], r->rel[1] + h * r->rel[0], r->rel[2] }, e1[3], e0[3];
    footprint f1 = oct_footprint(fwd), f0 = oct_footprint(back);
    fetch((const float (*)[3])l->esky, &f1, e1);
    fetch((const float (*)[3])l->esky, &f0, e0);
    float lobe = r->vis * r->cosine;
    float dz[ORL_ENV_DIM][3];
    for (int k = 0; k < ORL_ENV_DIM; k++) fetch((const float (*)[3])jl->desky[k], &r->f, dz[k]);
    for (int c = 0; c < 3; c++) {
        float g = o->cov * r->slope[c] * o->albedo[c] * (1 / PI) * r->s, E = l->sun_rgb[c];
        P[c][ORL_C_SUN_AZ] = g * (E * (r->vis_az * r->cosine + r->vis * cos_az) + o->open * (e1[c] - e0[c]) * (0.5f / h));
        P[c][ORL_C_SUN_EL] = g * (E * (r->vis_el * r->cosine + r->vis * cos_el) + r->below * ground[c] * E * up_el);
        float lit = l->code[ORL_C_SUN_RGB + c];
        if (lit > -12 && lit < 12) P[c][ORL_C_SUN_RGB + c] = g * E * (lobe + r->below * ground[c] * up);
        for (int k = 0; k < ORL_ENV_DIM; k++) P[c][ORL_C_ENV + k] = g * (o->open * dz[k][c] + r->below * jl->dground[k][c]);
        for (int k = 0; k < ORL_SHADOW_DIM; k++) P[c][ORL_C_SHADOW + k] = o->cov * r->slope[c] * o->albedo[c] * (1 / PI) * (1 - r->s) * r->irr[c] * o->phi[k];
    }
}

static void sky_jac(const orl_light *l, const orl_light_jac *jl, const orl_sample *o, const float rel[3], const float y[ORL_SKY_Y], float P[3][ORL_CODE])
{
    float a = rel[0], b = rel[1], z = rel[2], share = 1 - o->cov;
    const float y_az[ORL_SKY_Y] = { 0, b, -a, 0, b * b - a * a, -a * z, z * b, 4 * a * b, 0 };
    for (int c = 0; c < 3; c++) {
        P[c][ORL_C_SUN_AZ] += share * dot_y(l->sky_m[c], y_az);
        P[c][ORL_C_SUN_EL] += share * dot_y(jl->model->sky_gen[1][c], y);
        for (int k = 0; k < ORL_ENV_DIM + ORL_SKY_DIM; k++) P[c][ORL_C_ENV + k] += share * dot_y(jl->model->sky_gen[2 + k][c], y);
    }
}

void orl_light_shade_jac(const orl_light *l, const orl_light_jac *jl, const orl_sample *s, float rgb[3], float J[3][ORL_CODE])
{
    surface sf;
    float rel[3], y[ORL_SKY_Y], p[3], P[3][ORL_CODE] = { { 0 } };
    shade_parts(l, s, &sf, rel, y, p);
    tone(l, p, rgb);
    if (s->cov > 0) surface_jac(l, jl, s, &sf, P);
    if (s->cov < 1) sky_jac(l, jl, s, rel, y, P);
    for (int c = 0; c < 3; c++) {
        for (int k = 0; k < ORL_C_TONE; k++) J[c][k] = l->tone_a[c][0] * P[0][k] + l->tone_a[c][1] * P[1][k] + l->tone_a[c][2] * P[2][k];
        for (int k = 0; k < ORL_TONE_DIM; k++) J[c][ORL_C_TONE + k] = 0;
        for (int k = 0; k < 3; k++) J[c][ORL_C_TONE + 3 * c + k] = p[k];
        J[c][ORL_C_TONE + 9 + c] = 1;
    }
}

void orl_light_shade_back(const orl_light_model *m, const orl_light *l, const orl_sample *s, const float d_rgb[3],
                          float d_albedo[3], float d_phi[ORL_SHADOW_DIM], float d_ground[3], float d_sky_m[3][ORL_SKY_Y])
{
    (void)m;                                                            /* the ground's colour enters linearly */
    float d_p[3];
    for (int c = 0; c < 3; c++) d_p[c] = l->tone_a[0][c] * d_rgb[0] + l->tone_a[1][c] * d_rgb[1] + l->tone_a[2][c] * d_rgb[2];
    if (s->cov > 0 && (d_albedo || d_phi || d_ground)) {
        surface r;
        shade_surface(l, s, &r);
        float lobe = 0, up[3];
        up_irradiance(l, up);
        for (int c = 0; c < 3; c++) {
            float d_linear = s->cov * d_p[c] * r.slope[c] * (1 / PI), d_irr = d_linear * s->albedo[c];
            if (d_albedo) d_albedo[c] += d_linear * r.irr[c];
            if (d_ground) d_ground[c] += d_irr * r.s * r.below * up[c];
            lobe += d_irr * r.irr[c];
        }
        lobe *= 1 - r.s;
        if (d_phi) for (int k = 0; k < ORL_SHADOW_DIM; k++) d_phi[k] += lobe * l->code[ORL_C_SHADOW + k];
    }
    if (s->cov < 1 && d_sky_m) {
        float rel[3], y[ORL_SKY_Y];
        turn(l, s->dir, rel);
        sky_y(rel, y);
        for (int c = 0; c < 3; c++) for (int k = 0; k < ORL_SKY_Y; k++) d_sky_m[c][k] += (1 - s->cov) * d_p[c] * y[k];
    }
}
