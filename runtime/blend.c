/* The photo laid into the wide render (include/oriel/blend.h).
 *
 * Once: for every wide pixel its place in the photo (Q8), how much the photo counts (a smoothstep over the border's FEATHER), and how much it may tell about the seam.
 * Per frame, all integer: 1. the photo is area-averaged into the wide raster, and the difference photo - render near the border is summed in coarse cells, sky and surface apart, large
 * differences (people) counting little; 2. the cells are filled by push and pull over a pyramid and fade with the distance to the photo; 3. they are added to the render
 * (bilinear) and the photo is mixed in. Not done: parallax (the centres must agree), exposure differences that vary quickly along the border. */
#include "oriel/blend.h"
#include <stdlib.h>
#include <string.h>
#include "oriel/parallel.h"
#include "runtime/arena.h"
#include "runtime/kernels/shade.h"

enum { CELLS = 64, CELL_LOG2 = 4, SEAM = 16, SILENT = 13, LEVELS = 8, LAYERS = 2, SCALE_MAX = ORL_WARP_MOST, VALUE_Q = 4, KNEE = 32 };
#define FEATHER 0.03        /* of the photo's short side */
#define BAND    3.0         /* seam colours are taken this many feathers deep */
#define REACH   0.12        /* a correction has halved at this distance from the photo, in short sides */

typedef struct { int w, h; int32_t *value[3], *trust; } level;     /* value Q4; trust 0..256 */

struct orl_blend {
    int w, h, pw, ph;
    int box_x, box_y;                   /* footprint of a wide pixel in the photo, Q8, >= 256 */
    int16_t *column, *row;              /* the warp's shares */
    int rows, parts, narrow;
    int cell_log2, cell, gw, gh, levels;
    int *x0, *x1;                       /* covered columns of each row, */
    int *in0, *in1;                     /* and those in which the photo stands alone */
    orl_warp_at *at;                    /* [pixel] */
    uint8_t *weight, *seam, *layer;     /* [pixel] of the photo, of its seam colour; layer: 0..255 surface */
    uint8_t *warped;                    /* [pixel][3] */
    int64_t *sum;                       /* [layer][cell][4]: three differences and their weight */
    int32_t *fade;                      /* [cell] Q8 */
    level pyramid[LAYERS][LEVELS];
    const uint8_t *photo;
    uint8_t *wide;
};

static void lay_out(orl_arena *a, int w, int h, orl_blend **out)
{
    orl_blend *b = orl_arena_take(a, sizeof *b), dummy;
    if (!b) b = &dummy;
    memset(b, 0, sizeof *b);
    size_t n = (size_t)w * (size_t)h;
    int side = w > h ? w : h;
    b->w = w;
    b->h = h;
    b->cell_log2 = CELL_LOG2;
    while (CELLS << b->cell_log2 < side) b->cell_log2++;
    b->cell = 1 << b->cell_log2;
    b->gw = (w + b->cell - 1) / b->cell;
    b->gh = (h + b->cell - 1) / b->cell;
    b->x0 = orl_arena_take(a, (size_t)h * sizeof *b->x0);
    b->x1 = orl_arena_take(a, (size_t)h * sizeof *b->x1);
    b->in0 = orl_arena_take(a, (size_t)h * sizeof *b->in0);
    b->in1 = orl_arena_take(a, (size_t)h * sizeof *b->in1);
    b->at = orl_arena_take(a, n * sizeof *b->at);
    b->weight = orl_arena_take(a, n);
    b->seam = orl_arena_take(a, n);
    b->layer = orl_arena_take(a, n);
    b->warped = orl_arena_take(a, n * 3);
    b->column = orl_arena_take(a, 256 * ORL_WARP_PARTS * 16 * sizeof *b->column);
    b->row = orl_arena_take(a, 256 * ORL_WARP_ROWS * sizeof *b->row);
    size_t cells = (size_t)b->gw * (size_t)b->gh;
    b->sum = orl_arena_take(a, LAYERS * cells * 4 * sizeof *b->sum);
    b->fade = orl_arena_take(a, cells * sizeof *b->fade);
    for (int k = 0; k < LAYERS; k++) {
        int gw = b->gw, gh = b->gh;
        for (b->levels = 0; b->levels < LEVELS; ) {
            level *l = &b->pyramid[k][b->levels++];
            size_t m = (size_t)gw * (size_t)gh;
            l->w = gw;
            l->h = gh;
            for (int c = 0; c < 3; c++) l->value[c] = orl_arena_take(a, m * sizeof(int32_t));
            l->trust = orl_arena_take(a, m * sizeof(int32_t));
            if (gw == 1 && gh == 1) break;
            gw = (gw + 1) / 2;
            gh = (gh + 1) / 2;
        }
    }
    if (out) *out = b;
}

