/* Sky segmentation of one photo. In: sRGB photo, camera, pose, up, pixels of SfM points. Out: 255 surely sky .. 0 surely not.
 *
 * Evidence is a log-odds per pixel, from what a sky is: above the horizon, without SfM points and with none of them above it, smooth, joined to the top of the picture without an edge between,
 * brighter or bluer than the scene. It is spread along the picture by minimising  sum lambda_i (x_i - sigmoid(u_i))^2 + sum w_ij (x_i - x_j)^2,  w_ij falling with the step in colour and
 * lambda_i with doubt, so that the answer flows over flat areas and stops at edges. From x, colour histograms of sky and scene are learned and join the evidence: a few rounds at 256 px, one
 * at 512 px. In the end parts of the sky that do not share the colours of its largest part are called unknown, and so is what is far from every sign of the scene. Lengths are in pixels at 256. */
#include "oriel/skymask.h"
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

enum { COARSE = 256, FINE = 512, ROUNDS = 4, SWEEPS = 24, BINS = 24, CELLS = BINS * BINS * BINS };
#define BLOCKED 9.0f            /* barrier of what cannot be reached */
#define NEAR 1.2f               /* no way to the top leads closer past an SfM point */

typedef struct {
    int w, h;
    float scene;                /* texture that the scene shows */
    float unit;                 /* long side / COARSE: lengths below are for COARSE */
    float *ch[3];               /* luma, R - B, G - (R + B) / 2; 0..1 */
    float *wx, *wy;             /* edge weights to the right and down */
    float *texture;             /* mean step of colour around */
    float *dist;                /* to the nearest SfM point */
    float *crowd;               /* coarse only: points in the emptiest window that holds the pixel */
    float *cover;               /* 0 open .. 1 SfM points above */
    float *elevation;           /* radians over the horizon */
    float *barrier;             /* highest step on the easiest way to the top of the picture */
    float *base;                /* log-odds of all but colour */
    float *lambda, *goal, *x;
    uint8_t *blank;             /* frame left by an undistortion */
    float *block;
} level;

static float minf(float a, float b) { return a < b ? a : b; }
static float maxf(float a, float b) { return a > b ? a : b; }
static float clampf(float v, float lo, float hi) { return v < lo ? lo : v > hi ? hi : v; }
static float sigmoid(float u) { return 1 / (1 + expf(-u)); }

static orl_err level_alloc(level *l, int w, int h)
{
    float **plane[] = { &l->ch[0], &l->ch[1], &l->ch[2], &l->wx, &l->wy, &l->texture, &l->dist, &l->crowd, &l->cover, &l->elevation, &l->barrier, &l->base, &l->lambda, &l->goal, &l->x };
    size_t n = (size_t)w * (size_t)h, count = sizeof plane / sizeof *plane;
    *l = (level){ .w = w, .h = h, .unit = (float)(w > h ? w : h) / COARSE };
    l->block = calloc(n, count * sizeof(float) + 1);
    if (!l->block) return orl_fail(ORL_E_MEMORY, "sky mask: no memory for %d x %d", w, h);
    for (size_t i = 0; i < count; i++) *plane[i] = l->block + i * n;
    l->blank = (uint8_t *)(l->block + count * n);
    return ORL_OK;
}

/* ---- what a level sees ---- */

static void split_colour(level *l, const uint8_t *px)
{
    for (int i = 0; i < l->w * l->h; i++) {
        float r = px[3 * i] / 255.0f, g = px[3 * i + 1] / 255.0f, b = px[3 * i + 2] / 255.0f;
        l->ch[0][i] = 0.25f * r + 0.5f * g + 0.25f * b;
        l->ch[1][i] = r - b;
        l->ch[2][i] = g - 0.5f * (r + b);
    }
}

static float step_between(const level *l, int i, int j)
{
    float a = l->ch[0][i] - l->ch[0][j], b = l->ch[1][i] - l->ch[1][j], c = l->ch[2][i] - l->ch[2][j];
    return sqrtf(a * a + 0.5f * b * b + c * c);
}

