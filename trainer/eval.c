/* `oriel-train eval`: the half-photo protocol. A test photo's left half goes in, the whole picture comes out, the right half is scored:
 * by the exported scene in fixed point, by the trainer's model in float, and by trivial baselines. Also scores against ground truth, where
 * a SCENE has a gt/ folder (--geometry, --factors) or a recorded clip with the wide truth (--kiosk). */
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
#include "oriel/skymask.h"
#include "oriel/view.h"
#include "trainer/commands.h"
#include "trainer/checkpoint.h"
#include "trainer/order.h"
#include "trainer/transient.h"

enum { PIXELS = 3000, GAP = 4 };
const char *const EVAL_NAMES[EVAL_COLUMNS] = { "fixed", "float", "nerfw", "row_mean", "nearest_warp", "median_warp" };

/* ---- prediction ---- */

static void *aligned(size_t bytes) { return aligned_alloc(64, (bytes + 63) & ~(size_t)63); }

static orl_err cut(const orl_image *photo, int w, orl_image *out)
{
    orl_image im;
    orl_err e = orl_image_alloc(&im, w, photo->h, 3);
    if (e) return e;
    for (int y = 0; y < photo->h; y++) memcpy(im.px + (size_t)y * (size_t)w * 3, photo->px + (size_t)y * (size_t)photo->w * 3, (size_t)w * 3);
    *out = im;
    return ORL_OK;
}

/* Pixels that adaptation looks at: one in each cell of a square lattice, its place a hash of the cell. */
typedef struct { int x, y; } spot;
static int pick(int w, int h, spot *out, int cap)
{
    int cell = (int)ceil(sqrt((double)w * h / PIXELS)), n = 0;
    for (int y = 0; y < h; y += cell)
        for (int x = 0; x < w && n < cap; x += cell) {
            uint32_t k = (uint32_t)(y * 65537 + x) * 2654435761u;
            k = (k ^ (k >> 15)) * 2246822519u;
            spot p = { x + (int)((k >> 8) % (unsigned)cell), y + (int)((k >> 20) % (unsigned)cell) };
            if (p.x < w && p.y < h) out[n++] = p;
        }
    return n;
}

static void observe(const orl_image *known, spot p, orl_sample *s)
{
    const uint8_t *px = known->px + ((size_t)p.y * (size_t)known->w + (size_t)p.x) * 3;
    for (int c = 0; c < 3; c++) s->rgb[c] = (float)px[c] / 255;
    s->weight = 1;
}

static orl_err adapt(const orl_light_model *m, const orl_sample *s, int n, orl_adapt_result *out)
{
    size_t need = orl_adapt_need();
    void *work = aligned(need);
    orl_adapt_options opt = orl_adapt_defaults();
    orl_err e = work ? orl_adapt(m, s, (size_t)n, NULL, &opt, work, need, out) : orl_fail(ORL_E_MEMORY, "eval: no memory for adaptation");
    free(work);
    return e;
}

static orl_err open_view(const orl_scene *s, const orl_camera *cam, const orl_pose *pose, int supersample, int threads, orl_view *v, void **mem)
{
    size_t need = orl_view_need(cam->w, cam->h);
    *mem = aligned(need);
    if (!*mem) return orl_fail(ORL_E_MEMORY, "eval: no memory for a view of %d x %d", cam->w, cam->h);
    return orl_view_build(s, cam, pose, supersample, threads, *mem, need, v);
}

static orl_err adapt_view(const orl_scene *s, const orl_view *v, const orl_image *known, orl_adapt_result *out)
{
    int cap = 2 * PIXELS;
    spot *at = malloc((size_t)cap * sizeof *at);
    orl_sample *sample = calloc((size_t)cap, sizeof *sample);
    orl_err e = ORL_OK;
    if (at && sample) {
        int n = pick(known->w, known->h, at, cap);
        for (int i = 0; i < n; i++) {
            orl_view_sample(v, at[i].x, at[i].y, &sample[i]);
            observe(known, at[i], &sample[i]);
        }
        e = adapt(&s->light, sample, n, out);
    } else {
        e = orl_fail(ORL_E_MEMORY, "eval: no memory for samples");
    }
    free(at); free(sample);
    return e;
}

