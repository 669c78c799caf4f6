/* adam SCENE FILE.oriel: adaptation against 2,000 steps of Adam from the best of 8 suns, same objective and same samples: every test photo's left half, scored on the right one; and of SCENE/kiosk, where there is one,
 * the frames that have a wide truth, scored outside of the frame. A line each: PSNR and cost of ours and of Adam's; then the means. Minutes. */
#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>
#include "oriel/cpu.h"
#include "oriel/dataset.h"
#include "oriel/image.h"
#include "oriel/widen.h"
#include "tests/adam.h"
#include "trainer/predict.h"

enum { SAMPLES = 1500 };
typedef struct { double ours, adam, ours_cost, adam_cost; int n; } sums;

/* PSNR of a render of v under a code where score is set. */
static double psnr(const orl_scene *s, orl_view *v, const float *code, const orl_image *truth, const uint8_t *score)
{
    static orl_light light;
    orl_image im = { 0 };
    double err = 0, n = 0;
    orl_light_decode(&s->light, code, &light);
    if (predict_shade(v, &light, 0, orl_cpu_detect(), &im)) return NAN;
    for (size_t i = 0; i < (size_t)v->w * (size_t)v->h * 3; i++) {
        if (!score[i / 3]) continue;
        err += (im.px[i] - truth->px[i]) * (im.px[i] - truth->px[i]) / 65025.0;
        n++;
    }
    orl_image_free(&im);
    return -10 * log10(err / n);
}

/* Both lights of the same samples on the view that is scored. ours: orl_adapt's code. */
static void compare(const char *name, const orl_scene *s, const orl_sample *q, size_t n, const float *ours, orl_view *wide, const orl_image *truth, const uint8_t *score, sums *sum)
{
    const orl_adapt_options o = orl_adapt_defaults();
    float code[ORL_CODE];
    double g[ORL_CODE], at = adam_cost(&s->light, q, n, ours, &o, g), least = adam(&s->light, q, n, &o, code);
    double a = psnr(s, wide, ours, truth, score), b = psnr(s, wide, code, truth, score);
    printf("%-24.24s ours %6.2f dB, cost %.4f; Adam %6.2f dB, cost %.4f\n", name, a, at, b, least);
    fflush(stdout);
    sum->ours += a;
    sum->adam += b;
    sum->ours_cost += at;
    sum->adam_cost += least;
    sum->n++;
}

/* The left half of a photo: by horizons alone, as a cold start sees it. */
static orl_err half(const char *name, const orl_scene *s, orl_view *v, const orl_image *photo, sums *sum)
{
    size_t most = (size_t)v->w * (size_t)v->h, n = 0;
    orl_sample *q = calloc(SAMPLES + 1, sizeof *q);
    uint8_t *right = malloc(most);
    void *work = aligned_alloc(64, (orl_adapt_need() + 63) & ~(size_t)63);
    orl_adapt_result fit;
    orl_err e = q && right && work ? ORL_OK : orl_fail(ORL_E_MEMORY, "no memory for samples");
    for (size_t i = 0; !e && i < most; i++) right[i] = (int)(i % (size_t)v->w) >= v->w / 2;
    for (size_t k = 0; !e && k < SAMPLES; k++) {
        size_t x = k * 40503u % (size_t)(v->w / 2), y = k * (size_t)v->h / SAMPLES;
        orl_view_sample(v, (int)x, (int)y, &q[n]);
        q[n].weight = 1;
        for (size_t c = 0; c < 3; c++) q[n].rgb[c] = photo->px[3 * (y * (size_t)v->w + x) + c] / 255.0f;
        n++;
    }
    if (!e) e = orl_adapt(&s->light, q, n, NULL, NULL, work, orl_adapt_need(), &fit);
    if (!e) compare(name, s, q, n, fit.code, v, photo, right, sum);
    free(q); free(right); free(work);
    return e;
}

static void means(const char *what, const sums *s)
{
    if (s->n) printf("%s, mean of %d: ours %.3f dB, cost %.4f; Adam %.3f dB, cost %.4f\n", what, s->n, s->ours / s->n, s->ours_cost / s->n, s->adam / s->n, s->adam_cost / s->n);
}

