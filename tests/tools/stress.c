/* Hostile photo collections: a small SCENE folder, spoiled in one way. In: a SCENE folder whose model is text or binary. Out: another one that `oriel-train fit` must turn into a usable
 * scene or refuse in one line (tests/cli/stress.sh). Test photos are moved along with the world but never spoiled. */
#include <dirent.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include "oriel/colmap.h"
#include "oriel/image.h"

typedef struct { const char *in, *out, *name; orl_colmap m; } place;

static int is(const place *p, const char *name) { return !strcmp(p->name, name); }

static const char *const CASES[] = {
    "base", "black", "white", "exposures", "one", "two", "twins", "duplicates", "far", "wild", "large", "small", "origin", "nopoints", "onepoint", "plane", "line",
    "pixel1", "pixel2", "strip", "allsky", "nosky", "maskless", "masksize", "away", "focal", "focals", "rotation", "shaken", "photosize", "sightings",
};

static orl_err copy_file(const char *from, const char *to)
{
    uint8_t *bytes;
    size_t n;
    orl_err e = orl_file_read(from, 1 << 28, &bytes, &n);
    if (e) return e;
    e = orl_file_write(to, bytes, n);
    free(bytes);
    return e;
}

/* World x -> scale * x + offset: cameras keep what they see. */
static void move(orl_colmap *m, double scale, const double offset[3])
{
    for (uint32_t i = 0; i < m->npoints; i++) for (int a = 0; a < 3; a++) m->points[i].xyz[a] = scale * m->points[i].xyz[a] + offset[a];
    for (uint32_t i = 0; i < m->nimages; i++)
        for (int a = 0; a < 3; a++) {
            const double *r = m->images[i].pose.R + 3 * a;
            m->images[i].pose.t[a] = scale * m->images[i].pose.t[a] - (r[0] * offset[0] + r[1] * offset[1] + r[2] * offset[2]);
        }
}

/* Cameras and points. */
static void spoil_model(const place *p, orl_colmap *m, int test)
{
    const double none[3] = { 0 }, away[3] = { 1e6, -1e6, 1e6 };
    if (is(p, "large")) move(m, 1e4, none);
    if (is(p, "small")) move(m, 1e-4, none);
    if (is(p, "origin")) move(m, 1, away);
    if (test) return;
    if (is(p, "one")) m->nimages = 1;
    if (is(p, "two") || is(p, "twins")) m->nimages = 2;
    if (is(p, "twins")) {                       /* one place, one direction: no depth to be had but the points' */
        orl_colmap_image keep = m->images[1];
        m->images[1] = m->images[0];
        memcpy(m->images[1].name, keep.name, sizeof keep.name);
        m->images[1].id = keep.id;
    }
    if (is(p, "nopoints") || is(p, "onepoint")) m->npoints = is(p, "onepoint");
    for (uint32_t i = 0; i < m->nobs; i++) if (m->obs[i].point >= (int32_t)m->npoints) m->obs[i].point = -1;
    for (uint32_t i = 0; i < m->npoints; i++) {
        double *x = m->points[i].xyz;
        if (is(p, "far") && i % 12 == 0) x[i / 12 % 3] = i % 5 == 0 ? 1e30 : i % 5 == 1 ? -1e30 : i % 5 == 2 ? INFINITY : i % 5 == 3 ? NAN : 1e300;
        if (is(p, "wild")) for (int a = 0; a < 3; a++) x[a] = i % 2 ? x[a] : 1e6 * sin((double)i + a);
        if (is(p, "plane")) x[1] = 3;
        if (is(p, "line")) x[1] = x[2] = 3;
    }
    for (uint32_t i = 0; i < m->nimages; i++) {
        double *R = m->images[i].pose.R, *t = m->images[i].pose.t;
        if (is(p, "away")) for (int k = 0; k < 9; k++) if (k / 3 != 1) R[k] = -R[k];         /* half a turn about the camera's y */
        if (is(p, "away")) t[0] = -t[0], t[2] = -t[2];
        if (is(p, "shaken")) {                  /* 0.3 degrees about any axis, 0.3 % of the focal length */
            double axis[3] = { sin(7.0 * i + 1), sin(11.0 * i + 2), sin(13.0 * i + 3) }, n = 0.3 * 3.14159265 / 180 / hypot(hypot(axis[0], axis[1]), axis[2]), q[4], turned[4], c[3];
            orl_pose_centre(&m->images[i].pose, c);
            orl_pose_to_quat(&m->images[i].pose, q);
            double h[3] = { 0.5 * n * axis[0], 0.5 * n * axis[1], 0.5 * n * axis[2] };
            turned[0] = q[0] - h[0] * q[1] - h[1] * q[2] - h[2] * q[3];
            turned[1] = q[1] + h[0] * q[0] + h[1] * q[3] - h[2] * q[2];
            turned[2] = q[2] + h[1] * q[0] + h[2] * q[1] - h[0] * q[3];
            turned[3] = q[3] + h[2] * q[0] + h[0] * q[2] - h[1] * q[1];
            if (orl_pose_from_quat(&m->images[i].pose, turned, t)) abort();
            for (int a = 0; a < 3; a++) t[a] = -(R[3 * a] * c[0] + R[3 * a + 1] * c[1] + R[3 * a + 2] * c[2]);
            orl_camera *cam = &m->cameras[m->images[i].camera];
            cam->fx = cam->fy = cam->fy * (i & 1 ? 1.003 : 1 / 1.003);
        }
        if (is(p, "rotation") && i == 0) for (int k = 0; k < 3; k++) t[k] = 1e20 * (k - 1);
    }
    for (uint32_t i = 0; i < m->nobs; i++) if (is(p, "sightings")) m->obs[i].x = i % 3 ? -1e9f : 3e38f, m->obs[i].y = 1e9f;
    for (uint32_t i = 0; i < m->ncameras; i++) {
        orl_camera *c = &m->cameras[i];
        if (is(p, "focals") || (is(p, "focal") && i == 0)) c->fx = c->fy = 1e6 * c->w;
        if (is(p, "pixel1") || is(p, "pixel2")) *c = orl_camera_resized(c, is(p, "pixel1") ? 1 : 2, is(p, "pixel1") ? 1 : 2);
        if (is(p, "strip")) { c->cy -= (c->h - c->w / 16) / 2; c->h = c->w / 16; }
    }
}

