/* `oriel-train bench`: what training is made of, in CPU time: float peak, MLP, encodings, the whole step. Ratios are of one run; rounds of the two encodings alternate,
 * and each row is its fastest round (what disturbs a round only ever adds).
 * The MLP is 32-64-64-16: two hidden layers of 64. Samples are those of a photo: 16 a ray, one fine cell apart, about a wavy wall in a box of 512 x 512 x 256 cells; new rays in every round. */
#include <getopt.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include "oriel/colmap.h"
#include "oriel/image.h"
#include "oriel/model.h"
#include "oriel/parallel.h"
#include "oriel/scene.h"
#include "trainer/commands.h"
#include "trainer/encoding.h"
#include "trainer/mlp.h"

enum { ROUNDS = 10, BATCH = 32768, PIECE = 512, PER_RAY = 16, OUT = 16, ALONE = 32 };
static const int DIMS[3] = { 512, 512, 256 };

/* CPU time of all threads: other programs' share of the machine does not count. */
static double cpu_now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void *block(size_t bytes)
{
    void *p = aligned_alloc(64, (bytes + 63) & ~(size_t)63);
    if (p) memset(p, 0, bytes);
    return p;
}

/* What one thread works in. */
typedef struct { float (*x)[3], *feature, *hidden, *out, *dfeature; void *keep; } desk;

typedef enum { ENC_FORWARD, MLP_FORWARD, MLP_BACKWARD, ENC_BACKWARD, PHASES } phase;
typedef struct { phase what; encoding *e; mlp *m; desk *desks; int at; } job;

static void work(void *user, int begin, int end)
{
    job *j = user;
    for (int t = begin; t < end; t++) {
        desk *d = &j->desks[t];
        switch (j->what) {
        case ENC_FORWARD: enc_forward(j->e, PIECE, (const float (*)[3])d->x + j->at, d->feature, d->keep); break;
        case MLP_FORWARD: mlp_forward(j->m, PIECE, d->feature, d->hidden, d->out); break;
        case MLP_BACKWARD: mlp_backward(j->m, t, PIECE, d->feature, d->hidden, d->out, d->dfeature); break;
        default: enc_backward(j->e, t, PIECE, d->keep, d->dfeature); break;
        }
    }
}

static void draw_rays(float (*x)[3], rng *r)
{
    for (int i = 0; i < BATCH; i += PER_RAY) {
        float o[3] = { (float)DIMS[0] * rng_f(r), 20 * rng_f(r), 60 + 20 * rng_f(r) }, p[3] = { (float)DIMS[0] * rng_f(r), 0, 0.97f * (float)DIMS[2] * rng_f(r) }, d[3], n = 0;
        p[1] = 300 + 60 * sinf(0.03f * p[0]) * cosf(0.05f * p[2]);
        for (int a = 0; a < 3; a++) { d[a] = p[a] - o[a]; n += d[a] * d[a]; }
        for (int k = 0; k < PER_RAY; k++) {
            float t = (float)(k - PER_RAY / 2) + rng_f(r);
            for (int a = 0; a < 3; a++) x[i + k][a] = p[a] + t * d[a] / sqrtf(n);
        }
    }
}

static int json, rows;
/* seconds: CPU time a sample. rate: samples, or 10^9 float operations where gflops, a core and second. bytes a sample, 0: not stated. ratio to the row `against`, NULL: none. */
static void print_row(const char *name, double seconds, double rate, int gflops, double bytes, double ratio, const char *against)
{
    if (json) {
        printf("%s{\"name\": \"%s\", \"seconds\": %.4g, \"%s\": %.5g", rows ? ",\n " : "[", name, seconds, gflops ? "gflops" : "samples_per_core_second", rate);
        if (bytes > 0) printf(", \"bytes\": %.0f", bytes);
        if (against) printf(", \"ratio\": %.4f, \"against\": \"%s\"", ratio, against);
        printf("}");
    } else {
        printf("%-28s %9.1f ns", name, seconds * 1e9);
        printf(gflops ? " %9.1f GFLOP/s" : " %9.3f M/s    ", gflops ? rate : rate * 1e-6);
        if (bytes > 0) printf(" %7.0f bytes", bytes);
        else printf("              ");
        if (against) printf("  %.3f of %s", ratio, against);
        printf("\n");
    }
    rows++;
}

