/* The view: marches every pixel into planes (bit-identical for any thread count: a row is one thread's alone), turns a light into tables, and runs the re-lighting kernels over rows. */
#include "oriel/view.h"
#include <math.h>
#include <string.h>
#include "oriel/math.h"
#include "oriel/parallel.h"
#include "runtime/arena.h"
#include "runtime/kernels/shade.h"
#include "runtime/march.h"

enum { NODES = 66, GRAIN = 4, CHUNK = 1024, QUARTER = 255 * 256 };      /* QUARTER turn in units of the horizons' kernel */

/* Directions on a coarse grid of pixel centres: node (i, j) is pixel (i << log2, j << log2). */
typedef struct { int log2, nx, ny; float dir[NODES * NODES][3]; } sky_grid;

struct orl_view_light {
    orl_shade_tab tab;
    orl_vis_tab vis;
    int16_t sky[3][NODES * NODES];      /* encoded sky at the nodes, Q13 */
};

static size_t plane_size(const orl_view *v) { return (size_t)v->stride * (size_t)v->h; }
int orl_view_stride(int w) { return (w + 31) & ~31; }

/* ---- layout */

/* Places the planes in block (NULL: only counts). */
static size_t place(orl_view *v, uint8_t *block)
{
    size_t n = (size_t)v->stride * (size_t)v->h, at = 0;
#define PLANE(p, type, per) do { if (block) v->p = (type *)(block + at); at += orl_align64(n * per * sizeof(type)); } while (0)
    for (int c = 0; c < 3; c++) PLANE(normal[c], int8_t, 1);
    for (int c = 0; c < 3; c++) PLANE(albedo[c], uint8_t, 1);
    PLANE(open, uint8_t, 1);
    PLANE(cov, uint8_t, 1);
    PLANE(horizon, uint8_t, ORL_HORIZON);
    for (int g = 0; g < 2; g++) PLANE(phi[g], int8_t, ORL_PHI_GROUP);
    PLANE(fix, int8_t, 1);
    PLANE(depth, uint16_t, 1);
#undef PLANE
    if (block) v->sky = block + at;
    return at + orl_align64(sizeof(sky_grid));
}

size_t orl_view_need(int w, int h)
{
    orl_view v = { .w = w, .h = h, .stride = orl_view_stride(w) };
    return w > 0 && h > 0 ? place(&v, NULL) : 0;
}

/* ---- rays */

/* Unit direction of pixel position (x, y), scene frame. 0 if the lens has none. */
static int pixel_dir(const orl_view *v, double x, double y, double d[3])
{
    double c[3], len = 0;
    orl_camera_unproject(&v->cam, x, y, c);
    for (int a = 0; a < 3; a++) {
        d[a] = v->grid_from_cam[3 * a] * c[0] + v->grid_from_cam[3 * a + 1] * c[1] + v->grid_from_cam[3 * a + 2] * c[2];
        len += d[a] * d[a];
    }
    if (!(len > 1e-12 && len < 1e12)) return 0;
    len = sqrt(len);
    for (int a = 0; a < 3; a++) d[a] /= len;
    return 1;
}

static int8_t *phi_of(const orl_view *v, size_t at, int k) { return v->phi[k / ORL_PHI_GROUP] + at * ORL_PHI_GROUP + k % ORL_PHI_GROUP; }

/* Base colour, Q16, in the view's bytes: by the kernels' own power. */
static uint8_t albedo_byte(uint32_t q16)
{
    int e = (int)(q16 / 2);
    return (uint8_t)(e < 2 ? 0 : (orl_power_ref(e) * 255 + (1 << 14)) >> 15);
}

/* ---- building */

typedef struct { const orl_scene *s; orl_view *v; int ss; double origin[3]; } build_job;

/* The ground as in SCENE.md 4.8, in double with + - * / only: height over it, where it is met, and its colour. */
static double over_ground(const orl_scene *s, const double x[3]) { return x[2] - (s->ground[0] + s->ground[1] * x[0] + s->ground[2] * x[1]); }

static int ground_meet(const orl_scene *s, const double o[3], const double d[3], double *t)
{
    double over = over_ground(s, o), fall = s->ground[1] * d[0] + s->ground[2] * d[1] - d[2], eye = ORL_GROUND_EYE * 8 * s->nb[0];
    over = over > eye ? over : eye;
    if (!(fall > ORL_GROUND_FALL) || !(over < ORL_GROUND_FAR * fall)) return 0;
    *t = over / fall;
    return 1;
}

static void ground_hit(const orl_scene *s, const double o[3], const double d[3], double t, orl_hit *h)
{
    uint32_t at[2], w[2];       /* texel and share of the next one, Q8 */
    for (int a = 0; a < 2; a++) {
        double q = ((o[a] + t * d[a]) / (8.0 * s->nb[a]) + 1) * (ORL_GROUND_SIDE / 3.0) - 0.5;
        q = q > 0 ? q < ORL_GROUND_SIDE - 1 ? q : ORL_GROUND_SIDE - 1 : 0;
        at[a] = q < ORL_GROUND_SIDE - 2 ? (uint32_t)q : ORL_GROUND_SIDE - 2;
        w[a] = (uint32_t)((q - at[a]) * 256 + 0.5);
    }
    const uint8_t *c = s->ground_albedo + 3 * (at[1] * ORL_GROUND_SIDE + at[0]), *next = c + 3 * ORL_GROUND_SIDE;
    memset(h, 0, sizeof *h);
    h->grad[2] = 1;
    for (int k = 0; k < 3; k++) {
        uint32_t a = (256 - w[0]) * (uint32_t)(c[k] * c[k]) + w[0] * (uint32_t)(c[k + 3] * c[k + 3]), b = (256 - w[0]) * (uint32_t)(next[k] * next[k]) + w[0] * (uint32_t)(next[k + 3] * next[k + 3]);
        h->albedo[k] = (uint32_t)(((uint64_t)((256 - w[1]) * a + w[1] * b) * 65535 + 65025 * 32768u) / (65025ull * 65536));
    }
    h->lite[0] = 255 << 16;
    h->t = (int64_t)(t * 65536 + 0.5);
}

