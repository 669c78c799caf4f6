/* Loads the training set and fixes the scene's frame: up from the cameras (the direction most orthogonal to their x axes), box and scale from the SfM points. */
#include "trainer/world.h"
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "oriel/parallel.h"
#include "oriel/skymask.h"
#include "trainer/order.h"
#include "trainer/ranks.h"

void frame_apply(const frame *f, const double w[3], double g[3])
{
    for (int i = 0; i < 3; i++) g[i] = f->scale * (f->R[3 * i] * w[0] + f->R[3 * i + 1] * w[1] + f->R[3 * i + 2] * w[2]) + f->offset[i];
}

void world_correct(world_photo *p)
{
    const double *f = p->fix, *A = p->given_axes;
    double angle = sqrt(f[0] * f[0] + f[1] * f[1] + f[2] * f[2]), s = angle > 1e-12 ? sin(angle) / angle : 1, c = angle > 1e-6 ? (1 - cos(angle)) / (angle * angle) : 0.5;
    const double K[9] = { 0, -f[2], f[1], f[2], 0, -f[0], -f[1], f[0], 0 };
    double E[9];                                /* exp(omega), Rodrigues */
    for (int i = 0; i < 3; i++) for (int j = 0; j < 3; j++) E[3 * i + j] = (i == j) + s * K[3 * i + j] + c * (K[3 * i] * K[j] + K[3 * i + 1] * K[3 + j] + K[3 * i + 2] * K[6 + j]);
    for (int i = 0; i < 3; i++) {
        for (int j = 0; j < 3; j++) p->axes[3 * i + j] = A[3 * i] * E[3 * j] + A[3 * i + 1] * E[3 * j + 1] + A[3 * i + 2] * E[3 * j + 2];
        p->centre[i] = p->given_centre[i] + A[3 * i] * f[3] + A[3 * i + 1] * f[4] + A[3 * i + 2] * f[5];
    }
    p->cam = p->given_cam;
    p->cam.fx *= exp(f[6]);
    p->cam.fy *= exp(f[6]);
    p->cam.k1 += f[7];
}

void frame_view(const frame *f, const orl_camera *cam, const orl_pose *pose, world_photo *out)
{
    double c[3];
    memset(out, 0, sizeof *out);
    out->cam = *cam;
    out->w = cam->w;
    out->h = cam->h;
    out->pose = *pose;
    orl_pose_centre(pose, c);
    frame_apply(f, c, out->centre);
    for (int a = 0; a < 3; a++)
        for (int b = 0; b < 3; b++) out->axes[3 * a + b] = f->R[3 * a] * pose->R[3 * b] + f->R[3 * a + 1] * pose->R[3 * b + 1] + f->R[3 * a + 2] * pose->R[3 * b + 2];
}

void world_ray(const world_photo *p, double u, double v, float dir[3])
{
    double c[3];
    orl_camera_unproject(&p->cam, u, v, c);
    double n = 1.0 / sqrt(c[0] * c[0] + c[1] * c[1] + c[2] * c[2]);
    for (int i = 0; i < 3; i++) dir[i] = (float)((p->axes[3 * i] * c[0] + p->axes[3 * i + 1] * c[1] + p->axes[3 * i + 2] * c[2]) * n);
}

int world_project(const world_photo *p, const float x[3], double uv[2], double *depth)
{
    double d[3] = { x[0] - p->centre[0], x[1] - p->centre[1], x[2] - p->centre[2] }, c[3];
    for (int i = 0; i < 3; i++) c[i] = p->axes[i] * d[0] + p->axes[3 + i] * d[1] + p->axes[6 + i] * d[2];
    if (depth) *depth = c[2];
    return orl_camera_project(&p->cam, c, uv);
}

int world_sees(const world_photo *p, const float x[3], double uv[2], double *depth)
{
    return world_project(p, x, uv, depth) && uv[0] >= 0 && uv[1] >= 0 && uv[0] < p->w && uv[1] < p->h;
}

