/* `oriel-train eval`: the half-photo protocol. A test photo's left half goes in, the whole picture comes out, the right half is scored:
 * by the exported scene in fixed point, by the trainer's model in float, and by trivial baselines. Also scores against ground truth (truth.h). */
#include "trainer/eval.h"
#include <errno.h>
#include <getopt.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>
#include "oriel/cpu.h"
#include "trainer/commands.h"
#include "trainer/truth.h"

enum { GAP = 4 };
const char *const EVAL_NAMES[EVAL_COLUMNS] = { "fixed", "float", "nerfw", "row_mean", "nearest_warp", "median_warp" };

/* ---- the half-photo protocol ---- */

typedef struct {
    const char *dir, *scene, *checkpoint, *nerfw, *out, *photo;
    int long_side, limit, threads, json, full_adapt, baselines_only, geometry, factors, kiosk;
} options;

static void warn(void *user, const char *line) { (void)user; fprintf(stderr, "%s\n", line); }

orl_err eval_score(const orl_image *photo, const eval_prediction *p, eval_row *r)
{
    orl_imagef truth = { 0 }, test = { 0 };
    orl_err e = orl_image_to_float(photo, &truth);
    for (int k = 0; !e && k < EVAL_COLUMNS; k++) {
        if (!p->rgb[k].px) continue;
        e = orl_image_to_float(&p->rgb[k], &test);
        if (!e) e = orl_metrics_score(&truth, &test, photo->w / 2, photo->w, &r->right[k]);
        if (!e) e = orl_metrics_score(&truth, &test, 0, photo->w, &r->full[k]);
        r->has[k] = 1;
        orl_imagef_free(&test);
    }
    orl_imagef_free(&truth);
    return e;
}

/* The photo and every prediction side by side, white between, as DIR/NAME.png. */
static orl_err write_sheet(const char *dir, const char *name, const orl_image *photo, const eval_prediction *p)
{
    const orl_image *im[EVAL_COLUMNS + 1] = { photo };
    int n = 1;
    for (int k = 0; k < EVAL_COLUMNS; k++)
        if (p->rgb[k].px) im[n++] = &p->rgb[k];
    orl_image sheet;
    orl_err e = orl_image_alloc(&sheet, n * (photo->w + GAP) - GAP, photo->h, 3);
    if (e) return e;
    memset(sheet.px, 255, (size_t)sheet.w * (size_t)sheet.h * 3);
    for (int k = 0; k < n; k++)
        for (int y = 0; y < photo->h; y++)
            memcpy(sheet.px + ((size_t)y * (size_t)sheet.w + (size_t)(k * (photo->w + GAP))) * 3,
                   im[k]->px + (size_t)y * (size_t)photo->w * 3, (size_t)photo->w * 3);
    char path[4096], stem[256];
    snprintf(stem, sizeof stem, "%s", name);
    char *dot = strrchr(stem, '.');
    if (dot) *dot = 0;
    snprintf(path, sizeof path, "%s/%s.png", dir, stem);
    e = orl_image_write(path, &sheet);
    orl_image_free(&sheet);
    return e;
}

static void json_scores(const orl_score *s, const int *has)
{
    const char *comma = "";
    for (int k = 0; k < EVAL_COLUMNS; k++) {
        if (!has[k]) continue;
        printf("%s\"%s\": {\"psnr\": %.4f, \"ssim\": %.4f, \"flip\": %.4f}", comma, EVAL_NAMES[k], s[k].psnr, s[k].ssim, s[k].flip);
        comma = ", ";
    }
}

static void print_json(const char *scene, const options *o, const eval_row *rows, int n, const eval_row *mean)
{
    printf("{\"scene\": ");
    print_json_string(scene);
    printf(", \"protocol\": \"%s, %d px long side, right half scored\", \"photos\": [",
           o->full_adapt ? "adapted on the whole photo" : "half-photo", o->long_side);
    for (int i = 0; i < n; i++) {
        printf("%s{\"name\": ", i ? ", " : "");
        print_json_string(rows[i].name);
        printf(", ");
        json_scores(rows[i].right, rows[i].has);
        putchar('}');
    }
    printf("], \"mean\": {");
    json_scores(mean->right, mean->has);
    printf("}, \"mean_full\": {");
    json_scores(mean->full, mean->has);
    printf("}}\n");
}

static void print_line(const char *name, const orl_score *s, const int *has)
{
    printf("%-28.28s", name);
    for (int k = 0; k < EVAL_COLUMNS; k++)
        if (has[k]) printf("  %6.2f %6.4f %6.4f", s[k].psnr, s[k].ssim, s[k].flip);
    printf("\n");
}

static void print_head(const int *has)
{
    printf("%-28s", "right half");
    for (int k = 0; k < EVAL_COLUMNS; k++)
        if (has[k]) printf("  %-20s", EVAL_NAMES[k]);
    printf("\n%-28s", "");
    for (int k = 0; k < EVAL_COLUMNS; k++)
        if (has[k]) printf("  %6s %6s %6s", "PSNR", "SSIM", "FLIP");
    printf("\n");
}