size_t orl_blend_need(int w, int h)
{
    orl_arena a = { 0 };
    lay_out(&a, w, h, NULL);
    return a.used;
}

/* ---- once ---- */

/* World ray of a wide pixel's centre, in the photo's camera. */
static void photo_ray(const orl_camera *wide, const double turn[9], double x, double y, double d[3])
{
    double r[3];
    orl_camera_unproject(wide, x, y, r);
    for (int i = 0; i < 3; i++) d[i] = turn[3 * i] * r[0] + turn[3 * i + 1] * r[1] + turn[3 * i + 2] * r[2];
}

/* Photo pixel of a ray; 0 if the lens does not see it (a distortion polynomial folds back far outside the picture, so the way back must lead to the same ray). */
static int photo_pixel(const orl_camera *c, const double d[3], double uv[2])
{
    double back[3];
    if (!orl_camera_project(c, d, uv) || !(uv[0] >= 0 && uv[0] <= c->w && uv[1] >= 0 && uv[1] <= c->h)) return 0;
    orl_camera_unproject(c, uv[0], uv[1], back);
    double ex = back[0] - d[0] / d[2], ey = back[1] - d[1] / d[2];
    return ex * ex + ey * ey < 1e-6;
}

static int footprint(double photo_focal, double wide_focal)
{
    double s = photo_focal / wide_focal;
    return s <= 1 ? 256 : s >= SCALE_MAX ? SCALE_MAX * 256 : (int)(s * 256 + 0.5);
}

static double smooth(double t)
{
    t = t < 0 ? 0 : t > 1 ? 1 : t;
    return t * t * (3 - 2 * t);
}

/* Shares of a box's pixels, by the fraction of its corner: they sum to one. Their number. */
static int shares(int box, int fraction, int one, int16_t out[ORL_WARP_ROWS])
{
    int n = (fraction + box + 255) >> 8, rest = one;
    for (int k = 0; k < n; k++) {
        int left = k ? k << 8 : fraction, right = (k + 1) << 8 < fraction + box ? (k + 1) << 8 : fraction + box;
        out[k] = (int16_t)(k == n - 1 ? rest : ((right - left) * one + box / 2) / box);
        rest -= out[k];
    }
    return n;
}

static void warp_shares(orl_blend *b)
{
    int16_t one[ORL_WARP_ROWS];
    int most = (255 + b->box_x + 255) >> 8;
    b->rows = (255 + b->box_y + 255) >> 8;
    b->narrow = most <= 2 && b->rows <= 2;
    b->parts = (most + ORL_WARP_PART - 1) / ORL_WARP_PART;
    memset(b->column, 0, 256 * ORL_WARP_PARTS * 16 * sizeof *b->column);
    memset(b->row, 0, 256 * ORL_WARP_ROWS * sizeof *b->row);
    for (int f = 0; f < 256; f++) {
        int n = shares(b->box_x, f, 32767, one);
        for (int k = 0; k < n; k++) for (int c = 0; c < 3; c++) b->column[(f * b->parts + k / ORL_WARP_PART) * 16 + k % ORL_WARP_PART * 3 + c] = one[k];
        shares(b->box_y, f, 256, b->row + f * ORL_WARP_ROWS);
    }
}

static int clampi(int v, int lo, int hi) { return v < lo ? lo : v > hi ? hi : v; }

/* Does the footprint at (u, v) touch a masked pixel? */
static int masked(const orl_blend *b, const uint8_t *mask, int u, int v)
{
    for (int y = v >> 8; y << 8 < v + b->box_y; y++)
        for (int x = u >> 8; x << 8 < u + b->box_x; x++)
            if (mask[(size_t)y * (size_t)b->pw + (size_t)x]) return 1;
    return 0;
}

typedef struct { orl_blend *b; const orl_camera *photo, *wide; const double *turn; const uint8_t *mask; } place_job;