static orl_err shade_view(orl_view *v, const orl_light *light, unsigned cpu, orl_image *out)
{
    size_t need = orl_view_light_need();
    void *mem = aligned(need);
    orl_image im = { 0 };
    orl_err e = mem ? orl_image_alloc(&im, v->w, v->h, 3) : orl_fail(ORL_E_MEMORY, "eval: no memory for a light");
    if (!e) {
        orl_view_light *l = orl_view_light_make(v, light, mem, need);
        if (l) {
            orl_view_relight(v, l, cpu, 0, v->h);
            orl_view_shade(v, l, cpu, 0, v->h, im.px, (size_t)v->w * 3);
            *out = im;
        } else {
            orl_image_free(&im);
            e = orl_fail(ORL_E_MEMORY, "eval: light block too small");
        }
    }
    free(mem);
    return e;
}

static orl_err predict_fixed(const eval_setup *s, const orl_camera *cam, const orl_pose *pose, const orl_image *known,
                             orl_adapt_result *fit, orl_image *out)
{
    orl_view v;
    void *mem = NULL;
    orl_light *light = malloc(sizeof *light);
    orl_err e = light ? open_view(s->scene, cam, pose, 2, s->threads, &v, &mem) : orl_fail(ORL_E_MEMORY, "eval: no memory for a light");
    if (!e) e = adapt_view(s->scene, &v, known, fit);
    if (!e) {
        orl_light_decode(&s->scene->light, fit->code, light);
        e = shade_view(&v, light, s->cpu, out);
    }
    free(mem); free(light);
    return e;
}

static orl_err predict_float(const eval_setup *s, const orl_camera *cam, const orl_pose *pose, const orl_image *known,
                             orl_adapt_result *fit, orl_image *out)
{
    size_t pixels = (size_t)cam->w * (size_t)cam->h;
    int cap = 2 * PIXELS;
    const orl_light_model *model = orl_model_light(s->model);
    orl_sample *g = calloc(pixels, sizeof *g), *sample = calloc((size_t)cap, sizeof *sample);
    spot *at = malloc((size_t)cap * sizeof *at);
    orl_light *light = malloc(sizeof *light);
    orl_imagef im = { 0 };
    orl_err e = g && sample && at && light ? orl_imagef_alloc(&im, cam->w, cam->h, 3)
                                           : orl_fail(ORL_E_MEMORY, "eval: no memory for %zu samples", pixels);
    if (e) goto done;
    orl_model_gbuffer(s->model, cam, pose, s->threads, g, NULL);
    int n = pick(known->w, known->h, at, cap);
    for (int i = 0; i < n; i++) {
        sample[i] = g[(size_t)at[i].y * (size_t)cam->w + (size_t)at[i].x];
        observe(known, at[i], &sample[i]);
    }
    if ((e = adapt(model, sample, n, fit))) goto done;
    orl_light_decode(model, fit->code, light);
    for (size_t i = 0; i < pixels; i++) orl_light_shade(light, &g[i], im.px + 3 * i);
    e = orl_image_from_float(&im, out);
done:
    free(g); free(sample); free(at); free(light);
    orl_imagef_free(&im);
    return e;
}