/* Mean over a (2 r + 1)^2 window cut at the frame. tmp: a plane. */
static void box_mean(const float *in, int w, int h, int r, float *tmp, float *out)
{
    for (int y = 0; y < h; y++) {
        const float *a = in + (size_t)y * w;
        double s = 0;
        for (int x = 0; x < r && x < w; x++) s += a[x];
        for (int x = 0; x < w; x++) {
            if (x + r < w) s += a[x + r];
            if (x - r - 1 >= 0) s -= a[x - r - 1];
            int lo = x - r < 0 ? 0 : x - r, hi = x + r >= w ? w - 1 : x + r;
            tmp[(size_t)y * w + x] = (float)(s / (hi - lo + 1));
        }
    }
    for (int x = 0; x < w; x++) {
        double s = 0;
        for (int y = 0; y < r && y < h; y++) s += tmp[(size_t)y * w + x];
        for (int y = 0; y < h; y++) {
            if (y + r < h) s += tmp[(size_t)(y + r) * w + x];
            if (y - r - 1 >= 0) s -= tmp[(size_t)(y - r - 1) * w + x];
            int lo = y - r < 0 ? 0 : y - r, hi = y + r >= h ? h - 1 : y + r;
            out[(size_t)y * w + x] = (float)(s / (hi - lo + 1));
        }
    }
}

/* Least value in a (2 r + 1)^2 window. tmp: a plane; out may be in. */
static void lowest(const float *in, int w, int h, int r, float *tmp, float *out)
{
    for (int y = 0; y < h; y++)
        for (int x = 0; x < w; x++) {
            float m = in[y * w + x];
            for (int k = x - r < 0 ? 0 : x - r; k <= x + r && k < w; k++) m = minf(m, in[y * w + k]);
            tmp[y * w + x] = m;
        }
    for (int y = 0; y < h; y++)
        for (int x = 0; x < w; x++) {
            float m = tmp[y * w + x];
            for (int k = y - r < 0 ? 0 : y - r; k <= y + r && k < h; k++) m = minf(m, tmp[k * w + x]);
            out[y * w + x] = m;
        }
}

static void find_texture(level *l)
{
    int w = l->w, h = l->h;
    for (int y = 0; y < h; y++)
        for (int x = 0; x < w; x++) {
            int i = y * w + x;
            l->goal[i] = step_between(l, i, x + 1 < w ? i + 1 : i) + step_between(l, i, y + 1 < h ? i + w : i);
        }
    int r = l->unit > 1.25f ? (int)(2 * l->unit + 0.5f) : 2;
    box_mean(l->goal, w, h, r, l->lambda, l->base);
    lowest(l->base, w, h, r, l->lambda, l->texture);    /* the smoothest window that holds the pixel, so that sky beside an edge stays smooth */
}

/* Chamfer distance (3-4) to where d is 0; the rest of d is large on entry. */
static void chamfer(const level *l, float *d)
{
    int w = l->w, h = l->h;
    const float one = 1 / l->unit, diagonal = one * 4 / 3;
    for (int y = 0; y < h; y++)
        for (int x = 0, i = y * w; x < w; x++, i++) {
            if (x) d[i] = minf(d[i], d[i - 1] + one);
            if (y) d[i] = minf(d[i], d[i - w] + one);
            if (y && x) d[i] = minf(d[i], d[i - w - 1] + diagonal);
            if (y && x + 1 < w) d[i] = minf(d[i], d[i - w + 1] + diagonal);
        }
    for (int y = h - 1; y >= 0; y--)
        for (int x = w - 1, i = y * w + x; x >= 0; x--, i--) {
            if (x + 1 < w) d[i] = minf(d[i], d[i + 1] + one);
            if (y + 1 < h) d[i] = minf(d[i], d[i + w] + one);
            if (y + 1 < h && x + 1 < w) d[i] = minf(d[i], d[i + w + 1] + diagonal);
            if (y + 1 < h && x) d[i] = minf(d[i], d[i + w - 1] + diagonal);
        }
}

static void find_distance(level *l, const float (*pt)[2], size_t n, float sx, float sy)
{
    for (int i = 0; i < l->w * l->h; i++) l->dist[i] = 1e6f;
    for (size_t k = 0; k < n; k++) {
        float u = pt[k][0] * sx, v = pt[k][1] * sy;
        if (u < (float)l->w && v < (float)l->h) l->dist[(int)v * l->w + (int)u] = 0;
    }
    chamfer(l, l->dist);
}

static void find_crowd(level *l)
{
    int n = l->w * l->h, r = (int)(16 * l->unit + 0.5f);
    for (int i = 0; i < n; i++) l->goal[i] = (float)((2 * r + 1) * (2 * r + 1)) * (l->dist[i] == 0);
    box_mean(l->goal, l->w, l->h, r, l->lambda, l->crowd);
    lowest(l->crowd, l->w, l->h, r, l->lambda, l->crowd);
}

