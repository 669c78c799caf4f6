/* synth DIR [FRAMES [JUMP]]: a scene, a camera and a recording for the end-to-end tests, made by the runtime itself: DIR/scene.oriel (tests/synth_scene.h), DIR/pose.txt (two views), DIR/clip.y4m
 * (the recorded view while the sun wanders and the exposure jumps once, at frame JUMP), DIR/photo.png (its first frame), DIR/wide.png (the true wide view of it), DIR/sky.exr if built with EXR.
 * Same bytes on every machine. */
#include <stdio.h>
#include "oriel/cpu.h"
#include "oriel/image.h"
#include "oriel/math.h"
#include "oriel/sink.h"
#include "oriel/view.h"
#include "tests/synth_scene.h"

enum { W = 160, H = 120 };

static void light_of(const orl_light_model *m, int frame, int jump, orl_light *out)
{
    float code[ORL_CODE];
    memcpy(code, m->prior_mean, sizeof code);
    code[ORL_C_SUN_AZ] = 0.9f + 0.02f * (float)frame;
    code[ORL_C_SUN_EL] = 0.6f + 0.005f * (float)frame;
    for (int k = 0; k < 3; k++) code[ORL_C_TONE + 4 * k] += frame >= jump ? -0.25f : 0.0f;
    orl_light_decode(m, code, out);
}

static orl_err render(orl_view *v, const orl_light *l, uint8_t *rgb)
{
    void *block = aligned_alloc(64, (orl_view_light_need() + 63) & ~(size_t)63);
    orl_view_light *t = block ? orl_view_light_make(v, l, block, orl_view_light_need()) : NULL;
    if (t) {
        orl_view_shade(v, t, ORL_CPU_REF, 0, v->h, rgb, (size_t)v->w * 3);
    }
    free(block);
    return t ? ORL_OK : orl_fail(ORL_E_MEMORY, "synth: no memory");
}

static orl_err build(const orl_scene *s, const orl_camera *c, const orl_pose *p, orl_view *v, orl_image *im, void **block)
{
    size_t need = orl_view_need(c->w, c->h);
    *block = aligned_alloc(64, (need + 63) & ~(size_t)63);
    orl_err e = *block ? orl_view_build(s, c, p, 2, 1, *block, need, v) : orl_fail(ORL_E_MEMORY, "synth: no memory");
    return e ? e : orl_image_alloc(im, c->w, c->h, 3);
}

static orl_err write_pose(const char *path, const orl_camera *c, int n, const orl_pose *p)
{
    char text[4096];
    double q[4];
    int used = snprintf(text, sizeof text, "# NAME MODEL WIDTH HEIGHT FX FY CX CY QW QX QY QZ TX TY TZ\n");
    orl_pose_to_quat(p, q);
    for (int i = 0; i < n; i++)
        used += snprintf(text + used, sizeof text - (size_t)used, "%s PINHOLE %d %d %.17g %.17g %.17g %.17g %.17g %.17g %.17g %.17g %.17g %.17g %.17g\n", i ? "wide" : "recorded",
                         c[i].w, c[i].h, c[i].fx, c[i].fy, c[i].cx, c[i].cy, q[0], q[1], q[2], q[3], p->t[0], p->t[1], p->t[2]);
    return orl_file_write(path, text, (size_t)used);
}

/* A blue-grey dome with a small sun. */
static orl_err write_sky(const char *path)
{
    orl_imagef im;
    orl_err e = orl_imagef_alloc(&im, 128, 64, 3);
    if (e) return e;
    for (int y = 0; y < im.h; y++)
        for (int x = 0; x < im.w; x++) {
            float *p = im.px + ((size_t)y * (size_t)im.w + (size_t)x) * 3, up = y < im.h / 2 ? 1 - (float)y / (float)(im.h / 2) : 0;
            p[0] = 0.6f - 0.3f * up;
            p[1] = 0.7f - 0.2f * up;
            p[2] = 0.9f;
            if (x == 40 && y == 18) p[0] = p[1] = p[2] = 2000;
        }
    e = orl_exr_write(path, &im, "R,G,B");
    orl_imagef_free(&im);
    return e;
}

int main(int argc, char **argv)
{
    const char *dir = argc > 1 ? argv[1] : NULL;
    int frames = argc > 2 ? atoi(argv[2]) : 8, jump = argc > 3 ? atoi(argv[3]) : 5;
    char path[1024], spec[1100];
    orl_scene s;
    orl_view view, wide_view;
    orl_image im = { 0 }, wide = { 0 };
    orl_sink *clip = NULL;
    void *block[2] = { NULL };
    orl_light *light = malloc(sizeof *light);
    if (!dir || !light) {
        free(light);
        fprintf(stderr, "usage: synth DIR [FRAMES [JUMP]]\n");
        return 2;
    }
    synth_scene_make(&s, 8, 8, 6);
    orl_camera cam[2] = { synth_camera(W, H, 40), synth_camera(W * 5 / 4, H, 75) };
    const double eye[3] = { 6, -14, 26 }, target[3] = { 34, 34, 20 };
    orl_pose pose = synth_look(&s, eye, target);
    orl_err e = snprintf(path, sizeof path, "%s/scene.oriel", dir) < (int)sizeof path - 16 ? orl_scene_write(path, &s, NULL) : orl_fail(ORL_E_RANGE, "synth: path too long");
    snprintf(path, sizeof path, "%s/pose.txt", dir);
    if (!e) e = write_pose(path, cam, 2, &pose);
    if (!e) e = build(&s, &cam[0], &pose, &view, &im, &block[0]);
    if (!e) e = build(&s, &cam[1], &pose, &wide_view, &wide, &block[1]);
    snprintf(spec, sizeof spec, "y4m:%s/clip.y4m", dir);
    if (!e) e = orl_sink_open(spec, W, H, 10, 1, &clip);
    for (int i = 0; !e && i < frames; i++) {
        light_of(&s.light, i, jump, light);
        e = render(&view, light, im.px);
        if (!e) e = orl_sink_put(clip, im.px, (size_t)W * 3);
        snprintf(path, sizeof path, "%s/photo.png", dir);
        if (!e && !i) e = orl_image_write(path, &im);
        snprintf(path, sizeof path, "%s/wide.png", dir);
        if (!e && !i) e = render(&wide_view, light, wide.px);
        if (!e && !i) e = orl_image_write(path, &wide);
    }
    if (clip) {
        orl_err last = orl_sink_close(clip, NULL, 0);
        e = e ? e : last;
    }
    snprintf(path, sizeof path, "%s/sky.exr", dir);
    if (!e && strstr(orl_image_formats(), "exr")) e = write_sky(path);
    if (e) fprintf(stderr, "synth: %s\n", orl_error_text());
    free(block[0]); free(block[1]); free(light);
    orl_image_free(&im);
    orl_image_free(&wide);
    synth_scene_free(&s);
    return e != ORL_OK;
}