orl_err eval_predict(const eval_setup *s, const orl_camera *cam, const orl_pose *pose, const orl_image *photo, int known_w, eval_prediction *out)
{
    if (photo->c != 3 || photo->w != cam->w || photo->h != cam->h || known_w < 1 || known_w > cam->w)
        return orl_fail(ORL_E_RANGE, "eval: photo of %d x %d, camera of %d x %d, %d columns known", photo->w, photo->h, cam->w, cam->h, known_w);
    eval_prediction p;
    orl_image known;
    memset(&p, 0, sizeof p);
    orl_err e = cut(photo, known_w, &known);
    if (e) return e;
    if (s->scene) e = predict_fixed(s, cam, pose, &known, &p.adapt[EVAL_FIXED], &p.rgb[EVAL_FIXED]);
    if (!e && s->model) e = predict_float(s, cam, pose, &known, &p.adapt[EVAL_FLOAT], &p.rgb[EVAL_FLOAT]);
    if (!e && s->nerfw) e = nerfw_predict(s->nerfw, cam, pose, &known, s->threads, p.nerfw_code, &p.rgb[EVAL_NERFW]);
    if (!e) e = baselines_row_mean(&known, cam->w, &p.rgb[EVAL_ROW_MEAN]);
    if (!e && s->base) e = baselines_warp(s->base, cam, pose, &known, &p.rgb[EVAL_NEAREST], &p.rgb[EVAL_MEDIAN]);
    orl_image_free(&known);
    if (e) eval_prediction_free(&p);
    else *out = p;
    return e;
}

void eval_prediction_free(eval_prediction *p)
{
    for (int k = 0; k < EVAL_COLUMNS; k++) orl_image_free(&p->rgb[k]);
}

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

/* Reads DIR/gt/STEM_WHAT.exr at the photo's own size. */
static orl_err read_truth(const orl_dataset *d, const orl_photo *p, const char *what, const char *channels, orl_imagef *out)
{
    char path[2048];
    int stem = (int)strcspn(p->name, ".");
    snprintf(path, sizeof path, "%s/gt/%.*s_%s.exr", d->dir, stem, p->name, what);
    orl_imagef im;
    orl_err e = orl_exr_read(path, channels, &im);
    if (e) return e;
    if (im.w != p->cam.w || im.h != p->cam.h) {
        orl_imagef_free(&im);
        return orl_fail(ORL_E_FORMAT, "%s: not of the photo's size %d x %d", path, p->cam.w, p->cam.h);
    }
    *out = im;
    return ORL_OK;
}

/* Rotation world -> scene frame out of the scene's similarity. */
static void scene_rotation(const orl_scene *s, double R[9])
{
    const double *m = s->world_to_grid;
    double scale = sqrt(m[0] * m[0] + m[1] * m[1] + m[2] * m[2]);
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++) R[3 * i + k] = m[4 * i + k] / scale;
}

/* Depths at held-out SfM points against their distance, over the training photos that see them, at the observed pixel: |t - t_point| / t_point along the ray. Where nothing is
 * met the error is 1; points outside the box are not the scene's. */