/* Elevation of each pixel's ray (fixed where no horizon is known), and how many SfM points stand above it (towards the zenith, in a strip): n / (n + 3). */
static void find_up(level *l, const orl_camera *cam, const double up[3], int horizon, const float (*pt)[2], size_t n, float sx, float sy)
{
    int w = l->w, h = l->h;
    float *count = l->goal, *tmp = l->lambda;
    memset(count, 0, (size_t)w * h * sizeof *count);
    for (size_t k = 0; k < n; k++) {
        float u = pt[k][0] * sx, v = pt[k][1] * sy;
        if (u < (float)w && v < (float)h) count[(int)v * w + (int)u] += 1;
    }
    for (int y = 0; y < h; y++)
        for (int x = 0; x < w; x++) {
            double d[3];
            orl_camera_unproject(cam, x + 0.5, y + 0.5, d);
            double e = (d[0] * up[0] + d[1] * up[1] + d[2] * up[2]) / sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
            l->elevation[y * w + x] = horizon && isfinite(e) ? (float)asin(fmax(-1, fmin(1, e))) : 0.5f;
            if (!y) continue;
            double ux = up[0] - d[0] * up[2], uy = up[1] - d[1] * up[2];    /* the way to the zenith in the picture */
            if (!(uy < -0.5 * fabs(ux))) continue;                          /* not upright here: nothing is known to be above */
            double from = x - ux / uy;
            if (!(from >= 0 && from <= w - 1)) continue;
            int a = (int)from, b = a + 1 < w ? a + 1 : a;
            float f = (float)(from - a);
            const float *above = l->cover + (size_t)(y - 1) * w, *here = count + (size_t)(y - 1) * w;
            l->cover[y * w + x] = (above[a] + here[a]) * (1 - f) + (above[b] + here[b]) * f;
        }
    int r = (int)(3 * l->unit + 0.5f);
    memcpy(count, l->cover, (size_t)w * h * sizeof *count);
    for (int y = 0; y < h; y++) box_mean(count + (size_t)y * w, w, 1, r, tmp, l->cover + (size_t)y * w);
    for (int i = 0; i < w * h; i++) {
        float c = l->cover[i] * (float)(2 * r + 1);
        l->cover[i] = c / (c + 3);
    }
}

/* The black frame that an undistortion left: runs of black from the left, right and top rim. */
static void find_blank(level *l, const uint8_t *px)
{
    int w = l->w, h = l->h;
    for (int y = 0; y < h; y++)
        for (int side = 0; side < 2; side++)
            for (int k = 0; k < w; k++) {
                int i = y * w + (side ? w - 1 - k : k);
                if (px[3 * i] | px[3 * i + 1] | px[3 * i + 2]) break;
                l->blank[i] = 1;
            }
    for (int x = 0; x < w; x++)
        for (int y = 0; y < h; y++) {
            int i = y * w + x;
            if (px[3 * i] | px[3 * i + 1] | px[3 * i + 2]) break;
            l->blank[i] = 1;
        }
}

/* Minimax way from the top rim over pixels above the horizon and apart from SfM points: sweeps until nothing moves (a few). */
static void find_barrier(level *l)
{
    int w = l->w, h = l->h, n = w * h;
    float *b = l->barrier;
    for (int i = 0; i < n; i++) b[i] = i < w && !l->blank[i] && l->dist[i] >= NEAR ? 0 : BLOCKED;
    for (int i = w; i < n; i++) if (l->blank[i - w] && !l->blank[i] && l->dist[i] >= NEAR) b[i] = 0;
    for (int pass = 0, moved = 1; moved && pass < 16; pass++) {
        moved = 0;
        for (int k = 0; k < n; k++) {
            int i = pass & 1 ? n - 1 - k : k, x = i % w;
            if (l->blank[i] || l->dist[i] < NEAR || l->elevation[i] < 0) continue;
            const int to[4] = { x ? i - 1 : -1, x + 1 < w ? i + 1 : -1, i - w, i + w < n ? i + w : -1 };
            for (int q = 0; q < 4; q++) {
                int j = to[q];
                if (j < 0 || b[j] >= b[i]) continue;
                float via = maxf(b[j], step_between(l, i, j));
                if (via < b[i]) { b[i] = via; moved = 1; }
            }
        }
    }
}

/* ---- evidence ---- */

static float median_of(float *v, int n)         /* reorders v */
{
    int lo = 0, hi = n - 1, k = n / 2;
    while (lo < hi) {
        float pivot = v[(lo + hi) / 2];
        int i = lo, j = hi;
        while (i <= j) {
            while (v[i] < pivot) i++;
            while (v[j] > pivot) j--;
            if (i <= j) { float t = v[i]; v[i++] = v[j]; v[j--] = t; }
        }
        if (k <= j) hi = j; else if (k >= i) lo = i; else break;
    }
    return v[k];
}

