/* `oriel-train fit`: photos in, scene file out. Stages, checkpoints, progress. */
#include <getopt.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <time.h>
#include <unistd.h>
#include "oriel/parallel.h"
#include "oriel/sky.h"
#include "trainer/checkpoint.h"
#include "trainer/commands.h"

typedef struct { const char *name; int long_side, longest, rays, steps, pixels, rounds; } preset;
static const preset PRESETS[] = {
    { "demo",     320, 192, 2048,  2000,  8000,  40 },
    { "quick",    384, 256, 2048,  6000, 30000,  60 },
    { "standard", 512, 512, 4096, 10000, 90000, 100 },
    { "full",     768, 768, 4096, 45000, 60000, 160 },
};
enum { CHECKPOINT_SECONDS = 45, ROUND_STEPS = 6 };

static const char USAGE[] =
    "Usage: oriel-train fit SCENE -o FILE.oriel [options]\n"
    "Learns an attraction from a SCENE folder (photos/, sparse/0, optional masks/, split.tsv) and writes a scene file.\n\n"
    "  -o, --output FILE      scene file to write; FILE.ckpt holds the float model and the way to resume\n"
    "      --preset NAME      demo, quick, standard (default) or full: about 4, 10, 40, 180 minutes on two cores\n"
    "      --resume           go on from FILE.ckpt\n"
    "      --stage2           redo stage 2 from FILE.ckpt's geometry\n"
    "      --time-budget MIN  stop refining after so many minutes (not repeatable: steps depend on the machine)\n"
    "      --steps N          stage 1 steps, instead of the preset's\n"
    "      --cells N          fine cells along the longest side of the box\n"
    "      --sky FILE         sky decoder made by `oriel-train sky` (default: the built-in one)\n"
    "      --no-masks         do not read given masks (sky is segmented by the program)\n"
    "      --seed N           default 1; runs repeat for the same seed and thread count\n"
    "      --threads N        default: all cores\n"
    "      --json             figures on standard output at the end\n"
    "      --help\n";

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static double cpu_now(void)
{
    struct rusage u;
    getrusage(RUSAGE_SELF, &u);
    return (double)u.ru_utime.tv_sec + (double)u.ru_stime.tv_sec + 1e-6 * (double)(u.ru_utime.tv_usec + u.ru_stime.tv_usec);
}

static void warn_line(void *user, const char *line)
{
    (void)user;
    fprintf(stderr, "oriel-train: %s\n", line);
}

/* A line that redraws itself on a terminal, and a plain one every half minute elsewhere. */
static void progress(double start, double done, const char *text)
{
    static double last;
    int tty = isatty(STDERR_FILENO);
    double t = now(), left = done > 0 ? (t - start) * (1 - done) / done : 0;
    if (t - last < (tty ? 0.5 : 30) && done < 1) return;
    last = t;
    char bar[21];
    for (int i = 0; i < 20; i++) bar[i] = (double)i < done * 20 ? '#' : '.';
    bar[20] = 0;
    fprintf(stderr, tty ? "\r[%s] %3.0f%%  %s  %d:%02d left \033[K%s" : "[%s] %3.0f%%  %s  %d:%02d left%s", bar, 100 * done, text, (int)left / 60, (int)left % 60, tty && done < 1 ? "" : "\n");
    fflush(stderr);
}

typedef struct {
    char output[900], ckpt[1000];
    const char *sky;
    int resume, stage2, use_masks, json;
    double budget;
    checkpoint_header head;
} fit_options;