static orl_err spoil_photo(const place *p, const orl_colmap_image *im, uint32_t k, const char *from, const char *to)
{
    const orl_camera *cam = &p->m.cameras[im->camera];
    orl_image in, out = { 0 };
    orl_err e = orl_image_read(from, 3, &in);
    if (e) return e;
    int y0 = (in.h - cam->h) / 2, w = cam->w, h = cam->h;
    if (is(p, "strip")) e = orl_image_alloc(&out, w, h, 3);
    else if (is(p, "photosize")) e = orl_image_resize_area(&in, in.w / 2, in.h, &out);
    else e = orl_image_resize_area(&in, w, h, &out);
    for (int i = 0; !e && is(p, "strip") && i < h; i++) memcpy(out.px + (size_t)i * (size_t)w * 3, in.px + (size_t)(i + y0) * (size_t)w * 3, (size_t)w * 3);
    double gain = exp2(8.0 * k / fmax(p->m.nimages - 1.0, 1) - 4);
    for (size_t i = 0; !e && i < (size_t)out.w * (size_t)out.h * 3; i++) {
        if (is(p, "black")) out.px[i] = 0;
        if (is(p, "white")) out.px[i] = 255;
        if (is(p, "exposures")) out.px[i] = (uint8_t)(255 * pow(fmin(gain * pow(out.px[i] / 255.0, 2.2), 1), 1 / 2.2) + 0.5);
    }
    if (!e) e = orl_image_write(to, &out);
    orl_image_free(&in);
    orl_image_free(&out);
    return e;
}