orl_err world_photo_fill(world_photo *p, int w, int h, const uint8_t *rgb, const uint8_t *sky, int packed)
{
    size_t n = (size_t)w * (size_t)h;
    p->w = w;
    p->h = h;
    p->packed = packed;
    p->labels = calloc(world_label_bytes(p), 1);
    if (packed) p->blocks = malloc(blocks_count(w, h) * sizeof *p->blocks);
    else p->rgb = malloc(3 * n);
    if (!(packed ? (void *)p->blocks : p->rgb) || !p->labels) return orl_fail(ORL_E_MEMORY, "%s: no memory", p->name);
    if (packed) blocks_encode(rgb, w, h, p->blocks);
    else memcpy(p->rgb, rgb, 3 * n);
    int m = packed;                             /* a pixel that shares its label with the one before it, or above it */
    for (int y = 0; sky && y < h; y++)
        for (int x = 0; x < w; x++, sky++) {
            int label = *sky > ORL_SKY_SURE ? WORLD_SKY : *sky < ORL_SKY_SCENE ? WORLD_SCENE : WORLD_UNKNOWN;
            if (((x | y) & m) && world_label(p, x, y) != label) label = WORLD_UNKNOWN;
            world_set_label(p, x, y, label);
        }
    return ORL_OK;
}

float frame_ground_height(const frame *f, const float x[3]) { return f->ground[0] + f->ground[1] * x[0] + f->ground[2] * x[1]; }

int frame_ground_hit(const frame *f, const float o[3], const float d[3], float *t)
{
    float over = o[2] - frame_ground_height(f, o), fall = d[2] - f->ground[1] * d[0] - f->ground[2] * d[1];
    if (!(fall < -ORL_GROUND_FALL)) return 0;
    *t = fmaxf(over, ORL_GROUND_EYE * (float)f->dims[0]) / -fall;
    return *t < ORL_GROUND_FAR;
}

int box_clip(const int dims[3], const float o[3], const float d[3], float *t0, float *t1)
{
    float a = 0, b = 1e30f;
    for (int i = 0; i < 3; i++) {
        float inv = fabsf(d[i]) > 1e-9f ? 1.0f / d[i] : 1e9f;
        float lo = (0.01f - o[i]) * inv, hi = ((float)dims[i] - 0.01f - o[i]) * inv;
        if (lo > hi) { float s = lo; lo = hi; hi = s; }
        if (lo > a) a = lo;
        if (hi < b) b = hi;
    }
    *t0 = a;
    *t1 = b;
    return a < b;
}

/* Smallest eigenvector of a symmetric 3 x 3 by inverse power iteration on the shifted matrix. */
static void smallest_axis(const double m[9], double v[3])
{
    double a[9], tr = m[0] + m[4] + m[8];
    for (int i = 0; i < 9; i++) a[i] = (i % 4 == 0 ? tr : 0) - m[i];
    v[0] = 0.3; v[1] = 0.5; v[2] = 0.8;
    for (int k = 0; k < 500; k++) {
        double r[3], n = 0;
        for (int i = 0; i < 3; i++) { r[i] = a[3 * i] * v[0] + a[3 * i + 1] * v[1] + a[3 * i + 2] * v[2]; n += r[i] * r[i]; }
        n = n > 0 ? 1.0 / sqrt(n) : 0;
        for (int i = 0; i < 3; i++) v[i] = r[i] * n;
    }
}

/* SfM points in reach: a hundred times the median distance from the middle at most. What is farther (clouds, rays all but parallel, no numbers at all) is no surface that could be learned, and
 * would stretch the box. where: a point's index among those kept, -1 for others. */
typedef struct { double (*x)[3]; int32_t *where; int n; } reach;

