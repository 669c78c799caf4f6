/* `oriel-train sky`: the sky decoder and the light's prior, learned from parametric skies and HDR panoramas. In: panoramas and the split.tsv beside them. Out: a .oriel file with only the
 * sky sections. Panoramas named test there, and those that light the scene `basilica`, train nothing and are used to state the error. */
#include "trainer/sky.h"
#include <dirent.h>
#include <getopt.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/stat.h>
#include "oriel/dataset.h"
#include "oriel/scene.h"
#include "trainer/commands.h"

enum { PARAMETRIC = 384, VARIANTS = 24, MOST_VARIANTS = 3600, MOST_PANORAMAS = 1024 };

/* ---- a panorama ---- */

static double lum(const float *p) { return 0.2126 * p[0] + 0.7152 * p[1] + 0.0722 * p[2]; }

static void ray(const orl_imagef *im, int x, int y, double d[3])           /* seen from inside: to the right is clockwise, that is, decreasing azimuth */
{
    double el = M_PI / 2 - (y + 0.5) * M_PI / im->h, az = -(x + 0.5) * 2 * M_PI / im->w;
    d[0] = cos(el) * cos(az); d[1] = cos(el) * sin(az); d[2] = sin(el);
}

static double pixel_area(const orl_imagef *im, int y) { return 2 * M_PI / im->w * (cos(y * M_PI / im->h) - cos((y + 1) * M_PI / im->h)); }

/* Finds the brightest spot of the upper half; what stands well above the ring around it is taken out of the picture and summed as the sun's irradiance. */
static void cut_sun(orl_imagef *im, double dir[3], double irradiance[3])
{
    const double lobe = cos(7 * M_PI / 180), ring = cos(14 * M_PI / 180);
    double best = -1, d[3], around[3] = { 0 }, n = 0;
    for (int y = 1; y < im->h / 2; y++)
        for (int x = 0; x < im->w; x++) {
            double s = 0;
            for (int j = -1; j <= 1; j++) for (int i = -1; i <= 1; i++) s += lum(im->px + 3 * ((size_t)(y + j) * (size_t)im->w + (size_t)((x + i + im->w) % im->w)));
            if (s > best) { best = s; ray(im, x, y, dir); }
        }
    for (int pass = 0; pass < 2; pass++)
        for (int y = 0; y < im->h / 2; y++)
            for (int x = 0; x < im->w; x++) {
                ray(im, x, y, d);
                double c = d[0] * dir[0] + d[1] * dir[1] + d[2] * dir[2], area = pixel_area(im, y);
                float *p = im->px + 3 * ((size_t)y * (size_t)im->w + (size_t)x);
                if (pass == 0 && c < lobe && c > ring) { for (int k = 0; k < 3; k++) around[k] += p[k] * area; n += area; }
                if (pass == 1 && c >= lobe && lum(p) > 3 * (0.2126 * around[0] + 0.7152 * around[1] + 0.0722 * around[2]) / n)
                    for (int k = 0; k < 3; k++) {
                        irradiance[k] += fmax(p[k] - around[k] / n, 0) * area;
                        p[k] = (float)(around[k] / n);
                    }
            }
}

orl_err sky_from_panorama(const char *path, orl_sky *out, double *azimuth)
{
    orl_imagef im;
    orl_err e = orl_oiio_read_float(path, &im);
    if (e) return e;
    double dir[3] = { 1, 0, 0 }, sun[3] = { 0 }, mean = 0;
    static const orl_sky zero;
    orl_sky s = zero;
    if (im.h < 64 || im.w < 2 * im.h - 2 || im.w > 2 * im.h + 2) { e = orl_fail(ORL_E_FORMAT, "%s: %d x %d is not an equirectangular panorama (2:1, at least 64 rows)", path, im.w, im.h); goto done; }
    size_t n = (size_t)im.w * (size_t)im.h * 3;
    for (size_t i = 0; i < n; i++) { if (!(im.px[i] >= 0)) im.px[i] = 0; if (im.px[i] > 1e7f) im.px[i] = 1e7f; }
    cut_sun(&im, dir, sun);
    double az_sun = atan2(dir[1], dir[0]), total[ORL_ENV][3] = { { 0 } }, area[ORL_ENV] = { 0 };
    for (int y = 0; y < im.h / 2; y++)
        for (int x = 0; x < im.w; x++) {
            double az = remainder(-(x + 0.5) * 2 * M_PI / im.w - az_sun, 2 * M_PI), a = pixel_area(&im, y);
            int w = y * 2 * ORL_ENV_ROWS / im.h * ORL_ENV_COLS + ((int)floor((az + M_PI) / (2 * M_PI) * ORL_ENV_COLS) & (ORL_ENV_COLS - 1));
            const float *p = im.px + 3 * ((size_t)y * (size_t)im.w + (size_t)x);
            for (int c = 0; c < 3; c++) { total[w][c] += p[c] * a; mean += p[c] * a / (6 * M_PI); }
            area[w] += a;
        }
    if (!(mean > 1e-9)) { e = orl_fail(ORL_E_DEGENERATE, "%s: the sky is black", path); goto done; }
    /* Nothing is darker than a thousandth of the mean: sensors and scans have no say below. */
    for (int w = 0; w < ORL_ENV; w++) for (int c = 0; c < 3; c++) s.log_env[w][c] = (float)log(fmax(total[w][c] / (area[w] > 0 ? area[w] : 1), 1e-3 * mean));
    for (int c = 0; c < 3; c++) s.ln_sun[c] = (float)log(fmax(sun[c], 5e-3 * M_PI * mean));
    s.sun_el = (float)asin(fmin(fmax(dir[2], -1), 1));
    orl_sky_expose(&s, 0, 0);
    *out = s;
    if (azimuth) *azimuth = remainder(az_sun + M_PI, 2 * M_PI);     /* ray counts from the left rim */
done:
    orl_imagef_free(&im);
    return e;
}