static orl_err make(place *p)
{
    static const char *const FOLDERS[] = { "", "/photos", "/masks", "/sparse", "/sparse/0", "/sparse_test", "/sparse_test/0" };
    char from[2048], to[2048];
    orl_colmap test = { 0 };
    for (size_t i = 0; i < sizeof FOLDERS / sizeof *FOLDERS; i++) {
        snprintf(to, sizeof to, "%s%s", p->out, FOLDERS[i]);
        if (mkdir(to, 0777)) return orl_fail(ORL_E_IO, "%s: %m", to);
    }
    snprintf(from, sizeof from, "%s/sparse_test/0", p->in);
    snprintf(to, sizeof to, "%s/sparse_test/0", p->out);
    orl_err e = orl_colmap_read(from, NULL, NULL, &test);
    if (!e) spoil_model(p, &test, 1);
    if (!e) e = orl_colmap_write_text(to, &test);
    snprintf(from, sizeof from, "%s/sparse/0", p->in);
    snprintf(to, sizeof to, "%s/sparse/0", p->out);
    if (!e) e = orl_colmap_read(from, NULL, NULL, &p->m);
    if (!e) spoil_model(p, &p->m, 0);
    uint32_t n = p->m.nimages;
    if (!e && is(p, "duplicates")) {            /* every photo twice */
        orl_colmap_image *two = realloc(p->m.images, 2 * n * sizeof *two);
        orl_colmap_obs *seen = realloc(p->m.obs, 2 * ((size_t)p->m.nobs + 1) * sizeof *seen);
        if (!two || !seen) return orl_fail(ORL_E_MEMORY, "stress: no memory");
        p->m.images = two;
        p->m.obs = seen;
        memcpy(seen + p->m.nobs, seen, p->m.nobs * sizeof *seen);
        for (uint32_t i = 0; i < n; i++) {
            two[n + i] = two[i];
            two[n + i].id += 1000;
            two[n + i].obs_begin += p->m.nobs;
            snprintf(two[n + i].name, sizeof two->name, "again_%.200s", two[i].name);
        }
        p->m.nimages = 2 * n;
        p->m.nobs *= 2;
    }
    if (!e) e = orl_colmap_write_text(to, &p->m);
    for (uint32_t i = 0; !e && i < p->m.nimages + test.nimages; i++) {
        const orl_colmap_image *im = i < p->m.nimages ? &p->m.images[i] : &test.images[i - p->m.nimages];
        const char *source = strncmp(im->name, "again_", 6) ? im->name : im->name + 6;
        if (is(p, "twins") && i == 1) source = p->m.images[0].name;
        snprintf(from, sizeof from, "%s/photos/%s", p->in, source);
        snprintf(to, sizeof to, "%s/photos/%s", p->out, im->name);
        int plain = i >= p->m.nimages || !(is(p, "black") || is(p, "white") || is(p, "exposures") || is(p, "pixel1") || is(p, "pixel2") || is(p, "strip") || is(p, "photosize"));
        if ((e = plain ? copy_file(from, to) : spoil_photo(p, im, i, from, to)) || i >= p->m.nimages) continue;
        orl_image mask;
        int own = is(p, "allsky") || is(p, "nosky") || is(p, "masksize");
        snprintf(from, sizeof from, "%s/masks/%.*s.png", p->in, (int)strcspn(source, "."), source);
        snprintf(to, sizeof to, "%s/masks/%.*s.png", p->out, (int)strcspn(im->name, "."), im->name);
        if (!plain || is(p, "maskless")) continue;
        if (!own) { e = copy_file(from, to); continue; }
        const orl_camera *c = &p->m.cameras[im->camera];
        e = orl_image_alloc(&mask, is(p, "masksize") ? 7 : c->w, is(p, "masksize") ? 50 : c->h, 1);
        if (!e && is(p, "allsky")) memset(mask.px, 128, (size_t)mask.w * (size_t)mask.h);
        if (!e) e = orl_image_write(to, &mask);
        orl_image_free(&mask);
    }
    orl_colmap_free(&test);
    orl_colmap_free(&p->m);
    return e;
}

int main(int argc, char **argv)
{
    if (argc == 2 && !strcmp(argv[1], "--list")) {
        for (size_t i = 0; i < sizeof CASES / sizeof *CASES; i++) puts(CASES[i]);
        return 0;
    }
    if (argc != 4) {
        fputs("usage: stress SCENE OUT CASE\n       stress --list\n", stderr);
        return 2;
    }
    place p = { .in = argv[1], .out = argv[2], .name = argv[3] };
    int known = 0;
    for (size_t i = 0; i < sizeof CASES / sizeof *CASES; i++) known |= !strcmp(CASES[i], p.name);
    orl_err e = known ? make(&p) : orl_fail(ORL_E_RANGE, "%s: no such case", p.name);
    if (e) fprintf(stderr, "stress: %s\n", orl_error_text());
    return e ? 1 : 0;
}
