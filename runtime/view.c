/* The view: marches pixels into planes (bit-identical for any thread count: a tile is one thread's alone), turns a light into tables, and runs the re-lighting kernels over rows. */
#include "oriel/view.h"
#include <math.h>
#include <string.h>
#include "oriel/math.h"
#include "oriel/parallel.h"
#include "runtime/arena.h"
#include "runtime/kernels/shade.h"
#include "runtime/march.h"

enum { NODES = 66, GRAIN = 4, CHUNK = 1024, QUARTER = 255 * 256, APART = 96 };      /* QUARTER turn in units of the horizons' kernel */

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

/* Unit direction of pixel position (x, y), scene frame. 0 if the lens has none, d untouched. */
static int pixel_dir(const orl_view *v, double x, double y, double d[3])
{
    double c[3], r[3], len = 0;
    orl_camera_unproject(&v->cam, x, y, c);
    for (int a = 0; a < 3; a++) {
        r[a] = v->grid_from_cam[3 * a] * c[0] + v->grid_from_cam[3 * a + 1] * c[1] + v->grid_from_cam[3 * a + 2] * c[2];
        len += r[a] * r[a];
    }
    if (!(len > 1e-12 && len < 1e12)) return 0;
    len = sqrt(len);
    for (int a = 0; a < 3; a++) d[a] = r[a] / len;
    return 1;
}

static int8_t *phi_of(const orl_view *v, size_t at, int k) { return v->phi[k / ORL_PHI_GROUP] + at * ORL_PHI_GROUP + k % ORL_PHI_GROUP; }

/* A view's bytes of base colours Q16, by their upper 12 bits: the kernels' own power. */
enum { ALBEDOS = 4096 };
static void albedo_bytes(uint8_t byte[ALBEDOS])
{
    for (int i = 0; i < ALBEDOS; i++) byte[i] = (uint8_t)((orl_power_ref(8 * i + 4) * 255 + (1 << 14)) >> 15);
    byte[0] = 0;
}

/* ---- building */

enum { TILE = 15, FINE = 8, TILE_RAYS = 256 };       /* pixels a side whose rays set out together; FINE: where each pixel has four of its own */
_Static_assert((TILE + 1) * (TILE + 1) <= (int)TILE_RAYS && 4 * FINE * FINE <= (int)TILE_RAYS && (int)TILE_RAYS <= (int)ORL_RAYS, "a tile's rays");
#define COARSE_PIXEL 1.0             /* cells */

typedef struct { const orl_scene *s; orl_view *v; const uint8_t *wanted; const orl_beside *beside; int ss, across; double origin[3]; uint8_t albedo[ALBEDOS]; } build_job;       /* across: tiles in a row of them */

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
    h->brick = -1;
    h->grad[2] = 1;
    for (int k = 0; k < 3; k++) {
        uint32_t a = (256 - w[0]) * (uint32_t)(c[k] * c[k]) + w[0] * (uint32_t)(c[k + 3] * c[k + 3]), b = (256 - w[0]) * (uint32_t)(next[k] * next[k]) + w[0] * (uint32_t)(next[k + 3] * next[k + 3]);
        h->albedo[k] = (uint32_t)(((uint64_t)((256 - w[1]) * a + w[1] * b) * 65535 + 65025 * 32768u) / (65025ull * 65536));
    }
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
    h->brick = -1;
    float n[3];
    orl_backdrop_normal(uv[0], n);
    for (int a = 0; a < 3; a++) h->grad[a] = (n[a] > 0) - (n[a] < 0);
    for (int k = 0; k < 3; k++) h->albedo[k] = (uint32_t)(((uint64_t)rgba[k] * 65535 + 65025 * 128u) / (65025u * 256));
    h->t = (int64_t)(t * 65536 + 0.5);
    return 1;
}

static int beside_box(const orl_scene *s, const double x[3]) { return x[0] < 0 || x[1] < 0 || x[0] > 8.0 * s->nb[0] || x[1] > 8.0 * s->nb[1]; }

/* The surface, or the ground where a ray meets no surface, a low cut, or the ground beside the box first. Higher cuts are passed through: nobody knows what stands there. Without ground, a cut is a surface.
 * Where no surface is met, the backdrop stands before the ground behind it. met: *h holds the surface or cut that was met. */