static void place(void *user, int begin, int end)
{
    const place_job *j = user;
    orl_blend *b = j->b;
    const orl_camera *photo = j->photo, *wide = j->wide;
    const double *turn = j->turn;
    const uint8_t *mask = j->mask;
    double feather = FEATHER * (b->pw < b->ph ? b->pw : b->ph);
    for (int y = begin; y < end; y++) {
        b->x0[y] = b->w;
        for (int x = 0; x < b->w; x++) {
            size_t i = (size_t)y * (size_t)b->w + (size_t)x;
            double d[3], uv[2];
            b->weight[i] = b->seam[i] = 0;
            b->at[i] = (orl_warp_at){ 0, 0, 0, 0 };
            photo_ray(wide, turn, x + 0.5, y + 0.5, d);
            if (!photo_pixel(photo, d, uv)) continue;
            double dx = uv[0] < b->pw - uv[0] ? uv[0] : b->pw - uv[0], dy = uv[1] < b->ph - uv[1] ? uv[1] : b->ph - uv[1], in = (dx < dy ? dx : dy) / feather;
            b->weight[i] = (uint8_t)(255 * smooth(in) + 0.5);
            b->seam[i] = (uint8_t)(255 * smooth((BAND - in) / BAND * 2) + 0.5);
            int u = clampi((int)(uv[0] * 256 + 0.5) - b->box_x / 2, 0, b->pw * 256 - b->box_x), v = clampi((int)(uv[1] * 256 + 0.5) - b->box_y / 2, 0, b->ph * 256 - b->box_y);
            b->at[i] = (orl_warp_at){ 3 * ((uint32_t)(v >> 8) * (uint32_t)b->pw + (uint32_t)(u >> 8)), (uint8_t)u, (uint8_t)v, 0 };
            if (mask && masked(b, mask, u, v)) b->seam[i] = 0;
            if (b->x0[y] == b->w) b->x0[y] = x;
            b->x1[y] = x + 1;
        }
        if (b->x0[y] == b->w) b->x0[y] = b->x1[y] = 0;
        b->in0[y] = b->in1[y] = 0;
        for (int x = b->x0[y], from = x; x <= b->x1[y]; x++) {          /* the longest run of such pixels */
            size_t i = (size_t)y * (size_t)b->w + (size_t)x;
            if (x < b->x1[y] && b->weight[i] == 255 && !b->seam[i]) continue;
            if (x - from > b->in1[y] - b->in0[y]) { b->in0[y] = from; b->in1[y] = x; }
            from = x + 1;
        }
    }
}

/* How much of a correction is left in a cell: by its distance from the photo, as a lens without distortion would measure it. */
static void set_fade(orl_blend *b, const orl_camera *photo, const orl_camera *wide, const double turn[9])
{
    orl_camera plain = *photo;
    plain.model = ORL_CAM_PINHOLE;
    plain.k1 = plain.k2 = plain.p1 = plain.p2 = 0;
    double reach = REACH * (b->pw < b->ph ? b->pw : b->ph);
    for (int cy = 0; cy < b->gh; cy++)
        for (int cx = 0; cx < b->gw; cx++) {
            double d[3], uv[2];
            int *fade = &b->fade[cy * b->gw + cx];
            photo_ray(wide, turn, (cx + 0.5) * b->cell, (cy + 0.5) * b->cell, d);
            *fade = 0;
            if (!orl_camera_project(&plain, d, uv)) continue;
            double dx = uv[0] < 0 ? -uv[0] : uv[0] > b->pw ? uv[0] - b->pw : 0, dy = uv[1] < 0 ? -uv[1] : uv[1] > b->ph ? uv[1] - b->ph : 0;
            *fade = (int)(256 / (1 + (dx * dx + dy * dy) / (reach * reach)) + 0.5);
        }
}