static int reach_find(const orl_dataset *d, reach *r)
{
    size_t n = d->npoints;
    double *v = malloc((n + 1) * sizeof *v), mid[3] = { 0 };
    r->x = malloc((n + 1) * sizeof *r->x);
    r->where = malloc((n + 1) * sizeof *r->where);
    r->n = 0;
    if (!v || !r->x || !r->where) { free(v); return 0; }
    for (int a = 0; n && a < 3; a++) {
        for (size_t i = 0; i < n; i++) v[i] = d->points[i].xyz[a];
        mid[a] = order_percentile(v, n, 0.5);
    }
    for (int pass = 0; n && pass < 2; pass++) {
        double most = pass ? 100 * order_percentile(v, n, 0.5) : 0;
        for (size_t i = 0; i < n; i++) {
            const double *x = d->points[i].xyz;
            double away = hypot(hypot(x[0] - mid[0], x[1] - mid[1]), x[2] - mid[2]);
            if (!pass) { v[i] = away; continue; }
            r->where[i] = away <= most ? r->n : -1;
            if (away <= most) memcpy(r->x[r->n++], x, sizeof *r->x);
        }
    }
    free(v);
    return 1;
}

static orl_err place(const orl_dataset *d, const reach *pts, int longest, frame *f)
{
    double xx[9] = { 0 }, ydown[3] = { 0 }, up[3];
    int ncam = 0;
    for (uint32_t i = 0; i < d->nphotos; i++) {
        if (d->photos[i].test) continue;
        const double *R = d->photos[i].pose.R;
        for (int a = 0; a < 3; a++) {
            for (int b = 0; b < 3; b++) xx[3 * a + b] += R[a] * R[b];
            ydown[a] += R[3 + a];
        }
        ncam++;
    }
    if (ncam < 2 || pts->n < 16) return orl_fail(ORL_E_DEGENERATE, "%s: %d training photos and %d points are too few", d->dir, ncam, pts->n);
    smallest_axis(xx, up);
    if (up[0] * ydown[0] + up[1] * ydown[1] + up[2] * ydown[2] > 0) for (int a = 0; a < 3; a++) up[a] = -up[a];
    double x[3] = { 1, 0, 0 }, y[3];
    if (fabs(up[0]) > 0.9) { x[0] = 0; x[1] = 1; }
    double dot = x[0] * up[0] + x[1] * up[1] + x[2] * up[2], n = 0;
    for (int a = 0; a < 3; a++) { x[a] -= dot * up[a]; n += x[a] * x[a]; }
    for (int a = 0; a < 3; a++) x[a] /= sqrt(n);
    /* Turn about up so that the mean viewing direction is +y: facades then lie along the grid's axes more often than not. */
    double look[3] = { 0 };
    for (uint32_t i = 0; i < d->nphotos; i++) if (!d->photos[i].test) for (int a = 0; a < 3; a++) look[a] += d->photos[i].pose.R[6 + a];
    dot = look[0] * up[0] + look[1] * up[1] + look[2] * up[2];
    n = 0;
    for (int a = 0; a < 3; a++) { look[a] -= dot * up[a]; n += look[a] * look[a]; }
    if (n > 1e-6 * ncam) {
        for (int a = 0; a < 3; a++) y[a] = look[a] / sqrt(n);
        x[0] = y[1] * up[2] - y[2] * up[1]; x[1] = y[2] * up[0] - y[0] * up[2]; x[2] = y[0] * up[1] - y[1] * up[0];
    } else {
        y[0] = up[1] * x[2] - up[2] * x[1]; y[1] = up[2] * x[0] - up[0] * x[2]; y[2] = up[0] * x[1] - up[1] * x[0];
    }
    for (int a = 0; a < 3; a++) { f->R[a] = x[a]; f->R[3 + a] = y[a]; f->R[6 + a] = up[a]; }

    int np = pts->n, cap = np > (int)d->nphotos ? np : (int)d->nphotos;
    double *v = malloc((size_t)cap * sizeof *v), lo[3], hi[3], clo[3], chi[3], ground = 0;
    if (!v) return orl_fail(ORL_E_MEMORY, "%s: no memory", d->dir);
    for (int a = 0; a < 3; a++) {
        const double *r = f->R + 3 * a;
        for (int i = 0; i < np; i++) v[i] = r[0] * pts->x[i][0] + r[1] * pts->x[i][1] + r[2] * pts->x[i][2];
        lo[a] = order_percentile(v, (size_t)np, a == 2 ? 0.004 : 0.02);
        hi[a] = order_percentile(v, (size_t)np, a == 2 ? 0.998 : 0.98);
        if (a == 2) ground = order_percentile(v, (size_t)np, 0.01);
        int n2 = 0;
        for (uint32_t i = 0; i < d->nphotos; i++) {
            if (d->photos[i].test) continue;
            double c[3];
            orl_pose_centre(&d->photos[i].pose, c);
            v[n2++] = r[0] * c[0] + r[1] * c[1] + r[2] * c[2];
        }
        clo[a] = order_percentile(v, (size_t)n2, 0.05);
        chi[a] = order_percentile(v, (size_t)n2, 0.95);
    }
    free(v);
    double side = 0, reach;
    for (int a = 0; a < 3; a++) {
        double e = hi[a] - lo[a], margin = a == 2 ? 0.12 * e : 0.15 * e;
        lo[a] -= a == 2 ? 0.04 * e : margin;
        hi[a] += margin;
        side = fmax(side, hi[a] - lo[a]);
    }
    if (!(side > 0) || !isfinite(side)) return orl_fail(ORL_E_DEGENERATE, "%s: SfM points span no volume", d->dir);
    f->scale = longest / side;
    /* The ground between cameras and building belongs to the picture. Grids are sparse, so the box may grow at the same resolution. */
    reach = 1.2 * side;
    for (int a = 0; a < 2; a++) {
        if (clo[a] < lo[a]) lo[a] = fmax(clo[a] - 0.03 * side, lo[a] - reach);
        if (chi[a] > hi[a]) hi[a] = fmin(chi[a] + 0.03 * side, hi[a] + reach);
    }
    for (int a = 0; a < 3; a++) {
        f->dims[a] = ((int)ceil((hi[a] - lo[a]) * f->scale - 1e-6) + 15) & ~15;
        if (f->dims[a] < 32) f->dims[a] = 32;
        f->offset[a] = 0.5 * f->dims[a] - 0.5 * (lo[a] + hi[a]) * f->scale;
    }
    f->ground[0] = (float)(ground * f->scale + f->offset[2]);
    return ORL_OK;
}

