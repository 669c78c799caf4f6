/* A photo in the report (report.h): beside its render the factors that make it, and its light in words. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "oriel/cpu.h"
#include "trainer/report.h"

static const double DEGREES = 57.29577951;

/* Linear colour as a chip in the page; its brightest channel is 1. */
static void add_chip(orl_text *t, const double linear[3], double scale)
{
    orl_text_add(t, "<span class=\"chip\" style=\"background:rgb(");
    for (int c = 0; c < 3; c++) orl_text_add(t, "%s%.0f", c ? "," : "", 255 * fmin(orl_light_encode((float)fmin(fmax(linear[c] / scale, 0), 1)), 1));
    orl_text_add(t, ")\"></span>");
}

static double most(const double v[3]) { return fmax(fmax(fmax(v[0], v[1]), v[2]), 1e-9); }
static double mean(const double v[3]) { return (v[0] + v[1] + v[2]) / 3; }
static const char *hue(const double v[3]) { return v[0] > 1.2 * v[2] ? "warm" : v[2] > 1.2 * v[0] ? "cool" : "neutral"; }

static void add_colour(orl_text *t, const double v[3])
{
    double top = most(v);
    add_chip(t, v, top);
    orl_text_add(t, "%s (red, green, blue as %.2f : %.2f : %.2f)", hue(v), v[0] / top, v[1] / top, v[2] / top);
}

/* Where an azimuth lies for who looks along another. */
static const char *side_of(double azimuth, double heading)
{
    static const char *const SIDE[8] = { "ahead", "ahead to the left", "to the left", "behind to the left", "behind", "behind to the right", "to the right", "ahead to the right" };
    double turn = (azimuth - heading) / 6.283185307;
    return SIDE[(int)floor((turn - floor(turn)) * 8 + 0.5) % 8];
}

/* Sun and sky in words. */
static void add_light(orl_text *t, const orl_light *l, double heading)
{
    static const float UP[3] = { 0, 0, 1 };
    float e[3];
    orl_light_esky(l, UP, e);
    double sky[3] = { e[0], e[1], e[2] }, sun[3] = { l->sun_rgb[0], l->sun_rgb[1], l->sun_rgb[2] }, high = asin(fmin(fmax(l->sun_dir[2], -1), 1)), azimuth = atan2(l->sin_az, l->cos_az);
    double ratio = mean(sun) / fmax(mean(sky), 1e-9);
    orl_text_add(t, "<dt>Sun</dt><dd>%s, azimuth %.0f&deg;, elevation %.0f&deg;; ", side_of(azimuth, heading), azimuth * DEGREES, high * DEGREES);
    add_colour(t, sun);
    orl_text_add(t, "; %s: what faces it gets %.*f times the light that open level ground gets from the sky</dd>\n", ratio < 0.1 ? "next to no sun" : ratio < 1 ? "a weak sun" : "a strong sun", ratio < 10 ? 2 : 0, fmin(ratio, 9999));
    orl_text_add(t, "<dt>Sky</dt><dd>");
    add_colour(t, sky);
    orl_text_add(t, ", as level ground sees it</dd>\n");
}

/* A - I and b, display-referred. */
typedef struct { double a[3][3], b[3]; } tone;

static tone tone_of(const float code[ORL_CODE])
{
    tone t;
    for (int i = 0; i < 9; i++) t.a[i / 3][i % 3] = code[ORL_C_TONE + i] + (i % 4 == 0);
    for (int i = 0; i < 3; i++) t.b[i] = code[ORL_C_TONE + 9 + i];
    return t;
}

static void apply(const tone *t, const double in[3], double out[3])
{
    for (int i = 0; i < 3; i++) out[i] = t->a[i][0] * in[0] + t->a[i][1] * in[1] + t->a[i][2] * in[2] + t->b[i];
}

/* A change in words, if it is large enough to see. */
static void say(orl_text *t, int *said, double v, double least, const char *more, const char *less, const char *unit, double times)
{
    if (fabs(v) < least) return;
    orl_text_add(t, "%s%s %.0f%s", *said ? ", " : "", v > 0 ? more : less, fabs(v) * times, unit);
    ++*said;
}

static void describe(orl_text *t, const tone *g)
{
    static const double BLACK[3] = { 0, 0, 0 }, GREY[3] = { 0.5, 0.5, 0.5 };
    double black[3], grey[3], own = 0, other = 0;
    int said = 0;
    apply(g, BLACK, black);
    apply(g, GREY, grey);
    for (int i = 0; i < 9; i++) *(i % 4 ? &other : &own) += g->a[i / 3][i % 3];
    say(t, &said, mean(grey) - 0.5, 0.01, "mid-grey brighter by", "mid-grey darker by", " levels of 255", 255);
    say(t, &said, 2 * (mean(grey) - mean(black)) - 1, 0.02, "contrast higher by", "contrast lower by", " %", 100);
    say(t, &said, (own / 3 - other / 6) / fmax(2 * (mean(grey) - mean(black)), 0.05) - 1, 0.02, "colours stronger by", "colours weaker by", " %", 100);
    say(t, &said, grey[0] - grey[2], 0.01, "warmer by", "cooler by", " levels (red less blue)", 255);
    say(t, &said, grey[1] - (grey[0] + grey[2]) / 2, 0.01, "greener by", "more magenta by", " levels", 255);
    if (!said) orl_text_add(t, "next to no change");
}

static double rounded(double v) { return fabs(v) < 0.005 ? 0 : v; }      /* no "-0.00" */

