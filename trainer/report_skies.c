/* A view under a user's skies, in the report (report.h): what `oriel relight` makes of it, with the sun where it lights what the photo looks at. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "oriel/relight.h"
#include "trainer/report.h"

static const float PI = 3.14159265f;
#define BESIDE 2.2f             /* radians from where the camera looks to the sun: behind its left shoulder */

static const char *base_name(const char *path) { const char *slash = strrchr(path, '/'); return slash ? slash + 1 : path; }

static orl_err add_sky(page *p, orl_view *v, float heading, const char *path, float *linear, float *scratch, orl_image *out)
{
    orl_tone neutral;
    orl_panorama *sky = calloc(1, sizeof *sky);
    orl_relight *r = calloc(1, sizeof *r);
    orl_err e = sky && r ? orl_panorama_open(path, sky) : orl_fail(ORL_E_MEMORY, "report: no memory for a sky");
    if (!e) e = orl_tone_find("neutral", &neutral);
    if (!e) {
        char caption[300];
        sky->turn = heading + BESIDE - (sky->has_sun ? sky->az : 0);
        orl_sun sun = orl_panorama_sun(sky);
        orl_relight_init(v, &p->s->light, sky, &sun, r);
        orl_relight_trace(r, p->o->threads);
        orl_relight_linear(r, p->o->threads, linear);
        float bright = orl_relight_bright(r, linear, scratch);
        orl_relight_display(r, p->o->threads, linear, bright > 0 ? 0.8f / bright : 1, &neutral, out->px);
        if (sky->has_sun) snprintf(caption, sizeof caption, "%.200s, sun %.0f degrees high", base_name(path), (double)(sun.el * 180 / PI));
        else snprintf(caption, sizeof caption, "%.200s, no sun", base_name(path));
        e = report_picture(p, out, REPORT_LARGE, "under", caption);
    }
    if (sky) orl_panorama_close(sky);
    free(sky);
    free(r);
    return e;
}

orl_err report_add_skies(page *p)
{
    const orl_photo *photo = NULL;
    for (uint32_t i = 0; i < p->d->nphotos; i++) if (!photo || (p->d->photos[i].test && !photo->test)) photo = &p->d->photos[i];
    if (!p->o->nskies || !photo) return ORL_OK;
    orl_image im = { 0 }, out = { 0 };
    orl_camera cam;
    orl_view v;
    void *mem = NULL;
    float *linear = NULL, *scratch = NULL;
    orl_err e = orl_photo_load(photo, REPORT_SCORED, &im, &cam);
    if (!e) e = predict_view(p->s, &cam, &photo->pose, 2, p->o->threads, &v, &mem);
    if (!e) e = orl_image_alloc(&out, cam.w, cam.h, 3);
    if (!e) {
        linear = malloc((size_t)cam.w * (size_t)cam.h * 3 * sizeof *linear);
        scratch = malloc((size_t)cam.w * (size_t)cam.h * sizeof *scratch);
        if (!linear || !scratch) e = orl_fail(ORL_E_MEMORY, "report: no memory for a view");
    }
    if (!e) {
        report_section(p, "skies", "Under other skies");
        orl_text_add(&p->body, "<p>The view of ");
        orl_text_escape(&p->body, photo->name);
        orl_text_add(&p->body, " by <code>oriel relight</code>, each sun behind the camera's left shoulder, exposed for the building.</p>\n<div class=\"grid three\">\n");
        e = report_picture(p, &im, REPORT_LARGE, photo->name, "the photo");
        float heading = atan2f((float)v.grid_from_cam[5], (float)v.grid_from_cam[2]);
        for (int k = 0; !e && k < p->o->nskies; k++) e = add_sky(p, &v, heading, p->o->sky[k], linear, scratch, &out);
        orl_text_add(&p->body, "</div>\n");
    }
    free(linear);
    free(scratch);
    free(mem);
    orl_image_free(&im);
    orl_image_free(&out);
    return e;
}