/* Texture that the scene shows in this photo: the median over the neighbourhood of points, or of everything without points. */
static float scene_texture(const level *l, float *tmp)
{
    int n = l->w * l->h, m = 0;
    for (int i = 0; i < n; i++) if (!l->blank[i] && l->dist[i] < 4) tmp[m++] = l->texture[i];
    if (m < n / 50) for (int i = m = 0; i < n; i++) if (l->elevation[i] < 0.15f) tmp[m++] = l->texture[i];
    if (m < n / 50) for (int i = m = 0; i < n; i++) tmp[m++] = l->texture[i];
    return maxf(median_of(tmp, m), 0.006f);
}

static int blue_step(const level *l, int i, int steps)
{
    float y = l->ch[0][i], rb = l->ch[1][i], g = l->ch[2][i], b = y - 0.5f * g - 0.5f * rb;     /* B from luma and differences */
    return (int)clampf((b - rb + 1) / 3 * (float)steps, 0, (float)(steps - 1));
}

/* Skies are brighter or bluer than what stands below them: rank of 2 B - R among the pixels around the points (all pixels below 10 degrees without points), as log-odds. */
static void weigh_blue(level *l)
{
    enum { STEPS = 512 };
    int n = l->w * l->h, hist[STEPS] = { 0 }, total = 0;
    float rank[STEPS];
    for (int pass = 0; pass < 2 && total < n / 50; pass++)
        for (int i = 0; i < n; i++)
            if (!l->blank[i] && (pass ? l->elevation[i] < 0.17f : l->dist[i] < 4)) { hist[blue_step(l, i, STEPS)]++; total++; }
    int below = 0;
    for (int k = 0; k < STEPS; k++) {
        rank[k] = total ? ((float)below + 0.5f * (float)hist[k]) / (float)total : 0.7f;
        below += hist[k];
    }
    for (int i = 0; i < n; i++) {
        float r = rank[blue_step(l, i, STEPS)];
        l->base[i] += r < 0.7f ? 5 * (r - 0.7f) : 4 * (r - 0.7f);
    }
}

static void weigh(level *l)
{
    for (int i = 0; i < l->w * l->h; i++) {
        float u = 1.2f;
        u += 1.5f * clampf(logf(0.25f * l->scene / (l->texture[i] + 0.002f)), -2, 1);
        u += 0.7f * clampf(logf(0.3f * l->scene / (l->barrier[i] + 0.002f)), -2, 1);
        u -= 4 * l->cover[i];
        u -= 3 * clampf(1 - l->elevation[i] / 0.05f, 0, 2);
        l->base[i] = u;
    }
    weigh_blue(l);
}

static void weigh_edges(level *l, float sigma)
{
    int w = l->w, h = l->h;
    for (int y = 0; y < h; y++)
        for (int x = 0; x < w; x++) {
            int i = y * w + x;
            float a = x + 1 < w ? step_between(l, i, i + 1) / sigma : 0, b = y + 1 < h ? step_between(l, i, i + w) / sigma : 0;
            l->wx[i] = x + 1 < w ? expf(-a * a) + 1e-4f : 0;
            l->wy[i] = y + 1 < h ? expf(-b * b) + 1e-4f : 0;
        }
}

/* ---- colour: histograms of sky and scene, smoothed ---- */

typedef struct { float lo[3], scale[3], ratio[CELLS], trust; } colours;

static void colours_range(colours *c, const level *l)
{
    enum { STEPS = 1024 };
    int n = l->w * l->h, hist[STEPS];
    for (int k = 0; k < 3; k++) {
        memset(hist, 0, sizeof hist);
        for (int i = 0; i < n; i++) hist[(int)clampf((l->ch[k][i] + 1) * 0.5f * (STEPS - 1), 0, STEPS - 1)]++;
        int a = 0, b = STEPS - 1, cut = n / 200;
        for (int s = 0; a < STEPS - 1 && (s += hist[a]) <= cut; a++) {}
        for (int s = 0; b > a && (s += hist[b]) <= cut; b--) {}
        float lo = 2.0f * (float)a / (STEPS - 1) - 1, hi = 2.0f * (float)b / (STEPS - 1) - 1, span = maxf(hi - lo, 0.12f);
        c->lo[k] = 0.5f * (lo + hi - span);
        c->scale[k] = (float)(BINS - 1) / span;
    }
}

static int colours_cell(const colours *c, const level *l, int i)
{
    int cell = 0;
    for (int k = 0; k < 3; k++) cell = cell * BINS + (int)clampf((l->ch[k][i] - c->lo[k]) * c->scale[k] + 0.5f, 0, BINS - 1);
    return cell;
}