static orl_err bench(int threads)
{
    encoding enc[ENC_KINDS] = { 0 };
    mlp net = { 0 };
    desk *desks = calloc((size_t)threads, sizeof *desks);
    double spent[ENC_KINDS][PHASES] = { { 0 } }, adam[ENC_KINDS] = { 0 }, visited[ENC_KINDS] = { 0 }, alone[2] = { 0 }, peak = 0;
    orl_err e = desks ? mlp_init(&net, 3, (int[]){ ENC_WIDTH, MLP_WIDTH, MLP_WIDTH, OUT }, 1, 1, threads) : orl_fail(ORL_E_MEMORY, "bench: no memory");
    for (int k = 0; !e && k < ENC_KINDS; k++) e = enc_init(&enc[k], (enc_kind)k, DIMS, 1, threads);
    for (int t = 0; !e && t < threads; t++) {
        size_t keep = enc[0].keep > enc[1].keep ? enc[0].keep : enc[1].keep;
        desk *d = &desks[t];
        *d = (desk){ block(BATCH * sizeof *d->x), block(PIECE * ENC_WIDTH * 4), block(PIECE * (size_t)net.hidden * 4), block(PIECE * OUT * 4), block(PIECE * ENC_WIDTH * 4), block(PIECE * keep) };
        if (!d->x || !d->feature || !d->hidden || !d->out || !d->dfeature || !d->keep) e = orl_fail(ORL_E_MEMORY, "bench: no memory");
    }
    for (int round = -1; !e && round < ROUNDS; round++) {       /* the first one warms up */
        for (int t = 0; t < threads; t++) {
            rng r = rng_make(7, (uint64_t)(round + 1), (uint64_t)t);
            draw_rays(desks[t].x, &r);
        }
        double p = mlp_peak(0.1);
        peak = p > peak ? p : peak;
        for (int f = 0; f < 2; f++) {
            job j = { f ? MLP_BACKWARD : MLP_FORWARD, &enc[0], &net, desks, 0 };
            double t0 = cpu_now();
            for (int i = 0; i < ALONE; i++) orl_parallel(threads, threads, 1, work, &j);
            t0 = (cpu_now() - t0) / ALONE;
            alone[f] = alone[f] > 0 && alone[f] < t0 ? alone[f] : t0;
        }
        for (int k = 0; k < ENC_KINDS; k++) {
            double sum[PHASES] = { 0 }, t0;
            for (int at = 0; at < BATCH; at += PIECE)
                for (int f = 0; f < PHASES; f++) {
                    job j = { (phase)f, &enc[k], &net, desks, at };
                    t0 = cpu_now();
                    orl_parallel(threads, threads, 1, work, &j);
                    sum[f] += cpu_now() - t0;
                }
            t0 = cpu_now();
            double n = (double)enc_adam(&enc[k], 1e-4f, threads);
            mlp_adam(&net, 1e-4f, 0);
            double t1 = cpu_now() - t0;
            if (round < 0) continue;
            for (int f = 0; f < PHASES; f++) spent[k][f] = round && spent[k][f] < sum[f] ? spent[k][f] : sum[f];
            adam[k] = round && adam[k] < t1 ? adam[k] : t1;
            visited[k] += n;
        }
    }
    if (!e) {
        double n = (double)BATCH * threads, flop = 2.0 * (double)mlp_macs(&net), step[ENC_KINDS], both = 0, back = 0;
        both = fmin(spent[0][MLP_FORWARD], spent[1][MLP_FORWARD]) / n;
        back = fmin(spent[0][MLP_BACKWARD], spent[1][MLP_BACKWARD]) / n;
        print_row("float peak", flop / (2 * peak), 2e-9 * peak, 1, 0, 0, NULL);
        const double mlp_time[4] = { alone[0] / (PIECE * threads), alone[1] / (PIECE * threads), both, back };
        for (int i = 0; i < 4; i++) {
            char name[64];
            double f = flop * (1 + i % 2);
            snprintf(name, sizeof name, "mlp %s%s", i % 2 ? "backward" : "forward", i < 2 ? "" : ", in a step");
            print_row(name, mlp_time[i], 1e-9 * f / mlp_time[i], 1, 0, f / mlp_time[i] / (2 * peak), "float peak");
        }
        for (int k = ENC_KINDS - 1; k >= 0; k--) {
            double bytes = k == ENC_OURS ? 4 * 4 * 32 : 16 * 8 * 8, f = spent[k][ENC_FORWARD] / n, b = spent[k][ENC_BACKWARD] / n, a = adam[k] / n;
            double moved = visited[k] / (ROUNDS * n) * (3 + threads) * 2 * sizeof(v8);    /* parameter, two moments, each read and written; a gradient a thread */
            step[k] = f + b + a + both + back;
            char name[64];
            int ref = k == ENC_TEXTBOOK;
            const double *sr = spent[ENC_TEXTBOOK];
            snprintf(name, sizeof name, "%s forward", ENC_NAME[k]);
            print_row(name, f, 1 / f, 0, bytes, sr[ENC_FORWARD] / n / f, ref ? NULL : "textbook forward");
            snprintf(name, sizeof name, "%s backward", ENC_NAME[k]);
            print_row(name, b, 1 / b, 0, 2 * bytes, sr[ENC_BACKWARD] / n / b, ref ? NULL : "textbook backward");
            snprintf(name, sizeof name, "%s optimiser", ENC_NAME[k]);
            print_row(name, a, 1 / a, 0, moved, adam[ENC_TEXTBOOK] / n / a, ref ? NULL : "textbook optimiser");
            snprintf(name, sizeof name, "%s step, no optimiser", ENC_NAME[k]);
            print_row(name, step[k] - a, 1 / (step[k] - a), 0, 3 * bytes, (step[ENC_TEXTBOOK] - adam[ENC_TEXTBOOK] / n) / (step[k] - a), ref ? NULL : "textbook step, no optimiser");
            snprintf(name, sizeof name, "%s step", ENC_NAME[k]);
            print_row(name, step[k], 1 / step[k], 0, 3 * bytes + moved, step[ENC_TEXTBOOK] / step[k], ref ? NULL : "textbook step");
        }
        if (json) puts("]");
    }
    for (int t = 0; desks && t < threads; t++) {
        desk *d = &desks[t];
        free(d->x); free(d->feature); free(d->hidden); free(d->out); free(d->dfeature); free(d->keep);
    }
    free(desks);
    for (int k = 0; k < ENC_KINDS; k++) enc_free(&enc[k]);
    mlp_free(&net);
    return e;
}

