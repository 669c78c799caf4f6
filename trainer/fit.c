/* `oriel-train fit`: photos in, scene file out. Stages, checkpoints, progress. */
#include <errno.h>
#include <getopt.h>
#include <malloc.h>
#include <math.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <time.h>
#include <unistd.h>
#include "oriel/parallel.h"
#include "oriel/sky.h"
#include "trainer/checkpoint.h"
#include "trainer/commands.h"
#include "trainer/nerfw.h"
#include "trainer/ranks.h"
#include "trainer/backdrop.h"
#include "trainer/refine.h"
#include "trainer/texture.h"

typedef struct { const char *name; int long_side, longest, rays, steps, pixels, rounds; } preset;
static const preset PRESETS[] = {
    { "demo",     320, 192, 2048,  2000,  8000,  40 },
    { "quick",    384, 256, 2048,  2000, 30000,  30 },
    { "standard", 640, 512, 4096,  2500, 90000,  50 },
    { "full",     768, 768, 4096, 45000, 60000, 160 },
};
enum { ROUND_STEPS = 6, REFINE_ROUNDS = 6, NERFW_STEPS = 4 };      /* the baseline takes four steps of a quarter of the rays for one of stage 1: it needs steps more than rays */

static const char USAGE[] =
    "Usage: oriel-train fit SCENE -o FILE.oriel [options]\n"
    "Learns an attraction from a SCENE folder (photos/, sparse/0, optional masks/, split.tsv) and writes a scene file.\n\n"
    "  -o, --output FILE      scene file to write; FILE.ckpt holds the float model and the way to resume\n"
    "      --preset NAME      demo, quick, standard (default) or full: about 2, 4, 15, 180 minutes on two cores\n"
    "      --resume           go on from FILE.ckpt with the settings it was made with (give --sky, --no-masks and --refine-poses again)\n"
    "      --stage2           redo stage 2 from FILE.ckpt's geometry\n"
    "      --time-budget MIN  stop refining after so many minutes (not repeatable: steps depend on the machine)\n"
    "      --steps N          stage 1 steps, instead of the preset's (--method nerfw: four of its own for each)\n"
    "      --rounds N         stage 2 rounds, instead of the preset's\n"
    "      --cells N          fine cells along the longest side of the box, 64 to 2048, instead of the preset's\n"
    "      --long-side N      pixels along a photo's longer side, 64 to 8192, instead of the preset's\n"
    "      --checkpoint-seconds S  between two checkpoints, default 30\n"
    "      --sky FILE         sky decoder made by `oriel-train sky` (default: the built-in one)\n"
    "      --light NAME       oriel (default), or paper: one product of base colour, shadow and irradiance, with neither the surface's shadows nor the ground's light\n"
    "      --without LIST     leave out, to see what it is worth: tone, shadow, visibility, ground, distill, sky-prior; commas between them\n"
    "      --method NAME      oriel (default), or nerfw: the NeRF-W baseline, for eval --nerfw; it does not resume\n"
    "      --encoding NAME    of --method nerfw: ours (default) or textbook\n"
    "      --snapshots LIST   of --method nerfw: minutes of training, as 1,2,4,8, at which FILE.1m, FILE.2m, ... are written\n"
    "      --no-masks         do not read given masks (sky is segmented by the program)\n"
    "      --refine-poses on|off   correct poses and lenses along with the scene, default off\n"
    "      --seed N           default 1; runs repeat for the same seed and number of threads (of all ranks)\n"
    "      --threads N        default: all cores, shared out among the ranks of a machine\n"
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

/* To standard error, once for all ranks. */
static void tell(const char *format, ...)
{
    va_list a;
    va_start(a, format);
    if (!ranks_mine()) vfprintf(stderr, format, a);
    va_end(a);
}

static void warn_line(void *user, const char *line)
{
    (void)user;
    tell("oriel-train: %s\n", line);
}

/* A line that redraws itself on a terminal, and a plain one every half minute elsewhere. */
static void progress(double start, double done, const char *text)
{
    static double last;
    int tty = isatty(STDERR_FILENO);
    double t = now(), left = done > 0 ? (t - start) * (1 - done) / done : 0;
    if (ranks_mine() || (t - last < (tty ? 0.5 : 30) && done < 1)) return;
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
    int resume, stage2, use_masks, json, nerfw, refine;
    enc_kind encoding;
    double snapshot[16];            /* minutes, rising; 0 ends */
    double budget, checkpoint_seconds;
    checkpoint_header head;
} fit_options;