/* The backdrop as in SCENE.md 4.9: met nearer than `before` where its opacity (0..255) is at least opaque / 8 of 255. */
static int backdrop_meet(const orl_scene *s, const double o[3], const double d[3], int opaque, double before, orl_hit *h)
{
    const double middle[2] = { 4.0 * s->nb[0], 4.0 * s->nb[1] };
    double t, uv[2];
    uint32_t first, share[4], rgba[4] = { 0 };
    if (!s->backdrop_rgba || !orl_backdrop_meet(&s->backdrop, middle, s->ground, o, d, &t, uv) || t > before) return 0;
    orl_backdrop_texels(uv, &first, share);
    for (int k = 0; k < 4; k++) {
        const uint8_t *c = s->backdrop_rgba + 4 * (first + (k & 1 ? 1u : 0) + (k & 2 ? ORL_BACK_COLS : 0u));
        for (int q = 0; q < 4; q++) rgba[q] += share[k] * (q < 3 ? (uint32_t)c[q] * c[q] : c[q]);
    }
    if ((int)(8 * ((rgba[3] + 128) >> 8)) < 255 * opaque) return 0;
    memset(h, 0, sizeof *h);
    float n[3];
    orl_backdrop_normal(uv[0], n);
    for (int a = 0; a < 3; a++) h->grad[a] = (n[a] > 0) - (n[a] < 0);
    for (int k = 0; k < 3; k++) h->albedo[k] = (uint32_t)(((uint64_t)rgba[k] * 65535 + 65025 * 128u) / (65025u * 256));
    h->lite[0] = 255 << 16;
    h->t = (int64_t)(t * 65536 + 0.5);
    return 1;
}

static int beside_box(const orl_scene *s, const double x[3]) { return x[0] < 0 || x[1] < 0 || x[0] > 8.0 * s->nb[0] || x[1] > 8.0 * s->nb[1]; }

/* The surface, or the ground where the ray meets no surface, a low cut, or the ground beside the box first. Higher cuts are passed through: nobody knows what stands there. Without ground, a cut is a surface.
 * Where no surface is met, the backdrop stands before the ground behind it. */
static int meet(const orl_scene *s, const double o[3], const double d[3], int opaque, orl_hit *h)
{
    double t = 0, from[3] = { o[0], o[1], o[2] };
    int64_t gone = 0;
    if (!s->ground_albedo) return orl_march(s, o, d, h);
    int met = 0, falls = ground_meet(s, o, d, &t);
    for (int k = 0; !met && k < ORL_CUTS && orl_march(s, from, d, h); k++) {
        h->t = gone += h->t;
        for (int a = 0; a < 3; a++) from[a] = o[a] + (double)gone / 65536 * d[a];
        met = !h->cut || over_ground(s, from) <= ORL_GROUND_CUT * 8 * s->nb[0];
    }
    if (!met && !falls) return backdrop_meet(s, o, d, opaque, 1e12, h);
    if (met) {
        double hit = (double)h->t / 65536, down[3] = { o[0] + t * d[0], o[1] + t * d[1], o[2] + t * d[2] };
        int before = falls && t < hit;
        if (!(before && beside_box(s, down)) && !h->cut) return 1;
        if (!before) t = hit;
    }
    if (!backdrop_meet(s, o, d, opaque, t, h)) ground_hit(s, o, d, t, h);
    return 1;
}

/* Mean of the rays that hit; coverage is their share. The rays of a pixel ask for more and more opaque a backdrop. */
static void build_pixel(const build_job *j, int x, int y)
{
    orl_view *v = j->v;
    orl_hit h;
    int hits = 0, rays = j->ss * j->ss;
    int64_t t = 0;
    double n[3] = { 0 };
    uint32_t albedo[3] = { 0 }, lite[ORL_LITE_BYTES] = { 0 };
    int32_t phi[ORL_SHADOW_DIM] = { 0 };
    for (int k = 0; k < rays; k++) {
        double d[3];
        if (!pixel_dir(v, x + (k % j->ss + 0.5) / j->ss, y + (k / j->ss + 0.5) / j->ss, d) || !meet(j->s, j->origin, d, rays > 1 ? 2 * k + 1 : 4, &h)) continue;
        double g[3] = { h.grad[0], h.grad[1], h.grad[2] }, len = sqrt(g[0] * g[0] + g[1] * g[1] + g[2] * g[2]);
        if (len > 0) {
            float facing[3] = { (float)(g[0] / len), (float)(g[1] / len), (float)(g[2] / len) };
            orl_facing_turn(&j->s->facings, facing);
            for (int a = 0; a < 3; a++) n[a] += facing[a];
        }
        for (int c = 0; c < 3; c++) albedo[c] += h.albedo[c];
        for (int c = 0; c < ORL_LITE_BYTES; c++) lite[c] += h.lite[c];
        for (int c = 0; c < ORL_SHADOW_DIM; c++) phi[c] += h.phi[c];
        t += h.t;
        hits++;
    }
    if (!hits) return;
    size_t at = (size_t)y * (size_t)v->stride + (size_t)x;
    uint32_t m = (uint32_t)hits, half = m << 15;
    double len = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    for (int a = 0; a < 3 && len > 0; a++) v->normal[a][at] = (int8_t)(n[a] < 0 ? 127 * n[a] / len - 0.5 : 127 * n[a] / len + 0.5);
    for (int c = 0; c < 3; c++) v->albedo[c][at] = albedo_byte((albedo[c] + m / 2) / m);
    v->open[at] = (uint8_t)((lite[0] + half) / (m << 16));
    v->cov[at] = (uint8_t)((255 * hits + rays / 2) / rays);
    for (int i = 0; i < ORL_HORIZON; i++) v->horizon[(size_t)i * plane_size(v) + at] = (uint8_t)((lite[1 + i] + half) / (m << 16));
    for (int k = 0; k < ORL_SHADOW_DIM; k++) {      /* rounded half away from zero */
        int32_t p = phi[k], r = (int32_t)half, den = (int32_t)(m << 16);
        *phi_of(v, at, k) = (int8_t)((p < 0 ? p - r : p + r) / den);
    }
    int64_t depth = (t / hits + (1 << 11)) >> 12;
    v->depth[at] = (uint16_t)(depth > 65534 ? 65534 : depth);
}