/* ---- the exact picture */

typedef struct { const char *scene, *checkpoint, *pose, *out; double sigma; int w, h, rays, light, threads; } exact_options;

static int ends(const char *name, const char *with) { size_t n = strlen(name), m = strlen(with); return n > m && !strcmp(name + n - m, with); }

/* Display-referred, as 8-bit PNG or linear EXR. */
static orl_err write_exact(const char *path, orl_imagef *im)
{
    orl_image out = { 0 };
    if (ends(path, ".exr")) {
        for (size_t i = 0; i < (size_t)im->w * (size_t)im->h * 3; i++) im->px[i] = orl_light_decode_srgb(fminf(fmaxf(im->px[i], 0), 1));
        return orl_exr_write_float(path, im, "R,G,B");
    }
    orl_err e = orl_image_from_float(im, &out);
    if (!e) e = orl_image_write(path, &out);
    orl_image_free(&out);
    return e;
}

/* The last view of a pose file, the wide one where there are two, in the light of one training photo. */
static orl_err exact(const exact_options *o)
{
    orl_scene scene = { 0 };
    orl_model *model = NULL;
    orl_imagef im = { 0 };
    orl_view_pose view[2];
    int views = 0;
    orl_light *light = malloc(sizeof *light);
    char path[4096];
    snprintf(path, sizeof path, "%s.ckpt", o->scene);
    orl_err e = light ? orl_scene_open(o->scene, &scene) : orl_fail(ORL_E_MEMORY, "bench: no memory");
    if (!e) e = orl_posefile_read(o->pose, view, 2, &views);
    if (!e && views < 1) e = orl_fail(ORL_E_FORMAT, "%s: no view in it", o->pose);
    if (!e && (uint32_t)o->light >= scene.ncodes) e = orl_fail(ORL_E_RANGE, "--light %d: %s has the lights of %u photos", o->light, o->scene, scene.ncodes);
    if (!e) e = orl_model_load(o->checkpoint ? o->checkpoint : path, &model);
    orl_camera cam = { 0 };
    if (!e) cam = o->w ? orl_camera_resized(&view[views - 1].cam, o->w, o->h) : view[views - 1].cam;
    if (!e) e = orl_imagef_alloc(&im, cam.w, cam.h, 3);
    if (!e) {
        double t = cpu_now();
        orl_light_decode(orl_model_light(model), scene.codes + (size_t)o->light * ORL_CODE, light);
        orl_model_exact(model, &cam, &view[views - 1].pose, light, o->rays, (float)o->sigma, o->threads, im.px);
        t = cpu_now() - t;
        e = write_exact(o->out, &im);
        if (!e && json) printf("{\"name\": \"exact picture\", \"seconds\": %.4g, \"rays\": %d, \"sigma\": %g, \"light\": %d, \"width\": %d, \"height\": %d}\n", t, o->rays * o->rays, o->sigma, o->light, im.w, im.h);
        else if (!e) printf("%s: %d x %d, %d rays a pixel, volume-rendered; %.1f s of CPU time\n", o->out, im.w, im.h, o->rays * o->rays, t);
    }
    orl_imagef_free(&im);
    orl_model_free(model);
    orl_scene_close(&scene);
    free(light);
    return e;
}

