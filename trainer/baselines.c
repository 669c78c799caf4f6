/* Row mean, nearest warp and median of warps. Depth of the test view: SfM points that photos looking the same way observed are
 * projected into it, and at the nodes of a coarse lattice inverse depth (linear in the image on a plane) is fitted by moving least squares
 * over the nearest points. The sky gets the building's depth and so moves with it; occlusion is not resolved. */
#include "trainer/baselines.h"
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { STEP = 4, NEIGHBOURS = 16, POINTS_MIN = 8, FIT_MIN = 64, FIT_ROUNDS = 8, DEPTH_PHOTOS = 24 };
#define OUTLIER 1.3f         /* ratio of depths */

typedef struct { float u, v, q; } spot;         /* pixel and inverse depth of a point in the test view */
typedef struct { float score; uint32_t photo; } rank;

static int by_score(const void *a, const void *b)
{
    const rank *x = a, *y = b;
    return x->score != y->score ? (x->score < y->score) - (x->score > y->score) : (x->photo > y->photo) - (x->photo < y->photo);
}

orl_err baselines_open(const orl_dataset *d, int long_side, baselines *out)
{
    baselines b = { .data = d, .long_side = long_side };
    b.photo = calloc(d->nphotos + 1u, sizeof *b.photo);
    b.cam = calloc(d->nphotos + 1u, sizeof *b.cam);
    if (!b.photo || !b.cam) {
        free(b.photo); free(b.cam);
        return orl_fail(ORL_E_MEMORY, "%s: no memory for %u photos", d->dir, d->nphotos);
    }
    *out = b;
    return ORL_OK;
}

void baselines_close(baselines *b)
{
    for (uint32_t i = 0; b->photo && i < b->data->nphotos; i++) orl_image_free(&b->photo[i]);
    free(b->photo); free(b->cam);
    memset(b, 0, sizeof *b);
}

orl_err baselines_row_mean(const orl_image *known, int w, orl_image *out)
{
    orl_image im;
    orl_err e = orl_image_alloc(&im, w, known->h, 3);
    if (e) return e;
    for (int y = 0; y < known->h; y++) {
        const uint8_t *row = known->px + (size_t)y * (size_t)known->w * 3;
        uint8_t *o = im.px + (size_t)y * (size_t)w * 3;
        for (int c = 0; c < 3; c++) {
            long sum = 0;
            for (int x = 0; x < known->w; x++) sum += row[3 * x + c];
            for (int x = 0; x < w; x++) o[3 * x + c] = (uint8_t)((sum + known->w / 2) / known->w);
        }
    }
    *out = im;
    return ORL_OK;
}

/* Solves A X = B for symmetric positive definite A (n x n, destroyed); B is n x m, replaced by X. Returns 0 if A is singular. */
static int solve(double *A, int n, double *B, int m)
{
    for (int i = 0; i < n; i++) {
        double p = A[i * n + i];
        if (!(p > 1e-14)) return 0;
        for (int r = i + 1; r < n; r++) {
            double f = A[r * n + i] / p;
            for (int c = i; c < n; c++) A[r * n + c] -= f * A[i * n + c];
            for (int c = 0; c < m; c++) B[r * m + c] -= f * B[i * m + c];
        }
    }
    for (int i = n - 1; i >= 0; i--)
        for (int c = 0; c < m; c++) {
            for (int k = i + 1; k < n; k++) B[i * m + c] -= A[i * n + k] * B[k * m + c];
            B[i * m + c] /= A[i * n + i];
        }
    return 1;
}

/* ---- depth ---- */

static int project(const orl_camera *cam, const orl_pose *pose, const double xyz[3], double uv[2], double *z)
{
    double p[3];
    orl_pose_apply(pose, xyz, p);
    *z = p[2];
    return orl_camera_project(cam, p, uv) && uv[0] >= 0 && uv[1] >= 0 && uv[0] < cam->w && uv[1] < cam->h;
}

/* Points that the view should see. A photo votes for its points with the share of them that falls into the view times the cosine
 * between the optical axes; the best voters' points are taken. */