static void build_rows(void *user, int begin, int end)
{
    const build_job *j = user;
    for (int y = begin; y < end; y++) for (int x = 0; x < j->v->w; x++) build_pixel(j, x, y);
}

static void build_sky(orl_view *v)
{
    sky_grid *g = v->sky;
    int side = v->stride > v->h ? v->stride : v->h;
    g->log2 = 4;
    while (((side - 1) >> g->log2) + 2 > NODES) g->log2++;
    g->nx = ((v->stride - 1) >> g->log2) + 2;
    g->ny = ((v->h - 1) >> g->log2) + 2;
    double d[3] = { 0, 0, 1 };
    for (int i = 0; i < g->nx * g->ny; i++) {
        double try[3];
        if (pixel_dir(v, ((i % g->nx) << g->log2) + 0.5, ((i / g->nx) << g->log2) + 0.5, try)) memcpy(d, try, sizeof d);    /* else the last good one */
        for (int a = 0; a < 3; a++) g->dir[i][a] = (float)d[a];
    }
}

size_t orl_view_attach_need(int w, int h)
{
    size_t n = (size_t)orl_view_stride(w) * (size_t)h;
    return w > 0 && h > 0 ? orl_align64(n) + orl_align64(sizeof(sky_grid)) : 0;
}

orl_err orl_view_attach(const orl_view *from, void *block, size_t bytes, orl_view *out)
{
    if (bytes < orl_view_attach_need(from->w, from->h) || ((uintptr_t)block & 63)) return orl_fail(ORL_E_MEMORY, "view: block of %zu bytes, %zu aligned to 64 wanted", bytes, orl_view_attach_need(from->w, from->h));
    orl_view v = *from;
    size_t n = (size_t)v.stride * (size_t)v.h;
    v.fix = block;
    v.sky = (uint8_t *)block + orl_align64(n);
    memset(v.fix, 0, n);
    build_sky(&v);
    *out = v;
    return ORL_OK;
}

static int all_finite(const double *v, int n) { for (int i = 0; i < n; i++) if (!(v[i] > -1e12 && v[i] < 1e12)) return 0; return 1; }

orl_err orl_view_build(const orl_scene *s, const orl_camera *cam, const orl_pose *pose, int supersample, int threads, void *block, size_t bytes, orl_view *out)
{
    const double lens[] = { cam->fx, cam->fy, cam->cx, cam->cy, cam->k1, cam->k2, cam->p1, cam->p2 }, *R = pose->R, *m = s->world_to_grid;
    if (!s->bmap) return orl_fail(ORL_E_DEGENERATE, "view: the scene has no geometry (a sky file?)");
    if (cam->w < 1 || cam->h < 1 || cam->w > 65535 || cam->h > 65535) return orl_fail(ORL_E_RANGE, "view: size %d x %d", cam->w, cam->h);
    if (supersample != 1 && supersample != 2) return orl_fail(ORL_E_RANGE, "view: supersample %d", supersample);
    if (!all_finite(lens, 8) || !(cam->fx > 0) || !(cam->fy > 0)) return orl_fail(ORL_E_DEGENERATE, "view: camera parameters are not finite");
    if (!all_finite(R, 9) || !all_finite(pose->t, 3)) return orl_fail(ORL_E_DEGENERATE, "view: pose is not finite");
    double det = R[0] * (R[4] * R[8] - R[5] * R[7]) - R[1] * (R[3] * R[8] - R[5] * R[6]) + R[2] * (R[3] * R[7] - R[4] * R[6]);
    if (!(det > 0.9 && det < 1.1)) return orl_fail(ORL_E_DEGENERATE, "view: the pose's matrix is not a rotation (determinant %g)", det);
    if (bytes < orl_view_need(cam->w, cam->h) || ((uintptr_t)block & 63)) return orl_fail(ORL_E_MEMORY, "view: block of %zu bytes, %zu aligned to 64 wanted", bytes, orl_view_need(cam->w, cam->h));
    orl_view v = { .w = cam->w, .h = cam->h, .stride = orl_view_stride(cam->w), .cam = *cam, .pose = *pose, .scene = s };
    build_job j = { s, &v, supersample, { 0 } };
    place(&v, block);
    double scale = sqrt(m[0] * m[0] + m[1] * m[1] + m[2] * m[2]), centre[3];
    orl_pose_centre(pose, centre);
    for (int a = 0; a < 3; a++) {
        j.origin[a] = m[4 * a] * centre[0] + m[4 * a + 1] * centre[1] + m[4 * a + 2] * centre[2] + m[4 * a + 3];
        v.eye[a] = j.origin[a];
        for (int c = 0; c < 3; c++) v.grid_from_cam[3 * a + c] = (m[4 * a] * R[3 * c] + m[4 * a + 1] * R[3 * c + 1] + m[4 * a + 2] * R[3 * c + 2]) / scale;
    }
    size_t n = (size_t)v.stride * (size_t)v.h;
    memset(block, 0, (size_t)((uint8_t *)v.sky - (uint8_t *)block));    /* sky: everything 0, lit, no depth */
    memset(v.depth, 255, n * sizeof *v.depth);
    if (s->shadow) memcpy(v.phi_scale, s->shadow_scale, sizeof v.phi_scale);
    build_sky(&v);
    orl_parallel(threads, v.h, GRAIN, build_rows, &j);
    *out = v;
    return ORL_OK;
}