static void smooth_cells(float *v)
{
    for (int step = 1; step < CELLS; step *= BINS)
        for (int i = 0; i < CELLS; i++) {
            if (i / step % BINS) continue;
            float before = v[i];
            for (int k = 0; k < BINS; k++) {
                float *p = v + i + k * step, here = *p, after = k + 1 < BINS ? p[step] : here;
                *p = 0.25f * before + 0.5f * here + 0.25f * after;
                before = here;
            }
        }
}

/* 1 within a few pixels of sky, where blur and misplaced points mix the two, else 0. Uses lambda. */
static void find_rim(level *l, float *rim)
{
    int w = l->w, h = l->h;
    for (int i = 0; i < w * h; i++) rim[i] = l->x[i] > 0.5f;
    box_mean(rim, w, h, (int)(4 * l->unit + 0.5f), l->lambda, rim);
    for (int i = 0; i < w * h; i++) rim[i] = rim[i] > 0;
}

/* Parts of sky (x > 1/2, 4-connected) apart from the largest one must share its colours, or they are unknown: dome panels, panes, bright walls.
 * So is a part as rough as the scene or studded with points away from its rim, and all of it where the largest part is tiny, or is all there is above the horizon. */
static orl_err question_parts(level *l, const colours *c, float *hist)
{
    int w = l->w, n = w * l->h, parts = 0, best = -1, most = 0;
    int *label = malloc((size_t)n * sizeof *label), *stack = malloc((size_t)n * sizeof *stack);
    float *shared = NULL, *size, *rough, *deep, *hit, *inside = l->goal, outside = 0, met = 0;
    orl_err e = ORL_E_MEMORY;
    if (!label || !stack) goto done;
    for (int i = 0; i < n; i++) label[i] = l->x[i] > 0.5f ? -1 : -2;
    for (int seed = 0; seed < n; seed++) {
        if (label[seed] != -1) continue;
        int top = 0, area = 0;
        label[stack[top++] = seed] = parts;
        while (top) {
            int i = stack[--top], x = i % w;
            area++;
            const int to[4] = { x ? i - 1 : -1, x + 1 < w ? i + 1 : -1, i - w, i + w < n ? i + w : -1 };
            for (int q = 0; q < 4; q++) if (to[q] >= 0 && label[to[q]] == -1) label[stack[top++] = to[q]] = parts;
        }
        if (area > most) { most = area; best = parts; }
        parts++;
    }
    int above = 0;
    for (int i = 0; i < n; i++) above += l->elevation[i] > 0.05f;
    int nothing = most < n / 2000 || most > above - above / 50;
    memset(hist, 0, CELLS * sizeof *hist);
    for (int i = 0; i < n; i++) if (label[i] == best && best >= 0) hist[colours_cell(c, l, i)] += 1;
    for (int pass = 0; pass < 2; pass++) smooth_cells(hist);
    shared = calloc((size_t)parts + 1, 5 * sizeof *shared);
    if (!shared) goto done;
    size = shared + parts;
    rough = size + parts;
    deep = rough + parts;
    hit = deep + parts;
    for (int i = 0; i < n; i++) inside[i] = label[i] < 0 ? 0 : 1e6f;
    chamfer(l, inside);
    for (int i = 0; i < n; i++) {
        if (label[i] < 0) {
            outside += l->elevation[i] > 0;
            met += l->elevation[i] > 0 && l->dist[i] == 0;
            continue;
        }
        if (inside[i] > 4) { deep[label[i]] += 1; hit[label[i]] += l->dist[i] == 0; }
        size[label[i]] += 1;
        rough[label[i]] += l->texture[i] / l->scene;
        shared[label[i]] += hist[colours_cell(c, l, i)] > 2.0f * (float)most / CELLS;
    }
    for (int i = 0; i < n; i++) {
        int k = label[i];
        if (k < 0) continue;
        int studded = hit[k] > 4 && hit[k] * outside > 0.1f * met * deep[k];
        if (nothing || studded || rough[k] > 0.75f * size[k] || (size[k] < 0.15f * (float)most && shared[k] < 0.5f * size[k])) l->x[i] = 0.5f;
    }
    e = ORL_OK;
done:
    free(shared); free(label); free(stack);
    return e ? orl_fail(e, "sky mask: no memory for %d x %d", w, l->h) : ORL_OK;
}