static orl_err held_out(const orl_dataset *d, const orl_scene *s, int threads, figure out[2])
{
    const double *m = s->world_to_grid;
    double *rel = malloc((d->nobs + 1) * sizeof *rel);
    uint8_t *counted = calloc(d->npoints + 1, 1);
    size_t n = 0, points = 0;
    orl_err e = rel && counted ? ORL_OK : orl_fail(ORL_E_MEMORY, "eval: no memory for %u observations", d->nobs);
    for (uint32_t i = 0; !e && i < d->nphotos; i++) {
        const orl_photo *p = &d->photos[i];
        orl_view v;
        void *mem = NULL;
        double c[3], eye[3];
        orl_pose_centre(&p->pose, c);
        for (int a = 0; a < 3; a++) eye[a] = m[4 * a] * c[0] + m[4 * a + 1] * c[1] + m[4 * a + 2] * c[2] + m[4 * a + 3];
        for (uint32_t k = 0; !e && k < p->obs_count; k++) {
            const orl_colmap_obs *o = &d->obs[p->obs_begin + k];
            if (o->point < 0 || !world_held_out(&d->points[o->point])) continue;
            const double *x = d->points[o->point].xyz;
            double dist = 0;
            int inside = o->x >= 0 && o->y >= 0 && o->x < p->cam.w && o->y < p->cam.h;
            for (int a = 0; a < 3; a++) {
                double q = m[4 * a] * x[0] + m[4 * a + 1] * x[1] + m[4 * a + 2] * x[2] + m[4 * a + 3];
                inside &= q >= 0 && q <= ORL_BRICK * (double)s->nb[a];
                dist += (q - eye[a]) * (q - eye[a]);
            }
            dist = sqrt(dist);
            if (!inside || dist < 1) continue;
            if (!mem) e = open_view(s, &p->cam, &p->pose, 1, threads, &v, &mem);
            if (e) break;
            size_t own = (size_t)o->y * (size_t)v.stride + (size_t)o->x;
            rel[n] = 1;
            if (v.cov[own] >= 128 && v.depth[own] != 65535) {
                orl_sample q;
                double ray[3], g[3], len = 0, from = 0, to = 0;
                orl_view_sample(&v, (int)o->x, (int)o->y, &q);
                orl_camera_unproject(&v.cam, o->x, o->y, ray);
                for (int a = 0; a < 3; a++) {
                    g[a] = v.grid_from_cam[3 * a] * ray[0] + v.grid_from_cam[3 * a + 1] * ray[1] + v.grid_from_cam[3 * a + 2] * ray[2];
                    len += g[a] * g[a];
                    from += q.normal[a] * q.dir[a];
                    to += q.normal[a] * g[a];
                }
                double tilt = from * sqrt(len) / to;        /* from the pixel's centre to where the point was seen, on the surface's plane */
                rel[n] = fmin(fabs(v.depth[own] / 16.0 * (tilt > 0.8 && tilt < 1.25 ? tilt : 1) - dist) / dist, 1);
            }
            n++;
            points += !counted[o->point];
            counted[o->point] = 1;
        }
        free(mem);
    }
    out[0] = (figure){ n ? order_median(rel, n) : 1, "sfm_heldout_median_rel", 5 };
    out[1] = (figure){ (double)points, "sfm_heldout_points", 0 };
    free(rel);
    free(counted);
    return e;
}

/* Without ground truth: share of the test photos' sky (given masks, or else segmented) that the scene covers. */
static orl_err sky_by_masks(const orl_dataset *d, const orl_scene *s, int threads, figure *out)
{
    double up[3];
    size_t sky = 0, covered = 0;
    orl_err e = orl_skymask_up(d, up);
    for (uint32_t i = 0; !e && i < d->nphotos; i++) {
        const orl_photo *p = &d->photos[i];
        orl_image photo = { 0 }, mask = { 0 };
        orl_camera cam;
        orl_view v;
        void *mem = NULL;
        if (!p->test) continue;
        e = orl_photo_load(p, 512, &photo, &cam);
        if (!e && p->mask[0]) {
            e = orl_photo_load_mask(p, photo.w, photo.h, &mask);
            for (int k = 0; !e && k < mask.w * mask.h; k++) mask.px[k] = mask.px[k] == 128 ? 255 : 0;
        } else if (!e) {
            e = orl_skymask_photo(d, i, &photo, &cam, up, NULL, &mask);
        }
        if (!e) e = open_view(s, &cam, &p->pose, 2, threads, &v, &mem);
        for (int y = 0; !e && y < v.h; y++)
            for (int x = 0; x < v.w; x++) {
                int here = mask.px[(size_t)y * (size_t)v.w + (size_t)x] > ORL_SKY_SURE;
                sky += (size_t)here;
                covered += here && v.cov[(size_t)y * (size_t)v.stride + (size_t)x] >= 128;
            }
        free(mem);
        orl_image_free(&photo);
        orl_image_free(&mask);
    }
    *out = (figure){ sky ? (double)covered / (double)sky : 0, "sky_covered", 5 };
    return e;
}

/* World units a metre: gt/world.tsv says so where the model is not in metres. */
static orl_err unit_of_metre(const orl_dataset *d, double *unit)
{
    char path[2048];
    uint8_t *text;
    size_t bytes;
    *unit = 1;
    snprintf(path, sizeof path, "%s/gt/world.tsv", d->dir);
    if (access(path, R_OK)) return ORL_OK;
    orl_err e = orl_file_read(path, 1 << 16, &text, &bytes);
    if (e) return e;
    const char *at = strstr((char *)text, "\nscale\t");
    if (at) *unit = strtod(at + 7, NULL);
    free(text);
    return *unit > 0 && isfinite(*unit) ? ORL_OK : orl_fail(ORL_E_RANGE, "%s: scale is no positive number", path);
}

