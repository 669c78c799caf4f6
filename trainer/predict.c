/* What each column of the evaluation predicts of a view from the known part of a photo (predict.h). */
#include "trainer/predict.h"
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "oriel/cpu.h"

enum { PIXELS = 3000, TRACES = 2 };         /* TRACES: as the runtime's (runtime/widen.c) */

static void *aligned(size_t bytes) { return aligned_alloc(64, (bytes + 63) & ~(size_t)63); }

orl_err predict_cut(const orl_image *photo, int w, orl_image *out)
{
    orl_image im;
    orl_err e = orl_image_alloc(&im, w, photo->h, 3);
    if (e) return e;
    for (int y = 0; y < photo->h; y++) memcpy(im.px + (size_t)y * (size_t)w * 3, photo->px + (size_t)y * (size_t)photo->w * 3, (size_t)w * 3);
    *out = im;
    return ORL_OK;
}

/* Pixels that adaptation looks at: one in each cell of a square lattice, its place a hash of the cell. */
typedef struct { int x, y; } spot;
static int pick(int w, int h, spot *out, int cap)
{
    int cell = (int)ceil(sqrt((double)w * h / PIXELS)), n = 0;
    for (int y = 0; y < h; y += cell)
        for (int x = 0; x < w && n < cap; x += cell) {
            uint32_t k = (uint32_t)(y * 65537 + x) * 2654435761u;
            k = (k ^ (k >> 15)) * 2246822519u;
            spot p = { x + (int)((k >> 8) % (unsigned)cell), y + (int)((k >> 20) % (unsigned)cell) };
            if (p.x < w && p.y < h) out[n++] = p;
        }
    return n;
}

static void observe(const orl_image *known, spot p, orl_sample *s)
{
    const uint8_t *px = known->px + ((size_t)p.y * (size_t)known->w + (size_t)p.x) * 3;
    for (int c = 0; c < 3; c++) s->rgb[c] = (float)px[c] / 255;
    s->weight = 1;
}

/* init: NULL, a cold start; or the code to go on from. */
static orl_err adapt(const orl_light_model *m, const orl_sample *s, int n, const float *init, orl_adapt_result *out)
{
    size_t need = orl_adapt_need();
    void *work = aligned(need);
    orl_adapt_options opt = orl_adapt_defaults();
    orl_err e = work ? orl_adapt(m, s, (size_t)n, init, &opt, work, need, out) : orl_fail(ORL_E_MEMORY, "eval: no memory for adaptation");
    free(work);
    return e;
}

orl_err predict_view(const orl_scene *s, const orl_camera *cam, const orl_pose *pose, int supersample, int threads, orl_view *v, void **mem)
{
    size_t need = orl_view_need(cam->w, cam->h);
    *mem = aligned(need);
    if (!*mem) return orl_fail(ORL_E_MEMORY, "eval: no memory for a view of %d x %d", cam->w, cam->h);
    return orl_view_build(s, cam, pose, supersample, threads, *mem, need, v);
}

orl_err predict_light(const orl_scene *s, orl_view *v, const orl_image *known, int threads, orl_adapt_result *out)
{
    int cap = 2 * PIXELS;
    spot *at = malloc((size_t)cap * sizeof *at);
    orl_sample *sample = calloc((size_t)cap, sizeof *sample);
    orl_light *light = malloc(sizeof *light);
    orl_err e = ORL_OK;
    if (at && sample && light) {
        int n = pick(known->w, known->h, at, cap);
        memset(v->fix, 0, (size_t)v->stride * (size_t)v->h);
        for (int pass = 0; !e && pass <= TRACES; pass++) {
            for (int i = 0; i < n; i++) {
                orl_view_sample(v, at[i].x, at[i].y, &sample[i]);
                observe(known, at[i], &sample[i]);
            }
            e = adapt(&s->light, sample, n, pass ? out->code : NULL, out);
            if (e || pass == TRACES) break;
            orl_light_decode(&s->light, out->code, light);
            orl_view_trace_sun(v, light, 0, v->h, orl_cpu_detect(), threads);
        }
    } else {
        e = orl_fail(ORL_E_MEMORY, "eval: no memory for samples");
    }
    free(at); free(sample); free(light);
    return e;
}

orl_err predict_shade(orl_view *v, const orl_light *light, int threads, unsigned cpu, orl_image *out)
{
    size_t need = orl_view_light_need();
    void *mem = aligned(need);
    orl_image im = { 0 };
    orl_err e = mem ? orl_image_alloc(&im, v->w, v->h, 3) : orl_fail(ORL_E_MEMORY, "eval: no memory for a light");
    if (!e) {
        orl_view_light *l = orl_view_light_make(v, light, mem, need);
        if (l) {
            orl_view_trace_sun(v, light, 0, v->h, orl_cpu_detect(), threads);
            orl_view_shade(v, l, cpu, 0, v->h, im.px, (size_t)v->w * 3);
            *out = im;
        } else {
            orl_image_free(&im);
            e = orl_fail(ORL_E_MEMORY, "eval: light block too small");
        }
    }
    free(mem);
    return e;
}