/* A run: what it has made so far, and what it has spent. */
typedef struct {
    const fit_options *o;
    checkpoint_header head;
    world w;
    stereo_work *maps;
    stereo st;
    stage1 s1;
    surface surf;
    stage2 s2;
    stage2_options o2;
    orl_light_model light;
    double start, cpu0, before, before_cpu, last_save;
    int stuck;                      /* steps dropped in a row */
} run;

static void clock_in(run *r)
{
    r->head.seconds = r->before + now() - r->start;
    r->head.cpu_seconds = r->before_cpu + (cpu_now() - r->cpu0) * ranks_count();
}

/* Some 200 rows of the log a stage. */
static void note(run *r, int step, int steps, log_row row)
{
    if (step % (steps / 200 + 1) && step < steps) return;
    clock_in(r);
    row.step = (float)step;
    row.minutes = (float)(r->head.seconds / 60);
    row.cpu_minutes = (float)(r->head.cpu_seconds / 60);
    checkpoint_note(&r->head, &row);
}

static orl_err save(run *r)
{
    if (ranks_mine()) return ORL_OK;
    checkpoint_parts p = { &r->w, r->maps, &r->st, &r->s1, &r->surf, &r->s2 };
    clock_in(r);
    orl_err e = checkpoint_save(r->o->ckpt, &r->head, &p);
    r->last_save = now();
    return e;
}

/* The time budget's share is spent: rank 0's clock tells. */
static int spent(const run *r, double share)
{
    int yes = now() - r->start > share * 60 * r->o->budget;
    if (!(r->o->budget > 0)) return 0;
    ranks_share(0, &yes, sizeof yes);
    return yes;
}

static orl_err save_sometimes(run *r) { return now() - r->last_save >= r->o->checkpoint_seconds ? save(r) : ORL_OK; }

/* Stage 2 takes the pixels that it needs of the photos. */
static orl_err begin_stage2(run *r)
{
    if (r->o2.without & WITHOUT_VISIBILITY) surface_uncover(&r->surf);
    orl_err e = stage2_init(&r->s2, &r->w, &r->surf, &r->s1, &r->light, &r->o2);
    world_forget(&r->w);
    malloc_trim(0);                             /* photos are too small for the C library to give back by itself */
    return e;
}

/* What follows the checkpoint's header. */
static orl_err resume(run *r, FILE *ck)
{
    const char *path = r->o->ckpt;
    int phase = r->head.phase;
    orl_err e;
    if (phase == 0) return stereo_work_load(r->maps, ck, path);
    if (phase == 1) {
        e = stereo_load(&r->st, &r->w, ck, path);
        if (!e) e = stage1_start(&r->s1, &r->w, &r->st);
        if (!e) e = stage1_load(&r->s1, ck, 1, path);
        if (!e) e = refine_load(&r->w, ck, path);
        return e ? e : stereo_watch(r->maps);
    }
    if ((e = surface_load(&r->surf, ck, path))) return e;
    stage2 skip = { 0 };
    long at = ftell(ck);                        /* stage 2 needs stage 1's colours to be set up: read past it first */
    if (!(e = stage2_init(&skip, &r->w, &r->surf, NULL, NULL, &r->o2))) {
        if (phase == 2) skip.adam = calloc(4096, sizeof *skip.adam);
        e = stage2_load(&skip, ck, phase == 2, path);
    }
    stage2_free(&skip);
    if (!e) e = checkpoint_load_sky(&r->w, ck, path);
    if (!e) e = stage1_load(&r->s1, ck, 0, path);
    if (!e) e = refine_load(&r->w, ck, path);
    if (!e && r->o->stage2) e = surface_light(&r->surf, r->head.threads);
    if (!e && r->o->stage2) e = backdrop_find(&r->surf, &r->w, &r->s1, r->head.threads);
    if (!e) e = begin_stage2(r);
    if (!e && !r->o->stage2 && !fseek(ck, at, SEEK_SET)) e = stage2_load(&r->s2, ck, phase == 2, path);
    if (!e && (r->s2.round < 0 || r->s2.round > r->head.rounds)) e = orl_fail(ORL_E_RANGE, "%s: stage 2 round %d of %d", path, r->s2.round, r->head.rounds);
    return e;
}

