/* Re-lighting kernels per variant beside memcpy of the bytes they move (reads and writes counted on both sides), and the march in rays a second. Best of several runs.
 * --json: one object a row. */
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include "oriel/view.h"
#include "tests/kernel_data.h"
#include "tests/synth_scene.h"

enum { W = 1920, H = 540, RUNS = 7 };

static const char *const variants[] = {
#define NAME(n) n,
    ORL_KERNEL_VARIANTS(NAME)
#undef NAME
};
static int json;

static double now(void) { struct timespec t; clock_gettime(CLOCK_MONOTONIC, &t); return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec; }

static double copy_seconds(size_t bytes)            /* bytes: read + written */
{
    size_t n = bytes / 2;
    uint8_t *a = malloc(n), *b = malloc(n);
    double best = 1e9;
    if (!a || !b) exit(1);
    memset(a, 1, n);
    memset(b, 2, n);
    for (int i = 0; i < RUNS; i++) {
        double t = now();
        memcpy(b, a, n);
        __asm__ volatile("" : : "r"(b) : "memory");
        t = now() - t;
        best = t < best ? t : best;
    }
    free(a);
    free(b);
    return best;
}

static void row(const char *name, const char *variant, double seconds, size_t bytes)
{
    double copy = copy_seconds(bytes);
    if (json) printf("{\"name\": \"%s %s\", \"seconds\": %.6f, \"bytes\": %zu, \"ratio\": %.2f, \"against\": \"memcpy\"}\n", name, variant, seconds, bytes, seconds / copy);
    else printf("%-8s %-8s %8.3f ms  %7.2f ns/pixel  %6.2f x memcpy of %zu bytes\n", name, variant, 1e3 * seconds, 1e9 * seconds / (W * H), seconds / copy, bytes);
}

int main(int argc, char **argv)
{
    json = argc > 1 && !strcmp(argv[1], "--json");
    orl_scene s;
    orl_view v;
    synth_scene_make(&s, 62, 50, 25);
    const double eye[3] = { 60, -250, 120 }, target[3] = { 248, 200, 40 };
    orl_camera cam = synth_camera(640, 480, 60);
    orl_pose pose = synth_look(&s, eye, target);
    size_t bytes = orl_view_need(W, H);
    void *block = aligned_alloc(64, bytes), *lb = aligned_alloc(64, orl_view_light_need());
    uint8_t *rgb = malloc((size_t)W * H * 3);
    if (!block || !lb || !rgb) return 1;
    for (int ss = 1; ss <= 2; ss++) {
        double t = now();
        if (orl_view_build(&s, &cam, &pose, ss, 1, block, bytes, &v)) { fprintf(stderr, "%s\n", orl_error_text()); return 1; }
        t = now() - t;
        if (json) printf("{\"name\": \"march 640x480 x%d\", \"seconds\": %.6f, \"rays_per_second\": %.0f}\n", ss * ss, t, 640.0 * 480 * ss * ss / t);
        else printf("march    640 x 480, %d rays a pixel, 1 thread: %.3f s, %.2f million rays a second\n", ss * ss, t, 640.0 * 480e-6 * ss * ss / t);
    }
    cam = synth_camera(W, H, 60);
    if (orl_view_build(&s, &cam, &pose, 1, 1, block, bytes, &v)) return 1;
    orl_light light;
    orl_light_decode(&s.light, s.light.prior_mean, &light);
    double t_make = now();
    orl_view_light *l = orl_view_light_make(&v, &light, lb, orl_view_light_need());
    t_make = now() - t_make;
    if (json) printf("{\"name\": \"light tables\", \"seconds\": %.6f}\n", t_make);
    else printf("tables   of one light: %.3f ms\n", 1e3 * t_make);
    for (size_t i = 0; i < sizeof variants / sizeof *variants; i++) {
        unsigned cpu;
        if (orl_cpu_from_name(variants[i], &cpu)) continue;
        double relight = 1e9, shade = 1e9;
        for (int k = 0; k < RUNS; k++) {
            double a = now();
            orl_view_relight(&v, l, cpu, 0, v.h);
            double b = now();
            orl_view_shade(&v, l, cpu, 0, v.h, rgb, (size_t)W * 3);
            double c = now();
            relight = b - a < relight ? b - a : relight;
            shade = c - b < shade ? c - b : shade;
        }
        row("relight", variants[i], relight, (size_t)W * H * (16 + 1));
        row("shade", variants[i], shade, (size_t)W * H * (2 + 6 + 2 + 8 + 1 + 3));      /* normal, base colour, open + cov, phi, vis -> rgb */
    }
    free(block);
    free(lb);
    free(rgb);
    synth_scene_free(&s);
    return 0;
}
