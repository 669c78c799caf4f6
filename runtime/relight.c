/* Re-lighting by a panorama (oriel/relight.h): orl_relight_set -> per pixel layers -> linear picture -> display. */
#include "oriel/relight.h"
#include <math.h>
#include <string.h>
#include "oriel/cpu.h"
#include "oriel/math.h"
#include "oriel/parallel.h"

#define PI 3.14159265f
enum { GRAIN = 8 };

void orl_relight_set(orl_relight *r, const orl_sun *sun)
{
    float env[ORL_ENV][3], code[ORL_CODE];
    r->sun = *sun;
    orl_panorama_env(r->sky, sun, env);
    for (int i = 0; i < ORL_ENV; i++) for (int k = 0; k < 3; k++) env[i][k] *= r->level;
    memcpy(code, r->model->prior_mean, sizeof code);
    memset(code + ORL_C_TONE, 0, ORL_TONE_DIM * sizeof *code);
    code[ORL_C_SUN_AZ] = sun->az;
    code[ORL_C_SUN_EL] = sun->el;
    for (int k = 0; k < 3; k++) code[ORL_C_SUN_RGB + k] = orl_logf(sun->rgb[k] * r->level);
    orl_light_from_env(r->model, (const float (*)[3])env, code, &r->light);
}

void orl_relight_init(orl_view *view, const orl_light_model *model, const orl_panorama *sky, const orl_sun *sun, orl_relight *out)
{
    float up[3];
    out->view = view;
    out->model = model;
    out->sky = sky;
    out->level = 1;
    orl_relight_set(out, sun);
    orl_light_esky(&out->light, (const float[]) { 0, 0, 1 }, up);
    for (int k = 0; k < 3; k++) up[k] += sun->rgb[k] * orl_sinf(sun->el);
    out->level = orl_luminance(up) > 0 ? PI / orl_luminance(up) : 1;
    orl_relight_set(out, sun);
}

void orl_relight_trace(orl_relight *r, int threads) { orl_view_trace_sun(r->view, &r->light, 0, r->view->h, orl_cpu_detect(), threads); }

void orl_relight_pixel(const orl_relight *r, int x, int y, orl_layers *out)
{
    orl_sample p;
    float far[3] = { 0 };
    memset(&p, 0, sizeof p);
    memset(out, 0, sizeof *out);
    orl_view_sample(r->view, x, y, &p);
    out->cov = p.cov;
    if (p.cov < 1) orl_panorama_look(r->sky, &r->sun, p.dir, far);
    if (p.cov > 0) {
        memcpy(out->albedo, p.albedo, sizeof p.albedo);
        memcpy(out->normal, p.normal, sizeof p.normal);
        out->shadow = orl_light_shadow(&r->light, &p) * orl_light_sun_visibility(&r->light, &p);
        orl_light_irradiance(&r->light, &p, out->irradiance);
        for (int c = 0; c < 3; c++) out->irradiance[c] /= r->level;
    }
    for (int c = 0; c < 3; c++) {
        out->sky[c] = (1 - out->cov) * far[c];
        out->rgb[c] = out->cov * out->albedo[c] * out->irradiance[c] * (1 / PI) + out->sky[c];
    }
}

typedef struct { const orl_relight *r; float *linear; const float *from; float gain; const orl_tone *tone; uint8_t *rgb; } job;

static void linear_rows(void *user, int begin, int end)
{
    job *j = user;
    orl_layers l;
    for (int y = begin; y < end; y++)
        for (int x = 0; x < j->r->view->w; x++) {
            orl_relight_pixel(j->r, x, y, &l);
            memcpy(j->linear + ((size_t)y * (size_t)j->r->view->w + (size_t)x) * 3, l.rgb, sizeof l.rgb);
        }
}

void orl_relight_linear(const orl_relight *r, int threads, float *linear)
{
    job j = { .r = r, .linear = linear };
    orl_parallel(threads, r->view->h, GRAIN, linear_rows, &j);
}

static void display_rows(void *user, int begin, int end)
{
    job *j = user;
    const orl_tone *t = j->tone;
    size_t w = (size_t)j->r->view->w;
    for (size_t i = (size_t)begin * w; i < (size_t)end * w; i++) {
        float e[3];
        for (int c = 0; c < 3; c++) e[c] = orl_light_encode(j->from[3 * i + (size_t)c] * j->gain);
        for (int c = 0; c < 3; c++) {
            float d = t->a[c][0] * e[0] + t->a[c][1] * e[1] + t->a[c][2] * e[2] + t->b[c];
            j->rgb[3 * i + (size_t)c] = (uint8_t)((d > 0 ? d < 1 ? d : 1 : 0) * 255 + 0.5f);
        }
    }
}

void orl_relight_display(const orl_relight *r, int threads, const float *linear, float gain, const orl_tone *tone, uint8_t *rgb)
{
    job j = { .r = r, .from = linear, .gain = gain, .tone = tone, .rgb = rgb };
    orl_parallel(threads, r->view->h, GRAIN, display_rows, &j);
}

float orl_relight_bright(const orl_relight *r, const float *linear, float *scratch)
{
    const orl_view *v = r->view;
    size_t n = 0;
    for (int y = 0; y < v->h; y++)
        for (int x = 0; x < v->w; x++)
            if (v->cov[(size_t)y * (size_t)v->stride + (size_t)x] == 255) scratch[n++] = orl_luminance(linear + ((size_t)y * (size_t)v->w + (size_t)x) * 3);
    return orl_percentile(scratch, n, 95);
}