static orl_err photos(const orl_dataset *d, const orl_scene *s)
{
    sums sum = { 0 };
    orl_err e = ORL_OK;
    for (uint32_t i = 0; !e && i < d->nphotos; i++) {
        orl_image im = { 0 };
        orl_camera cam;
        orl_view v;
        void *mem = NULL;
        if (!d->photos[i].test) continue;
        e = orl_photo_load(&d->photos[i], 512, &im, &cam);
        if (!e) e = predict_view(s, &cam, &d->photos[i].pose, 2, 0, &v, &mem);
        if (!e) e = half(d->photos[i].name, s, &v, &im, &sum);
        free(mem);
        orl_image_free(&im);
    }
    means("right halves", &sum);
    return e;
}

/* The clip through the loop that `oriel run` runs; Adam is given the loop's own samples. */
static orl_err kiosk(const orl_dataset *d, const orl_scene *s)
{
    char path[2048];
    orl_view_pose pose[2];
    orl_widen w;
    int lines;
    sums sum = { 0 };
    snprintf(path, sizeof path, "%s/kiosk/camera.txt", d->dir);
    if (access(path, R_OK)) return ORL_OK;
    orl_err e = orl_posefile_read(path, pose, 2, &lines);
    if (!e && lines < 2) e = orl_fail(ORL_E_FORMAT, "%s: no second line", path);
    if (e) return e;
    orl_widen_config c = { .scene = s, .photo = pose[0].cam, .wide = pose[1].cam, .photo_pose = pose[0].pose, .wide_pose = pose[1].pose, .cpu = orl_cpu_detect() };
    void *block = orl_widen_block(orl_widen_need(&c));
    size_t n = (size_t)c.wide.w * (size_t)c.wide.h;
    uint8_t *outside = malloc(n);
    e = block && outside ? orl_widen_init(&c, block, orl_widen_need(&c), &w) : orl_fail(ORL_E_MEMORY, "no memory for a clip");
    for (size_t i = 0; !e && i < n; i++) {
        double ray[3], uv[2];
        orl_camera_unproject(&c.wide, (double)(i % (size_t)c.wide.w) + 0.5, (double)(i / (size_t)c.wide.w) + 0.5, ray);
        outside[i] = !(orl_camera_project(&c.photo, ray, uv) && uv[0] >= 0 && uv[1] >= 0 && uv[0] < c.photo.w && uv[1] < c.photo.h);
    }
    for (int f = 0; !e && f < 10000; f++) {
        orl_image truth = { 0 }, frame = { 0 };
        snprintf(path, sizeof path, "%s/kiosk/frames/%04d.jpg", d->dir, f);
        if (access(path, R_OK)) break;
        e = orl_image_read(path, 3, &frame);
        if (!e && (frame.w != c.photo.w || frame.h != c.photo.h)) e = orl_fail(ORL_E_FORMAT, "%s: not of the camera's size", path);
        if (!e) e = orl_widen_adapt(&w, frame.px);
        snprintf(path, sizeof path, "%s/kiosk/gt_wide/%04d.jpg", d->dir, f);
        if (!e && !access(path, R_OK)) {
            e = orl_image_read(path, 3, &truth);
            if (!e && (truth.w != c.wide.w || truth.h != c.wide.h)) e = orl_fail(ORL_E_FORMAT, "%s: not of the wide camera's size", path);
            if (!e) compare(path + strlen(path) - 8, s, w.samples, (size_t)w.nsamples, w.fit.code, &w.wide, &truth, outside, &sum);
        }
        orl_image_free(&truth);
        orl_image_free(&frame);
    }
    means("outside the frame", &sum);
    free(outside);
    free(block);
    return e;
}

int main(int argc, char **argv)
{
    orl_dataset d = { 0 };
    orl_scene s = { 0 };
    if (argc != 3) {
        fprintf(stderr, "Usage: adam SCENE FILE.oriel\n");
        return 2;
    }
    orl_err e = orl_dataset_open(argv[1], NULL, NULL, &d);
    if (!e) e = orl_scene_open(argv[2], &s);
    if (!e) e = photos(&d, &s);
    if (!e) e = kiosk(&d, &s);
    if (e) fprintf(stderr, "adam: %s\n", orl_error_text());
    orl_scene_close(&s);
    orl_dataset_free(&d);
    return e ? 1 : 0;
}