orl_err orl_blend_init(const orl_camera *photo, const orl_pose *photo_pose, const orl_camera *wide, const orl_pose *wide_pose,
                       const uint8_t *mask, int threads, void *block, size_t bytes, orl_blend **out)
{
    double a[3], c[3], turn[9], gap = 0, size = 0;
    if (bytes < orl_blend_need(wide->w, wide->h)) return orl_fail(ORL_E_MEMORY, "blend: the block is too small");
    if ((uint64_t)photo->w * (uint64_t)photo->h > UINT32_MAX / 3) return orl_fail(ORL_E_RANGE, "blend: a photo of %d x %d", photo->w, photo->h);
    orl_pose_centre(photo_pose, a);
    orl_pose_centre(wide_pose, c);
    for (int i = 0; i < 3; i++) {
        gap += (a[i] - c[i]) * (a[i] - c[i]);
        size += a[i] * a[i] + photo_pose->t[i] * photo_pose->t[i];
    }
    if (gap > 1e-8 * size + 1e-12) return orl_fail(ORL_E_RANGE, "blend: the wide view does not share the photo's centre");
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++) {       /* photo <- world <- wide */
            turn[3 * i + k] = 0;
            for (int j = 0; j < 3; j++) turn[3 * i + k] += photo_pose->R[3 * i + j] * wide_pose->R[3 * k + j];
        }
    orl_arena ar = { block, 0 };
    orl_blend *b;
    lay_out(&ar, wide->w, wide->h, &b);
    b->pw = photo->w;
    b->ph = photo->h;
    b->box_x = footprint(photo->fx, wide->fx);
    b->box_y = footprint(photo->fy, wide->fy);
    if (b->box_x > b->pw * 256) b->box_x = b->pw * 256;
    if (b->box_y > b->ph * 256) b->box_y = b->ph * 256;
    warp_shares(b);
    orl_parallel(threads, b->h, 16, place, &(place_job){ b, photo, wide, turn, mask });
    set_fade(b, photo, wide, turn);
    *out = b;
    return ORL_OK;
}

void orl_blend_layers(orl_blend *b, const uint8_t *cov, size_t cov_stride)
{
    for (int y = 0; y < b->h; y++) memcpy(b->layer + (size_t)y * (size_t)b->w, cov + (size_t)y * cov_stride, (size_t)b->w);
}

void orl_blend_covered(const orl_blend *b, int y, int *x0, int *x1) { *x0 = b->in0[y]; *x1 = b->in1[y]; }

/* ---- per frame ---- */

/* Geman-McClure weight of a difference of d levels, Q8. */
static int robust(int d)
{
    int a = KNEE * KNEE * 256 / (KNEE * KNEE + d * d);
    return a * a >> 8;
}

typedef struct { orl_blend *b; orl_kernels k; uint16_t robust[256]; } apply_job;

/* What columns [x0, x1) of a row of the seam say to its cells: one pixel in `stride`, so that a cell asks SEAM x SEAM whatever its size. */
static void seam(const apply_job *j, int y, int x0, int x1, int64_t (*sums)[4])
{
    const orl_blend *b = j->b;
    const size_t cells = (size_t)b->gw * (size_t)b->gh;
    const int stride = b->cell / SEAM;
    for (int x = (x0 + stride - 1) / stride * stride; x < x1; x += stride) {
        size_t i = (size_t)y * (size_t)b->w + (size_t)x;
        const uint8_t *p = b->warped + 3 * i, *r = b->wide + 3 * i;
        if (!b->seam[i]) continue;
        int d[3] = { p[0] - r[0], p[1] - r[1], p[2] - r[2] }, worst = 0;
        for (int c = 0; c < 3; c++) worst = abs(d[c]) > worst ? abs(d[c]) : worst;
        int w = b->seam[i] * j->robust[worst];
        int64_t *s = sums[(size_t)(b->layer[i] >= 128) * cells + (size_t)(x >> b->cell_log2)];
        for (int c = 0; c < 3; c++) s[c] += d[c] * w;
        s[3] += w;
    }
}

/* Rows of cells: the photo into the wide raster, the seam's differences into the cells. */
static void measure(void *user, int begin, int end)
{
    const apply_job *j = user;
    const orl_blend *b = j->b;
    const size_t cells = (size_t)b->gw * (size_t)b->gh;
    orl_warp_in in = { .photo = b->photo, .stride = 3 * (size_t)b->pw, .bytes = 3 * (size_t)b->pw * (size_t)b->ph, .rows = b->rows, .parts = b->parts, .narrow = b->narrow, .column = b->column, .row = b->row };
    for (int cy = begin; cy < end; cy++) {
        int64_t (*sums)[4] = (int64_t (*)[4])b->sum + (size_t)cy * (size_t)b->gw;
        for (int k = 0; k < LAYERS; k++) memset(sums + (size_t)k * cells, 0, (size_t)b->gw * sizeof *sums);
        int y1 = (cy + 1) * b->cell < b->h ? (cy + 1) * b->cell : b->h;
        for (int y = cy * b->cell; y < y1; y++) {
            size_t i = (size_t)y * (size_t)b->w + (size_t)b->x0[y];
            in.at = b->at + i;
            j->k.warp(&in, b->x1[y] - b->x0[y], b->warped + 3 * i);
            if (y % (b->cell / SEAM)) continue;
            seam(j, y, b->x0[y], b->in1[y] > b->in0[y] ? b->in0[y] : b->x1[y], sums);
            if (b->in1[y] > b->in0[y]) seam(j, y, b->in1[y], b->x1[y], sums);
        }
    }
}