static void refine(run *r, const stage1 *s, int round)
{
    refine_figures f;
    refine_photos(&r->w, s, r->head.seed, round, r->head.threads, &f);
    fprintf(stderr, "poses and lenses: reprojection %.3f -> %.3f px; corrected by %.3f degrees, %.3f cells, focal length %.3f %%\n", f.before, f.after, f.degrees, f.cells, 100 * f.focal);
}

static orl_err run_stereo(run *r)
{
    double t = now(), first = stereo_progress(r->maps);
    orl_err e;
    while (stereo_step(r->maps)) {
        double done = stereo_progress(r->maps);
        progress(t, (done - first) / (1 - first), "stereo");
        if (stereo_can_save(r->maps) && (e = save_sometimes(r))) return e;
    }
    e = stereo_finish(r->maps, &r->st);
    if (e || (e = stereo_watch(r->maps)) || (e = stage1_start(&r->s1, &r->w, &r->st))) return e;
    tell("stereo: %u points, %.1f s\n", r->st.npoints, now() - r->start);
    r->head.phase = 1;
    return save(r);
}

/* A step that is dropped now and then is only counted; when nothing else happens any more, the run ends. */
static orl_err count_dropped(run *r, int dropped, int moved)
{
    r->head.dropped += dropped;
    r->stuck = moved ? 0 : r->stuck + dropped;
    return r->stuck < 100 ? ORL_OK : orl_fail(ORL_E_DEGENERATE, "%s: %d steps in a row had no finite gradient", r->w.title, r->stuck);
}

static orl_err run_stage1(run *r)
{
    stage1 *s = &r->s1;
    stage1_losses mean = { 0 };
    int first = s->step;
    double t = now();
    orl_err e;
    s->watch = r->maps;
    while (s->step < r->head.steps) {
        stage1_losses l;
        int taken = stage1_step(s, &l);
        if ((e = count_dropped(r, !taken, taken))) return e;
        if (!taken) continue;
        int every = r->head.steps / (REFINE_ROUNDS + 2);        /* once there is a surface, and not when it has settled */
        if (r->o->refine && every && s->step % every == 0 && s->step > every && s->step <= (REFINE_ROUNDS + 1) * every) {
            refine(r, s, s->step / every);
            if ((e = stereo_watch(r->maps))) return e;
        }
        r->head.samples += l.samples;
        double k = s->step - first < 50 ? 1.0 / (s->step - first) : 0.02;
        for (size_t i = 0; i < sizeof l / sizeof(double); i++) ((double *)&mean)[i] += k * (((double *)&l)[i] - ((double *)&mean)[i]);
        if (spent(r, 0.75)) s->opt.steps = r->head.steps = s->step;
        char text[200];
        snprintf(text, sizeof text, "stage 1  step %d  PSNR %.2f  sky %.3f  eikonal %.3f  points %.2f  transient %.3f  %.1f samples/ray", s->step, -10 * log10(mean.mse + 1e-9),
                 mean.sky, mean.eikonal, mean.points, mean.transient, mean.samples / r->head.rays);
        progress(t, (double)(s->step - first) / (r->head.steps - first), text);
        note(r, s->step, r->head.steps, (log_row){ .stage = 1, .psnr = (float)(-10 * log10(mean.mse + 1e-9)), .sky = (float)mean.sky, .eikonal = (float)mean.eikonal, .points = (float)mean.points,
                                                   .transient = (float)mean.transient });
        if ((e = save_sometimes(r))) return e;
    }
    stage1_freeze(s);
    stereo_end(r->maps);
    r->maps = NULL;
    stereo_free(&r->st);
    if ((e = surface_build(s, &r->surf)) || (e = surface_carve(&r->surf, &r->w, r->head.threads)) || (e = surface_prune(&r->surf, &r->w, r->head.threads)) || (e = backdrop_find(&r->surf, &r->w, s, r->head.threads)) || (e = surface_light(&r->surf, r->head.threads))) return e;
    tell("surface: %u bricks, %.1f s\n", r->surf.nbricks, now() - r->start);
    if ((e = begin_stage2(r))) return e;
    r->head.phase = 2;
    return ORL_OK;
}