void sky_mirror(orl_sky *s)
{
    for (int r = 0; r < ORL_ENV_ROWS; r++)
        for (int c = 0; c < ORL_ENV_COLS / 2; c++)
            for (int k = 0; k < 3; k++) {
                float *a = &s->log_env[r * ORL_ENV_COLS + c][k], *b = &s->log_env[r * ORL_ENV_COLS + ORL_ENV_COLS - 1 - c][k], t = *a;
                *a = *b;
                *b = t;
            }
}

int sky_split(const char *path)
{
    const char *slash = strrchr(path, '/'), *name = slash ? slash + 1 : path;
    char tsv[1100], line[1024], file[256], split[64], dataset[64];
    snprintf(tsv, sizeof tsv, "%.*ssplit.tsv", (int)(name - path), path);
    FILE *f = fopen(tsv, "r");
    int role = SKY_TRAIN;
    while (f && fgets(line, sizeof line, f))
        if (sscanf(line, "%255[^\t]\t%*[^\t]\t%63[^\t]\t%63[^\t\r\n]", file, split, dataset) == 3 && !strcmp(file, name)) role = !strcmp(split, "test") ? SKY_TEST : !strcmp(dataset, "basilica") ? SKY_BASILICA : SKY_TRAIN;
    if (f) fclose(f);
    return role;
}

/* ---- the command ---- */

typedef struct { char path[1100]; int role; orl_sky sky; } panorama;

static int by_path(const void *a, const void *b) { return strcmp(((const panorama *)a)->path, ((const panorama *)b)->path); }

static void add(panorama *p, int *n, const char *dir, const char *name)
{
    if (*n < MOST_PANORAMAS) snprintf(p[(*n)++].path, sizeof p->path, "%s%s%s", dir ? dir : "", dir ? "/" : "", name);
}

static orl_err gather(char **args, int count, panorama *p, int *n)
{
    for (int i = 0; i < count; i++) {
        struct stat st;
        if (stat(args[i], &st)) return orl_fail(ORL_E_IO, "%s: no such file or folder", args[i]);
        DIR *d = S_ISDIR(st.st_mode) ? opendir(args[i]) : NULL;
        if (!d) { add(p, n, NULL, args[i]); continue; }
        for (struct dirent *f; (f = readdir(d));) {
            const char *dot = strrchr(f->d_name, '.');
            if (dot && dot > f->d_name && (!strcasecmp(dot, ".hdr") || !strcasecmp(dot, ".exr"))) add(p, n, args[i], f->d_name);
        }
        closedir(d);
    }
    qsort(p, (size_t)*n, sizeof *p, by_path);
    return *n ? ORL_OK : orl_fail(ORL_E_DEGENERATE, "%s: no .hdr or .exr panorama", args[0]);
}

static const char USAGE[] =
    "usage: oriel-train sky PANORAMAS...|FOLDER -o sky.oriel [options]\n"
    "Learns the sky decoder from parametric skies and from HDR panoramas. Rows named test in split.tsv beside them train nothing.\n"
    "  -o, --output F        the decoder\n"
    "      --include-basilica  train on the panoramas of dataset basilica too (no figures on that scene then)\n"
    "      --json            figures as one JSON object on standard output\n"
    "      --help\n";