static orl_err gather(const orl_dataset *d, const orl_camera *cam, const orl_pose *pose, spot *spots, int *count)
{
    rank *order = malloc((d->nphotos + 1u) * sizeof *order);
    uint8_t *taken = calloc(d->npoints + 1u, 1);
    if (!order || !taken) {
        free(order); free(taken);
        return orl_fail(ORL_E_MEMORY, "%s: no memory for %u points", d->dir, d->npoints);
    }
    int n = 0;
    double uv[2], z;
    for (uint32_t i = 0; i < d->nphotos; i++) {
        const orl_photo *p = &d->photos[i];
        int inside = 0;
        for (uint32_t k = 0; !p->test && k < p->obs_count; k++) {
            int32_t at = d->obs[p->obs_begin + k].point;
            inside += at >= 0 && project(cam, pose, d->points[at].xyz, uv, &z);
        }
        double cosine = p->pose.R[6] * pose->R[6] + p->pose.R[7] * pose->R[7] + p->pose.R[8] * pose->R[8];
        order[i] = (rank){ inside ? (float)(inside / sqrt(p->obs_count) * fmax(cosine, 0)) : 0, i };
    }
    qsort(order, d->nphotos, sizeof *order, by_score);
    for (uint32_t i = 0; i < d->nphotos && i < DEPTH_PHOTOS && order[i].score > 0; i++) {
        const orl_photo *p = &d->photos[order[i].photo];
        for (uint32_t k = 0; k < p->obs_count; k++) {
            int32_t at = d->obs[p->obs_begin + k].point;
            if (at < 0 || taken[at]) continue;
            taken[at] = 1;
            if (project(cam, pose, d->points[at].xyz, uv, &z)) spots[n++] = (spot){ (float)uv[0], (float)uv[1], (float)(1 / z) };
        }
    }
    free(order); free(taken);
    *count = n;
    return ORL_OK;
}

/* The nearest points to (u, v), closest first; their count (NEIGHBOURS unless there are fewer). */
static int nearest_spots(const spot *s, int n, float u, float v, int *idx, float *dist)
{
    int k = 0;
    for (int i = 0; i < n; i++) {
        float du = s[i].u - u, dv = s[i].v - v, d2 = du * du + dv * dv;
        if (k == NEIGHBOURS && d2 >= dist[k - 1]) continue;
        int at = k < NEIGHBOURS ? k++ : k - 1;
        for (; at > 0 && dist[at - 1] > d2; at--) { dist[at] = dist[at - 1]; idx[at] = idx[at - 1]; }
        dist[at] = d2;
        idx[at] = i;
    }
    return k;
}

/* Drops points that float before or behind the median of their neighbours (false matches in sky and lawn). */
static int drop_outliers(const spot *s, int n, spot *keep)
{
    int m = 0, idx[NEIGHBOURS];
    float dist[NEIGHBOURS], q[NEIGHBOURS];
    for (int i = 0; i < n; i++) {
        int k = nearest_spots(s, n, s[i].u, s[i].v, idx, dist);
        for (int j = 0; j < k; j++) {
            int at = j;
            for (; at > 0 && q[at - 1] > s[idx[j]].q; at--) q[at] = q[at - 1];
            q[at] = s[idx[j]].q;
        }
        float ratio = s[i].q / q[k / 2];
        if (ratio < OUTLIER && ratio > 1 / OUTLIER) keep[m++] = s[i];
    }
    return m;
}

/* Inverse depth at (u, v): a plane through the nearest points, weighted by distance, kept within their range. */
static float fit_depth(const spot *s, int n, float u, float v)
{
    float dist[NEIGHBOURS];
    int idx[NEIGHBOURS], k = nearest_spots(s, n, u, v, idx, dist);
    double A[9] = { 0 }, B[3] = { 0 }, reach = dist[k - 1] + 1, lo = INFINITY, hi = 0, mean = 0, sum = 0;
    for (int i = 0; i < k; i++) {
        const spot *p = &s[idx[i]];
        double x[3] = { 1, (p->u - u) / sqrt(reach), (p->v - v) / sqrt(reach) }, w = 1 / (dist[i] + 0.02 * reach);
        for (int r = 0; r < 3; r++) {
            B[r] += w * x[r] * p->q;
            for (int c = 0; c < 3; c++) A[3 * r + c] += w * x[r] * x[c];
        }
        lo = fmin(lo, p->q); hi = fmax(hi, p->q);
        mean += w * p->q; sum += w;
    }
    A[4] += 0.05 * sum; A[8] += 0.05 * sum;         /* slopes lean to zero: points on one line do not tilt the plane */
    double q = solve(A, 3, B, 1) ? B[0] : mean / sum;
    return (float)fmin(fmax(q, lo), hi);
}