static void colours_learn(colours *c, level *l, float *sky, float *scene)
{
    float *rim = l->goal;
    find_rim(l, rim);
    double ssky = 0, sscene = 0;
    memset(sky, 0, CELLS * sizeof *sky);
    memset(scene, 0, CELLS * sizeof *scene);
    for (int i = 0; i < l->w * l->h; i++) {
        if (l->blank[i]) continue;
        int cell = colours_cell(c, l, i);
        float a = clampf(2 * l->x[i] - 1, 0, 1), b = clampf(1 - 2 * l->x[i], 0, 1);
        b *= 1 - rim[i];
        sky[cell] += a;
        scene[cell] += b;
        ssky += a;
        sscene += b;
    }
    for (int pass = 0; pass < 2; pass++) { smooth_cells(sky); smooth_cells(scene); }
    float a = 1 / (float)(ssky + 1), b = 1 / (float)(sscene + 1), floor = 0.3f / CELLS;
    c->trust = (float)fmin(ssky, sscene) / (float)(fmin(ssky, sscene) + 0.01 * l->w * l->h);
    for (int i = 0; i < CELLS; i++) c->ratio[i] = c->trust * clampf(logf((sky[i] * a + floor) / (scene[i] * b + floor)), -3.5f, 3.5f);
}

/* ---- the answer ---- */

static void combine(level *l, const colours *c)
{
    for (int i = 0; i < l->w * l->h; i++) {
        float near = c ? expf(-l->dist[i] / 2) : 3 * expf(-l->dist[i] / 4) + 3 * l->crowd[i] / (l->crowd[i] + 1);     /* before colour is known, keep well away from points */
        float colour = c ? c->ratio[colours_cell(c, l, i)] : 0, u = l->base[i] - near + colour;
        l->goal[i] = sigmoid(u);
        l->lambda[i] = 0.002f + 0.15f * fabsf(2 * l->goal[i] - 1);
        if (l->dist[i] < 0.8f && colour < 1) { l->goal[i] = 0; l->lambda[i] = 0.5f; }       /* a point over plain sky is one that lies badly */
        if (l->elevation[i] < -0.07f) { l->goal[i] = 0; l->lambda[i] = 2; }
        if (l->blank[i]) l->goal[i] = 0.5f;
    }
}

/* Gauss-Seidel with over-relaxation, rows and columns run both ways in turn. */
static void solve(level *l, int sweeps)
{
    int w = l->w, h = l->h, n = w * h;
    for (int s = 0; s < sweeps; s++)
        for (int r = 0; r < h; r++) {
            int row = (s & 1 ? h - 1 - r : r) * w;
            for (int k = 0; k < w; k++) {
                int i = row + (s & 1 ? w - 1 - k : k);
                float sum = l->lambda[i] * l->goal[i], weight = l->lambda[i];
                if (i > row) { sum += l->wx[i - 1] * l->x[i - 1]; weight += l->wx[i - 1]; }
                if (i + 1 < row + w) { sum += l->wx[i] * l->x[i + 1]; weight += l->wx[i]; }
                if (row) { sum += l->wy[i - w] * l->x[i - w]; weight += l->wy[i - w]; }
                if (row + w < n) { sum += l->wy[i] * l->x[i + w]; weight += l->wy[i]; }
                l->x[i] = clampf(l->x[i] + 1.6f * (sum / weight - l->x[i]), 0, 1);
            }
        }
}

/* Above the horizon, far from all points and below none of them nothing proves a scene: trees of no concern, a branch, a sign, a wall that SfM could not see. */
static void admit_doubt(level *l)
{
    for (int i = 0; i < l->w * l->h; i++) {
        float far = clampf((l->dist[i] - 16) / 8, 0, 1) * clampf(l->elevation[i] / 0.03f, 0, 1) * clampf(1 - 2 * l->cover[i], 0, 1);
        l->x[i] = maxf(l->x[i], 0.4f * far);
    }
}

/* Points without two others near are left out: a bird, or a match that went wrong. Keeps order. */
static size_t drop_lonely(const float (*pt)[2], size_t n, int w, int h, float (*out)[2])
{
    enum { SIDE = 24 };         /* cells along the long side */
    uint32_t count[SIDE + 2][SIDE + 2] = { 0 };
    float s = (float)SIDE / (float)(w > h ? w : h);
    size_t kept = 0;
    for (int pass = 0; pass < 2; pass++)
        for (size_t k = 0; k < n; k++) {
            if (!(pt[k][0] >= 0 && pt[k][0] < (float)w && pt[k][1] >= 0 && pt[k][1] < (float)h)) continue;
            int x = (int)(pt[k][0] * s), y = (int)(pt[k][1] * s);
            x = x < SIDE ? x : SIDE - 1; y = y < SIDE ? y : SIDE - 1;
            if (!pass) { count[y + 1][x + 1]++; continue; }
            uint32_t near = 0;
            for (int dy = 0; dy < 3; dy++) for (int dx = 0; dx < 3; dx++) near += count[y + dy][x + dx];
            if (near < 3) continue;
            out[kept][0] = pt[k][0];
            out[kept++][1] = pt[k][1];
        }
    return kept;
}