static orl_err run_stage2(run *r)
{
    stage2 *s = &r->s2;
    int first = s->round;
    double t = now();
    orl_err e;
    while (s->round < r->head.rounds) {
        stage2_losses l;
        stage2_round(s, &l);
        if ((e = count_dropped(r, l.dropped, l.dropped < s->opt.steps))) return e;
        if (spent(r, 1)) s->opt.rounds = r->head.rounds = s->round;
        char text[200];
        snprintf(text, sizeof text, "stage 2  round %d  PSNR %.2f  codes' rms %.3f  degenerate %d", s->round, -10 * log10(l.mse + 1e-9), l.adapt_rms, l.degenerate);
        progress(t, (double)(s->round - first) / (r->head.rounds - first), text);
        note(r, s->round, r->head.rounds, (log_row){ .stage = 2, .psnr = (float)(-10 * log10(l.mse + 1e-9)), .codes_rms = (float)l.adapt_rms });
        if ((e = save_sometimes(r))) return e;
    }
    stage2_prior(s);
    double began = now();
    if ((e = stage2_texture(s))) return e;
    tell("base colour: %u textures, %.1f s\n", s->skin.n, now() - began);
    r->head.phase = 3;
    return ORL_OK;
}

static orl_err fit(const fit_options *o, const orl_dataset *d)
{
    run r = { .o = o, .head = o->head, .start = now(), .cpu0 = cpu_now() };
    checkpoint_header *head = &r.head;
    FILE *ck = NULL;
    size_t bytes = 0;
    orl_err e;
    r.last_save = r.start;
    if (o->resume || o->stage2) {
        if ((e = checkpoint_peek(o->ckpt, head, &ck))) return e;
        r.before = head->seconds;
        r.before_cpu = head->cpu_seconds;
        if (head->phase < 2 && o->stage2) { fclose(ck); return orl_fail(ORL_E_FORMAT, "%s: stage 1 has not finished", o->ckpt); }
        if (o->stage2) { head->pixels = o->head.pixels; head->rounds = o->head.rounds; head->without = o->head.without; while (head->logged && head->log[head->logged - 1].stage > 1) head->logged--; }
    }
    if ((e = world_load(d, head->long_side, head->longest, o->use_masks, head->threads, &r.w))) goto done;
    if (head->nphotos && head->nphotos != r.w.nphotos) { e = orl_fail(ORL_E_FORMAT, "%s: made from %d photos, %s has %d", o->ckpt, head->nphotos, d->dir, r.w.nphotos); goto done; }
    uint32_t place = checkpoint_place(&r.w);
    if (head->place && head->place != place) { e = orl_fail(ORL_E_FORMAT, "%s: made from other photos or cameras than those of %s", o->ckpt, d->dir); goto done; }
    head->nphotos = r.w.nphotos;
    head->place = place;
    tell("%s: %d photos, %u points, box %d x %d x %d cells of %.4g, %.1f s\n", d->name, r.w.nphotos, r.w.npoints, r.w.frame.dims[0], r.w.frame.dims[1], r.w.frame.dims[2],
            1 / r.w.frame.scale, now() - r.start);
    stage1_options o1 = { head->rays, head->steps, head->seed, head->threads, 0 };
    r.o2 = (stage2_options){ head->pixels, head->rounds, ROUND_STEPS, head->seed, head->threads, head->without };
    if ((e = stage1_init(&r.s1, &r.w, &o1))) goto done;
    if (o->sky) { if ((e = orl_sky_load(o->sky, &r.light))) goto done; }
    else orl_light_model_default(&r.light);
    if (o->refine && head->phase <= 1) refine(&r, NULL, 0);     /* by the SfM points alone, before anything is built on it; hence again by a run that is resumed */
    if (head->phase <= 1 && (e = stereo_begin(&r.w, head->seed, head->threads, &r.maps))) goto done;
    if (ck && (e = resume(&r, ck))) goto done;
    if (o->stage2) head->phase = 2;

    if (head->phase == 0 && (e = run_stereo(&r))) goto done;
    if (head->phase == 1 && (e = run_stage1(&r))) goto done;
    if (head->phase == 2 && (e = run_stage2(&r))) goto done;
    if (ranks_mine()) goto done;
    if ((e = export_scene(o->output, &r.surf, &r.s2, r.w.title, &bytes)) || (e = save(&r))) goto done;
    struct rusage u;
    getrusage(RUSAGE_SELF, &u);
    fprintf(stderr, "%s: %.1f MB, %u bricks, %.1f minutes, peak memory %.2f GB\n", o->output, (double)bytes * 1e-6, r.surf.nbricks, head->seconds / 60, (double)u.ru_maxrss * 1e-6);
    if (head->dropped) fprintf(stderr, "%d steps without finite gradients were dropped\n", head->dropped);
    if (o->json) {
        printf("{\"scene\": ");
        print_json_string(d->name);
        printf(", \"seconds\": %.1f, \"cpu_seconds\": %.1f, \"samples_per_core_second\": %.0f, \"peak_bytes\": %.0f, \"scene_bytes\": %zu, \"bricks\": %u, \"dropped_steps\": %d}\n", head->seconds, head->cpu_seconds,
               head->samples / (head->cpu_seconds > 0 ? head->cpu_seconds : 1), (double)u.ru_maxrss * 1024, bytes, r.surf.nbricks, head->dropped);
    }
done:
    if (ck) fclose(ck);
    stage2_free(&r.s2);
    surface_free(&r.surf);
    stage1_free(&r.s1);
    stereo_free(&r.st);
    stereo_end(r.maps);
    world_free(&r.w);
    return e;
}