orl_err baselines_inverse_depth(const orl_dataset *d, const orl_camera *cam, const orl_pose *pose, float *out)
{
    int n = 0, nw = (cam->w - 1) / STEP + 2, nh = (cam->h - 1) / STEP + 2;
    spot *all = malloc((d->npoints + 1u) * sizeof *all), *spots = malloc((d->npoints + 1u) * sizeof *spots);
    float *node = malloc((size_t)nw * (size_t)nh * sizeof *node);
    orl_err e = all && spots && node ? gather(d, cam, pose, all, &n) : orl_fail(ORL_E_MEMORY, "%s: no memory for depth", d->dir);
    if (e) goto done;
    n = drop_outliers(all, n, spots);
    if (n < POINTS_MIN) {
        memset(out, 0, (size_t)cam->w * (size_t)cam->h * sizeof *out);
        goto done;
    }
    for (int j = 0; j < nh; j++)
        for (int i = 0; i < nw; i++) node[j * nw + i] = fit_depth(spots, n, (float)(i * STEP) + 0.5f, (float)(j * STEP) + 0.5f);
    for (int y = 0; y < cam->h; y++)
        for (int x = 0; x < cam->w; x++) {
            const float *q = node + (y / STEP) * nw + x / STEP;
            float fx = (float)(x % STEP) / STEP, fy = (float)(y % STEP) / STEP;
            float a = q[0] + fx * (q[1] - q[0]), b = q[nw] + fx * (q[nw + 1] - q[nw]);
            out[(size_t)y * (size_t)cam->w + (size_t)x] = a + fy * (b - a);
        }
done:
    free(all); free(spots); free(node);
    return e;
}

/* ---- warps ---- */

/* World position of every pixel, from inverse depth. */
static void lift(const orl_camera *cam, const orl_pose *pose, const float *inv, double *xyz)
{
    double c[3];
    orl_pose_centre(pose, c);
    for (int y = 0; y < cam->h; y++)
        for (int x = 0; x < cam->w; x++) {
            double d[3], z = 1 / (double)inv[(size_t)y * (size_t)cam->w + (size_t)x];
            orl_camera_unproject(cam, x + 0.5, y + 0.5, d);
            for (int i = 0; i < 3; i++) *xyz++ = c[i] + z * (pose->R[i] * d[0] + pose->R[3 + i] * d[1] + pose->R[6 + i] * d[2]);
        }
}

/* How well a photo stands in for the view: share of pixels that it sees, each weighted by how little its ray turns (half at a quarter
 * of a radian) and by its sharpness there. */
static float closeness(const orl_camera *view, const orl_pose *pose, const double *xyz, const orl_camera *cam, const orl_pose *from)
{
    double c0[3], c1[3], sum = 0;
    int n = 0;
    orl_pose_centre(pose, c0);
    orl_pose_centre(from, c1);
    for (int y = STEP; y < view->h; y += 2 * STEP)
        for (int x = STEP; x < view->w; x += 2 * STEP, n++) {
            const double *p = xyz + 3 * ((size_t)y * (size_t)view->w + (size_t)x);
            double uv[2], z, dot = 0, r0 = 0, r1 = 0;
            if (!project(cam, from, p, uv, &z)) continue;
            for (int i = 0; i < 3; i++) {
                double a = p[i] - c0[i], b = p[i] - c1[i];
                dot += a * b; r0 += a * a; r1 += b * b;
            }
            double turn = acos(fmin(fmax(dot / sqrt(r0 * r1), -1), 1)), sharp = cam->fx / sqrt(r1) * sqrt(r0) / view->fx;
            sum += fmin(1, sharp) / (1 + turn * turn * 16);
        }
    return (float)(sum / (n ? n : 1));
}

