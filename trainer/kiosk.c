/* Figures of a recorded clip (truth.h): every frame of SCENE/kiosk/frames goes through adaptation and rendering as in `oriel run`, each light found from the last one's. SCENE/kiosk/camera.txt holds the two
 * cameras, gt_wide/ what the wide one saw of some frames, frames.json the true sun and where the exposure jumps. */
#include "trainer/truth.h"
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#include "oriel/cpu.h"
#include "oriel/image.h"
#include "oriel/metrics.h"
#include "oriel/widen.h"
#include "trainer/order.h"

enum { FRAMES = 10000, PERSON = 32 };       /* PERSON: levels in any channel by which a person differs from what stands behind; shadows at the wrong place do, too, and are left out with them */

/* One frame in the wide raster, and the render of it. */
typedef struct { float *seen; uint8_t *render, *person; } picture;

typedef struct {
    orl_widen w;
    int *box;                               /* [pixel][4] of the frame that a wide pixel covers: x0, y0, x1, y1; x0 = x1 outside */
    uint8_t *outside, *wide;
    picture now, last;
    double psnr, ssim, ratio, level[2][2];  /* sums; mean of the unmasked pixels: [last, now][seen, render] */
    double suns[FRAMES], jump;
    int truths, nsuns, pairs, followed;     /* followed: frames since the jump, -1 not yet */
} clip;

static size_t pixels(const clip *k) { return (size_t)k->w.wide.w * (size_t)k->w.wide.h; }
static int clampi(int v, int lo, int hi) { return v < lo ? lo : v > hi ? hi : v; }

static void place(clip *k)
{
    const orl_camera *wide = &k->w.config.wide, *photo = &k->w.config.photo;
    double half_x = 0.5 * photo->fx / wide->fx, half_y = 0.5 * photo->fy / wide->fy;
    for (size_t i = 0; i < pixels(k); i++) {
        double ray[3], uv[2];
        int *b = k->box + 4 * i;
        orl_camera_unproject(wide, (double)(i % (size_t)wide->w) + 0.5, (double)(i / (size_t)wide->w) + 0.5, ray);
        k->outside[i] = !(orl_camera_project(photo, ray, uv) && uv[0] >= 0 && uv[1] >= 0 && uv[0] < photo->w && uv[1] < photo->h);
        if (k->outside[i]) { memset(b, 0, 4 * sizeof *b); continue; }
        b[0] = clampi((int)floor(uv[0] - half_x + 0.5), 0, photo->w - 1);
        b[1] = clampi((int)floor(uv[1] - half_y + 0.5), 0, photo->h - 1);
        b[2] = clampi((int)floor(uv[0] + half_x + 0.5), b[0] + 1, photo->w);
        b[3] = clampi((int)floor(uv[1] + half_y + 0.5), b[1] + 1, photo->h);
    }
}

static void look(const clip *k, const orl_image *frame, picture *p)
{
    for (size_t i = 0; i < pixels(k); i++) {
        const int *b = k->box + 4 * i;
        long sum[3] = { 0 }, n = (long)(b[2] - b[0]) * (b[3] - b[1]);
        if (k->outside[i]) continue;
        for (int y = b[1]; y < b[3]; y++)
            for (int x = b[0]; x < b[2]; x++)
                for (int c = 0; c < 3; c++) sum[c] += frame->px[((size_t)y * (size_t)frame->w + (size_t)x) * 3 + (size_t)c];
        p->person[i] = 0;
        for (int c = 0; c < 3; c++) {
            p->seen[3 * i + (size_t)c] = (float)sum[c] / (float)n;
            p->person[i] |= fabsf(p->seen[3 * i + (size_t)c] - (float)p->render[3 * i + (size_t)c]) > PERSON;
        }
    }
}

/* How much render and recording change from the last frame to this; f: this one's number. */
static void compare(clip *k, int f, int jump)
{
    double change[2] = { 0 }, level[2][2] = { { 0 } };
    size_t n = 0;
    for (size_t i = 0; i < pixels(k); i++) {
        if (k->outside[i] || k->now.person[i] || k->last.person[i]) continue;
        for (size_t at = 3 * i; at < 3 * i + 3; at++, n++) {
            change[0] += fabs((double)k->now.seen[at] - (double)k->last.seen[at]);
            change[1] += abs(k->now.render[at] - k->last.render[at]);
            level[0][0] += (double)k->last.seen[at];
            level[1][0] += (double)k->now.seen[at];
            level[1][1] += k->now.render[at];
        }
    }
    if (change[0] > 0) {
        k->ratio += change[1] / change[0];
        k->pairs++;
    }
    if (!n || f < jump) return;
    if (f == jump) k->jump = fabs(level[1][0] - level[0][0]) / (double)n;
    if (k->followed < 0 && fabs(level[1][1] - level[1][0]) / (double)n <= 0.1 * k->jump) k->followed = f - jump;
}

static orl_err against_wide(clip *k, const char *path)
{
    orl_image truth = { 0 }, ours = { k->w.wide.w, k->w.wide.h, 3, k->wide };
    orl_imagef a = { 0 }, b = { 0 };
    double ssim = 0, err = 0;
    size_t n = 0;
    orl_err e = orl_image_read(path, 3, &truth);
    if (!e && (truth.w != ours.w || truth.h != ours.h)) e = orl_fail(ORL_E_FORMAT, "%s: not of the wide camera's size", path);
    if (!e) e = orl_image_to_float(&truth, &a);
    if (!e) e = orl_image_to_float(&ours, &b);
    if (!e) e = orl_metrics_ssim_where(&a, &b, k->outside, &ssim);
    for (size_t i = 0; !e && i < 3 * pixels(k); i++) {
        if (!k->outside[i / 3]) continue;
        double r = (double)(a.px[i] - b.px[i]);
        err += r * r;
        n++;
    }
    if (!e) {
        k->psnr -= 10 * log10(fmax(err / (double)n, 1e-9));
        k->ssim += ssim;
        k->truths++;
    }
    orl_image_free(&truth);
    orl_imagef_free(&a);
    orl_imagef_free(&b);
    return e;
}