static void push(const level *fine, level *coarse)
{
    for (int y = 0; y < coarse->h; y++)
        for (int x = 0; x < coarse->w; x++) {
            int32_t v[3] = { 0, 0, 0 }, t = 0;
            for (int k = 0; k < 4; k++) {
                int fx = 2 * x + (k & 1), fy = 2 * y + (k >> 1);
                if (fx >= fine->w || fy >= fine->h) continue;
                int i = fy * fine->w + fx;
                for (int c = 0; c < 3; c++) v[c] += fine->value[c][i] * fine->trust[i];
                t += fine->trust[i];
            }
            int o = y * coarse->w + x;
            for (int c = 0; c < 3; c++) coarse->value[c][o] = t ? v[c] / t : 0;
            coarse->trust[o] = t < 256 ? t : 256;
        }
}

static void pull(const level *coarse, level *fine)
{
    for (int y = 0; y < fine->h; y++)
        for (int x = 0; x < fine->w; x++) {
            int i = y * fine->w + x, t = fine->trust[i], xa = x / 2, ya = y / 2;
            int xb = clampi(xa + (x & 1 ? 1 : -1), 0, coarse->w - 1), yb = clampi(ya + (y & 1 ? 1 : -1), 0, coarse->h - 1);
            for (int c = 0; c < 3; c++) {
                const int32_t *q = coarse->value[c];
                int up = 9 * q[ya * coarse->w + xa] + 3 * q[ya * coarse->w + xb] + 3 * q[yb * coarse->w + xa] + q[yb * coarse->w + xb];
                fine->value[c][i] = (t * 16 * fine->value[c][i] + (256 - t) * up) / 4096;
            }
        }
}

static void spread(orl_blend *b)
{
    size_t cells = (size_t)b->gw * (size_t)b->gh;
    int64_t full = SEAM * SEAM * 255 * 256 / 4;     /* a quarter of a cell's pixels in full agreement: trusted */
    for (int k = 0; k < LAYERS; k++) {
        level *l = b->pyramid[k];
        for (size_t i = 0; i < cells; i++) {
            const int64_t *s = b->sum + ((size_t)k * cells + i) * 4;
            for (int c = 0; c < 3; c++) l[0].value[c][i] = s[3] ? (int32_t)(s[c] * (1 << VALUE_Q) / s[3]) : 0;
            int64_t t = s[3] * 256 / full;
            l[0].trust[i] = (int32_t)(t < 256 ? t : 256);
        }
        for (int n = 1; n < b->levels; n++) push(&l[n - 1], &l[n]);
        for (int n = b->levels - 1; n > 0; n--) pull(&l[n], &l[n - 1]);
        for (size_t i = 0; i < cells; i++)
            for (int c = 0; c < 3; c++) l[0].value[c][i] = l[0].value[c][i] * b->fade[i] / 256;
    }
}

/* Columns [x, end) of a row; x is a multiple of ORL_KERNEL_STEP. */
static void mix_span(const apply_job *j, orl_mix_in *in, int y, int x, int end)
{
    const orl_blend *b = j->b;
    size_t i = (size_t)y * (size_t)b->w + (size_t)x;
    int n = (end - x) / ORL_KERNEL_STEP * ORL_KERNEL_STEP, rest = end - x - n;
    in->x = x;
    in->layer = b->layer + i;
    in->weight = b->weight + i;
    in->photo = b->warped + 3 * i;
    j->k.mix(in, n, b->wide + 3 * i);
    if (!rest) return;
    uint8_t layer[ORL_KERNEL_STEP] = { 0 }, weight[ORL_KERNEL_STEP] = { 0 }, photo[3 * ORL_KERNEL_STEP] = { 0 }, rgb[3 * ORL_KERNEL_STEP] = { 0 };
    i += (size_t)n;
    in->x = x + n;
    in->layer = memcpy(layer, b->layer + i, (size_t)rest);
    in->weight = memcpy(weight, b->weight + i, (size_t)rest);
    in->photo = memcpy(photo, b->warped + 3 * i, 3 * (size_t)rest);
    memcpy(rgb, b->wide + 3 * i, 3 * (size_t)rest);
    j->k.mix(in, ORL_KERNEL_STEP, rgb);
    memcpy(b->wide + 3 * i, rgb, 3 * (size_t)rest);
}