typedef struct { const orl_dataset *d; world *w; int long_side, use_masks, packed; const uint32_t *index; const uint8_t *skip; char (*why)[400]; } load_job;     /* skip: points out of reach or held out. why: the error of each photo, "" if it loads */

/* A sighting of a point that trains, within the photo. */
static int counts(const orl_photo *p, const orl_colmap_obs *o, const uint8_t *skip)
{
    return o->point >= 0 && !skip[o->point] && o->x >= 0 && o->y >= 0 && o->x <= (float)p->cam.w && o->y <= (float)p->cam.h;
}

int world_held_out(const orl_colmap_point *p)
{
    uint64_t h = (p->id + 1) * 0x9e3779b97f4a7c15ull;
    h = (h ^ h >> 29) * 0xbf58476d1ce4e5b9ull;
    return (h >> 32) % 20 == 0;
}

static orl_err load_one(const load_job *job, int k)
{
    const orl_photo *p = &job->d->photos[job->index[k]];
    world_photo *o = &job->w->photos[k];
    const frame *f = &job->w->frame;
    orl_image im = { 0 }, sky = { 0 };
    orl_camera cam;
    orl_err e = orl_photo_load(p, job->long_side, &im, &cam);
    if (e) return e;
    if (im.w * im.h < 64) {
        orl_image_free(&im);
        return orl_fail(ORL_E_RANGE, "%s: %d x %d pixels are too few", p->path, p->cam.w, p->cam.h);
    }
    frame_view(f, &cam, &p->pose, o);
    o->given_cam = o->cam;
    memcpy(o->given_centre, o->centre, sizeof o->centre);
    memcpy(o->given_axes, o->axes, sizeof o->axes);
    snprintf(o->name, sizeof o->name, "%s", p->name);
    size_t n = 0, behind = 0;
    double c[3];
    for (uint32_t i = 0; i < p->obs_count; i++) {
        const orl_colmap_obs *ob = &job->d->obs[p->obs_begin + i];
        if (!counts(p, ob, job->skip)) continue;
        n++;
        orl_pose_apply(&p->pose, job->d->points[ob->point].xyz, c);
        behind += c[2] <= 0;
    }
    if (n > 8 && 2 * behind > n) {
        orl_image_free(&im);
        return orl_fail(ORL_E_DEGENERATE, "%s: %zu of the %zu points that it sees lie behind its camera", p->path, behind, n);
    }
    if (job->use_masks && p->mask[0]) {
        e = orl_photo_load_mask(p, im.w, im.h, &sky);
        if (!e) for (int i = 0; i < im.w * im.h; i++) sky.px[i] = sky.px[i] == 128 ? 255 : 0;
    } else {
        e = orl_skymask_photo(job->d, job->index[k], &im, &cam, f->R + 6, job->skip, &sky);
    }
    if (!e) e = world_photo_fill(o, im.w, im.h, im.px, sky.px, job->packed);
    orl_image_free(&im);
    orl_image_free(&sky);
    return e;
}