/* Spreading makes x timid along edges: 1.3 times its log-odds. */
static float sharpen(float x) { return sigmoid(1.3f * logf((x + 1e-3f) / (1.001f - x))); }

/* Bilinear, pixel centres aligned. */
static void stretch(const float *in, int w, int h, float *out, int ow, int oh)
{
    for (int y = 0; y < oh; y++)
        for (int x = 0; x < ow; x++) {
            float u = clampf(((float)x + 0.5f) * (float)w / (float)ow - 0.5f, 0, (float)(w - 1)), v = clampf(((float)y + 0.5f) * (float)h / (float)oh - 0.5f, 0, (float)(h - 1));
            int a = (int)u, b = (int)v, a1 = a + 1 < w ? a + 1 : a, b1 = b + 1 < h ? b + 1 : b;
            float fu = u - (float)a, fv = v - (float)b;
            out[(size_t)y * ow + x] = (1 - fv) * ((1 - fu) * in[b * w + a] + fu * in[b * w + a1]) + fv * ((1 - fu) * in[b1 * w + a] + fu * in[b1 * w + a1]);
        }
}

/* coarse: NULL, or the level that already knows what needs no detail. */
static orl_err level_make(level *l, const orl_image *photo, int side, const level *coarse, const orl_camera *cam, const double up[3], int horizon, const float (*pt)[2], size_t n)
{
    int w, h;
    orl_image small;
    orl_size_long_side(photo->w, photo->h, side, &w, &h);
    orl_err e = orl_image_resize_area(photo, w, h, &small);
    if (e) return e;
    if (!(e = level_alloc(l, w, h))) {
        float sx = (float)w / (float)photo->w, sy = (float)h / (float)photo->h;
        split_colour(l, small.px);
        find_blank(l, small.px);
        find_texture(l);
        find_distance(l, pt, n, sx, sy);
        if (coarse) {
            stretch(coarse->elevation, coarse->w, coarse->h, l->elevation, w, h);
            stretch(coarse->cover, coarse->w, coarse->h, l->cover, w, h);
            stretch(coarse->barrier, coarse->w, coarse->h, l->barrier, w, h);
        } else {
            orl_camera c = orl_camera_resized(cam, w, h);
            find_up(l, &c, up, horizon, pt, n, sx, sy);
            find_barrier(l);
            find_crowd(l);
        }
        l->scene = scene_texture(l, l->goal);
        weigh(l);
        weigh_edges(l, clampf(0.5f * l->scene, 0.01f, 0.05f));
    }
    orl_image_free(&small);
    return e;
}

orl_err orl_skymask(const orl_image *photo, const orl_camera *cam, const orl_pose *pose, const double up[3],
                    const float (*points)[2], size_t npoints, orl_image *prob)
{
    if (!photo || !photo->px || photo->c != 3 || photo->w < 1 || photo->h < 1) return orl_fail(ORL_E_RANGE, "sky mask: the photo is not RGB");
    double zenith[3] = { 0, -1, 0 }, norm = 0;
    if (up) {
        for (int a = 0; a < 3; a++) { zenith[a] = pose->R[3 * a] * up[0] + pose->R[3 * a + 1] * up[1] + pose->R[3 * a + 2] * up[2]; norm += zenith[a] * zenith[a]; }
        if (!(norm > 1e-12) || !isfinite(norm)) return orl_fail(ORL_E_RANGE, "sky mask: up is no direction");
        for (int a = 0; a < 3; a++) zenith[a] /= sqrt(norm);
    }
    level coarse = { 0 }, fine = { 0 };
    orl_image out = { 0 };
    float *full = NULL;
    colours *c = malloc(sizeof *c);
    float *cells = malloc(2 * CELLS * sizeof *cells), (*kept)[2] = malloc((npoints + 1) * sizeof *kept);
    orl_err e = c && cells && kept ? ORL_OK : orl_fail(ORL_E_MEMORY, "sky mask: no memory for colours and points");
    if (!e) npoints = drop_lonely(points, npoints, photo->w, photo->h, kept);
    const float (*pt)[2] = (const float (*)[2])kept;
    if (e || (e = level_make(&coarse, photo, COARSE, NULL, cam, zenith, up != NULL, pt, npoints)) ||
        (e = level_make(&fine, photo, FINE, &coarse, cam, zenith, up != NULL, pt, npoints))) goto done;

    colours_range(c, &coarse);
    for (int round = 0; round < ROUNDS; round++) {
        combine(&coarse, round ? c : NULL);
        if (!round) memcpy(coarse.x, coarse.goal, (size_t)coarse.w * coarse.h * sizeof *coarse.x);
        solve(&coarse, SWEEPS);
        colours_learn(c, &coarse, cells, cells + CELLS);
    }
    combine(&fine, c);
    stretch(coarse.x, coarse.w, coarse.h, fine.x, fine.w, fine.h);
    solve(&fine, SWEEPS / 2);
    if ((e = question_parts(&fine, c, cells))) goto done;
    if (npoints) admit_doubt(&fine);

    full = malloc((size_t)photo->w * photo->h * sizeof *full);
    if (!full) { e = orl_fail(ORL_E_MEMORY, "sky mask: no memory for %d x %d", photo->w, photo->h); goto done; }
    if ((e = orl_image_alloc(&out, photo->w, photo->h, 1))) goto done;
    stretch(fine.x, fine.w, fine.h, full, photo->w, photo->h);
    for (size_t i = 0; i < (size_t)photo->w * photo->h; i++) out.px[i] = (uint8_t)(255 * sharpen(full[i]) + 0.5f);
    *prob = out;
done:
    free(full); free(c); free(cells); free(kept); free(coarse.block); free(fine.block);
    return e;
}