#define NEAR_METRES 80.0        /* beyond it a place's own detail is no matter */

/* depth_median_rel: |z - truth| / truth where both see surface and the truth is near; normal_mean_deg there; both with _all over all distances; scene_missed: share of near pixels where the scene has no surface;
 * sky_covered: share of the true sky's pixels that the scene covers. All test photos together, full size. */
enum { DEPTH_FIGURES = 6 };
static orl_err against_depth(const orl_dataset *d, const orl_scene *s, int threads, figure out[DEPTH_FIGURES])
{
    double R[9], unit, angle[2] = { 0 }, *rel[2] = { NULL, NULL };      /* near, all */
    size_t n[2] = { 0 }, cap = 0, sky = 0, covered = 0, near = 0;
    orl_err e = unit_of_metre(d, &unit);
    scene_rotation(s, R);
    for (uint32_t i = 0; !e && i < d->nphotos; i++) {
        const orl_photo *p = &d->photos[i];
        if (!p->test) continue;
        orl_imagef z = { 0 }, nm = { 0 };
        orl_view v;
        void *mem = NULL;
        size_t pixels = (size_t)p->cam.w * (size_t)p->cam.h;
        e = read_truth(d, p, "depth", "Y", &z);
        if (!e) e = read_truth(d, p, "normal", "RGB", &nm);
        if (!e) e = open_view(s, &p->cam, &p->pose, 2, threads, &v, &mem);
        if (!e && n[1] + pixels > cap) {
            cap = 2 * (n[1] + pixels);
            for (int k = 0; !e && k < 2; k++) {
                double *more = realloc(rel[k], cap * sizeof *more);
                if (more) rel[k] = more;
                else e = orl_fail(ORL_E_MEMORY, "eval: no memory for %zu depths", cap);
            }
        }
        for (int y = 0; !e && y < v.h; y++)
            for (int x = 0; x < v.w; x++) {
                size_t at = (size_t)y * (size_t)v.w + (size_t)x, own = (size_t)y * (size_t)v.stride + (size_t)x;
                int hit = v.cov[own] >= 128 && v.depth[own] != 65535, close = z.px[at] < NEAR_METRES;
                if (!(z.px[at] > 0)) {
                    sky++;
                    covered += v.cov[own] >= 128;
                    continue;
                }
                near += (size_t)close;
                if (!hit) continue;
                double ray[3], t[3], dot = 0, len = 0;
                orl_sample q;
                orl_camera_unproject(&v.cam, x + 0.5, y + 0.5, ray);
                orl_view_sample(&v, x, y, &q);
                for (int k = 0; k < 3; k++) {
                    t[k] = R[3 * k] * nm.px[3 * at] + R[3 * k + 1] * nm.px[3 * at + 1] + R[3 * k + 2] * nm.px[3 * at + 2];
                    dot += t[k] * q.normal[k];
                    len += t[k] * t[k];
                }
                for (int k = close ? 0 : 1; k < 2; k++) {
                    rel[k][n[k]++] = fabs(v.depth[own] / 16.0 * s->cell_world / unit / sqrt(ray[0] * ray[0] + ray[1] * ray[1] + 1) - z.px[at]) / z.px[at];
                    angle[k] += acos(fmin(fmax(dot / sqrt(fmax(len, 1e-12)), -1), 1)) * 180 / 3.14159265358979;
                }
            }
        free(mem);
        orl_imagef_free(&z);
        orl_imagef_free(&nm);
    }
    if (!e && !n[0]) e = orl_fail(ORL_E_DEGENERATE, "%s: no pixel nearer than %g m where scene and ground truth both see surface", d->dir, NEAR_METRES);
    if (!e) {
        out[0] = (figure){ order_median(rel[0], n[0]), "depth_median_rel", 5 };
        out[1] = (figure){ angle[0] / (double)n[0], "normal_mean_deg", 3 };
        out[2] = (figure){ order_median(rel[1], n[1]), "depth_median_rel_all", 5 };
        out[3] = (figure){ angle[1] / (double)n[1], "normal_mean_deg_all", 3 };
        out[4] = (figure){ 1 - (double)n[0] / (double)near, "scene_missed", 5 };
        out[5] = (figure){ sky ? (double)covered / (double)sky : 0, "sky_covered", 5 };
    }
    free(rel[0]);
    free(rel[1]);
    return e;
}