static void load_range(void *user, int begin, int end)
{
    load_job *job = user;
    for (int k = begin; k < end; k++) if (load_one(job, k)) snprintf(job->why[k], sizeof job->why[k], "%s", orl_error_text());
}

orl_err world_load(const orl_dataset *d, int long_side, int longest, int use_masks, int threads, world *out)
{
    world w = { .longest = longest };
    reach pts;
    orl_err e = reach_find(d, &pts) ? place(d, &pts, longest, &w.frame) : orl_fail(ORL_E_MEMORY, "%s: no memory", d->dir);
    if (e) { free(pts.x); free(pts.where); return e; }
    snprintf(w.title, sizeof w.title, "%.63s", d->name);
    uint32_t *index = malloc(d->nphotos * sizeof *index);
    char (*why)[400] = calloc(d->nphotos, sizeof *why);
    w.photos = calloc(d->nphotos, sizeof *w.photos);
    w.points = calloc(d->npoints, sizeof *w.points);
    w.obs = calloc(d->nobs + 1, sizeof *w.obs);
    uint8_t *skip = malloc((size_t)d->npoints + 1);
    if (!index || !why || !skip || !w.photos || !w.points || !w.obs) { e = orl_fail(ORL_E_MEMORY, "%s: no memory", d->dir); goto done; }
    for (uint32_t i = 0; i < d->nphotos; i++) if (!d->photos[i].test) index[w.nphotos++] = i;
    for (uint32_t i = 0; i < d->npoints; i++) skip[i] = pts.where[i] < 0 || world_held_out(&d->points[i]);
    size_t plain = 0;
    for (int k = 0; k < w.nphotos; k++) {
        const orl_camera *c = &d->photos[index[k]].cam;
        double shrink = fmin(1, (double)long_side / (c->w > c->h ? c->w : c->h));
        plain += (size_t)(3 * shrink * shrink * c->w * c->h);
    }
    load_job job = { d, &w, long_side, use_masks, plain > WORLD_PLAIN_BYTES, index, skip, why };
    orl_parallel(threads, w.nphotos, 1, load_range, &job);
    int kept = 0;
    for (int k = 0; k < w.nphotos; k++) {
        const orl_photo *p = &d->photos[index[k]];
        if (why[k][0]) {
            if (!ranks_mine()) fprintf(stderr, "oriel-train: %s: left out\n", why[k]);
            continue;
        }
        world_photo *o = &w.photos[k];
        o->obs_begin = w.nobs;
        for (uint32_t i = 0; i < p->obs_count; i++) {
            const orl_colmap_obs *ob = &d->obs[p->obs_begin + i];
            if (!counts(p, ob, skip)) continue;
            w.obs[w.nobs++] = (world_obs){ (float)(ob->x * o->w / p->cam.w), (float)(ob->y * o->h / p->cam.h), (uint32_t)pts.where[ob->point] };
        }
        o->obs_count = w.nobs - o->obs_begin;
        w.photos[kept++] = *o;
    }
    w.nphotos = kept;
    if (kept < 2) { e = orl_fail(ORL_E_DEGENERATE, "%s: fewer than two photos load", d->dir); goto done; }
    w.npoints = (uint32_t)pts.n;
    for (uint32_t i = 0; i < d->npoints; i++) {
        double g[3];
        if (pts.where[i] < 0) continue;
        world_point *q = &w.points[pts.where[i]];
        frame_apply(&w.frame, d->points[i].xyz, g);
        for (int a = 0; a < 3; a++) q->x[a] = (float)g[a];
        float t = (float)d->points[i].track_length, r = d->points[i].error_px;
        q->weight = (t / (t + 3.0f)) / (1.0f + r * r);
    }
    double *depth = malloc((w.nobs + 1) * sizeof *depth);
    for (int k = 0; depth && k < kept; k++) {
        world_photo *p = &w.photos[k];
        double uv[2], z;
        int n = 0;
        for (uint32_t i = 0; i < p->obs_count; i++) if (world_project(p, w.points[w.obs[p->obs_begin + i].point].x, uv, &z)) depth[n++] = z;
        p->near = n ? (float)(0.5 * order_percentile(depth, (size_t)n, 0.5)) : 0;
    }
    free(depth);
    *out = w;
    memset(&w, 0, sizeof w);
done:
    world_free(&w);
    free(pts.x);
    free(pts.where);
    free(skip);
    free(index);
    free(why);
    return e;
}

