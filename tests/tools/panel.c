/* panel PHOTO WIDE TRUTH POSES OUT.png: puts a photo (in its place in the wide frame), the widened photo and the truth side by side, and prints PSNR, SSIM and FLIP of
 * widened against truth, over the whole picture and over what the photo did not show. POSES: pose file, line 1 the photo's view, line 2 the wide one. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "oriel/camera.h"
#include "oriel/image.h"
#include "oriel/metrics.h"

static int fail(void)
{
    fprintf(stderr, "panel: %s\n", orl_error_text());
    return 1;
}

int main(int argc, char **argv)
{
    enum { GAP = 8 };
    if (argc != 6) { fprintf(stderr, "Usage: panel PHOTO WIDE TRUTH POSES OUT.png\n"); return 2; }
    orl_image photo, wide, truth, out;
    orl_view_pose v[2];
    int n;
    if (orl_image_read(argv[1], 3, &photo) || orl_image_read(argv[2], 3, &wide) || orl_image_read(argv[3], 3, &truth) || orl_posefile_read(argv[4], v, 2, &n)) return fail();
    if (n != 2 || wide.w != truth.w || wide.h != truth.h) { fprintf(stderr, "panel: %s and %s differ in size, or %s has one view\n", argv[2], argv[3], argv[4]); return 1; }
    if (orl_image_alloc(&out, 3 * wide.w + 2 * GAP, wide.h, 3)) return fail();
    memset(out.px, 255, (size_t)out.w * (size_t)out.h * 3);
    orl_camera pc = orl_camera_resized(&v[0].cam, photo.w, photo.h), wc = orl_camera_resized(&v[1].cam, wide.w, wide.h);
    double sum = 0, count = 0;
    for (int y = 0; y < wide.h; y++)
        for (int x = 0; x < wide.w; x++) {
            double d[3], w[3], c[3], uv[2];
            orl_camera_unproject(&wc, x + 0.5, y + 0.5, d);
            orl_pose_ray(&v[1].pose, d, w);
            for (int i = 0; i < 3; i++) c[i] = v[0].pose.R[3 * i] * w[0] + v[0].pose.R[3 * i + 1] * w[1] + v[0].pose.R[3 * i + 2] * w[2];
            int seen = orl_camera_project(&pc, c, uv) && uv[0] >= 0 && uv[1] >= 0 && uv[0] < photo.w && uv[1] < photo.h;
            uint8_t *o = out.px + ((size_t)y * (size_t)out.w + (size_t)x) * 3;
            const uint8_t *a = wide.px + ((size_t)y * (size_t)wide.w + (size_t)x) * 3, *b = truth.px + ((size_t)y * (size_t)wide.w + (size_t)x) * 3;
            for (int k = 0; k < 3; k++) {
                o[k] = seen ? photo.px[((size_t)uv[1] * (size_t)photo.w + (size_t)uv[0]) * 3 + (size_t)k] : 225;
                o[3 * (wide.w + GAP) + k] = a[k];
                o[6 * (wide.w + GAP) + k] = b[k];
                if (!seen) { sum += (a[k] - b[k]) * (a[k] - b[k]) / 65025.0; count++; }
            }
        }
    orl_imagef fa, fb;
    if (orl_image_to_float(&wide, &fa) || orl_image_to_float(&truth, &fb) || orl_image_write(argv[5], &out)) return fail();
    orl_score s;
    if (orl_metrics_score(&fb, &fa, 0, fa.w, &s)) return fail();
    printf("whole wide picture: PSNR %.2f dB, SSIM %.4f, FLIP %.4f; outside the photo: PSNR %.2f dB\n", s.psnr, s.ssim, s.flip, -10 * log10(sum / count + 1e-12));
    return 0;
}