static orl_err frame(clip *k, const char *dir, const char *json, const double R[9], int f, int jump)
{
    char path[2048], key[32];
    double sun[3];
    orl_image photo = { 0 };
    orl_widen bare = { .blend = NULL };
    picture swap = k->last;
    snprintf(path, sizeof path, "%s/kiosk/frames/%04d.jpg", dir, f);
    orl_err e = orl_image_read(path, 3, &photo);
    if (!e && (photo.w != k->w.config.photo.w || photo.h != k->w.config.photo.h)) e = orl_fail(ORL_E_FORMAT, "%s: not of the camera's size", path);
    if (!e) e = orl_widen_adapt(&k->w, photo.px);
    k->last = k->now;
    k->now = swap;
    if (!e) {
        bare = k->w;
        bare.blend = NULL;
        e = orl_widen_render(&bare, photo.px, k->now.render);
    }
    if (!e) {
        look(k, &photo, &k->now);
        if (f) compare(k, f, jump);
        e = orl_widen_render(&k->w, photo.px, k->wide);
    }
    snprintf(path, sizeof path, "%s/kiosk/gt_wide/%04d.jpg", dir, f);
    if (!e && !access(path, R_OK)) {
        e = against_wide(k, path);
        snprintf(key, sizeof key, "\"frame\": %d,", f);
        if (!e && json && truth_sun_after(json, key, sun)) k->suns[k->nsuns++] = truth_sun_error(R, k->w.fit.code, sun);
    }
    orl_image_free(&photo);
    return e;
}

static int make_picture(picture *p, size_t n)
{
    p->seen = malloc(3 * n * sizeof *p->seen);
    p->render = malloc(3 * n);
    p->person = calloc(n, 1);
    return p->seen && p->render && p->person;
}

static void free_picture(picture *p) { free(p->seen); free(p->render); free(p->person); }

orl_err truth_kiosk(const orl_dataset *d, const orl_scene *s, const truth_options *o, figure out[TRUTH_FIGURES], int *count)
{
    char path[2048];
    orl_view_pose pose[2];
    int lines, jump = FRAMES, frames = 0;
    size_t bytes;
    double R[9];
    uint8_t *json = NULL;
    void *block = NULL;
    clip *k = calloc(1, sizeof *k);
    snprintf(path, sizeof path, "%s/kiosk/camera.txt", d->dir);
    orl_err e = k ? orl_posefile_read(path, pose, 2, &lines) : orl_fail(ORL_E_MEMORY, "eval: no memory for a clip");
    if (!e && lines < 2) e = orl_fail(ORL_E_FORMAT, "%s: no second line (the wide view)", path);
    if (e) goto done;
    snprintf(path, sizeof path, "%s/kiosk/frames.json", d->dir);
    if (!access(path, R_OK) && (e = orl_file_read(path, 1 << 24, &json, &bytes))) goto done;
    const char *at = json ? strstr((char *)json, "\"exposure_jump_frame\":") : NULL;
    if (at) jump = atoi(strchr(at, ':') + 1);
    orl_widen_config c = { .scene = s, .photo = pose[0].cam, .wide = pose[1].cam, .photo_pose = pose[0].pose, .wide_pose = pose[1].pose, .blend = 1, .threads = o->threads, .cpu = orl_cpu_detect() };
    size_t need = orl_widen_need(&c), n = (size_t)c.wide.w * (size_t)c.wide.h;
    block = orl_widen_block(need);
    k->box = malloc(4 * n * sizeof *k->box);
    k->outside = malloc(n);
    k->wide = malloc(3 * n);
    k->followed = -1;
    if (!make_picture(&k->now, n) || !make_picture(&k->last, n) || !block || !k->box || !k->outside || !k->wide) {
        e = orl_fail(ORL_E_MEMORY, "eval: no memory for a view of %d x %d", c.wide.w, c.wide.h);
        goto done;
    }
    if ((e = orl_widen_init(&c, block, need, &k->w))) goto done;
    place(k);
    truth_rotation(s, R);
    for (; !e && frames < FRAMES; frames++) {
        snprintf(path, sizeof path, "%s/kiosk/frames/%04d.jpg", d->dir, frames);
        if (access(path, R_OK)) break;
        e = frame(k, d->dir, (char *)json, R, frames, jump);
    }
    if (!e && !k->truths) e = orl_fail(ORL_E_IO, "%s/kiosk: no frame that has a wide truth", d->dir);
    if (e) goto done;
    figure *f = out + *count;
    *f++ = (figure){ k->psnr / k->truths, "outside_psnr", 3 };
    *f++ = (figure){ k->ssim / k->truths, "outside_ssim", 4 };
    if (k->nsuns) *f++ = (figure){ order_median(k->suns, (size_t)k->nsuns), "kiosk_sun_median_deg", 2 };
    if (k->pairs) *f++ = (figure){ k->ratio / k->pairs, "temporal_ratio", 3 };
    if (jump < frames) *f++ = (figure){ k->followed >= 0 ? k->followed : frames - jump, "jump_frames", 0 };
    *count = (int)(f - out);
done:
    if (k) {
        free(k->box);
        free(k->outside);
        free(k->wide);
        free_picture(&k->now);
        free_picture(&k->last);
    }
    free(k);
    free(block);
    free(json);
    return e;
}