uint8_t *world_cover(const world *w, int most, size_t pixels)
{
    size_t n = (size_t)w->nphotos, total = 0, taken = 0;
    uint8_t *use = malloc(n + 1);
    uint16_t *seen = calloc((size_t)w->npoints + 1, sizeof *seen);
    float *gain = malloc((n + 1) * sizeof *gain);       /* gains only fall: an old one bounds the new one */
    int *asked = calloc(n + 1, sizeof *asked);
    if (!use || !seen || !gain || !asked) { free(use); use = NULL; goto done; }
    for (size_t k = 0; k < n; k++) total += (size_t)w->photos[k].w * (size_t)w->photos[k].h;
    memset(use, total <= pixels && w->nphotos <= most, n);
    for (size_t k = 0; k < n; k++) gain[k] = INFINITY;
    for (int count = 0; count < most && !(total <= pixels && w->nphotos <= most);) {
        size_t k = n;
        for (size_t i = 0; i < n; i++) if (!use[i] && (k == n || gain[i] > gain[k])) k = i;
        if (k == n) break;
        const world_photo *p = &w->photos[k];
        if (asked[k] == count + 1) {
            if ((taken += (size_t)p->w * (size_t)p->h) > pixels) break;
            use[k] = 1;
            count++;
            for (uint32_t i = 0; i < p->obs_count; i++) {
                uint16_t *s = &seen[w->obs[p->obs_begin + i].point];
                *s = (uint16_t)(*s + (*s < UINT16_MAX));
            }
            continue;
        }
        gain[k] = 0;
        asked[k] = count + 1;
        for (uint32_t i = 0; i < p->obs_count; i++) {
            uint32_t at = w->obs[p->obs_begin + i].point;
            gain[k] += w->points[at].weight / (seen[at] < 3 ? 1 : (float)(seen[at] - 1));
        }
    }
done:
    free(seen);
    free(gain);
    free(asked);
    return use;
}

int world_ray_step(const world *w)
{
    enum { LEAST = 2, RAYS = 16 << 20 };
    double pixels = 0;
    for (int k = 0; k < w->nphotos; k++) pixels += (double)w->photos[k].w * w->photos[k].h;
    return (int)fmax(LEAST, ceil(sqrt(pixels / RAYS)));
}

void world_forget(world *w)
{
    for (int i = 0; w->photos && i < w->nphotos; i++) {
        free(w->photos[i].rgb);
        free(w->photos[i].blocks);
        w->photos[i].rgb = NULL;
        w->photos[i].blocks = NULL;
    }
}

void world_free(world *w)
{
    world_forget(w);
    for (int i = 0; w->photos && i < w->nphotos; i++) free(w->photos[i].labels);
    free(w->photos);
    free(w->obs);
    free(w->points);
    memset(w, 0, sizeof *w);
}