static orl_err predict_fixed(const eval_setup *s, const orl_camera *cam, const orl_pose *pose, const orl_image *known,
                             orl_adapt_result *fit, orl_image *out)
{
    orl_view v;
    void *mem = NULL;
    orl_light *light = malloc(sizeof *light);
    orl_err e = light ? predict_view(s->scene, cam, pose, 2, s->threads, &v, &mem) : orl_fail(ORL_E_MEMORY, "eval: no memory for a light");
    if (!e) e = predict_light(s->scene, &v, known, s->threads, fit);
    if (!e) {
        orl_light_decode(&s->scene->light, fit->code, light);
        e = predict_shade(&v, light, s->threads, s->cpu, out);
    }
    free(mem); free(light);
    return e;
}

static orl_err predict_float(const eval_setup *s, const orl_camera *cam, const orl_pose *pose, const orl_image *known,
                             orl_adapt_result *fit, orl_image *out)
{
    size_t pixels = (size_t)cam->w * (size_t)cam->h;
    int cap = 2 * PIXELS;
    const orl_light_model *model = orl_model_light(s->model);
    orl_sample *g = calloc(pixels, sizeof *g), *sample = calloc((size_t)cap, sizeof *sample);
    spot *at = malloc((size_t)cap * sizeof *at);
    int *pixel = malloc((size_t)cap * sizeof *pixel);
    orl_light *light = malloc(sizeof *light);
    orl_imagef im = { 0 };
    orl_err e = g && sample && at && pixel && light ? orl_imagef_alloc(&im, cam->w, cam->h, 3)
                                           : orl_fail(ORL_E_MEMORY, "eval: no memory for %zu samples", pixels);
    if (e) goto done;
    int n = pick(known->w, known->h, at, cap);
    for (int i = 0; i < n; i++) pixel[i] = at[i].y * cam->w + at[i].x;
    for (int pass = 0; pass <= TRACES; pass++) {
        orl_model_samples(s->model, cam, pose, pass ? light : NULL, pixel, n, s->threads, sample);
        for (int i = 0; i < n; i++) observe(known, at[i], &sample[i]);
        if ((e = adapt(model, sample, n, pass ? fit->code : NULL, fit))) goto done;
        orl_light_decode(model, fit->code, light);
    }
    orl_model_gbuffer(s->model, cam, pose, light, s->threads, g, NULL);
    for (size_t i = 0; i < pixels; i++) orl_light_shade(light, &g[i], im.px + 3 * i);
    e = orl_image_from_float(&im, out);
done:
    free(g); free(sample); free(at); free(pixel); free(light);
    orl_imagef_free(&im);
    return e;
}

orl_err eval_predict(const eval_setup *s, const orl_camera *cam, const orl_pose *pose, const orl_image *photo, int known_w, eval_prediction *out)
{
    if (photo->c != 3 || photo->w != cam->w || photo->h != cam->h || known_w < 1 || known_w > cam->w)
        return orl_fail(ORL_E_RANGE, "eval: photo of %d x %d, camera of %d x %d, %d columns known", photo->w, photo->h, cam->w, cam->h, known_w);
    eval_prediction p;
    orl_image known;
    memset(&p, 0, sizeof p);
    orl_err e = predict_cut(photo, known_w, &known);
    if (e) return e;
    if (s->scene) e = predict_fixed(s, cam, pose, &known, &p.adapt[EVAL_FIXED], &p.rgb[EVAL_FIXED]);
    if (!e && s->model) e = predict_float(s, cam, pose, &known, &p.adapt[EVAL_FLOAT], &p.rgb[EVAL_FLOAT]);
    if (!e && s->nerfw) e = nerfw_predict(s->nerfw, cam, pose, &known, s->threads, p.nerfw_code, &p.rgb[EVAL_NERFW]);
    if (!e) e = baselines_row_mean(&known, cam->w, &p.rgb[EVAL_ROW_MEAN]);
    if (!e && s->base) e = baselines_warp(s->base, cam, pose, &known, &p.rgb[EVAL_NEAREST], &p.rgb[EVAL_MEDIAN]);
    orl_image_free(&known);
    if (e) eval_prediction_free(&p);
    else *out = p;
    return e;
}

void eval_prediction_free(eval_prediction *p)
{
    for (int k = 0; k < EVAL_COLUMNS; k++) orl_image_free(&p->rgb[k]);
}