/* The tone matrix in words, on chips before and after, and in figures. */
static void add_tone(orl_text *t, const float code[ORL_CODE])
{
    static const double CHIP[8][3] = { { 0, 0, 0 }, { .25, .25, .25 }, { .5, .5, .5 }, { .75, .75, .75 }, { 1, 1, 1 }, { .75, .35, .3 }, { .4, .6, .3 }, { .35, .5, .8 } };
    tone g = tone_of(code);
    orl_text_add(t, "<dt>Tone</dt><dd>");
    describe(t, &g);
    orl_text_add(t, "\n<span class=\"tone\" role=\"img\" aria-label=\"colours before and after tone\">");
    for (int after = 0; after < 2; after++) {
        orl_text_add(t, "<span>");
        for (int i = 0; i < 8; i++) {
            double v[3];
            if (after) apply(&g, CHIP[i], v);
            else memcpy(v, CHIP[i], sizeof v);
            orl_text_add(t, "<i style=\"background:rgb(%.0f,%.0f,%.0f)\"></i>", 255 * fmin(fmax(v[0], 0), 1), 255 * fmin(fmax(v[1], 0), 1), 255 * fmin(fmax(v[2], 0), 1));
        }
        orl_text_add(t, "</span>");
    }
    orl_text_add(t, "</span>\n<code>");
    for (int i = 0; i < 3; i++) orl_text_add(t, "%c&prime; = %.2f r %+.2f g %+.2f b %+.3f%s", "rgb"[i], rounded(g.a[i][0]), rounded(g.a[i][1]), rounded(g.a[i][2]), g.b[i], i < 2 ? "\n" : "");
    orl_text_add(t, "</code></dd>\n");
}

static void add_title(page *p, const orl_photo *photo, const eval_row *row, int half)
{
    const orl_score *right = &row->right[EVAL_FIXED], *whole = &row->full[EVAL_FIXED];
    int id = (int)(photo - p->d->photos);
    orl_text_add(&p->body, "<article>\n<h3 id=\"photo%d\"><a href=\"#photo%d\">", id, id);
    orl_text_escape(&p->body, photo->name);
    orl_text_add(&p->body, "</a> <small>");
    if (half) orl_text_add(&p->body, "right half: %.2f dB, SSIM %.3f, FLIP %.3f; ", right->psnr, right->ssim, right->flip);
    orl_text_add(&p->body, "whole: %.2f dB, SSIM %.3f, FLIP %.3f</small></h3>\n", whole->psnr, whole->ssim, whole->flip);
}

static orl_err add_factors(page *p, const orl_view *v, const orl_light *l, const char *of)
{
    static const struct { report_layer what; const char *caption; } SHOW[] = { { LAYER_BASE, "base colour" }, { LAYER_NORMALS, "normals" }, { LAYER_SHADING, "shading" }, { LAYER_SUN, "sun's visibility" },
                                                                               { LAYER_SHADOW, "learned shadow" }, { LAYER_DEPTH, "depth" } };
    double heading = atan2(v->grid_from_cam[5], v->grid_from_cam[2]);
    orl_err e = ORL_OK;
    orl_text_add(&p->body, "<div class=\"grid six\">\n");
    for (size_t k = 0; !e && k < sizeof SHOW / sizeof *SHOW; k++) e = report_add_layer(p, v, SHOW[k].what, l, REPORT_SMALL, of, SHOW[k].caption);
    orl_text_add(&p->body, "</div>\n<div class=\"light\">\n");
    if (!e) e = report_add_sky(p, l, heading, of);
    orl_text_add(&p->body, "<dl>\n");
    add_light(&p->body, l, heading);
    add_tone(&p->body, l->code);
    orl_text_add(&p->body, "</dl>\n</div>\n");
    return e;
}

static orl_err add_article(page *p, const orl_photo *photo, const orl_image *im, const orl_image *render, const orl_view *v, const orl_light *l, const eval_row *row, int half)
{
    add_title(p, photo, row, half);
    orl_text_add(&p->body, "<div class=\"grid three\">\n");
    orl_err e = report_picture(p, im, REPORT_LARGE, photo->name, "photo");
    if (!e) e = report_picture(p, render, REPORT_LARGE, photo->name, half ? "render, light from the left half" : "render, light from the whole photo");
    if (!e) e = report_add_difference(p, im, render, photo->name);
    orl_text_add(&p->body, "</div>\n");
    if (!e) e = add_factors(p, v, l, photo->name);
    orl_text_add(&p->body, "</article>\n");
    return e;
}

orl_err report_add_photo(page *p, const orl_photo *photo, const eval_setup *setup, int half, eval_row *row, int *shown)
{
    orl_image im = { 0 };
    orl_camera cam;
    orl_view v;
    void *mem = NULL;
    eval_prediction pred;
    *shown = 0;
    if (orl_photo_load(photo, REPORT_SCORED, &im, &cam)) {
        fprintf(stderr, "%s: left out: %s\n", photo->name, orl_error_text());
        return ORL_OK;
    }
    memset(&pred, 0, sizeof pred);
    orl_light *light = malloc(sizeof *light);
    orl_err e = light ? eval_predict(setup, &cam, &photo->pose, &im, half ? im.w / 2 : im.w, &pred) : orl_fail(ORL_E_MEMORY, "report: no memory for a light");
    if (!e) e = eval_score(&im, &pred, row);
    if (!e) e = predict_view(p->s, &cam, &photo->pose, 2, p->o->threads, &v, &mem);
    if (!e) {
        row->name = photo->name;
        orl_light_decode(&p->s->light, pred.adapt[EVAL_FIXED].code, light);
        orl_view_trace_sun(&v, light, 0, v.h, orl_cpu_detect(), p->o->threads);
        e = add_article(p, photo, &im, &pred.rgb[EVAL_FIXED], &v, light, row, half);
        *shown = !e;
    }
    eval_prediction_free(&pred);
    free(mem);
    free(light);
    orl_image_free(&im);
    return e;
}