/* The baseline. Its clock is training alone: neither loading nor writing counts. With a budget the schedule follows the clock, else the steps. */
static orl_err fit_nerfw(const fit_options *o, const orl_dataset *d)
{
    const checkpoint_header *h = &o->head;
    world w = { 0 };
    nerfw n = { 0 };
    nerfw_losses mean = { 0 };
    if (ranks_count() > 1) return orl_fail(ORL_E_UNSUPPORTED, "%s: --method nerfw runs on one rank, not on %d", o->output, ranks_count());
    double samples = 0, spent = 0, spent_cpu = 0, start = 0;
    int next = 0;
    orl_err e = world_load(d, h->long_side, h->longest, o->use_masks, h->threads, &w);
    if (!e) e = nerfw_init(&n, &w, &(nerfw_options){ o->encoding, h->rays / NERFW_STEPS, h->threads, h->seed });
    if (!e) fprintf(stderr, "%s: %d photos, box %d x %d x %d cells, encoding %s\n", d->name, w.nphotos, w.frame.dims[0], w.frame.dims[1], w.frame.dims[2], ENC_NAME[o->encoding]);
    start = now();
    while (!e) {
        double t = now(), cpu = cpu_now(), done = o->budget > 0 ? spent / (60 * o->budget) : (double)n.step / (NERFW_STEPS * h->steps);
        if (done >= 1) break;
        nerfw_losses l;
        nerfw_step(&n, (float)done, &l);
        spent += now() - t;
        spent_cpu += cpu_now() - cpu;
        samples += l.samples;
        double k = n.step < 50 ? 1.0 / n.step : 0.02;
        for (size_t i = 0; i < sizeof l / sizeof(double); i++) ((double *)&mean)[i] += k * (((double *)&l)[i] - ((double *)&mean)[i]);
        char text[1000];
        snprintf(text, sizeof text, "nerfw  step %d  PSNR %.2f  sky %.3f  transient %.3f  distortion %.4f  %.2f M samples a core and second", n.step, -10 * log10(mean.mse + 1e-9), mean.sky, mean.transient,
                 mean.distortion, 1e-6 * samples / spent_cpu);
        progress(start, done, text);
        if (next < 16 && o->snapshot[next] > 0 && spent >= 60 * o->snapshot[next]) {
            snprintf(text, sizeof text, "%s.%gm", o->output, o->snapshot[next++]);
            e = nerfw_save(&n, text);
        }
    }
    if (!e) e = nerfw_save(&n, o->output);
    if (!e) {
        struct rusage u;
        getrusage(RUSAGE_SELF, &u);
        fprintf(stderr, "%s: %d steps, %.1f minutes, peak memory %.2f GB\n", o->output, n.step, spent / 60, (double)u.ru_maxrss * 1e-6);
        if (o->json) {
            printf("{\"scene\": ");
            print_json_string(d->name);
            printf(", \"method\": \"nerfw\", \"encoding\": \"%s\", \"steps\": %d, \"seconds\": %.1f, \"cpu_seconds\": %.1f, \"samples_per_core_second\": %.0f, \"peak_bytes\": %.0f}\n", ENC_NAME[o->encoding], n.step, spent,
                   spent_cpu, samples / (spent_cpu > 0 ? spent_cpu : 1), (double)u.ru_maxrss * 1024);
        }
    }
    nerfw_free(&n);
    world_free(&w);
    return e;
}