/* Intersection over union of the transients that the run finds in its training photos and those of SCENE/masks, all photos together. Nothing if there are no masks. */
static orl_err transients(const orl_dataset *d, const char *checkpoint, int threads, figure *out, int *n)
{
    finished_run run;
    size_t both = 0, either = 0;
    int given = 0;
    for (uint32_t i = 0; i < d->nphotos; i++) given |= !d->photos[i].test && d->photos[i].mask[0];
    if (!given) return ORL_OK;
    orl_err e = finished_open(checkpoint, d, threads, &run);
    if (e) return e;
    uint8_t **found = calloc((size_t)run.w.nphotos, sizeof *found);
    e = found ? transient_masks(&run.w, &run.s2, threads, found) : orl_fail(ORL_E_MEMORY, "eval: no memory for masks");
    for (int k = 0; !e && k < run.w.nphotos; k++)
        for (uint32_t i = 0; !e && i < d->nphotos; i++) {
            const world_photo *p = &run.w.photos[k];
            orl_image mask = { 0 };
            if (strcmp(d->photos[i].name, p->name) || !d->photos[i].mask[0]) continue;
            e = orl_photo_load_mask(&d->photos[i], p->w, p->h, &mask);
            int W = p->w / TRANSIENT_HALF, H = p->h / TRANSIENT_HALF;
            for (int y = 0; !e && y < H * TRANSIENT_HALF; y++)
                for (int x = 0; x < W * TRANSIENT_HALF; x++) {
                    int truth = mask.px[(size_t)y * (size_t)p->w + (size_t)x] == 255, here = found[k][(y / TRANSIENT_HALF) * W + x / TRANSIENT_HALF] == 255;
                    both += (size_t)(truth && here);
                    either += (size_t)(truth || here);
                }
            orl_image_free(&mask);
        }
    if (!e) out[(*n)++] = (figure){ either ? (double)both / (double)either : 1, "transient_iou", 4 };
    for (int k = 0; found && k < run.w.nphotos; k++) free(found[k]);
    free(found);
    finished_close(&run);
    return e;
}

static int has_depth(const orl_dataset *d)
{
    char path[2048];
    for (uint32_t i = 0; i < d->nphotos; i++) {
        snprintf(path, sizeof path, "%s/gt/%.*s_depth.exr", d->dir, (int)strcspn(d->photos[i].name, "."), d->photos[i].name);
        if (d->photos[i].test && !access(path, R_OK)) return 1;
    }
    return 0;
}

orl_err eval_geometry(const orl_dataset *d, const orl_scene *s, const char *checkpoint, int threads, figure out[EVAL_FIGURES], int *count)
{
    int n = has_depth(d) ? DEPTH_FIGURES : 1;
    orl_err e = n > 1 ? against_depth(d, s, threads, out) : sky_by_masks(d, s, threads, out);
    if (!e) e = held_out(d, s, threads, out + n);
    n += 2;
    if (!e && checkpoint) e = transients(d, checkpoint, threads, out, &n);
    if (!e) *count = n;
    return e;
}

/* Sun's direction of a photo in gt/photo_params.json; 0 if it has none. */
static int true_sun(const char *json, const orl_photo *p, double dir[3])
{
    char key[300];
    snprintf(key, sizeof key, "\"%.*s\":", (int)strcspn(p->name, "."), p->name);
    const char *at = strstr(json, key);
    if (at) at = strstr(at, "\"sun_dir\":");
    return at && sscanf(at, "\"sun_dir\": [ %lf , %lf , %lf", &dir[0], &dir[1], &dir[2]) == 3;
}