/* ---- photos of a dataset ---- */

orl_err orl_skymask_up(const orl_dataset *d, double up[3])
{
    enum { STEPS = 400 };
    double m[9] = { 0 }, y[3] = { 0 }, norm = 0;
    for (uint32_t i = 0; i < d->nphotos; i++) {
        const double *R = d->photos[i].pose.R;
        if (d->photos[i].test) continue;
        for (int a = 0; a < 3; a++) {
            for (int b = 0; b < 3; b++) m[3 * a + b] += R[a] * R[b];
            y[a] -= R[3 + a];
        }
    }
    for (int a = 0; a < 3; a++) norm += y[a] * y[a];
    if (!(norm > 1e-12)) return orl_fail(ORL_E_DEGENERATE, "%s: the cameras determine no up", d->dir);
    /* Smallest axis of sum x x^T + a little (I - y y^T), by power iteration on the trace minus that, started at the mean y. */
    double lean = 0.002 * (m[0] + m[4] + m[8]), v[3];
    for (int a = 0; a < 3; a++) for (int b = 0; b < 3; b++) m[3 * a + b] += lean * ((a == b) - y[a] * y[b] / norm);
    double trace = m[0] + m[4] + m[8];
    for (int a = 0; a < 3; a++) v[a] = y[a] / sqrt(norm);
    for (int k = 0; k < STEPS; k++) {
        double r[3], n = 0;
        for (int a = 0; a < 3; a++) {
            r[a] = trace * v[a] - m[3 * a] * v[0] - m[3 * a + 1] * v[1] - m[3 * a + 2] * v[2];
            n += r[a] * r[a];
        }
        for (int a = 0; a < 3; a++) v[a] = r[a] / sqrt(n);
    }
    memcpy(up, v, sizeof v);
    return ORL_OK;
}

orl_err orl_skymask_photo(const orl_dataset *d, uint32_t index, const orl_image *photo, const orl_camera *cam, const double up[3], const uint8_t *skip, orl_image *prob)
{
    const orl_photo *p = &d->photos[index];
    float (*pt)[2] = malloc(((size_t)p->obs_count + d->npoints + 1) * sizeof *pt);
    size_t n = 0;
    if (!pt) return orl_fail(ORL_E_MEMORY, "%s: no memory for its points", p->path);
    for (uint32_t i = 0; i < p->obs_count; i++) {
        const orl_colmap_obs *o = &d->obs[p->obs_begin + i];
        if (o->point < 0 || (skip && skip[o->point])) continue;
        pt[n][0] = o->x * (float)photo->w / (float)p->cam.w;
        pt[n++][1] = o->y * (float)photo->h / (float)p->cam.h;
    }
    for (uint32_t i = 0; i < d->npoints; i++) {
        double x[3], uv[2];
        if ((skip && skip[i]) || d->points[i].track_length < 3 || d->points[i].error_px > 1.5f) continue;
        orl_pose_apply(&p->pose, d->points[i].xyz, x);
        /* Far outside the lens's field distortion may fold points back into the picture. */
        if (!(x[2] > 0) || x[0] * x[0] + x[1] * x[1] > 2 * x[2] * x[2] || !orl_camera_project(cam, x, uv)) continue;
        pt[n][0] = (float)uv[0];
        pt[n++][1] = (float)uv[1];
    }
    orl_err e = orl_skymask(photo, cam, &p->pose, up, (const float (*)[2])pt, n, prob);
    free(pt);
    return e;
}
