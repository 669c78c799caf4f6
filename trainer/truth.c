/* Figures against ground truth (truth.h): SCENE/gt holds depth, normals, base colour and other skies of the test photos, SCENE/masks transients; SCENE/kiosk, a clip, is trainer/kiosk.c's. */
#include "trainer/truth.h"
#include <dirent.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#include "oriel/cpu.h"
#include "oriel/relight.h"
#include "oriel/skymask.h"
#include "trainer/checkpoint.h"
#include "trainer/order.h"
#include "trainer/predict.h"
#include "trainer/transient.h"

enum { MOST_SUNS = 1024 };

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

void truth_rotation(const orl_scene *s, double R[9])
{
    const double *m = s->world_to_grid;
    double scale = sqrt(m[0] * m[0] + m[1] * m[1] + m[2] * m[2]);
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++) R[3 * i + k] = m[4 * i + k] / scale;
}

static void to_scene(const double R[9], const double world[3], double out[3])
{
    for (int k = 0; k < 3; k++) out[k] = R[3 * k] * world[0] + R[3 * k + 1] * world[1] + R[3 * k + 2] * world[2];
}

static double angle_deg(const double a[3], const double b[3])
{
    double dot = a[0] * b[0] + a[1] * b[1] + a[2] * b[2], len = sqrt((a[0] * a[0] + a[1] * a[1] + a[2] * a[2]) * (b[0] * b[0] + b[1] * b[1] + b[2] * b[2]));
    return acos(fmin(fmax(dot / fmax(len, 1e-12), -1), 1)) * 180 / 3.14159265358979;
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
            if (!mem) e = predict_view(s, &p->cam, &p->pose, 1, threads, &v, &mem);
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
        if (!e) e = predict_view(s, &cam, &p->pose, 2, threads, &v, &mem);
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
    truth_rotation(s, R);
    for (uint32_t i = 0; !e && i < d->nphotos; i++) {
        const orl_photo *p = &d->photos[i];
        if (!p->test) continue;
        orl_imagef z = { 0 }, nm = { 0 };
        orl_view v;
        void *mem = NULL;
        size_t pixels = (size_t)p->cam.w * (size_t)p->cam.h;
        e = read_truth(d, p, "depth", "Y", &z);
        if (!e) e = read_truth(d, p, "normal", "RGB", &nm);
        if (!e) e = predict_view(s, &p->cam, &p->pose, 2, threads, &v, &mem);
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
                double ray[3], truth[3];
                orl_sample q;
                orl_camera_unproject(&v.cam, x + 0.5, y + 0.5, ray);
                orl_view_sample(&v, x, y, &q);
                to_scene(R, (double[]){ nm.px[3 * at], nm.px[3 * at + 1], nm.px[3 * at + 2] }, truth);
                double off = angle_deg((double[]){ q.normal[0], q.normal[1], q.normal[2] }, truth);
                for (int k = close ? 0 : 1; k < 2; k++) {
                    rel[k][n[k]++] = fabs(v.depth[own] / 16.0 * s->cell_world / unit / sqrt(ray[0] * ray[0] + ray[1] * ray[1] + 1) - z.px[at]) / z.px[at];
                    angle[k] += off;
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

orl_err truth_geometry(const orl_dataset *d, const orl_scene *s, const truth_options *o, figure out[TRUTH_FIGURES], int *count)
{
    int n = *count;
    orl_err e;
    if (has_depth(d)) { e = against_depth(d, s, o->threads, out + n); n += DEPTH_FIGURES; }
    else { e = sky_by_masks(d, s, o->threads, out + n); n++; }
    if (!e) e = held_out(d, s, o->threads, out + n);
    n += 2;
    if (!e && o->checkpoint) e = transients(d, o->checkpoint, o->threads, out, &n);
    if (!e) *count = n;
    return e;
}

int truth_sun_after(const char *json, const char *key, double dir[3])
{
    const char *at = strstr(json, key);
    if (at) at = strstr(at, "\"sun_dir\":");
    return at && sscanf(at, "\"sun_dir\": [ %lf , %lf , %lf", &dir[0], &dir[1], &dir[2]) == 3;
}

/* Of a photo, in gt/photo_params.json. */
static int true_sun(const char *json, const orl_photo *p, double dir[3])
{
    char key[300];
    snprintf(key, sizeof key, "\"%.*s\":", (int)strcspn(p->name, "."), p->name);
    return truth_sun_after(json, key, dir);
}

double truth_sun_error(const double R[9], const float *code, const double world[3])
{
    double az = code[ORL_C_SUN_AZ], el = code[ORL_C_SUN_EL], ours[3] = { cos(az) * cos(el), sin(az) * cos(el), sin(el) }, sun[3];
    to_scene(R, world, sun);
    return angle_deg(ours, sun);
}

/* True sun of the training photo taken nearest to p, of those that have one; 0 if none has. */
static int nearest_sun(const orl_dataset *d, const char *json, const orl_photo *p, double dir[3])
{
    double at[3], best = INFINITY;
    orl_pose_centre(&p->pose, at);
    for (uint32_t i = 0; i < d->nphotos; i++) {
        double c[3], sun[3], far = 0;
        if (d->photos[i].test || !true_sun(json, &d->photos[i], sun)) continue;
        orl_pose_centre(&d->photos[i].pose, c);
        for (int k = 0; k < 3; k++) far += (c[k] - at[k]) * (c[k] - at[k]);
        if (far >= best) continue;
        best = far;
        memcpy(dir, sun, sizeof sun);
    }
    return best < INFINITY;
}

/* Sums for the best scale of a prediction, and the squared error that it leaves. */
typedef struct { double ab, aa, bb; } scaling;
static void scaling_add(scaling *s, double ours, double truth) { s->ab += ours * truth; s->aa += ours * ours; s->bb += truth * truth; }
static double scaling_error(const scaling *s) { return fmax(s->bb - (s->aa > 0 ? s->ab * s->ab / s->aa : 0), 0); }

/* Base colour of a test photo's view, linear, where there is depth; what the scene has no surface for counts as black. */
static void base_colour(const orl_view *v, const orl_imagef *depth, const orl_imagef *albedo, scaling sum[3], size_t *pixels)
{
    for (int y = 0; y < v->h; y++)
        for (int x = 0; x < v->w; x++) {
            size_t at = (size_t)y * (size_t)v->w + (size_t)x;
            if (!(depth->px[at] > 0)) continue;
            orl_sample q;
            orl_view_sample(v, x, y, &q);
            for (int c = 0; c < 3; c++) scaling_add(&sum[c], q.albedo[c], albedo->px[3 * at + (size_t)c]);
            ++*pixels;
        }
}

/* PSNR of a linear picture against the true one over pixels with depth: one scale for all, then shown so that the truth's 95th percentile of luminance is 0.8 linear, in sRGB. 0 where nothing is to be seen.
 * light: room for n numbers. */
static double relit_score(const float *ours, const float *truth, const float *depth, size_t n, double *light)
{
    scaling all = { 0 };
    size_t seen = 0;
    double err = 0;
    for (size_t i = 0; i < n; i++) {
        const float *t = truth + 3 * i;
        if (!(depth[i] > 0)) continue;
        for (int c = 0; c < 3; c++) scaling_add(&all, ours[3 * i + (size_t)c], t[c]);
        light[seen++] = 0.2126 * t[0] + 0.7152 * t[1] + 0.0722 * t[2];
    }
    if (!(all.aa > 0)) return 0;
    double show = 0.8 / fmax(order_percentile(light, seen, 0.95), 1e-9), scale = all.ab / all.aa * show;
    for (size_t i = 0; i < n; i++)
        for (int c = 0; depth[i] > 0 && c < 3; c++) {
            double r = fmin(orl_light_encode((float)(scale * ours[3 * i + (size_t)c])), 1) - fmin(orl_light_encode((float)(show * truth[3 * i + (size_t)c])), 1);
            err += r * r;
        }
    return -10 * log10(fmax(err / (3 * (double)seen), 1e-9));
}

/* What `oriel relight` shows of our scene's view, sky included, and the true base colour under the same light without any shadow; linear. */
static void relit_pictures(const orl_relight *r, const double R[9], const orl_imagef *albedo, const orl_imagef *normal, int threads, float *ours, float *plain)
{
    orl_relight_linear(r, threads, ours);
    for (size_t i = 0; i < (size_t)r->view->w * (size_t)r->view->h; i++) {
        const float *n = normal->px + 3 * i;
        double turned[3];
        float sky[3], facing = 0;
        to_scene(R, (double[]){ n[0], n[1], n[2] }, turned);
        const float true_n[3] = { (float)turned[0], (float)turned[1], (float)turned[2] };
        orl_light_esky(&r->light, true_n, sky);
        for (int k = 0; k < 3; k++) facing += true_n[k] * r->light.sun_dir[k];
        for (size_t c = 0; c < 3; c++) plain[3 * i + c] = albedo->px[3 * i + c] * (sky[c] + fmaxf(facing, 0) * r->light.sun_rgb[c]);
    }
}

/* Sums of PSNRs over the views of a test photo under other skies, gt/STEM_relit_SKY.exr. */
typedef struct { double ours, noshadow; int n; } relit_sums;

static orl_err relit_views(const orl_dataset *d, const orl_scene *s, const orl_photo *p, orl_view *v, const double R[9], int threads, const orl_imagef *depth, const orl_imagef *albedo, relit_sums *sum)
{
    char dir[1100], start[300], what[300], path[2048];
    double east[3];
    orl_imagef normal = { 0 };
    size_t n = (size_t)v->w * (size_t)v->h, stem = strcspn(p->name, ".") + 1;
    float *ours = malloc(n * 3 * sizeof *ours), *plain = malloc(n * 3 * sizeof *plain);
    double *room = malloc(n * sizeof *room);
    orl_panorama *sky = calloc(1, sizeof *sky);
    orl_relight *r = malloc(sizeof *r);
    orl_err e = ours && plain && room && sky && r ? ORL_OK : orl_fail(ORL_E_MEMORY, "eval: no memory for a relit view");
    to_scene(R, (const double[]){ 1, 0, 0 }, east);
    snprintf(dir, sizeof dir, "%.1024s/gt", d->dir);
    snprintf(start, sizeof start, "%.*s_relit_", (int)stem - 1, p->name);
    DIR *all = opendir(dir);
    for (struct dirent *f; !e && all && (f = readdir(all));) {
        const char *dot = strrchr(f->d_name, '.');
        orl_imagef truth = { 0 };
        if (strncmp(f->d_name, start, strlen(start)) || !dot || strcmp(dot, ".exr")) continue;
        snprintf(what, sizeof what, "%.*s", (int)(dot - f->d_name - (ptrdiff_t)stem), f->d_name + stem);
        snprintf(path, sizeof path, "%s/env/%s.exr", dir, what);
        if (!normal.px) e = read_truth(d, p, "normal", "RGB", &normal);
        if (!e) e = orl_panorama_open(path, sky);
        if (!e) e = read_truth(d, p, what, "RGB", &truth);
        if (!e) {
            sky->turn = (float)atan2(east[1], east[0]);         /* the truth's centre column looks along the world's +x */
            orl_sun sun = orl_panorama_sun(sky);
            orl_relight_init(v, &s->light, sky, &sun, r);
            orl_relight_trace(r, threads);
            relit_pictures(r, R, albedo, &normal, threads, ours, plain);
            sum->ours += relit_score(ours, truth.px, depth->px, n, room);
            sum->noshadow += relit_score(plain, truth.px, depth->px, n, room);
            sum->n++;
        }
        orl_panorama_close(sky);
        orl_imagef_free(&truth);
    }
    if (all) closedir(all);
    free(ours); free(plain); free(room); free(sky); free(r);
    orl_imagef_free(&normal);
    return e;
}

/* Light of a test photo's left half. */
static orl_err light_of_half(const orl_scene *s, const orl_photo *p, const truth_options *o, orl_adapt_result *fit)
{
    orl_image photo = { 0 }, known = { 0 };
    orl_camera cam;
    orl_view v;
    void *mem = NULL;
    orl_err e = orl_photo_load(p, o->long_side, &photo, &cam);
    if (!e) e = predict_cut(&photo, o->full_adapt ? photo.w : photo.w / 2, &known);
    if (!e) e = predict_view(s, &cam, &p->pose, 2, o->threads, &v, &mem);
    if (!e) e = predict_light(s, &v, &known, o->threads, fit);
    free(mem);
    orl_image_free(&photo);
    orl_image_free(&known);
    return e;
}

orl_err truth_factors(const orl_dataset *d, const orl_scene *s, const truth_options *o, figure out[TRUTH_FIGURES], int *count)
{
    char path[2048];
    uint8_t *json = NULL;
    size_t bytes, pixels = 0, nsuns = 0;
    double R[9], suns[MOST_SUNS], near[MOST_SUNS];
    scaling albedo[3] = { { 0 } };
    relit_sums relit = { 0 };
    snprintf(path, sizeof path, "%s/gt/photo_params.json", d->dir);
    orl_err e = orl_file_read(path, 1 << 24, &json, &bytes);
    if (e) return e;
    truth_rotation(s, R);
    for (uint32_t i = 0; !e && i < d->nphotos; i++) {
        const orl_photo *p = &d->photos[i];
        orl_imagef depth = { 0 }, colour = { 0 };
        orl_view v;
        void *mem = NULL;
        orl_adapt_result fit;
        double sun[3], other[3];
        if (!p->test) continue;
        e = read_truth(d, p, "depth", "Y", &depth);
        if (!e) e = read_truth(d, p, "albedo", "RGB", &colour);
        if (!e) e = predict_view(s, &p->cam, &p->pose, 2, o->threads, &v, &mem);
        if (!e) base_colour(&v, &depth, &colour, albedo, &pixels);
        if (!e) e = relit_views(d, s, p, &v, R, o->threads, &depth, &colour, &relit);
        if (!e && nsuns < MOST_SUNS && true_sun((char *)json, p, sun) && !(e = light_of_half(s, p, o, &fit))) {
            suns[nsuns] = truth_sun_error(R, fit.code, sun);
            near[nsuns++] = nearest_sun(d, (char *)json, p, other) ? angle_deg(sun, other) : 180;
        }
        free(mem);
        orl_imagef_free(&depth);
        orl_imagef_free(&colour);
    }
    free(json);
    if (!e && !pixels) e = orl_fail(ORL_E_DEGENERATE, "%s: no test photo with true depth", d->dir);
    if (e) return e;
    double err = scaling_error(&albedo[0]) + scaling_error(&albedo[1]) + scaling_error(&albedo[2]);
    figure *f = out + *count;
    *f++ = (figure){ -10 * log10(fmax(err / (3 * (double)pixels), 1e-9)), "albedo_psnr", 3 };
    if (nsuns) {
        *f++ = (figure){ order_median(suns, nsuns), "sun_median_deg", 2 };
        *f++ = (figure){ order_median(near, nsuns), "sun_nearest_deg", 2 };
    }
    if (relit.n) {
        *f++ = (figure){ relit.ours / relit.n, "relit_psnr", 3 };
        *f++ = (figure){ relit.noshadow / relit.n, "relit_noshadow_psnr", 3 };
    }
    *count = (int)(f - out);
    return ORL_OK;
}