static orl_err run(const fit_options *o, const orl_dataset *d)
{
    checkpoint_header head = o->head;
    world w = { 0 };
    stage1 s1 = { 0 };
    surface surf = { 0 };
    stage2 s2 = { 0 };
    FILE *ck = NULL;
    double start = now(), cpu0 = cpu_now(), before = 0, before_cpu = 0, last_save = start;
    size_t bytes = 0;
    int phase = 1;
    orl_err e;
    if (o->resume || o->stage2) {
        if ((e = checkpoint_peek(o->ckpt, &head, &ck))) return e;
        phase = head.phase;
        before = head.seconds;
        before_cpu = head.cpu_seconds;
        if (phase == 3 && !o->stage2) { fclose(ck); fprintf(stderr, "oriel-train: %s is finished\n", o->ckpt); return ORL_OK; }
        if (phase == 1 && o->stage2) { fclose(ck); return orl_fail(ORL_E_FORMAT, "%s: stage 1 has not finished", o->ckpt); }
        if (o->stage2) { head.pixels = o->head.pixels; head.rounds = o->head.rounds; }
    }
    if ((e = world_load(d, head.long_side, head.longest, o->use_masks, head.threads, &w))) goto done;
    if (head.nphotos && head.nphotos != w.nphotos) { e = orl_fail(ORL_E_FORMAT, "%s: made from %d photos, %s has %d", o->ckpt, head.nphotos, d->dir, w.nphotos); goto done; }
    head.nphotos = w.nphotos;
    fprintf(stderr, "%s: %d photos, %u points, box %d x %d x %d cells of %.4g, %.1f s\n", d->name, w.nphotos, w.npoints, w.frame.dims[0], w.frame.dims[1], w.frame.dims[2], 1 / w.frame.scale, now() - start);
    stage1_options o1 = { head.rays, head.steps, head.seed, head.threads, 0 };
    stage2_options o2 = { head.pixels, head.rounds, ROUND_STEPS, head.seed, head.threads };
    if ((e = stage1_init(&s1, &w, &o1))) goto done;
    orl_light_model light;
    if (o->sky) { if ((e = orl_sky_load(o->sky, &light))) goto done; }
    else orl_light_model_default(&light);

    if (ck && phase >= 2) {
        if ((e = surface_load(&surf, ck, o->ckpt))) goto done;
        stage2 skip = { 0 };
        long at = ftell(ck);                    /* stage 2 needs stage 1's colours to be set up: read past it first */
        if (!(e = stage2_init(&skip, &w, &surf, NULL, NULL, &o2))) {
            if (phase == 2) skip.adam = calloc(4096, sizeof *skip.adam);
            e = stage2_load(&skip, ck, phase == 2, o->ckpt);
        }
        stage2_free(&skip);
        if (!e) e = stage1_load(&s1, ck, 0, o->ckpt);
        if (!e) e = stage2_init(&s2, &w, &surf, &s1, &light, &o2);
        if (!e && !o->stage2 && !fseek(ck, at, SEEK_SET)) e = stage2_load(&s2, ck, phase == 2, o->ckpt);
        if (e) goto done;
    } else if (ck) {
        if ((e = stage1_load(&s1, ck, 1, o->ckpt))) goto done;
    }
    stage1_losses mean = { 0 };
    int first = s1.step;
    double t1 = now();
    while (phase == 1 && s1.step < head.steps) {
        stage1_losses l;
        stage1_step(&s1, &l);
        head.samples += l.samples;
        double k = s1.step - first < 50 ? 1.0 / (s1.step - first) : 0.02;
        for (size_t i = 0; i < sizeof l / sizeof(double); i++) ((double *)&mean)[i] += k * (((double *)&l)[i] - ((double *)&mean)[i]);
        if (o->budget > 0 && now() - start > 0.75 * o->budget * 60) s1.opt.steps = head.steps = s1.step;
        char text[200];
        snprintf(text, sizeof text, "stage 1  step %d  PSNR %.2f  sky %.3f  eikonal %.3f  points %.2f  transient %.3f  %.1f samples/ray", s1.step, -10 * log10(mean.mse + 1e-9), mean.sky, mean.eikonal, mean.points, mean.transient, mean.samples / head.rays);
        progress(t1, (double)(s1.step - first) / (head.steps - first), text);
        if (now() - last_save > CHECKPOINT_SECONDS) {
            head.phase = 1;
            head.seconds = before + now() - start;
            head.cpu_seconds = before_cpu + cpu_now() - cpu0;
            if ((e = checkpoint_save(o->ckpt, &head, &s1, NULL, NULL))) goto done;
            last_save = now();
        }
    }
    if (phase == 1) {
        if ((e = surface_build(&s1, &surf)) || (e = surface_prune(&surf, &w, head.threads)) || (e = surface_light(&surf, head.threads))) goto done;
        fprintf(stderr, "surface: %u bricks, %.1f s\n", surf.nbricks, now() - start);
        if ((e = stage2_init(&s2, &w, &surf, &s1, &light, &o2))) goto done;
    }
    double t2 = now();
    int first2 = s2.round;
    while (s2.round < head.rounds) {
        stage2_losses l;
        stage2_round(&s2, &l);
        if (o->budget > 0 && now() - start > o->budget * 60) s2.opt.rounds = head.rounds = s2.round;
        char text[200];
        snprintf(text, sizeof text, "stage 2  round %d  PSNR %.2f  codes' rms %.3f  degenerate %d", s2.round, -10 * log10(l.mse + 1e-9), l.adapt_rms, l.degenerate);
        progress(t2, (double)(s2.round - first2) / (head.rounds - first2), text);
        if (now() - last_save > CHECKPOINT_SECONDS) {
            head.phase = 2;
            head.seconds = before + now() - start;
            head.cpu_seconds = before_cpu + cpu_now() - cpu0;
            if ((e = checkpoint_save(o->ckpt, &head, &s1, &surf, &s2))) goto done;
            last_save = now();
        }
    }
    stage2_prior(&s2);
    if ((e = export_scene(o->output, &surf, &s2, w.title, &bytes))) goto done;
    head.phase = 3;
    head.seconds = before + now() - start;
    head.cpu_seconds = before_cpu + cpu_now() - cpu0;
    if ((e = checkpoint_save(o->ckpt, &head, &s1, &surf, &s2))) goto done;
    struct rusage u;
    getrusage(RUSAGE_SELF, &u);
    fprintf(stderr, "%s: %.1f MB, %u bricks, %.1f minutes, peak memory %.2f GB\n", o->output, (double)bytes * 1e-6, surf.nbricks, head.seconds / 60, (double)u.ru_maxrss * 1e-6);
    if (o->json)
        printf("{\"scene\": \"%s\", \"seconds\": %.1f, \"cpu_seconds\": %.1f, \"samples_per_core_second\": %.0f, \"peak_bytes\": %.0f, \"scene_bytes\": %zu, \"bricks\": %u}\n", d->name, head.seconds, head.cpu_seconds,
               head.samples / (head.cpu_seconds > 0 ? head.cpu_seconds : 1), (double)u.ru_maxrss * 1024, bytes, surf.nbricks);
done:
    if (ck) fclose(ck);
    stage2_free(&s2);
    surface_free(&surf);
    stage1_free(&s1);
    world_free(&w);
    return e;
}

