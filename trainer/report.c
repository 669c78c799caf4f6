/* `oriel-train report`: one HTML page that shows what a fit has learned: figures, curves, the surface from outside, and each test photo beside its render and what that is made of.
 * Pictures are in the page itself; nothing is fetched and nothing runs. */
#include <getopt.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#include "oriel/cpu.h"
#include "oriel/view.h"
#include "trainer/checkpoint.h"
#include "trainer/commands.h"
#include "trainer/eval.h"
#include "trainer/order.h"
#include "trainer/plot.h"
#include "trainer/truth.h"

enum { SCORED = 512, SHOWN = 360, DOME = 220 };

typedef struct { const char *dir, *scene, *checkpoint, *output; int limit, threads; } options;
typedef struct { const options *o; const orl_dataset *d; const orl_scene *s; orl_model *model; checkpoint_header *head; text body; eval_row *rows; int nrows; } page;

/* ---- pictures ---- */

/* Into the page, at SHOWN pixels at most. Codecs write files: the picture takes the way over one beside the page. */
static orl_err add_picture(page *p, const orl_image *im, const char *caption)
{
    static const char DIGITS[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    char path[4096], *code = NULL;
    uint8_t *bytes = NULL;
    size_t n;
    int w, h, jpeg = strstr(orl_image_formats(), "jpeg") != NULL;
    orl_image small = { 0 };
    orl_size_long_side(im->w, im->h, SHOWN, &w, &h);
    if ((size_t)snprintf(path, sizeof path, "%s.part.%s", p->o->output, jpeg ? "jpg" : "png") >= sizeof path) return orl_fail(ORL_E_RANGE, "%s: name too long", p->o->output);
    orl_err e = orl_image_resize_area(im, w, h, &small);
    if (!e) e = orl_image_write(path, &small);
    if (!e) e = orl_file_read(path, 1 << 26, &bytes, &n);
    unlink(path);
    if (!e && !(code = malloc(4 * (n / 3 + 2)))) e = orl_fail(ORL_E_MEMORY, "%s: no memory for a picture", p->o->output);
    if (!e) {
        char *c = code;
        for (size_t i = 0; i < n; i += 3) {
            uint32_t v = (uint32_t)bytes[i] << 16 | (uint32_t)(i + 1 < n ? bytes[i + 1] : 0) << 8 | (i + 2 < n ? bytes[i + 2] : 0);
            for (int k = 0; k < 4; k++) *c++ = i + (size_t)k <= n ? DIGITS[v >> (18 - 6 * k) & 63] : '=';
        }
        *c = 0;
        text_add(&p->body, "<figure><img width=\"%d\" height=\"%d\" alt=\"", w, h);
        text_escape(&p->body, caption);
        text_add(&p->body, "\" src=\"data:image/%s;base64,%s\"><figcaption>", jpeg ? "jpeg" : "png", code);
        text_escape(&p->body, caption);
        text_add(&p->body, "</figcaption></figure>\n");
    }
    free(code);
    free(bytes);
    orl_image_free(&small);
    return e;
}

typedef enum { NORMALS, DEPTH, BASE, SHADOW, CLAY, LAYERS } layer;

static void ramp(double t, double out[3])       /* dark blue, teal, green, yellow; evenly lighter */
{
    static const double STOP[5][3] = { { 0.99, 0.91, 0.14 }, { 0.37, 0.79, 0.38 }, { 0.13, 0.57, 0.55 }, { 0.23, 0.32, 0.55 }, { 0.27, 0.0, 0.33 } };
    double q = fmin(fmax(t, 0), 0.9999) * 4, f = q - floor(q);
    for (int c = 0; c < 3; c++) out[c] = STOP[(int)q][c] * (1 - f) + STOP[(int)q + 1][c] * f;
}

static int by_depth(const void *a, const void *b) { return (int)*(const uint16_t *)a - (int)*(const uint16_t *)b; }

/* A layer of a view as a picture, white where there is no surface. light: for the shadow. */
static orl_err paint(const orl_view *v, layer what, const orl_light *light, orl_image *out)
{
    orl_image im;
    uint16_t near = 0, far = 65534;
    orl_err e = orl_image_alloc(&im, v->w, v->h, 3);
    if (e) return e;
    if (what == DEPTH) {
        size_t n = 0;
        uint16_t *all = malloc(((size_t)v->w * (size_t)v->h + 1) * sizeof *all);
        for (int y = 0; all && y < v->h; y++)
            for (int x = 0; x < v->w; x++) if (v->depth[(size_t)y * (size_t)v->stride + (size_t)x] != 65535) all[n++] = v->depth[(size_t)y * (size_t)v->stride + (size_t)x];
        if (n) {
            qsort(all, n, sizeof *all, by_depth);
            near = all[n / 50];
            far = all[n - 1 - n / 50];
        }
        free(all);
    }
    for (int y = 0; y < v->h; y++)
        for (int x = 0; x < v->w; x++) {
            uint8_t *px = im.px + 3 * ((size_t)y * (size_t)v->w + (size_t)x);
            uint16_t z = v->depth[(size_t)y * (size_t)v->stride + (size_t)x];
            double rgb[3] = { 1, 1, 1 };
            orl_sample q;
            orl_view_sample(v, x, y, &q);
            if (q.cov > 0) {
                if (what == NORMALS) for (int c = 0; c < 3; c++) rgb[c] = 0.5 + 0.5 * q.normal[c];
                if (what == BASE) for (int c = 0; c < 3; c++) rgb[c] = orl_light_encode(q.albedo[c]);
                if (what == DEPTH && z != 65535) ramp(log((double)z / near + 1e-9) / log((far + 1.0) / (near + 1e-9)), rgb);
                if (what == SHADOW) {
                    double u = ORL_SHADOW_BIAS;
                    for (int k = 0; k < ORL_SHADOW_DIM; k++) u += light->code[ORL_C_SHADOW + k] * q.phi[k];
                    double facing = q.normal[0] * light->sun_dir[0] + q.normal[1] * light->sun_dir[1] + q.normal[2] * light->sun_dir[2];
                    double s = 1 / (1 + exp(-u)) * (0.25 + 0.75 * orl_light_sun_visibility(light, q.horizon) * (facing > 0));
                    for (int c = 0; c < 3; c++) rgb[c] = s;
                }
                if (what == CLAY) {         /* lit from behind the left shoulder */
                    double l[3] = { -0.45, -0.6, -0.66 }, dot = 0;
                    for (int a = 0; a < 3; a++) dot += q.normal[a] * (v->grid_from_cam[3 * a] * l[0] + v->grid_from_cam[3 * a + 1] * l[1] + v->grid_from_cam[3 * a + 2] * l[2]);
                    for (int c = 0; c < 3; c++) rgb[c] = (0.28 + 0.62 * fmax(dot, 0)) * (c == 2 ? 0.96 : 1);
                }
                for (int c = 0; c < 3; c++) rgb[c] = rgb[c] * q.cov + 1 - q.cov;
            }
            for (int c = 0; c < 3; c++) px[c] = (uint8_t)(fmin(fmax(rgb[c], 0), 1) * 255 + 0.5);
        }
    *out = im;
    return ORL_OK;
}

static orl_err add_layer(page *p, const orl_view *v, layer what, const orl_light *light, const char *caption)
{
    orl_image im;
    orl_err e = paint(v, what, light, &im);
    if (e) return e;
    e = add_picture(p, &im, caption);
    orl_image_free(&im);
    return e;
}

/* The sky as it is found: seen from below, zenith in the middle, horizon on the rim, +y of the scene frame up; a ring where the sun stands. */
static orl_err add_sky(page *p, const orl_light *l)
{
    orl_image im;
    float grey[ORL_ENV];
    orl_err e = orl_image_alloc(&im, DOME, DOME, 3);
    if (e) return e;
    for (int i = 0; i < ORL_ENV; i++) grey[i] = (l->env[i][0] + l->env[i][1] + l->env[i][2]) / 3;
    float top = 1e-9f;
    for (int i = 0; i < ORL_ENV; i++) {         /* exposure: a tenth of the sky may be white */
        int above = 0;
        for (int j = 0; j < ORL_ENV; j++) above += grey[j] > grey[i];
        if (above == ORL_ENV / 10) top = grey[i];
    }
    double sun_el = asin(fmin(fmax(l->sun_dir[2], -1), 1)), sun_r = (1 - sun_el / 1.5707963) * (DOME / 2 - 4);
    double sx = DOME / 2.0 + sun_r * l->cos_az, sy = DOME / 2.0 - sun_r * l->sin_az;
    for (int y = 0; y < DOME; y++)
        for (int x = 0; x < DOME; x++) {
            uint8_t *px = im.px + 3 * ((size_t)y * DOME + (size_t)x);
            double dx = x + 0.5 - DOME / 2.0, dy = DOME / 2.0 - y - 0.5, r = sqrt(dx * dx + dy * dy) / (DOME / 2 - 4);
            memset(px, 255, 3);
            if (r <= 1) {
                double az = atan2(dy * l->cos_az - dx * l->sin_az, dx * l->cos_az + dy * l->sin_az), row = fmin(fmax(r * ORL_ENV_ROWS - 0.5, 0), ORL_ENV_ROWS - 1), col = (az + 3.14159265) / 6.2831853 * ORL_ENV_COLS - 0.5;
                int r0 = (int)row, r1 = r0 + 1 < ORL_ENV_ROWS ? r0 + 1 : r0, c0 = (int)floor(col);
                double fr = row - r0, fc = col - c0;
                int ca = (c0 + ORL_ENV_COLS) % ORL_ENV_COLS, cb = (c0 + 1) % ORL_ENV_COLS;
                for (int c = 0; c < 3; c++) {
                    double v = (1 - fr) * ((1 - fc) * l->env[r0 * ORL_ENV_COLS + ca][c] + fc * l->env[r0 * ORL_ENV_COLS + cb][c]) + fr * ((1 - fc) * l->env[r1 * ORL_ENV_COLS + ca][c] + fc * l->env[r1 * ORL_ENV_COLS + cb][c]);
                    px[c] = (uint8_t)(fmin(orl_light_encode((float)(0.9 * v / top)), 1) * 255 + 0.5);
                }
            }
            double ring = fabs(sqrt((x + 0.5 - sx) * (x + 0.5 - sx) + (y + 0.5 - sy) * (y + 0.5 - sy)) - 8);
            if (ring < 1.6) { px[0] = 235; px[1] = 120; px[2] = 20; }
        }
    e = add_picture(p, &im, "sky found; ring: sun");
    orl_image_free(&im);
    return e;
}

static void *aligned(size_t bytes) { return aligned_alloc(64, (bytes + 63) & ~(size_t)63); }

static orl_err open_view(const page *p, const orl_camera *cam, const orl_pose *pose, orl_view *v, void **mem)
{
    size_t need = orl_view_need(cam->w, cam->h);
    if (!(*mem = aligned(need))) return orl_fail(ORL_E_MEMORY, "report: no memory for a view of %d x %d", cam->w, cam->h);
    return orl_view_build(p->s, cam, pose, 2, p->o->threads, *mem, need, v);
}

/* ---- sections ---- */

/* A camera outside: behind the photographers, higher and to one side, looking at the middle of the SfM points. */
static orl_err outside(const page *p, double turn, orl_camera *cam, orl_pose *pose)
{
    const orl_dataset *d = p->d;
    const double *g = p->s->world_to_grid;
    double up[3], target[3], eye[3], n = 0, len = 0, high = 0, *v = malloc((d->npoints + d->nphotos + 1u) * sizeof *v), scale = sqrt(g[8] * g[8] + g[9] * g[9] + g[10] * g[10]);
    if (!v) return orl_fail(ORL_E_MEMORY, "report: no memory");
    for (int a = 0; a < 3; a++) {
        uint32_t m = 0;
        for (uint32_t i = 0; i < d->npoints; i++) v[i] = d->points[i].xyz[a];
        target[a] = order_median(v, d->npoints);
        for (uint32_t i = 0; i < d->nphotos; i++) {
            double c[3];
            if (d->photos[i].test) continue;
            orl_pose_centre(&d->photos[i].pose, c);
            v[m++] = c[a];
        }
        eye[a] = m ? order_median(v, m) : 1;
        up[a] = g[8 + a] / scale;
    }
    free(v);
    double to[3], side[3];
    for (int a = 0; a < 3; a++) { to[a] = eye[a] - target[a]; high += to[a] * up[a]; n += to[a] * to[a]; }
    n = sqrt(n);
    for (int a = 0; a < 3; a++) { to[a] -= high * up[a]; len += to[a] * to[a]; }
    len = sqrt(fmax(len, 1e-12));
    for (int a = 0; a < 3; a++) to[a] /= len;
    for (int a = 0; a < 3; a++) side[a] = up[(a + 1) % 3] * to[(a + 2) % 3] - up[(a + 2) % 3] * to[(a + 1) % 3];
    double *R = pose->R, far = 1.5 * n, ahead = 0;
    for (int a = 0; a < 3; a++) eye[a] = target[a] + far * (0.88 * (cos(turn) * to[a] + sin(turn) * side[a]) + 0.47 * up[a]);
    for (int a = 0; a < 3; a++) { R[6 + a] = target[a] - eye[a]; ahead += R[6 + a] * R[6 + a]; }
    for (int a = 0; a < 3; a++) R[6 + a] /= sqrt(ahead);
    len = 0;
    for (int a = 0; a < 3; a++) { R[a] = R[6 + (a + 1) % 3] * up[(a + 2) % 3] - R[6 + (a + 2) % 3] * up[(a + 1) % 3]; len += R[a] * R[a]; }
    if (!(len > 1e-9)) return orl_fail(ORL_E_DEGENERATE, "report: the photos look straight down");
    for (int a = 0; a < 3; a++) R[a] /= sqrt(len);
    for (int a = 0; a < 3; a++) R[3 + a] = R[6 + (a + 1) % 3] * R[(a + 2) % 3] - R[6 + (a + 2) % 3] * R[(a + 1) % 3];
    for (int a = 0; a < 3; a++) pose->t[a] = -(R[3 * a] * eye[0] + R[3 * a + 1] * eye[1] + R[3 * a + 2] * eye[2]);
    double f = 0.95 * 2 * SHOWN;
    return orl_camera_from_params(cam, ORL_CAM_PINHOLE, 2 * SHOWN, 3 * SHOWN / 2, (double[4]){ f, f, SHOWN, 0.75 * SHOWN }, 4);
}

static orl_err add_outside(page *p)
{
    orl_err e = ORL_OK;
    text_add(&p->body, "<h2>The surface from outside</h2>\n<div class=\"grid wide\">\n");
    for (int k = 0; !e && k < 2; k++) {
        orl_camera cam;
        orl_pose pose;
        orl_view v;
        void *mem = NULL;
        e = outside(p, k ? -0.6 : 0.5, &cam, &pose);
        if (!e) e = open_view(p, &cam, &pose, &v, &mem);
        if (!e) e = add_layer(p, &v, CLAY, NULL, "shape");
        if (!e) e = add_layer(p, &v, NORMALS, NULL, "normals (red, green, blue: x, y, up)");
        if (!e) e = add_layer(p, &v, BASE, NULL, "base colour");
        free(mem);
    }
    text_add(&p->body, "</div>\n");
    return e;
}

static void add_curves(page *p)
{
    const checkpoint_header *h = p->head;
    double x[LOG_ROWS], y[6][LOG_ROWS];
    if (!h || h->logged < 2) return;
    int n = h->logged, first = 0;
    for (int i = 0; i < n; i++) {
        const log_row *r = &h->log[i];
        const float v[6] = { r->psnr, r->sky, r->eikonal, r->points, r->transient, r->codes_rms };
        x[i] = r->cpu_minutes;
        for (int k = 0; k < 6; k++) y[k][i] = v[k];
        first += r->stage < 2;
    }
    text_add(&p->body, "<h2>Training</h2>\n<div class=\"plots\">\n");
    const plot_series psnr[] = { { "stage 1: volume rendering", x, y[0], first }, { "stage 2: relighting", x + first, y[0] + first, n - first } };
    plot_svg(&p->body, psnr, 2, &(plot_style){ .title = "PSNR on training pixels", .x_label = "CPU minutes", .y_label = "dB", .w = 560, .h = 320 });
    for (int k = 1; k < 5; k++)                 /* on one axis: logarithms */
        for (int i = 0; i < first; i++) y[k][i] = log10(fmax(y[k][i], 1e-6));
    const plot_series losses[] = { { "sky", x, y[1], first }, { "Eikonal", x, y[2], first }, { "points, cells", x, y[3], first }, { "transient share", x, y[4], first } };
    if (first > 1) plot_svg(&p->body, losses, 4, &(plot_style){ .title = "Stage 1 losses", .x_label = "CPU minutes", .y_label = "log10", .w = 560, .h = 320 });
    text_add(&p->body, "</div>\n");
}

/* Two pictures' absolute difference, doubled. */
static orl_err add_difference(page *p, const orl_image *a, const orl_image *b)
{
    orl_image im;
    orl_err e = orl_image_alloc(&im, a->w, a->h, 3);
    if (e) return e;
    for (size_t i = 0; i < 3 * (size_t)a->w * (size_t)a->h; i++) {
        int v = 2 * abs(a->px[i] - b->px[i]);
        im.px[i] = (uint8_t)(v > 255 ? 255 : v);
    }
    e = add_picture(p, &im, "difference, doubled");
    orl_image_free(&im);
    return e;
}

static orl_err add_photo(page *p, const orl_photo *photo, const eval_setup *setup)
{
    orl_image im = { 0 };
    orl_camera cam;
    orl_view v;
    void *mem = NULL;
    eval_prediction pred;
    eval_row *row = &p->rows[p->nrows];
    orl_light *light = malloc(sizeof *light);
    memset(&pred, 0, sizeof pred);
    orl_err e = light ? orl_photo_load(photo, SCORED, &im, &cam) : orl_fail(ORL_E_MEMORY, "report: no memory for a light");
    if (!e) e = eval_predict(setup, &cam, &photo->pose, &im, im.w / 2, &pred);
    if (!e) e = eval_score(&im, &pred, row);
    if (!e) e = open_view(p, &cam, &photo->pose, &v, &mem);
    if (!e) {
        orl_light_decode(&p->s->light, pred.adapt[EVAL_FIXED].code, light);
        row->name = photo->name;
        text_add(&p->body, "<article>\n<h3>");
        text_escape(&p->body, photo->name);
        text_add(&p->body, " <small>right half: %.2f dB, SSIM %.3f, FLIP %.3f; whole: %.2f dB</small></h3>\n<div class=\"grid\">\n", row->right[EVAL_FIXED].psnr, row->right[EVAL_FIXED].ssim,
                 row->right[EVAL_FIXED].flip, row->full[EVAL_FIXED].psnr);
        e = add_picture(p, &im, "photo");
    }
    if (!e) e = add_picture(p, &pred.rgb[EVAL_FIXED], "render (light from the left half)");
    if (!e) e = add_difference(p, &im, &pred.rgb[EVAL_FIXED]);
    if (!e) e = add_layer(p, &v, BASE, light, "base colour");
    if (!e) e = add_layer(p, &v, SHADOW, light, "shadow: sun's visibility, learned part");
    if (!e) e = add_layer(p, &v, NORMALS, light, "normals");
    if (!e) e = add_layer(p, &v, DEPTH, light, "depth: near yellow, far blue");
    if (!e) e = add_sky(p, light);
    if (!e) {
        text_add(&p->body, "</div>\n</article>\n");
        p->nrows++;
    }
    eval_prediction_free(&pred);
    free(mem);
    free(light);
    orl_image_free(&im);
    return e;
}

static void add_scores(text *t, const eval_row *mean)
{
    static const char *const TITLE[EVAL_COLUMNS] = { [EVAL_FIXED] = "Oriel, fixed point", [EVAL_FLOAT] = "Oriel, float", [EVAL_ROW_MEAN] = "row mean", [EVAL_NEAREST] = "nearest photo, warped", [EVAL_MEDIAN] = "median of 12 warps" };
    text_add(t, "<table>\n<tr><th></th><th colspan=\"3\">right half</th><th colspan=\"3\">whole photo</th></tr>\n<tr><th>mean over test photos</th><th>PSNR</th><th>SSIM</th><th>FLIP</th><th>PSNR</th><th>SSIM</th><th>FLIP</th></tr>\n");
    for (int k = 0; k < EVAL_COLUMNS; k++) {
        if (!mean->has[k]) continue;
        const orl_score *r = &mean->right[k], *f = &mean->full[k];
        text_add(t, "<tr%s><td>%s</td><td>%.2f</td><td>%.3f</td><td>%.3f</td><td>%.2f</td><td>%.3f</td><td>%.3f</td></tr>\n", k == EVAL_FIXED ? " class=\"ours\"" : "", TITLE[k] ? TITLE[k] : EVAL_NAMES[k], r->psnr, r->ssim, r->flip,
                 f->psnr, f->ssim, f->flip);
    }
    text_add(t, "</table>\n");
}

static void fact(text *t, const char *value, const char *what)
{
    text_add(t, "<div><b>%s</b>%s</div>\n", value, what);
}

static void add_facts(text *t, const page *p, int train, int test, const figure *f, int n)
{
    static const struct { const char *key, *what, *unit; double times; int digits; } SHOW[] = {
        { "depth_median_rel", "median depth error", " %", 100, 2 }, { "normal_mean_deg", "mean normal error", "&deg;", 1, 1 }, { "sky_covered", "of the sky covered", " %", 100, 2 },
        { "sfm_heldout_median_rel", "off held-out SfM points (median)", " %", 100, 2 }, { "transient_iou", "transients found (IoU)", "", 1, 2 } };
    char v[64];
    text_add(t, "<div class=\"facts\">\n");
    snprintf(v, sizeof v, "%d + %d", train, test);
    fact(t, v, "training and test photos");
    if (p->head) {
        snprintf(v, sizeof v, "%.1f min", p->head->seconds / 60);
        fact(t, v, "of training");
        snprintf(v, sizeof v, "%.1f min", p->head->cpu_seconds / 60);
        fact(t, v, "of CPU time");
    }
    snprintf(v, sizeof v, "%.1f MB", (double)p->s->map_bytes * 1e-6);
    fact(t, v, "scene file");
    for (int i = 0; i < n; i++)
        for (size_t k = 0; k < sizeof SHOW / sizeof *SHOW; k++)
            if (!strcmp(SHOW[k].key, f[i].key)) {
                snprintf(v, sizeof v, "%.*f%s", SHOW[k].digits, f[i].v * SHOW[k].times, SHOW[k].unit);
                fact(t, v, SHOW[k].what);
            }
    text_add(t, "</div>\n");
}

static const char STYLE[] =
    "*{box-sizing:border-box}body{margin:0 auto;max-width:1240px;padding:1.5rem 1.25rem 4rem;font:16px/1.55 system-ui,-apple-system,'Segoe UI',sans-serif;color:#1e293b;background:#fff}"
    "h1{font-size:1.9rem;margin:.5rem 0 0;letter-spacing:-.02em}h2{font-size:1.3rem;margin:2.6rem 0 .9rem;padding-top:1.2rem;border-top:1px solid #e2e8f0}h3{font-size:1rem;margin:1.9rem 0 .6rem}"
    "h3 small{font-weight:400;color:#64748b;margin-left:.5rem}p{color:#475569;max-width:70ch}.facts{display:grid;grid-template-columns:repeat(auto-fill,minmax(165px,1fr));gap:.7rem;margin:1.4rem 0}"
    ".facts div{background:#f8fafc;border:1px solid #e2e8f0;border-radius:8px;padding:.65rem .85rem;font-size:.84rem;color:#64748b;line-height:1.35}.facts b{display:block;font-size:1.2rem;color:#0f172a;font-variant-numeric:tabular-nums}"
    ".scroll{overflow-x:auto}table{border-collapse:collapse;font-variant-numeric:tabular-nums;font-size:.93rem}th,td{padding:.35rem .8rem;text-align:right;border-bottom:1px solid #e2e8f0;white-space:nowrap}th{color:#64748b;font-weight:500}"
    "th[colspan]{text-align:center}td:first-child,th:first-child{text-align:left}.ours td{font-weight:600}.grid{display:grid;grid-template-columns:repeat(4,1fr);gap:.75rem}.wide{grid-template-columns:repeat(3,1fr)}"
    "figure{margin:0}img{width:100%;height:auto;border-radius:5px;display:block;background:#f8fafc}figcaption{font-size:.78rem;color:#64748b;margin-top:.25rem}.plots{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,440px),1fr));gap:1rem}"
    ".plots svg{width:100%;height:auto;border:1px solid #e2e8f0;border-radius:8px}@media(max-width:760px){.grid,.wide{grid-template-columns:repeat(2,1fr)}}@media print{article{break-inside:avoid}}";

static orl_err make(page *p)
{
    const options *o = p->o;
    baselines base = { 0 };
    figure f[TRUTH_FIGURES];
    text out = { 0 };
    int n = 0, train = 0, test = 0;
    orl_err e = baselines_open(p->d, SCORED, &base);
    eval_setup setup = { .scene = p->s, .model = p->model, .base = &base, .cpu = orl_cpu_detect(), .threads = o->threads };
    if (!e) e = truth_geometry(p->d, p->s, &(truth_options){ .checkpoint = p->head ? o->checkpoint : NULL, .threads = o->threads }, f, &n);
    if (!e) e = add_outside(p);
    if (!e) add_curves(p);
    if (!e) text_add(&p->body, "<h2>Test photos</h2>\n<p>The light of each is found on its left half; the right half is scored.</p>\n");
    for (uint32_t i = 0; !e && i < p->d->nphotos; i++) {
        train += !p->d->photos[i].test;
        test += p->d->photos[i].test;
        if (!p->d->photos[i].test || (o->limit && p->nrows >= o->limit)) continue;
        if (isatty(STDERR_FILENO)) fprintf(stderr, "%s\n", p->d->photos[i].name);
        e = add_photo(p, &p->d->photos[i], &setup);
    }
    if (!e) {
        text_add(&out, "<!DOCTYPE html>\n<html lang=\"en\">\n<meta charset=\"utf-8\">\n<meta name=\"viewport\" content=\"width=device-width,initial-scale=1\">\n<title>");
        text_escape(&out, p->d->name);
        text_add(&out, ": Oriel report</title>\n<style>%s</style>\n<h1>", STYLE);
        text_escape(&out, p->d->name);
        text_add(&out, "</h1>\n<p>What Oriel has learned from %d photos.</p>\n", train);
        add_facts(&out, p, train, test, f, n);
        eval_row mean = eval_mean(p->rows, p->nrows);
        if (p->nrows) {
            text_add(&out, "<div class=\"scroll\">\n");
            add_scores(&out, &mean);
            text_add(&out, "</div>\n");
        }
        text_add(&out, "%s</html>\n", p->body.s ? p->body.s : "");
        out.failed |= p->body.failed;
        e = text_write(&out, o->output);
    }
    if (!e) printf("%s: %d test photos, %.1f MB\n", o->output, p->nrows, (double)out.n * 1e-6);
    text_free(&out);
    baselines_close(&base);
    return e;
}

static void warn(void *user, const char *line) { (void)user; fprintf(stderr, "%s\n", line); }

static const char HELP[] =
    "Usage: oriel-train report SCENE --scene FILE.oriel -o FILE.html [options]\n"
    "Writes one self-contained page: figures, curves, the surface from outside, and each test photo beside its render and what that is made of.\n\n"
    "      --scene FILE        exported scene\n"
    "  -o, --output FILE       page to write\n"
    "      --checkpoint FILE   default: the scene's name with .ckpt appended; without it no curves and no figure on transients\n"
    "      --limit N           the first N test photos\n"
    "      --threads N         default: one per core\n"
    "      --help\n";

int cmd_report(int argc, char **argv)
{
    enum { SCENE = 256, CHECKPOINT, LIMIT, THREADS };
    static const struct option LONG[] = { { "scene", 1, 0, SCENE }, { "output", 1, 0, 'o' }, { "checkpoint", 1, 0, CHECKPOINT }, { "limit", 1, 0, LIMIT }, { "threads", 1, 0, THREADS }, { "help", 0, 0, 'h' }, { 0 } };
    options o = { 0 };
    char own[4096];
    int c;
    while ((c = getopt_long(argc, argv, "o:h", LONG, NULL)) != -1) {
        char *end = NULL;
        switch (c) {
        case SCENE: o.scene = optarg; break;
        case 'o': o.output = optarg; break;
        case CHECKPOINT: o.checkpoint = optarg; break;
        case LIMIT: o.limit = (int)strtol(optarg, &end, 10); break;
        case THREADS: o.threads = (int)strtol(optarg, &end, 10); break;
        case 'h': fputs(HELP, stdout); return 0;
        default: fputs(HELP, stderr); return 2;
        }
        if (end && (*end || (c == LIMIT ? o.limit < 1 : o.threads < 1 || o.threads > 64))) {
            fprintf(stderr, "oriel-train report: --%s %s: %s\n", c == LIMIT ? "limit" : "threads", optarg, c == LIMIT ? "1 or more" : "1 to 64");
            return 2;
        }
    }
    if (optind + 1 != argc || !o.scene || !o.output) { fputs(HELP, stderr); return 2; }
    o.dir = argv[optind];
    orl_dataset d = { 0 };
    orl_scene s = { 0 };
    checkpoint_header *head = malloc(sizeof *head);
    page p = { .o = &o, .d = &d, .s = &s };
    FILE *f = NULL;
    orl_err e = head ? orl_dataset_open(o.dir, warn, NULL, &d) : orl_fail(ORL_E_MEMORY, "report: no memory");
    if (!e) e = orl_scene_open(o.scene, &s);
    if (!e && !s.nbricks) e = orl_fail(ORL_E_DEGENERATE, "%s: holds no surface", o.scene);
    if (!e && !(p.rows = calloc(d.nphotos + 1u, sizeof *p.rows))) e = orl_fail(ORL_E_MEMORY, "report: no memory");
    if (!e && !o.checkpoint) {
        snprintf(own, sizeof own, "%s.ckpt", o.scene);
        if (access(own, R_OK)) fprintf(stderr, "%s: no checkpoint, no curves\n", own);
        else o.checkpoint = own;
    }
    if (!e && o.checkpoint && !(e = checkpoint_peek(o.checkpoint, head, &f))) {
        fclose(f);
        p.head = head;
        e = orl_model_load(o.checkpoint, &p.model);
    }
    if (!e) e = make(&p);
    if (e) fprintf(stderr, "oriel-train: %s\n", orl_error_text());
    if (p.model) orl_model_free(p.model);
    text_free(&p.body);
    free(p.rows);
    free(head);
    orl_scene_close(&s);
    orl_dataset_free(&d);
    return e ? 1 : 0;
}
