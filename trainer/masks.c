/* `oriel-train masks`: sky masks as the trainer makes them, written as PNG and compared with given ones. */
#include <errno.h>
#include <getopt.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include "oriel/parallel.h"
#include "oriel/skymask.h"
#include "trainer/commands.h"

typedef struct { double precision, recall, iou; } agreement;     /* NAN where undefined: nothing called sky, no sky there */
typedef struct {
    agreement sure, likely;         /* at > ORL_SKY_SURE, at >= 128 */
    double sky, unknown;            /* shares of the picture */
    int given;
    orl_err err;
    char text[512];                 /* of err */
} result;
typedef struct { const orl_dataset *d; const char *out; int check, long_side; double up[3]; result *r; } job;

static agreement agree(const orl_image *prob, const orl_image *given, int threshold)
{
    double tp = 0, fp = 0, fn = 0;
    for (int i = 0; i < prob->w * prob->h; i++) {
        int truth = given->px[i] == 128, here = prob->px[i] >= threshold;
        tp += truth && here;
        fp += !truth && here;
        fn += truth && !here;
    }
    return (agreement){ tp + fp > 0 ? tp / (tp + fp) : NAN, tp + fn > 0 ? tp / (tp + fn) : NAN, tp + fp + fn > 0 ? tp / (tp + fp + fn) : NAN };
}

static orl_err mask_one(const job *j, uint32_t i, result *r)
{
    const orl_photo *p = &j->d->photos[i];
    orl_image photo = { 0 }, prob = { 0 }, given = { 0 };
    orl_camera cam;
    orl_err e = orl_photo_load(p, j->long_side, &photo, &cam);
    if (e || (e = orl_skymask_photo(j->d, i, &photo, &cam, j->up, NULL, &prob))) goto done;
    size_t sky = 0, unknown = 0, n = (size_t)prob.w * (size_t)prob.h;
    for (size_t k = 0; k < n; k++) {
        sky += prob.px[k] > ORL_SKY_SURE;
        unknown += prob.px[k] <= ORL_SKY_SURE && prob.px[k] >= ORL_SKY_SCENE;
    }
    r->sky = (double)sky / (double)n;
    r->unknown = (double)unknown / (double)n;
    if (j->check && p->mask[0]) {
        if ((e = orl_photo_load_mask(p, prob.w, prob.h, &given))) goto done;
        r->given = 1;
        r->sure = agree(&prob, &given, ORL_SKY_SURE + 1);
        r->likely = agree(&prob, &given, 128);
    }
    if (j->out) {
        char path[2048];
        const char *dot = strrchr(p->name, '.');
        snprintf(path, sizeof path, "%s/%.*s.png", j->out, dot ? (int)(dot - p->name) : (int)strlen(p->name), p->name);
        e = orl_image_write(path, &prob);
    }
done:
    orl_image_free(&photo); orl_image_free(&prob); orl_image_free(&given);
    return e;
}

static void mask_range(void *user, int begin, int end)
{
    const job *j = user;
    for (int i = begin; i < end; i++) {
        result *r = &j->r[i];
        if ((r->err = mask_one(j, (uint32_t)i, r))) snprintf(r->text, sizeof r->text, "%s", orl_error_text());
    }
}

void print_json_string(const char *s)
{
    putchar('"');
    for (; *s; s++) {
        if (*s == '"' || *s == '\\') putchar('\\');
        if ((unsigned char)*s < 32) printf("\\u%04x", (unsigned)*s); else putchar(*s);
    }
    putchar('"');
}

static void print_number(const char *key, double v) { if (isfinite(v)) printf("\"%s\": %.5f", key, v); else printf("\"%s\": null", key); }

static void print_agreement(const char *key, const agreement *a)
{
    printf(", \"%s\": {", key);
    print_number("precision", a->precision); printf(", ");
    print_number("recall", a->recall); printf(", ");
    print_number("iou", a->iou); printf("}");
}

static void print_result(const char *name, const result *r, int json)
{
    if (json) {
        printf("{\"name\": ");
        print_json_string(name);
        printf(", ");
        print_number("sky", r->sky); printf(", ");
        print_number("unknown", r->unknown);
        if (r->given) { print_agreement("sure", &r->sure); print_agreement("likely", &r->likely); }
        putchar('}');
        return;
    }
    printf("%-32s sky %5.1f %%  unknown %4.1f %%", name, 100 * r->sky, 100 * r->unknown);
    if (r->given)
        printf("   > %d: precision %.4f recall %.4f IoU %.4f   >= 128: %.4f %.4f %.4f", ORL_SKY_SURE, r->sure.precision, r->sure.recall, r->sure.iou, r->likely.precision, r->likely.recall, r->likely.iou);
    putchar('\n');
}

static void add(double *sum, int *n, double v) { if (isfinite(v)) { *sum += v; ++*n; } }