/* Samples a photo at every pixel of the view; ok = 0 where it does not see it. */
static void warp(const orl_camera *view, const double *xyz, const orl_image *im, const orl_camera *cam,
                 const orl_pose *from, float *rgb, uint8_t *ok)
{
    size_t n = (size_t)view->w * (size_t)view->h;
    for (size_t i = 0; i < n; i++) {
        double uv[2], z;
        ok[i] = (uint8_t)project(cam, from, xyz + 3 * i, uv, &z);
        if (!ok[i]) continue;
        double u = fmin(fmax(uv[0] - 0.5, 0), im->w - 1), v = fmin(fmax(uv[1] - 0.5, 0), im->h - 1);
        int x0 = (int)u, y0 = (int)v, x1 = x0 + (x0 < im->w - 1), y1 = y0 + (y0 < im->h - 1);
        float fx = (float)(u - x0), fy = (float)(v - y0);
        for (int c = 0; c < 3; c++) {
            #define AT(x, y) (float)im->px[((size_t)(y) * (size_t)im->w + (size_t)(x)) * 3 + (size_t)c]
            float a = AT(x0, y0) + fx * (AT(x1, y0) - AT(x0, y0)), b = AT(x0, y1) + fx * (AT(x1, y1) - AT(x0, y1));
            #undef AT
            rgb[3 * i + (size_t)c] = (a + fy * (b - a)) / 255;
        }
    }
}

/* Affine colour map from warp to known pixels: reweighted least squares (Geman-McClure, scale from the residuals' mean), a trace of
 * ridge towards the identity. Applied to rgb. Returns 0 if too few pixels are shared. */
static int match_colour(const orl_image *known, int w, float *rgb, const uint8_t *ok)
{
    double M[12] = { 1, 0, 0,  0, 1, 0,  0, 0, 1,  0, 0, 0 }, scale2 = INFINITY;       /* rows: r, g, b, 1; columns: out */
    for (int round = 0; round < FIT_ROUNDS; round++) {
        double A[16] = { 0 }, B[12] = { 0 }, err = 0, weight = 0;
        for (int y = 0; y < known->h; y++)
            for (int x = 0; x < known->w; x++) {
                size_t i = (size_t)y * (size_t)w + (size_t)x;
                if (!ok[i]) continue;
                double in[4] = { rgb[3 * i], rgb[3 * i + 1], rgb[3 * i + 2], 1 }, out[3], r2 = 0;
                for (int c = 0; c < 3; c++) {
                    out[c] = known->px[((size_t)y * (size_t)known->w + (size_t)x) * 3 + (size_t)c] / 255.0;
                    double r = out[c] - (in[0] * M[c] + in[1] * M[3 + c] + in[2] * M[6 + c] + M[9 + c]);
                    r2 += r * r;
                }
                double k = 1 / (1 + r2 / scale2), g = k * k;
                err += sqrt(r2);
                weight++;
                for (int a = 0; a < 4; a++) {
                    for (int b = 0; b < 4; b++) A[4 * a + b] += g * in[a] * in[b];
                    for (int c = 0; c < 3; c++) B[3 * a + c] += g * in[a] * out[c];
                }
            }
        if (weight < FIT_MIN) return 0;
        for (int a = 0; a < 4; a++) {
            double ridge = 1e-5 * weight;
            A[5 * a] += ridge;
            if (a < 3) B[4 * a] += ridge;
        }
        if (!solve(A, 4, B, 3)) return 0;
        memcpy(M, B, sizeof M);
        scale2 = fmax(16 * err * err / (weight * weight), 1e-4);
    }
    size_t n = (size_t)w * (size_t)known->h;
    for (size_t i = 0; i < n; i++) {
        if (!ok[i]) continue;
        float *p = rgb + 3 * i;
        double in[3] = { p[0], p[1], p[2] };
        for (int c = 0; c < 3; c++) p[c] = (float)fmin(fmax(in[0] * M[c] + in[1] * M[3 + c] + in[2] * M[6 + c] + M[9 + c], 0), 1);
    }
    return 1;
}