void orl_view_sample(const orl_view *v, int x, int y, orl_sample *out)
{
    size_t at = (size_t)y * (size_t)v->stride + (size_t)x;
    double d[3] = { 0, 0, 1 };
    orl_sample s = { .open = (float)v->open[at] / 255, .cov = (float)v->cov[at] / 255 };
    pixel_dir(v, x + 0.5, y + 0.5, d);
    float n[3] = { v->normal[0][at], v->normal[1][at], v->normal[2][at] }, len = sqrtf(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    for (int c = 0; c < 3; c++) {
        s.normal[c] = len > 0 ? n[c] / len : c == 2;
        s.albedo[c] = orl_powf((float)v->albedo[c][at] / 255, 2.4f);
        s.dir[c] = (float)d[c];
    }
    for (int i = 0; i < ORL_HORIZON; i++) s.horizon[i] = (float)v->horizon[(size_t)i * plane_size(v) + at] * (1.57079633f / 255);
    s.fix = (float)v->fix[at] * (1 / 127.0f);
    for (int k = 0; k < ORL_SHADOW_DIM; k++) s.phi[k] = (float)*phi_of(v, at, k) * v->phi_scale[k];
    *out = s;
}

/* ---- light tables */

static float clampf(float v, float lo, float hi) { return v > lo ? (v < hi ? v : hi) : lo; }       /* NaN -> lo */
static int32_t rounded(float v) { return (int32_t)(v < 0 ? v - 0.5f : v + 0.5f); }
static float exp2i(int e) { uint32_t bits = (uint32_t)(e + 127) << 23; float f; memcpy(&f, &bits, 4); return f; }

/* Nine terms of a unit normal: shade.h's. */
static void sky_terms(const float n[3], double t[ORL_SKY_TERMS])
{
    const double x = n[0], y = n[1], z = n[2];
    memcpy(t, (const double[ORL_SKY_TERMS]){ 1, x, y, z, x * y, y * z, z * x, x * x - y * y, z * z }, ORL_SKY_TERMS * sizeof *t);
}

/* Least squares over directions: the sky's irradiance in those terms, within 1 % of its peak in the places and lights seen (0.3 % rms; Ramamoorthi and Hanrahan, SIGGRAPH 2001, say why). top: its greatest with ground. */
static void fit_sky(const orl_light *l, double k[3][ORL_SKY_TERMS], float top[3])
{
    enum { SIDE = 16, N = ORL_SKY_TERMS };
    double a[N][N + 3] = { { 0 } };
    for (int i = 0; i < SIDE * SIDE; i++) {
        float n[3], e[3];
        double t[N];
        orl_oct_dir(((float)(i % SIDE) + 0.5f) / (SIDE / 2) - 1, ((float)(i / SIDE) + 0.5f) / (SIDE / 2) - 1, n);
        orl_light_esky(l, n, e);
        sky_terms(n, t);
        for (int c = 0; c < 3; c++) {
            e[c] = clampf(e[c], 0, 1e9f);
            float both = e[c] + 0.5f * (1 - n[2]) * clampf(l->eground[c], 0, 1e9f);
            if (!i || both > top[c]) top[c] = both;
        }
        for (int r = 0; r < N; r++) {
            for (int q = 0; q < N; q++) a[r][q] += t[r] * t[q];
            for (int c = 0; c < 3; c++) a[r][N + c] += t[r] * e[c];
        }
    }
    for (int p = 0; p < N; p++)             /* the directions are the same for every light, and far from singular */
        for (int r = 0; r < N; r++) {
            if (r == p) continue;
            double f = a[r][p] / a[p][p];
            for (int q = p; q < N + 3; q++) a[r][q] -= f * a[p][q];
        }
    for (int c = 0; c < 3; c++) for (int r = 0; r < N; r++) k[c][r] = a[r][N + c] / a[r][r];
}

static int16_t entry(double v) { return (int16_t)(v > -32767 ? v < 32767 ? v < 0 ? v - 0.5 : v + 0.5 : 32767 : -32767); }     /* NaN -> -32767 */

/* Normals are 127 / 128, openness is 255 / 256 of what it stands for: the tables make up for it. */
static void make_light(orl_shade_tab *t, const orl_light *l)
{
    const double inv_pi = 0.318309886, up = 128.0 / 127, term[ORL_SKY_TERMS] = { 1, up, up, up, up * up, up * up, up * up, up * up, up * up };
    double sky[3][ORL_SKY_TERMS], sun[3], ground[3], most = 0;
    float top[3];
    fit_sky(l, sky, top);
    for (int c = 0; c < 3; c++) {
        sun[c] = inv_pi * clampf(l->sun_rgb[c], 0, 1e9f);
        ground[c] = inv_pi * 0.5 * clampf(l->eground[c], 0, 1e9f);
        double sum = sun[c] + inv_pi * top[c] * 1.03;
        most = sum > most ? sum : most;
        for (int k = 0; k < ORL_SKY_TERMS; k++) {
            sky[c][k] *= inv_pi * term[k] * (256.0 / 255);
            most = sky[c][k] > most ? sky[c][k] : -sky[c][k] > most ? -sky[c][k] : most;
        }
    }
    int k = 20;
    while (k > 4 && most * exp2i(k) > 32700) k--;
    const double one = exp2i(k);
    for (int c = 0; c < 3; c++) {
        t->sun_dir[c] = entry(32767 * (double)clampf(l->sun_dir[c], -1, 1));
        t->sun[c] = entry(one * sun[c] * up);
        for (int i = 0; i < ORL_SKY_TERMS; i++) t->sky[c][i] = entry(one * sky[c][i]);
        t->ground[c][0] = entry(one * ground[c]);
        t->ground[c][1] = entry(one * ground[c] * up);
    }
    double gain = 1.055 * 8192 * (256.0 / 255) * 1.0003 * (double)orl_powf(exp2i(15 - k), 5.0f / 12);      /* 1.0003: what the power falls short of */
    for (t->gain_shift = 0; gain > 32767; gain /= 2) t->gain_shift++;
    t->gain = entry(gain);
}

/* Shadow code in the features' scales, one power of two for all, at most 8 an entry (the sigmoid is flat long before); the sigmoid's root in pieces of 1, each a parabola through both ends and the middle. */
static void make_shadow(orl_shade_tab *t, const orl_view *v, const orl_light *l)
{
    float w[ORL_SHADOW_DIM], top = 0, f[3] = { 0 };
    for (int k = 0; k < ORL_SHADOW_DIM; k++) {
        w[k] = clampf(l->code[ORL_C_SHADOW + k] * v->phi_scale[k], -7.9f, 7.9f);
        top = w[k] > top ? w[k] : -w[k] > top ? -w[k] : top;
    }
    int q = 26;
    while (q > 11 && top * exp2i(q) > ORL_PHI_W_MAX) q--;
    t->phi_shift = q - 11;
    t->phi_bias = rounded((ORL_SHADOW_BIAS + 8) * 2048);
    for (int k = 0; k < ORL_SHADOW_DIM; k++) {
        int x = rounded(w[k] * exp2i(q)), hi = (x + 64) >> 7;
        t->phi_hi[k] = (int8_t)hi;
        t->phi_lo[k] = (int8_t)(x - 128 * hi);
    }
    for (int i = 0; i < ORL_SHADOW_KNOTS; i++) {
        for (int k = 0; k < 3; k++) f[k] = 32767 * orl_powf(1 / (1 + orl_expf(8 - (float)i - 0.5f * (float)k)), 5.0f / 12);
        float bend = 2 * (f[0] - 2 * f[1] + f[2]);
        t->shadow[0][i] = entry(f[0]);
        t->shadow[1][i] = entry(f[2] - f[0] - bend);
        t->shadow[2][i] = entry(bend);
    }
    t->no_shadow = entry(32767 * orl_powf(1 / (1 + orl_expf(-ORL_SHADOW_BIAS)), 5.0f / 12));
}

/* tone_shift: the greatest at which a row of colours of at most 3.49 leaves 16 bits nowhere. What 16 times white or more takes off or adds is cut, as are rows whose entries sum above 15.9: no photo's tone is near. */
static void make_tone(orl_shade_tab *t, const orl_light *l)
{
    float a[3][3], b[3], most = 0;
    for (int c = 0; c < 3; c++) {
        float sum = 0;
        for (int k = 0; k < 3; k++) {
            a[c][k] = clampf(l->tone_a[c][k], -1e3f, 1e3f);
            sum += a[c][k] < 0 ? -a[c][k] : a[c][k];
        }
        for (int k = 0; k < 3 && sum > 15.9f; k++) a[c][k] *= 15.9f / sum;
        b[c] = clampf(l->tone_b[c], -16, 16);
        if (sum > 15.9f) sum = 15.9f;
        float reach = 3.49f * sum + (b[c] < 0 ? -b[c] : b[c]);
        if (reach < 4.03f * sum) reach = 4.03f * sum;               /* entries themselves */
        most = reach > most ? reach : most;
    }
    for (t->tone_shift = 4; t->tone_shift > 0 && most * (float)(255 << t->tone_shift) > 32700; ) t->tone_shift--;
    for (int c = 0; c < 3; c++) {
        for (int k = 0; k < 3; k++) t->tone[c][k] = entry((double)a[c][k] * (1 << (10 + t->tone_shift)) * (255.0 / 256));
        t->tone_b[c] = entry(b[c] * 255.0 * (1 << t->tone_shift) + (1 << t->tone_shift) / 2);
    }
}

static void make_vis(orl_vis_tab *t, const orl_light *l)
{
    const float pi = 3.14159265f;
    float a = l->code[ORL_C_SUN_AZ] * (ORL_HORIZON / (2 * pi));
    int i = (int)a - (a < (float)(int)a);
    t->i0 = i & (ORL_HORIZON - 1);
    t->i1 = (i + 1) & (ORL_HORIZON - 1);
    t->f = rounded((a - (float)i) * 256);
    t->over = rounded(clampf((l->code[ORL_C_SUN_EL] + ORL_SUN_SOFT / 2) * (QUARTER * 2 / pi), -1e6f, 1e6f));
    t->under = QUARTER + ORL_VIS_SPAN - t->over;                /* pi / 2 - elevation + half the soft sun */
    if (t->under < ORL_VIS_SPAN) t->under = ORL_VIS_SPAN;       /* nothing overhead hides nothing */
}

static void make_sky(int16_t out[3][NODES * NODES], const sky_grid *g, const orl_light *l)
{
    for (int i = 0; i < g->nx * g->ny; i++) {
        const float *d = g->dir[i];
        float x = l->cos_az * d[0] + l->sin_az * d[1], y = l->cos_az * d[1] - l->sin_az * d[0], z = d[2];
        const float Y[ORL_SKY_Y] = { 1, x, y, z, x * y, y * z, z * x, x * x - y * y, 3 * z * z - 1 };
        for (int c = 0; c < 3; c++) {
            float e = 0;
            for (int k = 0; k < ORL_SKY_Y; k++) e += l->sky_m[c][k] * Y[k];
            out[c][i] = (int16_t)rounded(8192 * clampf(e, -0.5f, 3.49f));
        }
    }
}
size_t orl_view_light_need(void) { return orl_align64(sizeof(orl_view_light)); }

orl_view_light *orl_view_light_make(const orl_view *v, const orl_light *l, void *block, size_t bytes)
{
    if (bytes < sizeof(orl_view_light) || ((uintptr_t)block & 63)) return NULL;
    orl_view_light *t = block;
    make_light(&t->tab, l);
    make_shadow(&t->tab, v, l);
    make_tone(&t->tab, l);
    make_vis(&t->vis, l);
    make_sky(t->sky, v->sky, l);
    return t;
}

/* Sun visibility of n pixels from `at` on, Q15, by a view's horizons and ceilings, and with_fix by what a traced sun has over the horizons. */
static void vis_of(const orl_kernels *k, const orl_view *v, const orl_vis_tab *t, int with_fix, size_t at, int n, int16_t *vis)
{
    size_t i0 = (size_t)t->i0 * plane_size(v) + at, i1 = (size_t)t->i1 * plane_size(v) + at;
    orl_vis_in in = { { v->horizon + i0, v->horizon + i1 }, { NULL, NULL }, NULL, v->cov + at };
    if (v->ceiling) in.ceiling[0] = v->ceiling + i0, in.ceiling[1] = v->ceiling + i1;
    else if (with_fix) in.fix = v->fix + at;
    k->vis(&in, t, n, vis);
}

/* ---- the sun's way */

/* Where rays from a pixel's surface begin. 0: the lens has no such pixel. */
static int lifted(const orl_view *v, int x, int y, const float n[3], double o[3])
{
    double d[3], t = v->depth[(size_t)y * (size_t)v->stride + (size_t)x] / 16.0;
    if (!pixel_dir(v, x + 0.5, y + 0.5, d)) return 0;
    for (int a = 0; a < 3; a++) o[a] = v->eye[a] + t * d[a] + (double)(ORL_SUN_LIFT * n[a]);
    return 1;
}

static int sunlit(const orl_view *v, int x, int y, const orl_sample *p, const orl_light *l)
{
    const float *n = p->normal, *s = l->sun_dir;
    double o[3], sun[3] = { s[0], s[1], s[2] };
    orl_hit h;
    if (!(n[0] * s[0] + n[1] * s[1] + n[2] * s[2] > 0) || !lifted(v, x, y, n, o)) return 0;
    return !orl_march(v->scene, o, sun, &h);
}

/* A ceiling hides a sun of this elevation as a horizon does that stands as far above the sun as the ceiling below it. */
void orl_view_sample_sun(const orl_view *v, const orl_light *l, int x, int y, orl_sample *s)
{
    const float unit = 1.57079633f / 255, zenith = 1.57079633f, el = l->code[ORL_C_SUN_EL];
    size_t at = (size_t)y * (size_t)v->stride + (size_t)x;
    s->fix = 0;
    for (int i = 0; v->ceiling && i < ORL_HORIZON; i++) {
        size_t k = (size_t)i * plane_size(v) + at;
        float up = (float)v->horizon[k] * unit, hidden = v->ceiling[k] ? 2 * el - (float)(255 - v->ceiling[k]) * unit : 0;
        s->horizon[i] = hidden > up ? hidden < zenith ? hidden : zenith : up;
    }
    if (!v->ceiling && v->cov[at] && v->scene->lite && l->sun_dir[2] > 0) s->fix = (float)sunlit(v, x, y, s, l) - orl_light_sun_visibility(l, s);
}

typedef struct { orl_view *v; const orl_light *l; int y0; orl_vis_tab vis; uint8_t *ceiling; orl_kernels k; } trace_job;

static void trace_row(const trace_job *j, int y)
{
    orl_view *v = j->v;
    const orl_light *l = j->l;
    for (int x = 0; x < v->w; x++) {
        size_t at = (size_t)y * (size_t)v->stride + (size_t)x;
        orl_sample p;
        v->fix[at] = 0;
        if (!v->cov[at] || !v->scene->lite || !(l->sun_dir[2] > 0)) continue;     /* a scene without horizons takes the sun as unhidden */
        orl_view_sample(v, x, y, &p);
        v->fix[at] = (int8_t)rounded(127 * ((float)sunlit(v, x, y, &p, l) - orl_light_sun_visibility(l, &p)));
    }
}

/* What a ceiling takes of a baked pixel's sun. */
static void look_up_row(const trace_job *j, int y)
{
    orl_view *v = j->v, open = *v;
    open.ceiling = NULL;
    if (!(j->l->sun_dir[2] > 0)) { memset(v->fix + (size_t)y * (size_t)v->stride, 0, (size_t)v->stride); return; }
    for (int x = 0; x < v->stride; x += CHUNK) {
        int16_t vis[CHUNK], over[CHUNK];
        size_t at = (size_t)y * (size_t)v->stride + (size_t)x;
        int n = v->stride - x < CHUNK ? v->stride - x : CHUNK;
        vis_of(&j->k, v, &j->vis, 0, at, n, vis);
        vis_of(&j->k, &open, &j->vis, 0, at, n, over);
        for (int i = 0; i < n; i++) v->fix[at + (size_t)i] = (int8_t)-((over[i] - vis[i] + 129) / 258);
    }
}

static void trace_rows(void *user, int begin, int end)
{
    const trace_job *j = user;
    for (int y = j->y0 + begin; y < j->y0 + end; y++) (j->v->ceiling ? look_up_row : trace_row)(j, y);
}

void orl_view_trace_sun(orl_view *v, const orl_light *l, int y0, int y1, unsigned cpu, int threads)
{
    trace_job j = { .v = v, .l = l, .y0 = y0 };
    orl_kernels_init(&j.k, cpu);
    make_vis(&j.vis, l);
    orl_parallel(threads, y1 - y0, GRAIN, trace_rows, &j);
}

/* ---- baking */

enum { LOOKS = 18, HALVINGS = 3 };      /* elevations looked at in an azimuth, 5 degrees apart; then each end of the gap is halved so often */

static int open_at(const orl_view *v, const double o[3], float az, float el)
{
    const double d[3] = { orl_cosf(el) * orl_cosf(az), orl_cosf(el) * orl_sinf(az), orl_sinf(el) };
    orl_hit h;
    return !orl_march(v->scene, o, d, &h);
}

/* Elevation between shut and open at which the one becomes the other. */
static float edge(const orl_view *v, const double o[3], float az, float shut, float open)
{
    for (int k = 0; k < HALVINGS; k++) {
        float mid = 0.5f * (shut + open);
        if (open_at(v, o, az, mid)) open = mid;
        else shut = mid;
    }
    return 0.5f * (shut + open);
}

/* The widest gap of one azimuth in bytes of a quarter turn. 0: the surface looks away from all of it, and it does not matter. */
static int gap_of(const orl_view *v, const double o[3], const float n[3], int azimuth, uint8_t *horizon, uint8_t *ceiling)
{
    const float quarter = 1.57079633f, step = quarter / LOOKS, az = (float)azimuth * (4 * quarter / ORL_HORIZON), ahead = n[0] * orl_cosf(az) + n[1] * orl_sinf(az);
    int open[LOOKS], best = 0, first = 0, known = 0;
    for (int k = 0; k < LOOKS; k++) {
        float el = ((float)k + 0.5f) * step;
        int faces = orl_cosf(el) * ahead + orl_sinf(el) * n[2] > 0.02f;
        open[k] = faces ? open_at(v, o, az, el) : -1;
        known |= faces;
    }
    if (!known) return 0;
    for (int k = 1; k < LOOKS; k++) if (open[k] < 0) open[k] = open[k - 1];         /* where the surface looks away, as next to it */
    for (int k = LOOKS - 2; k >= 0; k--) if (open[k] < 0) open[k] = open[k + 1];
    for (int k = 0, from = 0; k <= LOOKS; k++) {
        if (k < LOOKS && open[k]) continue;
        if (k - from > best) { best = k - from; first = from; }
        from = k + 1;
    }
    float lo = first ? edge(v, o, az, ((float)first - 0.5f) * step, ((float)first + 0.5f) * step) : 0;
    float hi = first + best < LOOKS ? edge(v, o, az, ((float)(first + best) + 0.5f) * step, ((float)(first + best) - 0.5f) * step) : quarter;
    *horizon = (uint8_t)(best ? rounded(lo * (255 / quarter)) : 255);
    *ceiling = (uint8_t)(best ? 255 - rounded(hi * (255 / quarter)) : 0);
    return 1;
}

static void bake_pixel(const trace_job *j, int x, int y)
{
    orl_view *v = j->v;
    size_t at = ((size_t)y * (size_t)v->stride + (size_t)x);
    uint8_t *horizon = v->horizon + at, *ceiling = j->ceiling + at;
    const size_t n = plane_size(v);
    orl_sample p;
    double o[3];
    int known[ORL_HORIZON];
    if (!v->cov[at] || !v->scene->lite) return;
    orl_view_sample(v, x, y, &p);
    if (!lifted(v, x, y, p.normal, o)) return;
    for (int i = 0; i < ORL_HORIZON; i++) known[i] = gap_of(v, o, p.normal, i, &horizon[(size_t)i * n], &ceiling[(size_t)i * n]);
    for (int i = 0; i < ORL_HORIZON; i++)
        for (int off = 1; !known[i] && off < ORL_HORIZON; off++) {                   /* as the nearest azimuth that it faces; the first of two */
            size_t to = (size_t)i * n, from = (size_t)((i + (off & 1 ? (off + 1) / 2 : ORL_HORIZON - off / 2)) & (ORL_HORIZON - 1));
            if (!known[from]) continue;
            horizon[to] = horizon[from * n];
            ceiling[to] = ceiling[from * n];
            break;
        }
}

static void bake_rows(void *user, int begin, int end)
{
    const trace_job *j = user;
    for (int y = j->y0 + begin; y < j->y0 + end; y++) for (int x = 0; x < j->v->w; x++) bake_pixel(j, x, y);
}

void orl_view_bake(orl_view *v, int y0, int y1, int threads, uint8_t *ceiling)
{
    orl_parallel(threads, y1 - y0, 1, bake_rows, &(trace_job){ .v = v, .y0 = y0, .ceiling = ceiling });
}

/* ---- rows */

static void look_ahead(orl_shade_in *in, const uint8_t *at, int step)
{
    for (int k = 0; k < step; k++) {
        in->ahead[in->aheads].at = at + 64 * k;
        in->ahead[in->aheads++].step = step;
    }
}

/* What will be shaded CHUNK pixels later. */
static void look_ahead_of(const orl_view *v, const orl_vis_tab *t, int shadows, size_t at, orl_shade_in *in)
{
    const size_t i0 = (size_t)t->i0 * plane_size(v) + at, i1 = (size_t)t->i1 * plane_size(v) + at;
    for (int c = 0; c < 3; c++) look_ahead(in, (const uint8_t *)v->normal[c] + at, 1);
    for (int c = 0; c < 3; c++) look_ahead(in, v->albedo[c] + at, 1);
    look_ahead(in, v->open + at, 1);
    look_ahead(in, v->cov + at, 1);
    look_ahead(in, v->horizon + i0, 1);
    look_ahead(in, v->horizon + i1, 1);
    if (v->ceiling) {
        look_ahead(in, v->ceiling + i0, 1);
        look_ahead(in, v->ceiling + i1, 1);
    } else look_ahead(in, (const uint8_t *)v->fix + at, 1);
    for (int g = 0; shadows && g < 2; g++) look_ahead(in, (const uint8_t *)v->phi[g] + at * ORL_PHI_GROUP, ORL_PHI_GROUP);
}

/* Columns [x, end) of a row; x is a multiple of ORL_KERNEL_STEP, end one or the row's. */
static void shade_span(const orl_view *v, const orl_view_light *l, const orl_kernels *k, int y, int x, int end, const int16_t *const sky[3], uint8_t *rgb)
{
    const sky_grid *g = v->sky;
    int shadows = 0;
    for (int i = 0; i < ORL_SHADOW_DIM; i++) shadows |= v->phi_scale[i] > 0;
    for (int n; x < end; x += n) {
        int16_t s[CHUNK], vis[CHUNK];
        size_t at = (size_t)y * (size_t)v->stride + (size_t)x;
        uint8_t tail[CHUNK * 3], *to = rgb + 3 * (size_t)x;
        n = end - x < CHUNK ? end - x : CHUNK;
        int padded_n = (n + ORL_KERNEL_STEP - 1) / ORL_KERNEL_STEP * ORL_KERNEL_STEP, whole = padded_n == n;        /* the row's padding makes room */
        orl_shade_in in = { .open = v->open + at, .cov = v->cov + at, .vis = vis, .s = shadows ? s : NULL, .sky_log2 = g->log2, .x = x };
        for (int c = 0; c < 3; c++) {
            in.normal[c] = v->normal[c] + at;
            in.albedo[c] = v->albedo[c] + at;
            in.sky[c] = sky[c];
        }
        if (at + 2 * CHUNK < plane_size(v)) look_ahead_of(v, &l->vis, shadows, at + CHUNK, &in);
        vis_of(k, v, &l->vis, 1, at, padded_n, vis);
        if (shadows) k->shadow((const int8_t *const[]){ v->phi[0] + at * ORL_PHI_GROUP, v->phi[1] + at * ORL_PHI_GROUP }, v->cov + at, &l->tab, padded_n, s);
        k->shade(&in, &l->tab, padded_n, whole ? to : tail);
        if (!whole) memcpy(to, tail, 3 * (size_t)n);
    }
}

void orl_view_shade_row(const orl_view *v, const orl_view_light *l, unsigned cpu, int y, int x0, int x1, uint8_t *rgb)
{
    const sky_grid *g = v->sky;
    int16_t sky[3][NODES + ORL_NODES_MORE];
    const size_t first = (size_t)(y >> g->log2) * (size_t)g->nx;
    int f = (y & ((1 << g->log2) - 1)) << (15 - g->log2);
    orl_kernels k;
    orl_kernels_init(&k, cpu);
    for (int c = 0; c < 3; c++) {
        const int16_t *a = l->sky[c] + first, *b = a + g->nx;
        for (int i = 0; i < g->nx; i++) sky[c][i] = (int16_t)(a[i] + (((b[i] - a[i]) * f + 0x4000) >> 15));
        for (int i = 0; i < ORL_NODES_MORE; i++) sky[c][g->nx + i] = 0;
    }
    int left = (x0 + ORL_KERNEL_STEP - 1) / ORL_KERNEL_STEP * ORL_KERNEL_STEP, right = x1 / ORL_KERNEL_STEP * ORL_KERNEL_STEP;
    if (left >= right) left = right = 0;
    const int16_t *const rows[3] = { sky[0], sky[1], sky[2] };
    shade_span(v, l, &k, y, 0, left, rows, rgb);
    shade_span(v, l, &k, y, right, v->w, rows, rgb);
}

void orl_view_shade(const orl_view *v, const orl_view_light *l, unsigned cpu, int y0, int y1, uint8_t *rgb, size_t row_bytes)
{
    for (int y = y0; y < y1; y++) orl_view_shade_row(v, l, cpu, y, 0, 0, rgb + (size_t)(y - y0) * row_bytes);
}