/* Means over the photos where a figure is defined. */
static result mean_of(const result *r, uint32_t n)
{
    result m = { 0 };
    double *to[8] = { &m.sure.precision, &m.sure.recall, &m.sure.iou, &m.likely.precision, &m.likely.recall, &m.likely.iou, &m.sky, &m.unknown };
    int count[8] = { 0 };
    for (uint32_t i = 0; i < n; i++) {
        const result *p = &r[i];
        if (p->err) continue;
        const double v[8] = { p->sure.precision, p->sure.recall, p->sure.iou, p->likely.precision, p->likely.recall, p->likely.iou, p->sky, p->unknown };
        for (int k = p->given ? 0 : 6; k < 8; k++) add(to[k], &count[k], v[k]);
        m.given |= p->given;
    }
    for (int k = 0; k < 8; k++) *to[k] = count[k] ? *to[k] / count[k] : NAN;
    return m;
}

static void warn(void *user, const char *line) { (void)user; fprintf(stderr, "oriel-train: %s\n", line); }

static int usage(FILE *f)
{
    fprintf(f,
        "Usage: oriel-train masks SCENE [options]\n"
        "Segments the sky of each photo of a SCENE folder, as `fit` does where no mask is given. Masks are grey: 255 surely sky,\n"
        "0 surely not; fit takes > %d as sky, < %d as scene, the rest as unknown.\n\n"
        "  -o, --output DIR       write DIR/NAME.png (DIR is made)\n"
        "      --check            compare with the given masks (masks/NAME.png, label 128): precision, recall, IoU\n"
        "      --long-side N      size of the masks (default 512; 0: as the photo)\n"
        "      --threads N        (default: one per core)\n"
        "      --json             figures as JSON\n"
        "  -h, --help\n", ORL_SKY_SURE, ORL_SKY_SCENE);
    return f == stdout ? 0 : 2;
}

int cmd_masks(int argc, char **argv)
{
    enum { CHECK = 256, SIDE, THREADS, JSON };
    static const struct option options[] = {
        { "output", 1, 0, 'o' }, { "check", 0, 0, CHECK }, { "long-side", 1, 0, SIDE }, { "threads", 1, 0, THREADS }, { "json", 0, 0, JSON }, { "help", 0, 0, 'h' }, { 0 },
    };
    job j = { .long_side = 512 };
    int json = 0, threads = 0, status = 0;
    for (int c; (c = getopt_long(argc, argv, "o:h", options, NULL)) != -1;) {
        char *end = "";
        long v = c == SIDE || c == THREADS ? strtol(optarg, &end, 10) : 0;
        if (*end || v < 0 || v > ORL_IMAGE_MAX_SIDE) { fprintf(stderr, "oriel-train masks: %s is no number in range\n", optarg); return 2; }
        switch (c) {
        case 'o': j.out = optarg; break;
        case CHECK: j.check = 1; break;
        case SIDE: j.long_side = (int)v; break;
        case THREADS: threads = (int)v; break;
        case JSON: json = 1; break;
        case 'h': return usage(stdout);
        default: return usage(stderr);
        }
    }
    if (optind + 1 != argc) return usage(stderr);
    orl_dataset d;
    if (orl_dataset_open(argv[optind], warn, NULL, &d)) { fprintf(stderr, "oriel-train: %s\n", orl_error_text()); return 1; }
    j.d = &d;
    j.r = calloc(d.nphotos + 1, sizeof *j.r);
    if (!j.r) { fprintf(stderr, "oriel-train: no memory for %u photos\n", d.nphotos); status = 1; goto done; }
    if (orl_skymask_up(&d, j.up)) { fprintf(stderr, "oriel-train: %s\n", orl_error_text()); status = 1; goto done; }
    if (j.out && mkdir(j.out, 0777) && errno != EEXIST) { fprintf(stderr, "oriel-train: %s: %s\n", j.out, strerror(errno)); status = 1; goto done; }
    orl_parallel(threads, (int)d.nphotos, 1, mask_range, &j);

    if (json) { printf("{\"scene\": "); print_json_string(d.name); printf(", \"photos\": ["); }
    int given = 0, printed = 0;
    for (uint32_t i = 0; i < d.nphotos; i++) {
        const result *r = &j.r[i];
        given += r->given;
        if (r->err) { fprintf(stderr, "oriel-train: %s\n", r->text); status = 1; continue; }
        if (json && printed++) printf(", ");
        print_result(d.photos[i].name, r, json);
    }
    result mean = mean_of(j.r, d.nphotos);
    if (json) printf("], \"mean\": ");
    print_result("mean", &mean, json);
    if (json) puts("}");
    if (j.check && !given) { fprintf(stderr, "oriel-train: %s has no masks to check against\n", d.dir); status = 1; }
done:
    free(j.r);
    orl_dataset_free(&d);
    return status;
}