int cmd_sky(int argc, char **argv)
{
    enum { BASILICA = 256, JSON };
    static const struct option LONG[] = { { "output", 1, 0, 'o' }, { "include-basilica", 0, 0, BASILICA }, { "json", 0, 0, JSON }, { "help", 0, 0, 'h' }, { 0 } };
    const char *output = NULL;
    int c, basilica = 0, json = 0, n = 0, kept = 0, train = 0;
    while ((c = getopt_long(argc, argv, "o:h", LONG, NULL)) != -1) switch (c) {
        case 'o': output = optarg; break;
        case BASILICA: basilica = 1; break;
        case JSON: json = 1; break;
        case 'h': fputs(USAGE, stdout); return 0;
        default: fputs(USAGE, stderr); return 2;
    }
    if (!output || optind >= argc) { fputs(USAGE, stderr); return 2; }

    panorama *p = calloc(MOST_PANORAMAS, sizeof *p);
    orl_sky *skies = malloc((PARAMETRIC + MOST_VARIANTS) * sizeof *skies);
    orl_scene *scene = calloc(1, sizeof *scene);
    orl_light_model *plain = malloc(sizeof *plain);
    orl_err e = p && skies && scene && plain ? ORL_OK : orl_fail(ORL_E_MEMORY, "sky: no memory");
    if (!e) e = gather(argv + optind, argc - optind, p, &n);
    for (int i = 0; !e && i < n; i++) {
        if (sky_from_panorama(p[i].path, &p[i].sky, NULL)) { fprintf(stderr, "sky: left out: %s\n", orl_error_text()); continue; }
        p[i].role = sky_split(p[i].path);
        if (p[i].role == SKY_BASILICA && basilica) p[i].role = SKY_TRAIN;
        train += p[i].role == SKY_TRAIN;
        p[kept++] = p[i];
    }
    if (!e && !kept) e = orl_fail(ORL_E_DEGENERATE, "none of %d panoramas can be used", n);
    if (e) goto done;
    size_t count = 0;
    for (uint32_t i = 0; i < PARAMETRIC; i++) orl_sky_parametric(i, &skies[count++]);
    uint32_t variants = train && MOST_VARIANTS / train < VARIANTS ? (uint32_t)(MOST_VARIANTS / train) : VARIANTS;
    for (int i = 0; i < kept; i++)
        for (uint32_t v = 0; p[i].role == SKY_TRAIN && v < variants; v++) {
            uint32_t id = 0x40000000u + (uint32_t)i * VARIANTS + v;
            orl_sky *s = &skies[count++];
            *s = p[i].sky;
            if (v & 1) sky_mirror(s);
            orl_sky_expose(s, 0.7f * orl_sky_normal(id, 1), 0.12f * orl_sky_normal(id, 2));
        }
    fprintf(stderr, "sky: %d parametric skies, %d panoramas of %d in %u variants each\n", PARAMETRIC, train, kept, variants);
    if ((e = orl_sky_fit(skies, count, &scene->light))) goto done;

    orl_light_model_default(plain);
    double sum[3][3] = { { 0 } };
    int number[3] = { 0 };
    static const char *const ROLE[] = { "train", "test", "left out" };
    for (int i = 0; i < kept; i++) {
        float z[ORL_ENV_DIM], r[3] = { orl_sky_project(&scene->light, &p[i].sky, NULL), orl_sky_project(plain, &p[i].sky, z), orl_sky_project(&scene->light, &p[i].sky, z) };
        const char *slash = strrchr(p[i].path, '/');
        fprintf(stderr, "  %-36s %-8s  sun %5.1f deg, ln %5.2f %5.2f %5.2f  rms ln radiance: mean %.3f, parametric decoder %.3f, this %.3f\n", slash ? slash + 1 : p[i].path, ROLE[p[i].role],
                p[i].sky.sun_el * 180 / M_PI, (double)p[i].sky.ln_sun[0], (double)p[i].sky.ln_sun[1], (double)p[i].sky.ln_sun[2], (double)r[0], (double)r[1], (double)r[2]);
        for (int k = 0; k < 3; k++) sum[p[i].role][k] += r[k];
        number[p[i].role]++;
    }
    for (int role = 0; role < 3; role++)
        if (number[role]) fprintf(stderr, "%s (%d): mean %.3f, parametric decoder %.3f, this %.3f\n", ROLE[role], number[role], sum[role][0] / number[role], sum[role][1] / number[role], sum[role][2] / number[role]);
    snprintf(scene->title, sizeof scene->title, "sky decoder, %d panoramas", train);
    size_t bytes = 0;
    if ((e = orl_scene_write(output, scene, &bytes))) goto done;
    fprintf(stderr, "%s: %zu bytes\n", output, bytes);
    double held = number[1] + number[2] > 0 ? number[1] + number[2] : 1;
    if (json)
        printf("{\"panoramas\": %d, \"held_out\": %d, \"rms_mean\": %.4f, \"rms_parametric\": %.4f, \"rms\": %.4f, \"bytes\": %zu}\n", train, number[1] + number[2],
               (sum[1][0] + sum[2][0]) / held, (sum[1][1] + sum[2][1]) / held, (sum[1][2] + sum[2][2]) / held, bytes);
done:
    if (e) fprintf(stderr, "oriel-train: %s\n", orl_error_text());
    free(p);
    free(skies);
    free(scene);
    free(plain);
    return e ? 1 : 0;
}