int cmd_fit(int argc, char **argv)
{
    enum { PRESET = 256, RESUME, STAGE2, BUDGET, STEPS, CELLS, SKY, NO_MASKS, SEED, THREADS, JSON };
    static const struct option LONG[] = {
        { "output", 1, 0, 'o' }, { "preset", 1, 0, PRESET }, { "resume", 0, 0, RESUME }, { "stage2", 0, 0, STAGE2 }, { "time-budget", 1, 0, BUDGET }, { "steps", 1, 0, STEPS }, { "cells", 1, 0, CELLS },
        { "sky", 1, 0, SKY }, { "no-masks", 0, 0, NO_MASKS }, { "seed", 1, 0, SEED }, { "threads", 1, 0, THREADS }, { "json", 0, 0, JSON }, { "help", 0, 0, 'h' }, { 0 },
    };
    fit_options o = { .use_masks = 1 };
    const preset *p = &PRESETS[2];
    int c, steps = 0, cells = 0, threads = orl_cores();
    unsigned long long seed = 1;
    while ((c = getopt_long(argc, argv, "o:h", LONG, NULL)) != -1) {
        switch (c) {
        case 'o': snprintf(o.output, sizeof o.output, "%s", optarg); break;
        case PRESET:
            p = NULL;
            for (size_t i = 0; i < sizeof PRESETS / sizeof *PRESETS; i++) if (!strcmp(PRESETS[i].name, optarg)) p = &PRESETS[i];
            if (!p) { fprintf(stderr, "oriel-train fit: --preset %s: demo, quick, standard or full\n", optarg); return 2; }
            break;
        case RESUME: o.resume = 1; break;
        case STAGE2: o.stage2 = 1; break;
        case BUDGET: o.budget = atof(optarg); break;
        case STEPS: steps = atoi(optarg); break;
        case CELLS: cells = atoi(optarg); break;
        case SKY: o.sky = optarg; break;
        case NO_MASKS: o.use_masks = 0; break;
        case SEED: seed = strtoull(optarg, NULL, 10); break;
        case THREADS: threads = atoi(optarg); break;
        case JSON: o.json = 1; break;
        case 'h': fputs(USAGE, stdout); return 0;
        default: fputs(USAGE, stderr); return 2;
        }
    }
    if (optind + 1 != argc || !o.output[0] || steps < 0 || cells < 0 || (cells && (cells < 64 || cells > 2048)) || threads < 1) { fputs(USAGE, stderr); return 2; }
    snprintf(o.ckpt, sizeof o.ckpt, "%s.ckpt", o.output);
    if (threads > GRID_THREADS) threads = GRID_THREADS;
    o.head = (checkpoint_header){ .long_side = p->long_side, .longest = cells ? cells : p->longest, .rays = p->rays, .steps = steps ? steps : p->steps, .pixels = p->pixels, .rounds = p->rounds, .threads = threads, .seed = seed };
    orl_dataset d;
    orl_err e = orl_dataset_open(argv[optind], warn_line, NULL, &d);
    if (!e) {
        e = run(&o, &d);
        orl_dataset_free(&d);
    }
    if (e) fprintf(stderr, "oriel-train: %s\n", orl_error_text());
    return e ? 1 : 0;
}