/* PSNR of base colour in sRGB after one scale a photo, and the median angle between the sun that the left half gives and the true one. */
static orl_err factors(const orl_dataset *d, const orl_scene *s, const options *o, figure *out)
{
    char path[2048];
    uint8_t *json = NULL;
    size_t bytes;
    double R[9], psnr = 0, suns[1024];
    int photos = 0;
    size_t nsuns = 0;
    snprintf(path, sizeof path, "%s/gt/photo_params.json", d->dir);
    orl_err e = orl_file_read(path, 1 << 24, &json, &bytes);
    if (e) return e;
    scene_rotation(s, R);
    for (uint32_t i = 0; !e && i < d->nphotos; i++) {
        const orl_photo *p = &d->photos[i];
        if (!p->test) continue;
        orl_imagef z = { 0 }, truth = { 0 };
        orl_image photo = { 0 }, known = { 0 };
        orl_camera cam;
        orl_view v, small;
        void *mem = NULL, *mem2 = NULL;
        orl_adapt_result fit;
        e = read_truth(d, p, "depth", "Y", &z);
        if (!e) e = read_truth(d, p, "albedo", "RGB", &truth);
        if (!e) e = open_view(s, &p->cam, &p->pose, 2, o->threads, &v, &mem);
        if (!e) {
            double ab = 0, aa = 0, err = 0;
            size_t n = 0;
            for (int pass = 0; pass < 2; pass++)
                for (int y = 0; y < v.h; y++)
                    for (int x = 0; x < v.w; x++) {
                        size_t at = (size_t)y * (size_t)v.w + (size_t)x, own = (size_t)y * (size_t)v.stride + (size_t)x;
                        if (!(z.px[at] > 0) || v.cov[own] < 128) continue;
                        for (int c = 0; c < 3; c++) {
                            double a = v.albedo[c][own] / 65535.0, b = truth.px[3 * at + (size_t)c];
                            if (!pass) {
                                ab += a * b; aa += a * a;
                                continue;
                            }
                            double r = fmin(orl_light_encode((float)(a * ab / fmax(aa, 1e-12))), 1) - orl_light_encode((float)b);
                            err += r * r;
                            n++;
                        }
                    }
            if (n) {
                psnr += -10 * log10(fmax(err / (double)n, 1e-9));
                photos++;
            }
        }
        double sun[3];
        if (!e && true_sun((char *)json, p, sun) && nsuns < sizeof suns / sizeof *suns) {
            e = orl_photo_load(p, o->long_side, &photo, &cam);
            if (!e) e = cut(&photo, o->full_adapt ? photo.w : photo.w / 2, &known);
            if (!e) e = open_view(s, &cam, &p->pose, 2, o->threads, &small, &mem2);
            if (!e) e = adapt_view(s, &small, &known, &fit);
            if (!e) {
                double az = fit.code[ORL_C_SUN_AZ], el = fit.code[ORL_C_SUN_EL], dot = 0;
                double ours[3] = { cos(az) * cos(el), sin(az) * cos(el), sin(el) };
                for (int k = 0; k < 3; k++) dot += ours[k] * (R[3 * k] * sun[0] + R[3 * k + 1] * sun[1] + R[3 * k + 2] * sun[2]);
                suns[nsuns++] = acos(fmin(fmax(dot, -1), 1)) * 180 / 3.14159265358979;
            }
        }
        free(mem); free(mem2);
        orl_imagef_free(&z); orl_imagef_free(&truth);
        orl_image_free(&photo); orl_image_free(&known);
    }
    free(json);
    if (!e && !photos) e = orl_fail(ORL_E_DEGENERATE, "%s: no pixel where scene and ground truth both see surface", d->dir);
    if (!e) {
        out[0] = (figure){ psnr / photos, "albedo_psnr", 3 };
        out[1] = (figure){ order_median(suns, nsuns), "sun_median_deg", 2 };
    }
    return e;
}