typedef int16_t nodes[3][LAYERS][CELLS + 2 + ORL_NODES_MORE];

/* Columns [x0, x1) of a row that the mix changes: where the photo is, and what nodes reach that are more than SILENT: no value between such as are not comes to half a level. */
static void reached(const orl_blend *b, int y, const nodes node, int *x0, int *x1)
{
    int lo = b->gw + 2, hi = -1;
    for (int n = 0; n < b->gw + 2; n++) {
        int loud = 0;
        for (int c = 0; c < 3; c++) for (int k = 0; k < LAYERS; k++) loud |= node[c][k][n] > SILENT || node[c][k][n] < -SILENT;
        if (loud) lo = lo < n ? lo : n, hi = n;
    }
    *x0 = clampi((lo - 1) * b->cell - b->cell / 2, 0, b->w);
    *x1 = clampi((hi + 1) * b->cell - b->cell / 2, 0, b->w);
    if (lo > hi) *x0 = b->w, *x1 = 0;
    if (b->x1[y] > b->x0[y]) {
        *x0 = *x0 < b->x0[y] ? *x0 : b->x0[y];
        *x1 = *x1 > b->x1[y] ? *x1 : b->x1[y];
    }
    *x0 = *x0 / ORL_KERNEL_STEP * ORL_KERNEL_STEP;
}

static void mix(void *user, int begin, int end)
{
    const apply_job *j = user;
    const orl_blend *b = j->b;
    nodes node;
    orl_mix_in in = { .log2 = b->cell_log2 };
    memset(node, 0, sizeof node);
    for (int c = 0; c < 3; c++) for (int k = 0; k < LAYERS; k++) in.node[c][k] = node[c][k];
    for (int y = begin; y < end; y++) {
        int q = clampi(((2 * y + 1) * 128) / b->cell - 128, 0, (b->gh - 1) * 256), cy = clampi(q >> 8, 0, b->gh > 1 ? b->gh - 2 : 0), fy = b->gh > 1 ? q - cy * 256 : 0;
        for (int c = 0; c < 3; c++)
            for (int k = 0; k < LAYERS; k++) {      /* down between cells; the kernel goes along them */
                const int32_t *top = b->pyramid[k][0].value[c] + cy * b->gw, *low = b->gh > 1 ? top + b->gw : top;
                int16_t *to = node[c][k] + 1;
                for (int x = 0; x < b->gw; x++) to[x] = (int16_t)((top[x] * (256 - fy) + low[x] * fy + 64) >> 7);
                to[-1] = to[0];
                to[b->gw] = to[b->gw - 1];
            }
        int in0 = (b->in0[y] + ORL_KERNEL_STEP - 1) / ORL_KERNEL_STEP * ORL_KERNEL_STEP, in1 = b->in1[y] / ORL_KERNEL_STEP * ORL_KERNEL_STEP;
        int x0, x1;
        reached(b, y, (const int16_t (*)[LAYERS][CELLS + 2 + ORL_NODES_MORE])node, &x0, &x1);
        if (in0 >= in1) {
            if (x0 < x1) mix_span(j, &in, y, x0, x1);
            continue;
        }
        size_t i = (size_t)y * (size_t)b->w + (size_t)in0;
        mix_span(j, &in, y, x0, in0);
        memcpy(b->wide + 3 * i, b->warped + 3 * i, 3 * (size_t)(in1 - in0));
        mix_span(j, &in, y, in1, x1);
    }
}

void orl_blend_apply(orl_blend *b, const uint8_t *photo, uint8_t *wide, unsigned cpu, int threads)
{
    apply_job j = { .b = b };
    orl_kernels_init(&j.k, cpu);
    for (int d = 0; d < 256; d++) j.robust[d] = (uint16_t)robust(d);
    b->photo = photo;
    b->wide = wide;
    orl_parallel(threads, b->gh, 1, measure, &j);
    spread(b);
    orl_parallel(threads, b->h, 16, mix, &j);
}
