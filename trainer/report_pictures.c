/* Pictures of the report (report.h): layers of views, the sky found, the surface from outside. They are in the page itself, as JPEG where this build writes it. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#include "trainer/order.h"
#include "trainer/report.h"

enum { DOME = 220, OUTSIDE = 720 };
static const double PI = 3.14159265358979;

/* ---- into the page ---- */

static char *base64(const uint8_t *bytes, size_t n)
{
    static const char DIGITS[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    char *code = malloc(4 * (n / 3 + 2)), *c = code;
    for (size_t i = 0; code && i < n; i += 3) {
        uint32_t v = (uint32_t)bytes[i] << 16 | (uint32_t)(i + 1 < n ? bytes[i + 1] : 0) << 8 | (i + 2 < n ? bytes[i + 2] : 0);
        for (int k = 0; k < 4; k++) *c++ = i + (size_t)k <= n ? DIGITS[v >> (18 - 6 * k) & 63] : '=';
    }
    if (code) *c = 0;
    return code;
}

/* Codecs write files: the picture takes the way over one beside the page. */
orl_err report_picture(page *p, const orl_image *im, int side, const char *of, const char *caption)
{
    char path[4096], *code = NULL;
    uint8_t *bytes = NULL;
    size_t n;
    int w, h, jpeg = strstr(orl_image_formats(), "jpeg") != NULL;
    orl_image small = { 0 };
    orl_size_long_side(im->w, im->h, side, &w, &h);
    if ((size_t)snprintf(path, sizeof path, "%s.part.%s", p->o->output, jpeg ? "jpg" : "png") >= sizeof path) return orl_fail(ORL_E_RANGE, "%s: name too long", p->o->output);
    orl_err e = orl_image_resize_area(im, w, h, &small);
    if (!e) e = orl_image_write(path, &small);
    if (!e) e = orl_file_read(path, 1 << 26, &bytes, &n);
    unlink(path);
    if (!e && !(code = base64(bytes, n))) e = orl_fail(ORL_E_MEMORY, "%s: no memory for a picture", p->o->output);
    if (!e) {
        orl_text_add(&p->body, "<figure><img width=\"%d\" height=\"%d\" alt=\"", w, h);
        orl_text_escape(&p->body, of);
        orl_text_add(&p->body, ": ");
        orl_text_escape(&p->body, caption);
        orl_text_add(&p->body, "\" src=\"data:image/%s;base64,%s\"><figcaption>", jpeg ? "jpeg" : "png", code);
        orl_text_escape(&p->body, caption);
        orl_text_add(&p->body, "</figcaption></figure>\n");
    }
    free(code);
    free(bytes);
    orl_image_free(&small);
    return e;
}

orl_err report_add_difference(page *p, const orl_image *a, const orl_image *b, const char *of)
{
    orl_image im;
    orl_err e = orl_image_alloc(&im, a->w, a->h, 3);
    if (e) return e;
    for (size_t i = 0; i < 3 * (size_t)a->w * (size_t)a->h; i++) {
        int v = 2 * abs(a->px[i] - b->px[i]);
        im.px[i] = (uint8_t)(v > 255 ? 255 : v);
    }
    e = report_picture(p, &im, REPORT_LARGE, of, "difference, doubled");
    orl_image_free(&im);
    return e;
}

/* ---- layers of a view ---- */

/* What a layer is painted with. exposure: of irradiance. */
typedef struct { report_layer what; const orl_view *v; const orl_light *light; double exposure, near, far; } brush;

static uint8_t byte_of(double v) { return (uint8_t)(fmin(fmax(v, 0), 1) * 255 + 0.5); }

static uint16_t depth_at(const orl_view *v, int x, int y) { return v->depth[(size_t)y * (size_t)v->stride + (size_t)x]; }

static void ramp(double t, double out[3])       /* yellow, green, teal, dark blue; evenly darker */
{
    static const double STOP[5][3] = { { 0.99, 0.91, 0.14 }, { 0.37, 0.79, 0.38 }, { 0.13, 0.57, 0.55 }, { 0.23, 0.32, 0.55 }, { 0.27, 0.0, 0.33 } };
    double q = fmin(fmax(t, 0), 0.9999) * 4, f = q - floor(q);
    for (int c = 0; c < 3; c++) out[c] = STOP[(int)q][c] * (1 - f) + STOP[(int)q + 1][c] * f;
}

static double sun_visible(const orl_light *l, const orl_sample *q)      /* faces that are turned away lie in their own shade */
{
    return q->normal[0] * l->sun_dir[0] + q->normal[1] * l->sun_dir[1] + q->normal[2] * l->sun_dir[2] > 0 ? orl_light_sun_visibility(l, q) : 0;
}

static double clay(const orl_view *v, const orl_sample *q)      /* lit from behind the left shoulder */
{
    static const double LAMP[3] = { -0.45, -0.6, -0.66 };
    double dot = 0;
    for (int a = 0; a < 3; a++) dot += q->normal[a] * (v->grid_from_cam[3 * a] * LAMP[0] + v->grid_from_cam[3 * a + 1] * LAMP[1] + v->grid_from_cam[3 * a + 2] * LAMP[2]);
    return 0.28 + 0.62 * fmax(dot, 0);
}

static void colour_of(const brush *b, const orl_sample *q, uint16_t z, double rgb[3])
{
    double grey = 0;
    float e[3];
    switch (b->what) {
    case LAYER_BASE: for (int c = 0; c < 3; c++) rgb[c] = orl_light_encode(q->albedo[c]); return;
    case LAYER_NORMALS: for (int c = 0; c < 3; c++) rgb[c] = 0.5 + 0.5 * q->normal[c]; return;
    case LAYER_SHADING:
        orl_light_irradiance(b->light, q, e);
        for (int c = 0; c < 3; c++) rgb[c] = orl_light_encode((float)(b->exposure * e[c]));
        return;
    case LAYER_DEPTH: if (z != 65535) ramp(log(z / b->near + 1e-9) / log((b->far + 1) / b->near), rgb); return;
    case LAYER_SUN: grey = sun_visible(b->light, q); break;
    case LAYER_SHADOW: grey = orl_light_shadow(b->light, q); break;
    case LAYER_CLAY: grey = clay(b->v, q); break;
    }
    for (int c = 0; c < 3; c++) rgb[c] = grey;
    if (b->what == LAYER_CLAY) rgb[2] *= 0.96;
}

/* Nearest and farthest, two in a hundred left out at each end. */
static void depth_range(brush *b, double *room)
{
    size_t n = 0;
    for (int y = 0; y < b->v->h; y++) for (int x = 0; x < b->v->w; x++) if (depth_at(b->v, x, y) != 65535) room[n++] = depth_at(b->v, x, y);
    b->near = fmax(order_percentile(room, n, 0.02), 1);
    b->far = fmax(order_percentile(room, n, 0.98), b->near);
}

/* The brightest twentieth may be whiter than 0.8. */
static void find_exposure(brush *b, double *room)
{
    size_t n = 0;
    for (int y = 0; y < b->v->h; y += 2)
        for (int x = 0; x < b->v->w; x += 2) {
            orl_sample q;
            float e[3];
            orl_view_sample(b->v, x, y, &q);
            if (q.cov <= 0.5f) continue;
            orl_light_irradiance(b->light, &q, e);
            room[n++] = (e[0] + e[1] + e[2]) / 3;
        }
    b->exposure = 0.8 / fmax(order_percentile(room, n, 0.95), 1e-6);
}

static orl_err prepare(brush *b)
{
    double *room = malloc(((size_t)b->v->w * (size_t)b->v->h + 1) * sizeof *room);
    if (!room) return orl_fail(ORL_E_MEMORY, "report: no memory");
    if (b->what == LAYER_DEPTH) depth_range(b, room);
    if (b->what == LAYER_SHADING) find_exposure(b, room);
    free(room);
    return ORL_OK;
}

/* White where there is no surface. */
static void paint(const brush *b, orl_image *im)
{
    for (int y = 0; y < im->h; y++)
        for (int x = 0; x < im->w; x++) {
            uint8_t *px = im->px + 3 * ((size_t)y * (size_t)im->w + (size_t)x);
            double rgb[3] = { 1, 1, 1 };
            orl_sample q;
            orl_view_sample(b->v, x, y, &q);
            if (q.cov > 0) colour_of(b, &q, depth_at(b->v, x, y), rgb);
            for (int c = 0; c < 3; c++) px[c] = byte_of(fmin(rgb[c], 1) * q.cov + 1 - q.cov);
        }
}

orl_err report_add_layer(page *p, const orl_view *v, report_layer what, const orl_light *light, int side, const char *of, const char *caption)
{
    brush b = { .what = what, .v = v, .light = light };
    orl_image im = { 0 };
    orl_err e = orl_image_alloc(&im, v->w, v->h, 3);
    if (!e) e = prepare(&b);
    if (!e) paint(&b, &im);
    if (!e) e = report_picture(p, &im, side, of, caption);
    orl_image_free(&im);
    return e;
}

/* ---- the sky found ---- */

/* Radiance from azimuth (scene frame) and elevation, bilinear. */
static void sky_at(const orl_light *l, double azimuth, double elevation, double rgb[3])
{
    double row = fmin(fmax((1 - elevation / (PI / 2)) * ORL_ENV_ROWS - 0.5, 0), ORL_ENV_ROWS - 1), turn = (azimuth - atan2(l->sin_az, l->cos_az)) / (2 * PI) + 0.5, col = (turn - floor(turn)) * ORL_ENV_COLS - 0.5;
    int r0 = (int)row, r1 = r0 + 1 < ORL_ENV_ROWS ? r0 + 1 : r0, c0 = (int)floor(col), a = (c0 + ORL_ENV_COLS) % ORL_ENV_COLS, b = (c0 + 1) % ORL_ENV_COLS;
    double fr = row - r0, fc = col - c0;
    for (int c = 0; c < 3; c++)
        rgb[c] = (1 - fr) * ((1 - fc) * l->env[r0 * ORL_ENV_COLS + a][c] + fc * l->env[r0 * ORL_ENV_COLS + b][c]) + fr * ((1 - fc) * l->env[r1 * ORL_ENV_COLS + a][c] + fc * l->env[r1 * ORL_ENV_COLS + b][c]);
}

static double sky_exposure(const orl_light *l)      /* a tenth of the sky may be white */
{
    double grey[ORL_ENV];
    for (int i = 0; i < ORL_ENV; i++) grey[i] = (l->env[i][0] + l->env[i][1] + l->env[i][2]) / 3;
    return 0.9 / fmax(order_percentile(grey, ORL_ENV, 0.9), 1e-9);
}

orl_err report_add_sky(page *p, const orl_light *l, double heading, const char *of)
{
    static const uint8_t RING[3] = { 235, 110, 10 };
    const double mid = DOME / 2.0, rim = mid - 4, exposure = sky_exposure(l);
    double high = asin(fmin(fmax(l->sun_dir[2], -1), 1)), sun = atan2(l->sin_az, l->cos_az) - heading, out = (1 - high / (PI / 2)) * rim, sx = -sin(sun) * out, sy = cos(sun) * out;
    orl_image im;
    orl_err e = orl_image_alloc(&im, DOME, DOME, 3);
    if (e) return e;
    for (int y = 0; y < DOME; y++)
        for (int x = 0; x < DOME; x++) {
            uint8_t *px = im.px + 3 * ((size_t)y * DOME + (size_t)x);
            double dx = x + 0.5 - mid, dy = mid - y - 0.5, r = hypot(dx, dy) / rim, rgb[3];
            memset(px, 255, 3);
            if (r <= 1) {
                sky_at(l, heading + atan2(-dx, dy), (1 - r) * PI / 2, rgb);
                for (int c = 0; c < 3; c++) px[c] = byte_of(orl_light_encode((float)(exposure * rgb[c])));
            }
            if (fabs(hypot(dx - sx, dy - sy) - 8) < 1.6) memcpy(px, RING, 3);
        }
    e = report_picture(p, &im, DOME, of, "sky map found; ring: sun");
    orl_image_free(&im);
    return e;
}

/* ---- from outside ---- */

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
    double f = 0.95 * OUTSIDE;
    return orl_camera_from_params(cam, ORL_CAM_PINHOLE, OUTSIDE, OUTSIDE * 3 / 4, (double[4]){ f, f, OUTSIDE / 2, OUTSIDE * 3 / 8 }, 4);
}

static orl_err add_side(page *p, double turn)
{
    orl_camera cam;
    orl_pose pose;
    orl_view v;
    void *mem = NULL;
    orl_err e = outside(p, turn, &cam, &pose);
    if (!e) e = predict_view(p->s, &cam, &pose, 2, p->o->threads, &v, &mem);
    if (!e) e = report_add_layer(p, &v, LAYER_CLAY, NULL, REPORT_LARGE, p->d->name, "shape");
    if (!e) e = report_add_layer(p, &v, LAYER_NORMALS, NULL, REPORT_LARGE, p->d->name, "normals");
    if (!e) e = report_add_layer(p, &v, LAYER_BASE, NULL, REPORT_LARGE, p->d->name, "base colour");
    free(mem);
    return e;
}

orl_err report_add_outside(page *p)
{
    report_section(p, "surface", "The surface from outside");
    orl_text_add(&p->body, "<div class=\"grid three\">\n");
    orl_err e = add_side(p, 0.5);
    if (!e) e = add_side(p, -0.6);
    orl_text_add(&p->body, "</div>\n");
    return e;
}
