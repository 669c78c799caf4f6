/* crowd SCENE N WIDTH OUT: a collection of N photos WIDTH pixels wide from the few of SCENE, for measuring how memory and time grow. Each is one of SCENE's photos enlarged, cropped elsewhere
 * (the principal point moves along), and in another light: gains by channel. Cameras, observations, points and sky masks fit; it shows no more than SCENE does. */
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include "oriel/skymask.h"

enum { MASK = 4 };                  /* masks are so many times smaller */

static int fail(void)
{
    fprintf(stderr, "crowd: %s\n", orl_error_text());
    return 1;
}

static int folder(const char *dir, const char *name)
{
    char path[1200];
    snprintf(path, sizeof path, "%s/%s", dir, name);
    if (!mkdir(path, 0777) || errno == EEXIST) return 0;
    fprintf(stderr, "crowd: %s: %s\n", path, strerror(errno));
    return 1;
}

static uint32_t mix(uint32_t x) { x = (x ^ x >> 16) * 0x45d9f3bu; x = (x ^ x >> 16) * 0x45d9f3bu; return x ^ x >> 16; }

int main(int argc, char **argv)
{
    int n = argc == 5 ? atoi(argv[2]) : 0, width = argc == 5 ? atoi(argv[3]) : 0;
    if (n < 2 || n > 100000 || width < 64 || width > 8192) { fprintf(stderr, "Usage: crowd SCENE N WIDTH OUT\n"); return 2; }
    const char *dir = argv[4];
    orl_dataset d;
    if (orl_dataset_open(argv[1], NULL, NULL, &d)) return fail();
    if (folder(dir, "") || folder(dir, "photos") || folder(dir, "masks") || folder(dir, "sparse") || folder(dir, "sparse/0")) return 1;
    uint32_t *base = malloc((d.nphotos + 1) * sizeof *base), bases = 0;
    orl_colmap m = { .points = d.points, .npoints = d.npoints, .ncameras = (uint32_t)n, .nimages = (uint32_t)n };
    m.cameras = calloc((size_t)n, sizeof *m.cameras);
    m.images = calloc((size_t)n, sizeof *m.images);
    double up[3];
    if (!base || !m.cameras || !m.images || orl_skymask_up(&d, up)) return fail();
    for (uint32_t i = 0; i < d.nphotos; i++) if (!d.photos[i].test) base[bases++] = i;
    for (uint32_t b = 0; b < bases; b++) {
        const orl_photo *p = &d.photos[base[b]];
        orl_image im, sky, big;
        orl_camera cam;
        if (orl_photo_load(p, 0, &im, &cam) || orl_skymask_photo(&d, base[b], &im, &cam, up, NULL, &sky)) return fail();
        int w = width, h = (int)((long)width * im.h / im.w), bw = w + w / 12, bh = h + h / 12;
        if (orl_image_resize_area(&im, bw, bh, &big)) return fail();
        for (int k = (int)b; k < n; k += (int)bases) {
            uint32_t dice = mix((uint32_t)k);
            int dx = (int)(dice % (uint32_t)(bw - w + 1)), dy = (int)(dice / 1024 % (uint32_t)(bh - h + 1));
            uint8_t tone[3][256];
            orl_image out, mask;
            char path[1200];
            for (int c = 0; c < 3; c++)
                for (int v = 0; v < 256; v++) {
                    double t = v * (0.8 + 0.4 * (mix(dice + (uint32_t)c) & 255) / 255);
                    tone[c][v] = (uint8_t)(t > 255 ? 255 : t);
                }
            if (orl_image_alloc(&out, w, h, 3) || orl_image_alloc(&mask, w / MASK, h / MASK, 1)) return fail();
            for (int y = 0; y < h; y++)
                for (int x = 0; x < w; x++)
                    for (int c = 0; c < 3; c++) out.px[3 * (y * w + x) + c] = tone[c][big.px[3 * ((y + dy) * bw + x + dx) + c]];
            for (int y = 0; y < mask.h; y++)
                for (int x = 0; x < mask.w; x++) {
                    int sx = (MASK * x + MASK / 2 + dx) * im.w / bw, sy = (MASK * y + MASK / 2 + dy) * im.h / bh;
                    mask.px[y * mask.w + x] = sky.px[sy * im.w + sx] > ORL_SKY_SURE ? 128 : 0;
                }
            orl_colmap_image *o = &m.images[k];
            snprintf(o->name, sizeof o->name, "crowd_%05d.jpg", k);
            o->id = (uint32_t)k + 1;
            o->camera = k;
            o->pose = p->pose;
            orl_camera *c = &m.cameras[k];
            *c = orl_camera_resized(&cam, bw, bh);
            c->w = w;
            c->h = h;
            c->cx -= dx;
            c->cy -= dy;
            o->obs_begin = m.nobs;
            m.obs = realloc(m.obs, ((size_t)m.nobs + p->obs_count + 1) * sizeof *m.obs);
            if (!m.obs) return fail();
            for (uint32_t i = 0; i < p->obs_count; i++) {
                orl_colmap_obs q = d.obs[p->obs_begin + i];
                q.x = q.x * (float)bw / (float)im.w - (float)dx;
                q.y = q.y * (float)bh / (float)im.h - (float)dy;
                if (q.x >= 0 && q.y >= 0 && q.x < (float)w && q.y < (float)h) m.obs[m.nobs++] = q;
            }
            o->obs_count = m.nobs - o->obs_begin;
            snprintf(path, sizeof path, "%s/photos/%s", dir, o->name);
            if (orl_image_write(path, &out)) return fail();
            snprintf(path, sizeof path, "%s/masks/crowd_%05d.png", dir, k);
            if (orl_image_write(path, &mask)) return fail();
            orl_image_free(&out);
            orl_image_free(&mask);
        }
        orl_image_free(&im);
        orl_image_free(&sky);
        orl_image_free(&big);
    }
    char path[1200];
    snprintf(path, sizeof path, "%s/sparse/0", dir);
    if (orl_colmap_write_text(path, &m)) return fail();
    printf("%s: %d photos of %d x %d, %u observations\n", dir, n, m.cameras[0].w, m.cameras[0].h, m.nobs);
    return 0;
}