/* Median of the warps that see a pixel; others keep what out holds. */
static void median_of(float *const *rgb, uint8_t *const *ok, int n, orl_image *out)
{
    size_t pixels = (size_t)out->w * (size_t)out->h;
    for (size_t i = 0; i < pixels; i++)
        for (size_t c = 0; c < 3; c++) {
            float v[BASELINES_WARPS];
            int k = 0;
            for (int j = 0; j < n; j++) {
                if (!ok[j][i]) continue;
                float x = rgb[j][3 * i + c];
                int at = k++;
                for (; at > 0 && v[at - 1] > x; at--) v[at] = v[at - 1];
                v[at] = x;
            }
            if (!k) continue;
            out->px[3 * i + c] = (uint8_t)(127.5f * (v[(k - 1) / 2] + v[k / 2]) + 0.5f);
        }
}

static orl_err fetch(baselines *b, uint32_t i)
{
    return b->photo[i].px ? ORL_OK : orl_photo_load(&b->data->photos[i], b->long_side, &b->photo[i], &b->cam[i]);
}

orl_err baselines_warp(baselines *b, const orl_camera *cam, const orl_pose *pose, const orl_image *known, orl_image *nearest, orl_image *median)
{
    const orl_dataset *d = b->data;
    size_t n = (size_t)cam->w * (size_t)cam->h;
    float *inv = malloc(n * sizeof *inv), *rgb[BASELINES_WARPS] = { 0 };
    double *xyz = malloc(3 * n * sizeof *xyz);
    uint8_t *ok[BASELINES_WARPS] = { 0 };
    rank *order = malloc((d->nphotos + 1u) * sizeof *order);
    orl_image out[2] = { { 0 }, { 0 } };
    int used = 0;
    orl_err e = inv && xyz && order ? ORL_OK : orl_fail(ORL_E_MEMORY, "%s: no memory for warps", d->dir);
    if (!e) e = baselines_row_mean(known, cam->w, &out[0]);
    if (!e) e = baselines_row_mean(known, cam->w, &out[1]);
    if (!e) e = baselines_inverse_depth(d, cam, pose, inv);
    if (e) goto done;
    if (inv[0] > 0) {
        lift(cam, pose, inv, xyz);
        for (uint32_t i = 0; i < d->nphotos; i++) {
            const orl_photo *p = &d->photos[i];
            int w, h;
            orl_size_long_side(p->cam.w, p->cam.h, b->long_side, &w, &h);
            orl_camera small = orl_camera_resized(&p->cam, w, h);
            order[i] = (rank){ p->test ? 0 : closeness(cam, pose, xyz, &small, &p->pose), i };
        }
        qsort(order, d->nphotos, sizeof *order, by_score);
        for (uint32_t k = 0; k < d->nphotos && used < BASELINES_WARPS && order[k].score > 0; k++) {
            uint32_t i = order[k].photo;
            if (fetch(b, i)) continue;                  /* a photo that will not decode: the next one stands in */
            if (!rgb[used]) rgb[used] = malloc(3 * n * sizeof **rgb);
            if (!ok[used]) ok[used] = malloc(n);
            if (!rgb[used] || !ok[used]) {
                e = orl_fail(ORL_E_MEMORY, "%s: no memory for warps", d->dir);
                goto done;
            }
            warp(cam, xyz, &b->photo[i], &b->cam[i], &d->photos[i].pose, rgb[used], ok[used]);
            used += match_colour(known, cam->w, rgb[used], ok[used]);
        }
        if (used) median_of(rgb, ok, 1, &out[0]);
        median_of(rgb, ok, used, &out[1]);
    }
    *nearest = out[0]; *median = out[1];
    memset(out, 0, sizeof out);
done:
    for (int k = 0; k < BASELINES_WARPS; k++) { free(rgb[k]); free(ok[k]); }
    free(inv); free(xyz); free(order);
    orl_image_free(&out[0]); orl_image_free(&out[1]);
    return e;
}