static int number(const char *text, double lo, double hi, double *out)
{
    char *end;
    *out = strtod(text, &end);
    return end != text && !*end && *out >= lo && *out <= hi;
}

static int whole(const char *text, int lo, int hi, int *out)
{
    double v;
    if (!number(text, lo, hi, &v) || v != floor(v)) return 0;
    *out = (int)v;
    return 1;
}

static int size(const char *text, int *w, int *h)
{
    int used = 0;
    return sscanf(text, "%5dx%5d%n", w, h, &used) == 2 && !text[used] && *w >= 8 && *h >= 8 && *w <= 16384 && *h <= 16384;
}

static const char USAGE[] =
    "Usage: oriel-train bench [options]\n"
    "       oriel-train bench --scene FILE --pose FILE -o PICTURE [options]\n"
    "CPU time of what training is made of: encodings, MLP, optimiser; ratios measured in this run. Or the exact picture of a\n"
    "pose, the float model volume-rendered, for `oriel bench --reference PICTURE`.\n\n"
    "      --scene FILE       with its checkpoint beside it\n"
    "      --pose FILE        as of oriel; its last view is rendered (one alone: that of `oriel bench --widen 1`)\n"
    "  -o, --out PICTURE      PNG, or linear EXR\n"
    "      --checkpoint FILE  default: SCENE.ckpt\n"
    "      --size WxH         of the picture\n"
    "      --light N          light of the Nth training photo; 0\n"
    "      --rays N           N x N rays a pixel, 1 to 16; 4\n"
    "      --sigma F          softness of the surface, fine cells; 0.4, as it was trained (0.03: as good as hard)\n"
    "      --threads N        default 1\n"
    "      --json             an array with an object a row, or one object\n"
    "      --help\n";

int cmd_bench(int argc, char **argv)
{
    static const struct option LONG[] = {
        { "scene", 1, 0, 's' }, { "pose", 1, 0, 'p' }, { "out", 1, 0, 'o' }, { "checkpoint", 1, 0, 'c' }, { "size", 1, 0, 'z' }, { "light", 1, 0, 'l' }, { "rays", 1, 0, 'r' }, { "sigma", 1, 0, 'S' },
        { "threads", 1, 0, 't' }, { "json", 0, 0, 'j' }, { "help", 0, 0, 'h' }, { 0 } };
    exact_options o = { .rays = 4, .sigma = ORL_MODEL_SIGMA, .threads = 1 };
    int c, ok = 1;
    while (ok && (c = getopt_long(argc, argv, "o:h", LONG, NULL)) != -1) switch (c) {
        case 's': o.scene = optarg; break;
        case 'p': o.pose = optarg; break;
        case 'o': o.out = optarg; break;
        case 'c': o.checkpoint = optarg; break;
        case 'z': ok = size(optarg, &o.w, &o.h); break;
        case 'l': ok = whole(optarg, 0, 1 << 30, &o.light); break;
        case 'r': ok = whole(optarg, 1, 16, &o.rays); break;
        case 'S': ok = number(optarg, 0.01, 10, &o.sigma); break;
        case 't': ok = whole(optarg, 1, GRID_THREADS, &o.threads); break;
        case 'j': json = 1; break;
        case 'h': fputs(USAGE, stdout); return 0;
        default: fputs(USAGE, stderr); return 2;
        }
    if (!ok) { fprintf(stderr, "oriel-train bench: %s is out of range (--help tells more)\n", optarg); return 2; }
    const int picture = o.scene || o.pose || o.out;
    if (optind != argc) { fputs(USAGE, stderr); return 2; }
    if (picture && !(o.scene && o.pose && o.out)) { fprintf(stderr, "oriel-train bench: --scene, --pose and --out go together\n"); return 2; }
    orl_err e = picture ? exact(&o) : bench(o.threads);
    if (e) fprintf(stderr, "oriel-train: %s\n", orl_error_text());
    return e ? 1 : 0;
}