static int settle_ray(const orl_scene *s, const double o[3], const double d[3], int met, int opaque, orl_hit *h)
{
    double t = 0;
    if (!s->ground_albedo) return met;
    int falls = ground_meet(s, o, d, &t);
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

typedef struct {
    double d[TILE_RAYS][3];    /* 0: the lens has none */
    orl_hit hit[TILE_RAYS];
    float n[TILE_RAYS][3];
    int wanted[TILE_RAYS], met[TILE_RAYS], open[TILE_RAYS], count;      /* open: rays under way */
    orl_march march;
} tile;

/* Marches a tile's rays up to a surface or a low cut; without ground, any cut. */
static void march_tile(const build_job *j, tile *l, double freely)
{
    const orl_scene *s = j->s;
    int n = 0;
    for (int i = 0; i < l->count; i++) {
        l->met[i] = 0;
        l->hit[i].t = 0;
        if (l->wanted[i]) l->open[n++] = i;
    }
    if (freely >= 1e12) n = 0;
    for (int cuts = 0; n && cuts < (s->ground_albedo ? ORL_CUTS : 1); cuts++) {
        int left = 0;
        l->march.n = 0;
        for (int k = 0; k < n; k++) {
            int i = l->open[k];
            double o[3];
            for (int a = 0; a < 3; a++) o[a] = j->origin[a] + (double)l->hit[i].t / 65536 * l->d[i][a];
            orl_march_begin(s, o, l->d[i], cuts ? 0 : freely, &l->march);
        }
        orl_march_run(s, 1, &l->march);
        for (int k = 0; k < n; k++) {
            int i = l->open[k];
            orl_hit *h = &l->hit[i];
            int64_t gone = h->t;
            if (!orl_march_hit(s, &l->march, k, h)) continue;
            h->t += gone;
            double x[3];
            for (int a = 0; a < 3; a++) x[a] = j->origin[a] + (double)h->t / 65536 * l->d[i][a];
            l->met[i] = !s->ground_albedo || !h->cut || over_ground(s, x) <= ORL_GROUND_CUT * 8 * s->nb[0];
            if (!l->met[i]) l->open[left++] = i;
        }
        n = left;
    }
}

typedef struct { uint32_t albedo[3]; int32_t lite[ORL_LITE_BYTES], phi[ORL_SHADOW_DIM]; int64_t t; } sums;

static inline __attribute__((always_inline)) void put_means(const build_job *j, size_t at, const sums *s, int m)
{
    const int32_t one = m << 8, half = m << 7;
    orl_view *v = j->v;
    for (int c = 0; c < 3; c++) v->albedo[c][at] = j->albedo[((s->albedo[c] + (uint32_t)m / 2) / (uint32_t)m) >> 4];
    v->open[at] = (uint8_t)((s->lite[0] + half) / one);
    for (int i = 0; i < ORL_HORIZON; i++) v->horizon[(size_t)i * plane_size(v) + at] = (uint8_t)((uint32_t)(s->lite[1 + i] + half) / (uint32_t)one);
    for (int k = 0; k < ORL_SHADOW_DIM; k++) *phi_of(v, at, k) = (int8_t)((s->phi[k] < 0 ? s->phi[k] - half : s->phi[k] + half) / one);     /* half away from zero */
    int64_t depth = (s->t / m + (1 << 11)) >> 12;
    v->depth[at] = (uint16_t)(depth > 65534 ? 65534 : depth);
}

/* What a ray met: its unit normal, turned, in n; (0, 0, 0) where the SDF is flat. */
static int see(const build_job *j, tile *l, int i, int opaque)
{
    const double *d = l->d[i];
    orl_hit *h = &l->hit[i];
    memset(l->n[i], 0, sizeof l->n[i]);
    if (!l->wanted[i] || !settle_ray(j->s, j->origin, d, l->met[i], opaque, h)) return 0;
    if (h->brick >= 0) orl_march_surface(j->s, h);
    double g[3] = { h->grad[0], h->grad[1], h->grad[2] }, len = sqrt(g[0] * g[0] + g[1] * g[1] + g[2] * g[2]);
    if (!(len > 0)) return 1;
    for (int a = 0; a < 3; a++) l->n[i][a] = (float)(g[a] / len);
    orl_facing_turn(&j->s->facings, l->n[i]);
    return 1;
}

/* Mean of the rays that hit; coverage is their share. Light changes slowly: rays that hit one brick take the light of the middle of their hits. of: the pixel's rays. */
static void build_pixel(const build_job *j, int x, int y, const tile *l, const int *of)
{
    orl_view *v = j->v;
    int hits = 0, rays = j->ss == ORL_RAYS_MIDDLE ? 1 : 4, alike[4] = { 0 };
    double n[3] = { 0 };
    sums sum = { 0 };
    const orl_hit *hit[4];
    for (int k = 0; k < rays; k++) {
        if (!l->met[of[k]]) continue;
        const orl_hit *h = hit[hits++] = &l->hit[of[k]];
        for (int a = 0; a < 3; a++) n[a] += l->n[of[k]][a];
        for (int c = 0; c < 3; c++) sum.albedo[c] += h->albedo[c];
        sum.t += h->t;
    }
    for (int k = 0; k < hits; k++) {
        int32_t at[3] = { 0 };
        uint16_t lit[ORL_LITE_BYTES];
        int16_t dark[ORL_SHADOW_DIM];
        int same = 0;
        if (alike[k]) continue;
        for (int i = k; i < hits; i++) {
            if (hit[i]->brick != hit[k]->brick) continue;
            for (int a = 0; a < 3; a++) at[a] += hit[i]->at[a];         /* below 2^24 each */
            alike[i] = 1;
            same++;
        }
        for (int a = 0; a < 3; a++) at[a] = same == 4 ? at[a] / 4 : at[a] / same;      /* mostly four, and a shift */
        orl_march_light(j->s, hit[k]->brick, at, lit, dark);
        for (int c = 0; c < ORL_LITE_BYTES; c++) sum.lite[c] += same * lit[c];
        for (int c = 0; c < ORL_SHADOW_DIM; c++) sum.phi[c] += same * dark[c];
    }
    if (!hits) return;
    size_t at = (size_t)y * (size_t)v->stride + (size_t)x;
    double len = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    for (int a = 0; a < 3 && len > 0; a++) v->normal[a][at] = (int8_t)(n[a] < 0 ? 127 * n[a] / len - 0.5 : 127 * n[a] / len + 0.5);
    v->cov[at] = (uint8_t)((255 * hits + rays / 2) / rays);
    switch (hits) {         /* constant divisors */
    case 1: put_means(j, at, &sum, 1); break;
    case 2: put_means(j, at, &sum, 2); break;
    case 3: put_means(j, at, &sum, 3); break;
    case 4: put_means(j, at, &sum, 4); break;
    }
}

/* How rays run: n of a pixel's side, the first one at `off` from its corner, and one more at the end of a row and of rows of pixels if `more`. */
typedef struct { int n, more; double off; } pattern;
static const pattern MIDDLES = { 1, 0, 0.5 }, CORNERS = { 1, 1, 0 }, FOURS = { 2, 0, 0.5 };

/* The tile's rays and the ball that holds them, those of pixels that are not wanted, too, which makes no pixel depend on what else is wanted: its middle's direction and its radius at distance 1.
 * 0: no pixel is wanted, or rays run all round, as no camera's do. */
static int aim(const build_job *j, int x0, int y0, int w, int h, const pattern *p, tile *l, double middle[3], double *spread)
{
    const orl_view *v = j->v;
    const int cols = w * p->n + p->more, side = p->n == 2 || p->more ? 2 : 1;
    double len = 0, most = 0;
    l->count = cols * (h * p->n + p->more);
    int any = 0;
    memset(l->wanted, 0, sizeof l->wanted);
    for (int y = 0; y < h; y++)
        for (int x = 0; x < w; x++) {
            int wanted = !j->wanted || j->wanted[(size_t)(y0 + y) * (size_t)v->w + (size_t)(x0 + x)];
            for (int k = 0; k < side * side; k++) l->wanted[(y * p->n + k / side) * cols + x * p->n + k % side] |= wanted;
            any |= wanted;
        }
    if (!any) return 0;
    for (int a = 0; a < 3; a++) middle[a] = 0;
    for (int i = 0; i < l->count; i++) {
        double *d = l->d[i];
        if (!pixel_dir(v, x0 + (i % cols + p->off) / p->n, y0 + (i / cols + p->off) / p->n, d)) d[0] = d[1] = d[2] = l->wanted[i] = 0;
        for (int a = 0; a < 3; a++) middle[a] += d[a];
    }
    for (int a = 0; a < 3; a++) len += middle[a] * middle[a];
    if (!(len > 0)) return 0;
    len = 1 / sqrt(len);
    for (int a = 0; a < 3; a++) middle[a] *= len;
    for (int i = 0; i < l->count; i++) {
        const double *d = l->d[i];
        double q = (d[0] - middle[0]) * (d[0] - middle[0]) + (d[1] - middle[1]) * (d[1] - middle[1]) + (d[2] - middle[2]) * (d[2] - middle[2]);
        if (q > most && (d[0] != 0 || d[1] != 0 || d[2] != 0)) most = q;
    }
    *spread = sqrt(most);
    return 1;
}

static void build_tile(const build_job *j, int x0, int y0, int w, int h, const pattern *p);
static void build_fours(const build_job *j, int x0, int y0, int w, int h)
{
    for (int y = 0; y < h; y += FINE) for (int x = 0; x < w; x += FINE) build_tile(j, x0 + x, y0 + y, w - x < FINE ? w - x : FINE, h - y < FINE ? h - y : FINE, &FOURS);
}

/* A tile's rays set out together: a ball round the middle one that holds all of them goes as far as it meets no brick. One ray a pixel runs through its middle; four run through its corners, and neighbours
 * share them, unless a pixel is wider than COARSE_PIXEL where the ball ends: then more is to be seen in it, and it has four rays of its own. */
static void build_tile(const build_job *j, int x0, int y0, int w, int h, const pattern *p)
{
    const orl_view *v = j->v;
    double middle[3], spread;
    tile l;
    if (!aim(j, x0, y0, w, h, p, &l, middle, &spread)) return;
    double freely = orl_march_freely(j->s, j->origin, middle, spread);
    if (p == &CORNERS && freely < 1e12 && 2 * spread * freely > COARSE_PIXEL * sqrt((double)(w * w + h * h))) {
        build_fours(j, x0, y0, w, h);
        return;
    }
    march_tile(j, &l, freely);
    const int cols = w * p->n + p->more, X = x0 * p->n, Y = y0 * p->n;
    for (int i = 0; i < l.count; i++) l.met[i] = see(j, &l, i, p == &MIDDLES ? 4 : 2 * ((X + i % cols) % 2 + 2 * ((Y + i / cols) % 2)) + 1);     /* so that the rays of a pixel ask for more and more opaque a backdrop */
    for (int y = 0; y < h; y++)
        for (int x = 0; x < w; x++) {
            int at = y * p->n * cols + x * p->n, of[4] = { at, at + 1, at + cols, at + cols + 1 };
            if (!j->wanted || j->wanted[(size_t)(y0 + y) * (size_t)v->w + (size_t)(x0 + x)]) build_pixel(j, x0 + x, y0 + y, &l, of);
        }
}

/* The first GRAIN of them stand for what is done beside. */
static void build_tiles(void *user, int begin, int end)
{
    const build_job *j = user;
    const int first = j->beside ? GRAIN : 0;
    if (begin < first) { j->beside->fn(j->beside->user); return; }
    for (int i = begin - first; i < end - first; i++) {
        int x = i % j->across * TILE, y = i / j->across * TILE;
        int w = j->v->w - x < TILE ? j->v->w - x : TILE, h = j->v->h - y < TILE ? j->v->h - y : TILE;
        if (j->ss == ORL_RAYS_FOUR) build_fours(j, x, y, w, h);
        else build_tile(j, x, y, w, h, j->ss == ORL_RAYS_MIDDLE ? &MIDDLES : &CORNERS);
    }
}

/* Sky: everything 0, lit, no depth. */
static void clear_rows(void *user, int begin, int end)
{
    const orl_view *v = user;
    size_t at = (size_t)begin * (size_t)v->stride, n = (size_t)(end - begin) * (size_t)v->stride;
    for (int c = 0; c < 3; c++) memset(v->normal[c] + at, 0, n);
    for (int c = 0; c < 3; c++) memset(v->albedo[c] + at, 0, n);
    memset(v->open + at, 0, n);
    memset(v->cov + at, 0, n);
    for (size_t i = 0; i < ORL_HORIZON; i++) memset(v->horizon + i * plane_size(v) + at, 0, n);
    for (int g = 0; g < 2; g++) memset(v->phi[g] + at * ORL_PHI_GROUP, 0, n * ORL_PHI_GROUP);
    memset(v->fix + at, 0, n);
    memset(v->depth + at, 255, n * sizeof *v->depth);
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
    return orl_view_build_some(s, cam, pose, supersample, NULL, NULL, threads, block, bytes, out);
}

orl_err orl_view_build_some(const orl_scene *s, const orl_camera *cam, const orl_pose *pose, int supersample, const uint8_t *wanted, const orl_beside *beside, int threads, void *block, size_t bytes, orl_view *out)
{
    const double lens[] = { cam->fx, cam->fy, cam->cx, cam->cy, cam->k1, cam->k2, cam->p1, cam->p2 }, *R = pose->R, *m = s->world_to_grid;
    if (!s->bmap) return orl_fail(ORL_E_DEGENERATE, "view: the scene has no geometry (a sky file?)");
    if (cam->w < 1 || cam->h < 1 || cam->w > 65535 || cam->h > 65535) return orl_fail(ORL_E_RANGE, "view: size %d x %d", cam->w, cam->h);
    if (supersample < ORL_RAYS_MIDDLE || supersample > ORL_RAYS_CORNERS) return orl_fail(ORL_E_RANGE, "view: supersample %d", supersample);
    if (!all_finite(lens, 8) || !(cam->fx > 0) || !(cam->fy > 0)) return orl_fail(ORL_E_DEGENERATE, "view: camera parameters are not finite");
    if (!all_finite(R, 9) || !all_finite(pose->t, 3)) return orl_fail(ORL_E_DEGENERATE, "view: pose is not finite");
    double det = R[0] * (R[4] * R[8] - R[5] * R[7]) - R[1] * (R[3] * R[8] - R[5] * R[6]) + R[2] * (R[3] * R[7] - R[4] * R[6]);
    if (!(det > 0.9 && det < 1.1)) return orl_fail(ORL_E_DEGENERATE, "view: the pose's matrix is not a rotation (determinant %g)", det);
    if (bytes < orl_view_need(cam->w, cam->h) || ((uintptr_t)block & 63)) return orl_fail(ORL_E_MEMORY, "view: block of %zu bytes, %zu aligned to 64 wanted", bytes, orl_view_need(cam->w, cam->h));
    orl_view v = { .w = cam->w, .h = cam->h, .stride = orl_view_stride(cam->w), .cam = *cam, .pose = *pose, .scene = s };
    build_job j = { s, &v, wanted, beside, supersample, (cam->w + TILE - 1) / TILE, { 0 }, { 0 } };
    albedo_bytes(j.albedo);
    place(&v, block);
    double scale = sqrt(m[0] * m[0] + m[1] * m[1] + m[2] * m[2]), centre[3];
    orl_pose_centre(pose, centre);
    for (int a = 0; a < 3; a++) {
        j.origin[a] = m[4 * a] * centre[0] + m[4 * a + 1] * centre[1] + m[4 * a + 2] * centre[2] + m[4 * a + 3];
        v.eye[a] = j.origin[a];
        for (int c = 0; c < 3; c++) v.grid_from_cam[3 * a + c] = (m[4 * a] * R[3 * c] + m[4 * a + 1] * R[3 * c + 1] + m[4 * a + 2] * R[3 * c + 2]) / scale;
    }
    orl_parallel(threads, v.h, 4 * GRAIN, clear_rows, &v);
    if (s->shadow) memcpy(v.phi_scale, s->shadow_scale, sizeof v.phi_scale);
    build_sky(&v);
    orl_parallel(threads, (beside ? GRAIN : 0) + j.across * ((v.h + TILE - 1) / TILE), GRAIN, build_tiles, &j);
    *out = v;
    return ORL_OK;
}

/* A pixel's normal made unit; up where nothing is. */
static void normal_of(const orl_view *v, size_t at, float n[3])
{
    const float b[3] = { v->normal[0][at], v->normal[1][at], v->normal[2][at] }, len = sqrtf(b[0] * b[0] + b[1] * b[1] + b[2] * b[2]);
    for (int a = 0; a < 3; a++) n[a] = len > 0 ? b[a] / len : a == 2;
}

void orl_view_sample(const orl_view *v, int x, int y, orl_sample *out)
{
    size_t at = (size_t)y * (size_t)v->stride + (size_t)x;
    double d[3] = { 0, 0, 1 };
    orl_sample s = { .open = (float)v->open[at] / 255, .cov = (float)v->cov[at] / 255 };
    pixel_dir(v, x + 0.5, y + 0.5, d);
    normal_of(v, at, s.normal);
    for (int c = 0; c < 3; c++) {
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
    const double one = most * exp2i(k) > 32700 ? 32700 / most : exp2i(k);       /* above 2000 x white all of it is darker, and white */
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

/* apart: of a view's own horizons; the scene's are coarse, and as the float model takes them. */
static void make_vis(orl_vis_tab *t, const orl_light *l, int baked)
{
    const float pi = 3.14159265f;
    float a = l->code[ORL_C_SUN_AZ] * (ORL_HORIZON / (2 * pi));
    int i = (int)a - (a < (float)(int)a);
    t->i0 = i & (ORL_HORIZON - 1);
    t->i1 = (i + 1) & (ORL_HORIZON - 1);
    t->f = rounded((a - (float)i) * 256);
    t->apart = baked ? APART : 255;
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
    make_vis(&t->vis, l, v->ceiling != NULL);
    make_sky(t->sky, v->sky, l);
    return t;
}

/* Sun visibility of n pixels from `at` on, Q15, by a view's horizons and ceilings, and with_fix by what a traced sun has over the horizons. cov: of these pixels. */
static void vis_of(const orl_kernels *k, const orl_view *v, const orl_vis_tab *t, int with_fix, size_t at, const uint8_t *cov, int n, int16_t *vis)
{
    size_t i0 = (size_t)t->i0 * plane_size(v) + at, i1 = (size_t)t->i1 * plane_size(v) + at;
    orl_vis_in in = { { v->horizon + i0, v->horizon + i1 }, { NULL, NULL }, NULL, cov };
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

typedef struct { orl_view *v; const orl_light *l; int y0; orl_vis_tab vis, between; uint8_t *ceiling; orl_kernels k; } trace_job;

/* A ceiling hides a sun of this elevation as a horizon does that stands as far above the sun as the ceiling below it. */
static void mirror_ceilings(const orl_view *v, const orl_light *l, size_t at, orl_sample *s)
{
    const float unit = 1.57079633f / 255, zenith = 1.57079633f, el = l->code[ORL_C_SUN_EL];
    for (int i = 0; i < ORL_HORIZON; i++) {
        size_t k = (size_t)i * plane_size(v) + at;
        float up = (float)v->horizon[k] * unit, hidden = v->ceiling[k] ? 2 * el - (float)(255 - v->ceiling[k]) * unit : 0;
        s->horizon[i] = hidden > up ? hidden < zenith ? hidden : zenith : up;
    }
}

static void sunlit(const orl_view *v, orl_march *m, orl_sample *const of[ORL_RAYS])
{
    orl_march_run(v->scene, 0, m);
    for (int k = 0; k < m->n; k++) of[k]->fix += m->rays.t[k] < 0;
    m->n = 0;
}

void orl_view_sample_sun(const orl_view *v, const orl_light *l, const int *spot, int step, orl_sample *s, int n)
{
    const float *sun = l->sun_dir;
    orl_sample *of[ORL_RAYS];
    orl_march m;
    m.n = 0;
    for (int i = 0; i < n; i++) {
        int x = spot[i * step] % v->w, y = spot[i * step] / v->w;
        size_t at = (size_t)y * (size_t)v->stride + (size_t)x;
        const float *normal = s[i].normal;
        double o[3];
        s[i].fix = 0;
        if (v->ceiling) { mirror_ceilings(v, l, at, &s[i]); continue; }
        if (!v->cov[at] || !v->scene->lite || !(sun[2] > 0)) continue;
        s[i].fix = -orl_light_sun_visibility(l, &s[i]);
        if (!(normal[0] * sun[0] + normal[1] * sun[1] + normal[2] * sun[2] > 0) || !lifted(v, x, y, normal, o)) continue;
        of[m.n] = &s[i];
        orl_march_begin(v->scene, o, (const double[3]){ sun[0], sun[1], sun[2] }, 0, &m);
        if (m.n == ORL_RAYS) sunlit(v, &m, of);
    }
    if (m.n) sunlit(v, &m, of);
}

static int faces_sun(const trace_job *j, size_t at, float n[3])
{
    const float *s = j->l->sun_dir;
    normal_of(j->v, at, n);
    return n[0] * s[0] + n[1] * s[1] + n[2] * s[2] > 0;
}

enum { NOTHING, SEEN, HIDDEN, AWAY };   /* the sun, of a pixel: no surface, no ray that hits, one that does, a surface that looks away */
typedef struct { orl_march m; int8_t *to[ORL_RAYS]; } questions;

static void answer(const trace_job *j, questions *q)
{
    orl_march_run(j->v->scene, 0, &q->m);
    for (int k = 0; k < q->m.n; k++) *q->to[k] = q->m.rays.t[k] < 0 ? SEEN : HIDDEN;
    q->m.n = 0;
}

static void ask(const trace_job *j, int x, int y, int8_t *to, questions *q)
{
    const orl_view *v = j->v;
    const float *s = j->l->sun_dir;
    size_t here = (size_t)y * (size_t)v->stride + (size_t)x;
    float n[3];
    double o[3];
    *to = NOTHING;
    if (!v->cov[here]) return;
    *to = AWAY;
    if (!faces_sun(j, here, n) || !lifted(v, x, y, n, o)) return;
    if (q->m.n == ORL_RAYS) answer(j, q);
    q->to[q->m.n] = to;
    orl_march_begin(v->scene, o, (const double[3]){ s[0], s[1], s[2] }, 0, &q->m);
}

static void ask_row(const trace_job *j, int y, int8_t *row, questions *q)
{
    for (int x = 0; x < j->v->w; x += 2) ask(j, x, y, &row[x / 2], q);
    answer(j, q);
}

/* Rows [begin, end): of every other pixel of every other row a ray goes to the sun. Between them a pixel that looks at the sun believes what its two or four neighbours all say, or asks for itself. */
static void trace_band(const trace_job *j, int begin, int end)
{
    enum { HALF = 32768 };
    orl_view *v = j->v;
    int8_t rows[2][HALF + 1], *up = rows[0], *down = rows[1];
    questions q;
    q.m.n = 0;
    memset(v->fix + (size_t)begin * (size_t)v->stride, 0, (size_t)(end - begin) * (size_t)v->stride);
    if (!v->scene->lite || !(j->l->sun_dir[2] > 0)) return;         /* a scene without horizons takes the sun as unhidden */
    ask_row(j, begin & ~1, down, &q);
    for (int y = begin; y < end; y++) {
        int8_t *fix = v->fix + (size_t)y * (size_t)v->stride, *was = up;
        if (!(y & 1) || y == begin) {
            up = down;
            down = was;
        }
        if (y & 1 && y + 1 < v->h) ask_row(j, y + 1, down, &q);
        const int8_t *below = y & 1 && y + 1 < v->h ? down : up;
        for (int x = 0; x < v->w; x++) {
            float n[3];
            int i = x / 2, k = x & 1 && x + 1 < v->w ? i + 1 : i;
            if (!(x & 1) && !(y & 1)) fix[x] = up[i];
            else if (!v->cov[(size_t)y * (size_t)v->stride + (size_t)x]) fix[x] = NOTHING;
            else if (!faces_sun(j, (size_t)y * (size_t)v->stride + (size_t)x, n)) fix[x] = AWAY;
            else if ((up[i] == SEEN || up[i] == HIDDEN) && up[k] == up[i] && below[i] == up[i] && below[k] == up[i]) fix[x] = up[i];
            else ask(j, x, y, &fix[x], &q);
        }
        answer(j, &q);
    }
    for (int y = begin; y < end; y++)
        for (int x = 0; x < v->stride; x += CHUNK) {
            int16_t over[CHUNK];
            size_t from = (size_t)y * (size_t)v->stride + (size_t)x;
            int n = v->stride - x < CHUNK ? v->stride - x : CHUNK;
            vis_of(&j->k, v, &j->vis, 0, from, v->cov + from, n, over);
            for (int i = 0; i < n; i++) {
                int8_t *f = &v->fix[from + (size_t)i];
                *f = (int8_t)(*f == NOTHING ? 0 : *f == SEEN ? (32767 - over[i] + 129) / 258 : -((over[i] + 129) / 258));
            }
        }
}

/* What a baked pixel's sun has over the float model's. */
static void look_up_row(const trace_job *j, int y)
{
    orl_view *v = j->v, open = *v;
    open.ceiling = NULL;
    if (!(j->l->sun_dir[2] > 0)) { memset(v->fix + (size_t)y * (size_t)v->stride, 0, (size_t)v->stride); return; }
    for (int x = 0; x < v->stride; x += CHUNK) {
        int16_t vis[CHUNK], over[CHUNK];
        size_t at = (size_t)y * (size_t)v->stride + (size_t)x;
        int n = v->stride - x < CHUNK ? v->stride - x : CHUNK;
        vis_of(&j->k, v, &j->vis, 0, at, v->cov + at, n, vis);
        vis_of(&j->k, &open, &j->between, 0, at, v->cov + at, n, over);
        for (int i = 0; i < n; i++) v->fix[at + (size_t)i] = (int8_t)((vis[i] - over[i] + (vis[i] < over[i] ? -129 : 129)) / 258);
    }
}

static void trace_rows(void *user, int begin, int end)
{
    const trace_job *j = user;
    if (!j->v->ceiling) trace_band(j, j->y0 + begin, j->y0 + end);
    else for (int y = j->y0 + begin; y < j->y0 + end; y++) look_up_row(j, y);
}

void orl_view_trace_sun(orl_view *v, const orl_light *l, int y0, int y1, unsigned cpu, int threads)
{
    trace_job j = { .v = v, .l = l, .y0 = y0 };
    orl_kernels_init(&j.k, cpu);
    make_vis(&j.vis, l, v->ceiling != NULL);
    make_vis(&j.between, l, 0);
    orl_parallel(threads, y1 - y0, 4 * GRAIN, trace_rows, &j);
}

/* ---- baking */

enum { LOOKS = 18, HALVINGS = 3 };      /* elevations looked at in an azimuth, 5 degrees apart; then each end of the gap is halved so often */

#define QUARTER_TURN 1.57079633f

static float azimuth_of(int i) { return (float)i * (4 * QUARTER_TURN / ORL_HORIZON); }

static void look_at(const orl_view *v, const double o[3], float az, float el, orl_march *m)
{
    const double d[3] = { orl_cosf(el) * orl_cosf(az), orl_cosf(el) * orl_sinf(az), orl_sinf(el) };
    orl_march_begin(v->scene, o, d, 0, m);
}

/* A pixel's azimuths: at which elevations the sky is open (1), shut (0), or the surface looks away (-1). */
static void look_around(const orl_view *v, const double o[3], const float n[3], int open[ORL_HORIZON][LOOKS])
{
    enum { AT_ONCE = ORL_RAYS / LOOKS };
    orl_march m;
    for (int first = 0; first < ORL_HORIZON; first += AT_ONCE) {
        int *of[ORL_RAYS];
        m.n = 0;
        for (int i = first; i < first + AT_ONCE && i < ORL_HORIZON; i++) {
            float az = azimuth_of(i), ahead = n[0] * orl_cosf(az) + n[1] * orl_sinf(az);
            for (int k = 0; k < LOOKS; k++) {
                float el = ((float)k + 0.5f) * (QUARTER_TURN / LOOKS);
                open[i][k] = -1;
                if (!(orl_cosf(el) * ahead + orl_sinf(el) * n[2] > 0.02f)) continue;
                of[m.n] = &open[i][k];
                look_at(v, o, az, el, &m);
            }
        }
        orl_march_run(v->scene, 0, &m);
        for (int k = 0; k < m.n; k++) *of[k] = m.rays.t[k] < 0;
    }
}

/* The widest gap of an azimuth: its first look and how many. 0: the surface looks away from all of it. */
static int gap_of(int open[LOOKS], int *first, int *looks)
{
    int known = 0;
    *first = *looks = 0;
    for (int k = 0; k < LOOKS; k++) known |= open[k] >= 0;
    if (!known) return 0;
    for (int k = 1; k < LOOKS; k++) if (open[k] < 0) open[k] = open[k - 1];         /* where the surface looks away, as next to it */
    for (int k = LOOKS - 2; k >= 0; k--) if (open[k] < 0) open[k] = open[k + 1];
    for (int k = 0, from = 0; k <= LOOKS; k++) {
        if (k < LOOKS && open[k]) continue;
        if (k - from > *looks) { *looks = k - from; *first = from; }
        from = k + 1;
    }
    return 1;
}

typedef struct { int azimuth; float shut, open; } edge;

/* Elevations at which the one becomes the other. */
static void halve(const orl_view *v, const double o[3], edge *e, int n)
{
    orl_march m;
    for (int h = 0; n && h < HALVINGS; h++) {
        m.n = 0;
        for (int k = 0; k < n; k++) look_at(v, o, azimuth_of(e[k].azimuth), 0.5f * (e[k].shut + e[k].open), &m);
        orl_march_run(v->scene, 0, &m);
        for (int k = 0; k < n; k++) *(m.rays.t[k] < 0 ? &e[k].open : &e[k].shut) = 0.5f * (e[k].shut + e[k].open);
    }
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
    const float step = QUARTER_TURN / LOOKS;
    int open[ORL_HORIZON][LOOKS], edges = 0, low[ORL_HORIZON], high[ORL_HORIZON];       /* the gap's ends among the edges; -1: horizon and zenith */
    edge e[2 * ORL_HORIZON];
    look_around(v, o, p.normal, open);
    for (int i = 0; i < ORL_HORIZON; i++) {
        int first, looks;
        low[i] = high[i] = -1;
        known[i] = gap_of(open[i], &first, &looks);
        if (known[i] && !looks) { horizon[(size_t)i * n] = 255; ceiling[(size_t)i * n] = 0; known[i] = 2; }
        if (known[i] != 1) continue;
        if (first) { low[i] = edges; e[edges++] = (edge){ i, ((float)first - 0.5f) * step, ((float)first + 0.5f) * step }; }
        if (first + looks < LOOKS) { high[i] = edges; e[edges++] = (edge){ i, ((float)(first + looks) + 0.5f) * step, ((float)(first + looks) - 0.5f) * step }; }
    }
    halve(v, o, e, edges);
    for (int i = 0; i < ORL_HORIZON; i++) {
        if (known[i] != 1) continue;
        float lo = low[i] < 0 ? 0 : 0.5f * (e[low[i]].shut + e[low[i]].open), hi = high[i] < 0 ? QUARTER_TURN : 0.5f * (e[high[i]].shut + e[high[i]].open);
        horizon[(size_t)i * n] = (uint8_t)rounded(lo * (255 / QUARTER_TURN));
        ceiling[(size_t)i * n] = (uint8_t)(255 - rounded(hi * (255 / QUARTER_TURN)));
    }
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

/* What will be shaded soon. */
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

/* Columns [x, end) of a row; x is a multiple of ORL_KERNEL_STEP, end one or the row's. ahead: pixels from here to what will be shaded soon. */
static void shade_span(const orl_view *v, const orl_view_light *l, const orl_kernels *k, int y, int x, int end, int ahead, const int16_t *const sky[3], uint8_t *rgb)
{
    const sky_grid *g = v->sky;
    const int all = (v->no_skip & ORL_SKIP_SKY) != 0;
    int shadows = (v->no_skip & ORL_SKIP_SHADOW) != 0;
    uint8_t everywhere[CHUNK];
    if (all) memset(everywhere, 255, sizeof everywhere);
    for (int i = 0; i < ORL_SHADOW_DIM; i++) shadows |= v->phi_scale[i] > 0;
    for (int n; x < end; x += n) {
        int16_t s[CHUNK], vis[CHUNK];
        size_t at = (size_t)y * (size_t)v->stride + (size_t)x;
        uint8_t tail[CHUNK * 3], *to = rgb + 3 * (size_t)x;
        n = end - x < CHUNK ? end - x : CHUNK;
        int padded_n = (n + ORL_KERNEL_STEP - 1) / ORL_KERNEL_STEP * ORL_KERNEL_STEP, whole = padded_n == n;        /* the row's padding makes room */
        orl_shade_in in = { .open = v->open + at, .cov = v->cov + at, .vis = vis, .s = shadows ? s : NULL, .sky_log2 = g->log2, .x = x, .all = all };
        const uint8_t *runs = all ? everywhere : in.cov;
        for (int c = 0; c < 3; c++) {
            in.normal[c] = v->normal[c] + at;
            in.albedo[c] = v->albedo[c] + at;
            in.sky[c] = sky[c];
        }
        if (at + (size_t)ahead + CHUNK < plane_size(v)) look_ahead_of(v, &l->vis, shadows, at + (size_t)ahead, &in);
        vis_of(k, v, &l->vis, 1, at, runs, padded_n, vis);
        if (shadows) k->shadow((const int8_t *const[]){ v->phi[0] + at * ORL_PHI_GROUP, v->phi[1] + at * ORL_PHI_GROUP }, runs, &l->tab, padded_n, s);
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
    const int ahead = left < right ? v->stride : CHUNK;        /* the next row's, where what is between is left out */
    shade_span(v, l, &k, y, 0, left, ahead, rows, rgb);
    shade_span(v, l, &k, y, right, v->w, ahead, rows, rgb);
}

void orl_view_shade(const orl_view *v, const orl_view_light *l, unsigned cpu, int y0, int y1, uint8_t *rgb, size_t row_bytes)
{
    for (int y = y0; y < y1; y++) orl_view_shade_row(v, l, cpu, y, 0, 0, rgb + (size_t)(y - y0) * row_bytes);
}