/* The recorded clip: light from each frame that has a wide truth, the wide view under it, PSNR outside the frame; mean over frames. */
static orl_err kiosk(const orl_dataset *d, const orl_scene *s, const options *o, figure *out)
{
    char path[2048];
    orl_view_pose pose[2];
    int count, frames = 0;
    double sum = 0;
    orl_view near, wide;
    void *mem[2] = { NULL, NULL };
    orl_light *light = malloc(sizeof *light);
    snprintf(path, sizeof path, "%s/kiosk/camera.txt", d->dir);
    orl_err e = light ? orl_posefile_read(path, pose, 2, &count) : orl_fail(ORL_E_MEMORY, "eval: no memory for a light");
    if (!e && count < 2) e = orl_fail(ORL_E_FORMAT, "%s: no second line (the wide view)", path);
    if (!e) e = open_view(s, &pose[0].cam, &pose[0].pose, 2, o->threads, &near, &mem[0]);
    if (!e) e = open_view(s, &pose[1].cam, &pose[1].pose, 2, o->threads, &wide, &mem[1]);
    for (int f = 0; !e && f < 10000; f++) {
        orl_image frame = { 0 }, truth = { 0 }, ours = { 0 };
        orl_adapt_result fit;
        snprintf(path, sizeof path, "%s/kiosk/gt_wide/%04d.jpg", d->dir, f);
        if (access(path, R_OK)) continue;
        e = orl_image_read(path, 3, &truth);
        snprintf(path, sizeof path, "%s/kiosk/frames/%04d.jpg", d->dir, f);
        if (!e) e = orl_image_read(path, 3, &frame);
        if (!e && (frame.w != near.w || frame.h != near.h || truth.w != wide.w || truth.h != wide.h))
            e = orl_fail(ORL_E_FORMAT, "%s: frame or truth not of the camera's size", path);
        if (!e) e = adapt_view(s, &near, &frame, &fit);
        if (!e) {
            orl_light_decode(&s->light, fit.code, light);
            e = shade_view(&wide, light, orl_cpu_detect(), &ours);
        }
        if (!e) {
            double err = 0;
            size_t n = 0;
            for (int y = 0; y < wide.h; y++)
                for (int x = 0; x < wide.w; x++) {
                    double ray[3], uv[2];
                    orl_camera_unproject(&wide.cam, x + 0.5, y + 0.5, ray);
                    if (orl_camera_project(&near.cam, ray, uv) && uv[0] >= 0 && uv[1] >= 0 && uv[0] < near.w && uv[1] < near.h) continue;
                    for (int c = 0; c < 3; c++, n++) {
                        size_t at = ((size_t)y * (size_t)wide.w + (size_t)x) * 3 + (size_t)c;
                        double r = (ours.px[at] - truth.px[at]) / 255.0;
                        err += r * r;
                    }
                }
            sum += -10 * log10(fmax(err / (double)(n ? n : 1), 1e-9));
            frames++;
        }
        orl_image_free(&frame); orl_image_free(&truth); orl_image_free(&ours);
    }
    free(mem[0]); free(mem[1]); free(light);
    if (!e && !frames) e = orl_fail(ORL_E_IO, "%s/kiosk/gt_wide: no frame", d->dir);
    if (!e) out[0] = (figure){ sum / frames, "outside_psnr", 3 };
    return e;
}

static orl_err against_truth(const options *o, const orl_dataset *d, const orl_scene *s)
{
    figure f[EVAL_FIGURES + 3];
    int n = 0;
    orl_err e = ORL_OK;
    if (o->geometry && (e = eval_geometry(d, s, o->checkpoint, o->threads, f, &n))) return e;
    if (!e && o->factors && !(e = factors(d, s, o, f + n))) n += 2;
    if (!e && o->kiosk && !(e = kiosk(d, s, o, f + n))) n += 1;
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
    "      --factors         base colour, sun against SCENE/gt instead\n"
    "      --kiosk           widened frames against SCENE/kiosk/gt_wide instead\n"
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