static void add(orl_score *sum, const orl_score *s, double f)
{
    sum->psnr += f * s->psnr;
    sum->ssim += f * s->ssim;
    sum->flip += f * s->flip;
}

eval_row eval_mean(const eval_row *rows, int n)
{
    eval_row mean = { 0 };
    if (n) memcpy(mean.has, rows[0].has, sizeof mean.has);
    for (int i = 0; i < n; i++)
        for (int k = 0; k < EVAL_COLUMNS; k++) {
            add(&mean.right[k], &rows[i].right[k], 1.0 / n);
            add(&mean.full[k], &rows[i].full[k], 1.0 / n);
        }
    return mean;
}

static orl_err half_photo(const options *o, const orl_dataset *data, const orl_scene *scene, const orl_model *model, const nerfw *nerf)
{
    baselines base = { 0 };
    eval_row *rows = calloc(data->nphotos + 1u, sizeof *rows), mean = { 0 };
    int n = 0;
    orl_err e = rows ? baselines_open(data, o->long_side, &base) : orl_fail(ORL_E_MEMORY, "eval: no memory for scores");
    eval_setup setup = { .scene = scene, .model = model, .nerfw = nerf, .base = &base, .cpu = orl_cpu_detect(), .threads = o->threads };
    if (!e && o->out && mkdir(o->out, 0777) && errno != EEXIST)
        e = orl_fail(ORL_E_IO, "%s: cannot make the folder: %s", o->out, strerror(errno));
    for (uint32_t i = 0; !e && i < data->nphotos && (!o->limit || n < o->limit); i++) {
        const orl_photo *p = &data->photos[i];
        if (!p->test || (o->photo && strcmp(o->photo, p->name))) continue;
        orl_image photo;
        orl_camera cam;
        eval_prediction pred;
        if (orl_photo_load(p, o->long_side, &photo, &cam)) {
            fprintf(stderr, "%s: left out: %s\n", p->name, orl_error_text());
            continue;
        }
        rows[n].name = p->name;
        e = eval_predict(&setup, &cam, &p->pose, &photo, o->full_adapt ? photo.w : photo.w / 2, &pred);
        if (!e) {
            e = eval_score(&photo, &pred, &rows[n]);
            if (!e && o->out) e = write_sheet(o->out, p->name, &photo, &pred);
            eval_prediction_free(&pred);
        }
        if (!e && !o->json) {
            if (!n) print_head(rows[n].has);
            print_line(p->name, rows[n].right, rows[n].has);
            fflush(stdout);
        } else if (!e && isatty(STDERR_FILENO)) {
            fprintf(stderr, "%s\n", p->name);
        }
        orl_image_free(&photo);
        n += !e;
    }
    if (!e && !n)
        e = o->photo ? orl_fail(ORL_E_RANGE, "%s: no test photo %s", o->dir, o->photo)
                     : orl_fail(ORL_E_RANGE, "%s: no test photos (split.tsv names them)", o->dir);
    if (!e) {
        mean = eval_mean(rows, n);
        if (o->json) {
            print_json(data->name, o, rows, n, &mean);
        } else {
            print_line("mean", mean.right, mean.has);
            print_line("mean, whole picture", mean.full, mean.has);
        }
    }
    baselines_close(&base);
    free(rows);
    return e;
}

/* ---- against ground truth ---- */

static orl_err against_truth(const options *o, const orl_dataset *d, const orl_scene *s)
{
    figure f[TRUTH_FIGURES];
    truth_options t = { o->checkpoint, o->long_side, o->full_adapt, o->threads };
    int n = 0;
    orl_err e = ORL_OK;
    if (o->geometry) e = truth_geometry(d, s, &t, f, &n);
    if (!e && o->factors) e = truth_factors(d, s, &t, f, &n);
    if (!e && o->kiosk) e = truth_kiosk(d, s, &t, f, &n);
    if (e) return e;
    if (o->json) {
        printf("{\"scene\": ");
        print_json_string(d->name);
        for (int i = 0; i < n; i++) printf(", \"%s\": %.*f", f[i].key, f[i].digits, f[i].v);
        printf("}\n");
    } else {
        for (int i = 0; i < n; i++) printf("%-20s %.*f\n", f[i].key, f[i].digits, f[i].v);
    }
    return ORL_OK;
}

/* ---- command ---- */

static const char HELP[] =
    "usage: oriel-train eval SCENE --scene F | --nerfw G [options]\n"
    "Scores the right half of test photos, predicted from the left half.\n"
    "      --scene F         exported scene (column fixed)\n"
    "      --checkpoint F    float model (column float); default: the scene's name with .ckpt appended\n"
    "      --nerfw G         baseline made by `fit --method nerfw` (column nerfw), beside the scene or alone\n"
    "      --baselines-only  no scene needed\n"
    "      --photo NAME      this test photo only\n"
    "      --limit N         the first N test photos\n"
    "      --long-side N     pixels, default 512\n"
    "      --full-adapt      adaptation and baselines see the whole photo (no fair figure)\n"
    "      --out DIR         writes the photo and each prediction side by side\n"
    "      --geometry        depth, normals, sky against SCENE/gt instead, SfM points held out from training, and\n"
    "                        transients against SCENE/masks; each where the SCENE and the checkpoint have what it takes\n"
    "      --factors         base colour, sun, views under other skies against SCENE/gt instead\n"
    "      --kiosk           SCENE/kiosk, a clip, through the loop of `oriel run` instead: widened frames, sun, flicker\n"
    "      --threads N       default: one per core\n"
    "      --json            figures as JSON\n";