static char range[80];              /* of the number that did not fit, for the message */

static int number(const char *text, double lo, double hi, double *out)
{
    char *end;
    double v = strtod(text, &end);
    snprintf(range, sizeof range, " (%.16g to %.16g)", lo, hi);
    if (end == text || *end || !(v >= lo && v <= hi)) return 0;
    *out = v;
    return 1;
}

static int whole(const char *text, int lo, int hi, int *out)
{
    double v;
    if (!number(text, lo, hi, &v) || v != floor(v)) {
        snprintf(range, sizeof range, " (whole, %d to %d)", lo, hi);
        return 0;
    }
    *out = (int)v;
    return 1;
}

/* Rising minutes between commas. */
static int minutes(const char *text, double out[16])
{
    int n = 0;
    for (char *end; n < 15; text = end + 1) {
        out[n] = strtod(text, &end);
        if (end == text || !(out[n] > (n ? out[n - 1] : 0) && out[n] < 1e6)) return 0;
        n++;
        if (*end != ',') return !*end;
    }
    return 0;
}

/* Names between commas, as bits. */
static int left_out(const char *text, unsigned *without)
{
    for (size_t n; *text; text += n + (text[n] == ',')) {
        int k = 0;
        n = strcspn(text, ",");
        while (k < WITHOUTS && (strlen(WITHOUT_NAME[k]) != n || strncmp(WITHOUT_NAME[k], text, n))) k++;
        if (k == WITHOUTS) return 0;
        *without |= 1u << k;
    }
    return *without != 0;
}

/* Whether files can be made beside the output: said before the work is done, not after. */
static orl_err check_folder(const char *output)
{
    char dir[900];
    snprintf(dir, sizeof dir, "%s", output);
    char *slash = strrchr(dir, '/');
    if (slash) slash[slash == dir] = 0;
    return access(slash ? dir : ".", W_OK | X_OK) ? orl_fail(ORL_E_IO, "%s: %s", output, strerror(errno)) : ORL_OK;
}