static int number(const char *text, int lo, int hi, int *out)
{
    char *end;
    long v = strtol(text, &end, 10);
    if (*end || end == text || v < lo || v > hi) return 0;
    *out = (int)v;
    return 1;
}

int cmd_eval(int argc, char **argv)
{
    enum { SCENE = 256, CHECKPOINT, BASELINES, PHOTO, LIMIT, LONG_SIDE, FULL, OUT, GEOMETRY, FACTORS, KIOSK, THREADS, JSON,
           NERFW, REALISM, HELP_ME };
    static const struct option longs[] = {
        { "scene", 1, 0, SCENE }, { "checkpoint", 1, 0, CHECKPOINT }, { "baselines-only", 0, 0, BASELINES }, { "photo", 1, 0, PHOTO },
        { "limit", 1, 0, LIMIT }, { "long-side", 1, 0, LONG_SIDE }, { "full-adapt", 0, 0, FULL }, { "out", 1, 0, OUT },
        { "geometry", 0, 0, GEOMETRY }, { "factors", 0, 0, FACTORS }, { "kiosk", 0, 0, KIOSK }, { "threads", 1, 0, THREADS },
        { "json", 0, 0, JSON }, { "nerfw", 1, 0, NERFW }, { "realism", 1, 0, REALISM }, { "help", 0, 0, HELP_ME }, { 0 },
    };
    options o = { .long_side = 512 };
    int c, ok = 1;
    optind = 0;
    while ((c = getopt_long(argc, argv, "", longs, NULL)) != -1) switch (c) {
        case SCENE: o.scene = optarg; break;
        case CHECKPOINT: o.checkpoint = optarg; break;
        case BASELINES: o.baselines_only = 1; break;
        case PHOTO: o.photo = optarg; break;
        case LIMIT: ok &= number(optarg, 1, 1000000, &o.limit); break;
        case LONG_SIDE: ok &= number(optarg, 32, ORL_IMAGE_MAX_SIDE, &o.long_side); break;
        case FULL: o.full_adapt = 1; break;
        case OUT: o.out = optarg; break;
        case GEOMETRY: o.geometry = 1; break;
        case FACTORS: o.factors = 1; break;
        case KIOSK: o.kiosk = 1; break;
        case THREADS: ok &= number(optarg, 1, 64, &o.threads); break;
        case JSON: o.json = 1; break;
        case HELP_ME: fputs(HELP, stdout); return 0;
        case NERFW: o.nerfw = optarg; break;
        case REALISM:
            fprintf(stderr, "oriel-train eval: --realism is not built yet\n");
            return 2;
        default: return 2;
        }
    if (!ok || optind != argc - 1) {
        fprintf(stderr, !ok ? "oriel-train eval: a number is out of range\n" : "oriel-train eval: one SCENE folder wanted; see --help\n");
        return 2;
    }
    o.dir = argv[optind];
    int truth = o.geometry || o.factors || o.kiosk;
    if (truth ? !o.scene || o.baselines_only : (o.scene || o.nerfw) == o.baselines_only) {
        fprintf(stderr, "oriel-train eval: --scene F wanted%s\n", truth ? "" : ", or --nerfw G, or else --baselines-only");
        return 2;
    }

    orl_dataset data = { 0 };
    orl_scene scene = { 0 };
    orl_model *model = NULL;
    nerfw nerf = { 0 };
    char checkpoint[4096];
    orl_err e = orl_dataset_open(o.dir, warn, NULL, &data);
    if (e) goto done;
    if (o.scene && (e = orl_scene_open(o.scene, &scene))) goto done;
    if (o.scene && !o.checkpoint) {
        snprintf(checkpoint, sizeof checkpoint, "%s.ckpt", o.scene);
        if (access(checkpoint, R_OK)) fprintf(stderr, "%s: no checkpoint, what needs it is left out\n", checkpoint);
        else o.checkpoint = checkpoint;
    }
    if (truth) {
        e = against_truth(&o, &data, &scene);
        goto done;
    }
    if (o.checkpoint && (e = orl_model_load(o.checkpoint, &model))) goto done;
    if (o.nerfw && (e = nerfw_load(o.nerfw, &nerf))) goto done;
    e = half_photo(&o, &data, o.scene ? &scene : NULL, model, o.nerfw ? &nerf : NULL);
done:
    if (e) fprintf(stderr, "oriel-train: %s\n", orl_error_text());
    if (model) orl_model_free(model);
    nerfw_free(&nerf);
    orl_scene_close(&scene);
    orl_dataset_free(&data);
    return e ? 1 : 0;
}