int cmd_fit(int argc, char **argv)
{
    enum { PRESET = 256, RESUME, STAGE2, BUDGET, STEPS, ROUNDS, CELLS, LONG_SIDE, CHECKPOINT, SKY, NO_MASKS, LIGHT, WITHOUT, METHOD, ENCODING, SNAPSHOTS, REFINE, SEED, THREADS, JSON };
    static const struct option LONG[] = {
        { "output", 1, 0, 'o' }, { "preset", 1, 0, PRESET }, { "resume", 0, 0, RESUME }, { "stage2", 0, 0, STAGE2 }, { "time-budget", 1, 0, BUDGET }, { "steps", 1, 0, STEPS }, { "rounds", 1, 0, ROUNDS },
        { "cells", 1, 0, CELLS }, { "long-side", 1, 0, LONG_SIDE }, { "checkpoint-seconds", 1, 0, CHECKPOINT }, { "sky", 1, 0, SKY }, { "no-masks", 0, 0, NO_MASKS }, { "light", 1, 0, LIGHT }, { "without", 1, 0, WITHOUT }, { "method", 1, 0, METHOD }, { "encoding", 1, 0, ENCODING }, { "snapshots", 1, 0, SNAPSHOTS },
        { "refine-poses", 1, 0, REFINE }, { "seed", 1, 0, SEED }, { "threads", 1, 0, THREADS }, { "json", 0, 0, JSON }, { "help", 0, 0, 'h' }, { 0 },
    };
    fit_options o = { .use_masks = 1, .checkpoint_seconds = 30 };
    const preset *p = &PRESETS[2];
    int c, ok = 1, steps = 0, rounds = 0, cells = 0, long_side = 0, threads = 0;
    double seed = 1;
    unsigned without = 0;
    for (int which = 0; (c = getopt_long(argc, argv, "o:h", LONG, &which)) != -1;) {
        range[0] = 0;
        switch (c) {
        case 'o': ok = (size_t)snprintf(o.output, sizeof o.output, "%s", optarg) < sizeof o.output; break;
        case PRESET:
            p = NULL;
            for (size_t i = 0; i < sizeof PRESETS / sizeof *PRESETS; i++) if (!strcmp(PRESETS[i].name, optarg)) p = &PRESETS[i];
            if (!p) { fprintf(stderr, "oriel-train fit: --preset %s: demo, quick, standard or full\n", optarg); return 2; }
            break;
        case LIGHT:
            ok = !strcmp(optarg, "paper") || !strcmp(optarg, "oriel");
            if (optarg[0] == 'p') without |= LIGHT_PAPER;
            break;
        case WITHOUT: ok = left_out(optarg, &without); break;
        case METHOD: ok = (o.nerfw = !strcmp(optarg, "nerfw")) || !strcmp(optarg, "oriel"); break;
        case ENCODING:
            ok = 0;
            for (int k = 0; k < ENC_KINDS; k++) if (!strcmp(optarg, ENC_NAME[k])) { o.encoding = (enc_kind)k; ok = 1; }
            break;
        case SNAPSHOTS: ok = minutes(optarg, o.snapshot); break;
        case RESUME: o.resume = 1; break;
        case STAGE2: o.stage2 = 1; break;
        case BUDGET: ok = number(optarg, 0, 1e6, &o.budget); break;
        case STEPS: ok = whole(optarg, 1, 10000000, &steps); break;
        case ROUNDS: ok = whole(optarg, 1, 100000, &rounds); break;
        case LONG_SIDE: ok = whole(optarg, 64, 8192, &long_side); break;
        case CELLS: ok = whole(optarg, 64, 2048, &cells); break;
        case CHECKPOINT: ok = number(optarg, 0, 1e9, &o.checkpoint_seconds); break;
        case SKY: o.sky = optarg; break;
        case NO_MASKS: o.use_masks = 0; break;
        case REFINE: o.refine = !strcmp(optarg, "on"); ok = o.refine || !strcmp(optarg, "off"); break;
        case SEED: ok = number(optarg, 0, 9e15, &seed) && seed == floor(seed); break;
        case THREADS: ok = whole(optarg, 1, 1024, &threads); break;
        case JSON: o.json = 1; break;
        case 'h': fputs(USAGE, stdout); return 0;
        default: fputs(USAGE, stderr); return 2;
        }
        if (!ok) { fprintf(stderr, "oriel-train fit: --%s: %s is out of range%s (oriel-train fit --help tells more)\n", c == 'o' ? "output" : LONG[which].name, optarg, range); return 2; }
    }
    if (optind + 1 != argc || !o.output[0]) { fputs(USAGE, stderr); return 2; }
    if (o.nerfw && (o.resume || o.stage2)) { fprintf(stderr, "oriel-train fit: --method nerfw neither resumes nor has a stage 2\n"); return 2; }
    if (o.nerfw && without) { fprintf(stderr, "oriel-train fit: --light and --without go with --method oriel\n"); return 2; }
    if (!o.nerfw && (o.encoding || o.snapshot[0] > 0)) { fprintf(stderr, "oriel-train fit: --encoding and --snapshots go with --method nerfw\n"); return 2; }
    snprintf(o.ckpt, sizeof o.ckpt, "%s.ckpt", o.output);
    o.head = (checkpoint_header){ .long_side = long_side ? long_side : p->long_side, .longest = cells ? cells : p->longest, .rays = p->rays, .steps = steps ? steps : p->steps, .pixels = p->pixels, .rounds = rounds ? rounds : p->rounds, .seed = (uint64_t)seed, .without = without };
    ranks_start();
    if (!threads) threads = orl_cores() / ranks_here() > 1 ? orl_cores() / ranks_here() : 1;
    o.head.threads = threads < GRID_THREADS ? threads : GRID_THREADS;
    orl_dataset d;
    orl_err e = check_folder(o.output);
    if (!e) e = orl_dataset_open(argv[optind], warn_line, NULL, &d);
    if (!e) {
        e = o.nerfw ? fit_nerfw(&o, &d) : fit(&o, &d);
        orl_dataset_free(&d);
    }
    if (e && ranks_mine()) sleep(2);            /* what fails on every rank is told by rank 0, which ends the others meanwhile */
    if (e) fprintf(stderr, "oriel-train: %s\n", orl_error_text());
    if (e) ranks_fail();
    ranks_end();
    return e ? 1 : 0;
}
