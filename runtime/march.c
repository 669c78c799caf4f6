/* Rays against the scene: clipped to the box in double (+ - * / only), marched in floats by the kernels (runtime/kernels/rays.h), and what a hit holds in integers, so that every machine finds the same. */
#include "runtime/march.h"
#include <string.h>
#include "oriel/cpu.h"

static int64_t fixed(double v, int q) { v *= (double)(1LL << q); return (int64_t)(v < 0 ? v - 0.5 : v + 0.5); }

void orl_march_begin(const orl_scene *s, const double o[3], const double dir[3], double from, orl_march *m)
{
    orl_rays *r = &m->rays;
    double t0 = from > 0 ? from : 0, t1 = 1e12;
    int k = m->n++;
    r->end[k] = 0;
    m->start[k] = 0;
    for (int a = 0; a < 3; a++) {
        double size = 8.0 * s->nb[a];
        if (!(o[a] > -1e9 && o[a] < 1e9) || !(dir[a] >= -1.001 && dir[a] <= 1.001)) return;
        if (dir[a] > -1e-9 && dir[a] < 1e-9) {
            if (o[a] <= 0 || o[a] >= size) return;
            continue;
        }
        double ta = (0 - o[a]) / dir[a], tb = (size - o[a]) / dir[a];
        if (ta > tb) { double x = ta; ta = tb; tb = x; }
        if (ta > t0) t0 = ta;
        if (tb < t1) t1 = tb;
    }
    if (!(t0 < t1) || t1 - t0 > 1e5) return;
    for (int a = 0; a < 3; a++) {
        const double least = 1.0 / (1 << 20);
        double p = o[a] + t0 * dir[a], size = 8.0 * s->nb[a];
        r->o[a][k] = (float)(p < 0 ? 0 : p > size ? size : p);
        r->d[a][k] = (float)(dir[a] > -least && dir[a] < least ? -least : dir[a]);
    }
    r->end[k] = (float)(t1 - t0);
    r->within[k] = t0 > 0 ? 0 : -1;
    m->start[k] = t0;
}

void orl_march_run(const orl_scene *s, int refine, orl_march *m)
{
    orl_rays *r = &m->rays;
    int n = (m->n + ORL_RAY_STEP - 1) / ORL_RAY_STEP * ORL_RAY_STEP;
    for (int k = m->n; k < n; k++) r->end[k] = 0;
    if (!s->nbricks) {
        for (int k = 0; k < n; k++) r->t[k] = -1;
        return;
    }
    orl_rays_march(s, n, refine, orl_cpu_detect(), r);
}

int orl_march_hit(const orl_scene *s, const orl_march *m, int k, orl_hit *out)
{
    const orl_rays *r = &m->rays;
    if (!(r->t[k] >= 0)) return 0;
    out->t = fixed((m->start[k] < 1e9 ? m->start[k] : 1e9) + (double)r->t[k], 16);
    out->brick = r->brick[k];
    out->cut = r->cut[k] != 0;
    for (int a = 0; a < 3; a++) {
        float p = r->o[a][k] + r->t[k] * r->d[a][k], top = (float)(8 * s->nb[a]) - 1 / 1024.0f;      /* as the kernels have it */
        out->at[a] = (int32_t)((p < 0 ? 0 : p > top ? top : p) * 4096);
    }
    return 1;
}

/* Brick of a Q12 position, or minus the distance. */
static inline int32_t brick_of(const orl_scene *s, const int32_t p[3])
{
    return s->bmap[((size_t)(p[2] >> 15) * s->nb[1] + (size_t)(p[1] >> 15)) * s->nb[0] + (size_t)(p[0] >> 15)];
}

/* Cell and 0..256 fraction of each axis of a position relative to the brick, Q12, clamped into it. */
static inline int cell_of(const int32_t q[3], int32_t f[3])
{
    int at = 0;
    for (int a = 2; a >= 0; a--) {
        int32_t v = q[a] < 0 ? 0 : q[a] > 8 << 12 ? 8 << 12 : q[a], i = v >> 12;
        i = i > 7 ? 7 : i;
        f[a] = (v - (i << 12)) >> 4;
        at = at * 9 + i;
    }
    return at;
}

/* Trilinear SDF, Q16 cells, from a cell's first vertex. */
static inline int32_t interpolate(const int8_t *v, const int32_t f[3])
{
    int32_t a0 = v[0] * 256 + (v[1] - v[0]) * f[0], a1 = v[9] * 256 + (v[10] - v[9]) * f[0], a2 = v[81] * 256 + (v[82] - v[81]) * f[0], a3 = v[90] * 256 + (v[91] - v[90]) * f[0];
    int32_t b0 = a0 * 256 + (a1 - a0) * f[1], b1 = a2 * 256 + (a3 - a2) * f[1];         /* Q21 */
    return (b0 * (256 - f[2]) + b1 * f[2]) >> 13;                                       /* Q29 -> Q16 */
}

static int32_t brick_sdf(const orl_scene *s, int32_t brick, const int32_t q[3])
{
    int32_t f[3], at = cell_of(q, f);
    return interpolate(s->sdf + (size_t)brick * ORL_BRICK_VERTS + at, f);
}

static inline void local(const int32_t p[3], const int32_t of[3], int32_t q[3]) { for (int a = 0; a < 3; a++) q[a] = p[a] - (of[a] & ~0x7fff); }

/* Central differences over +-2 cells; where a neighbour has no brick, the nearest point of the hit's own. */
static void gradient(const orl_scene *s, const int32_t p[3], int32_t own, int32_t grad[3])
{
    static const int PITCH[3] = { 2, 2 * 9, 2 * 81 };
    int32_t q[3], f[3];
    local(p, p, q);
    const int8_t *v = s->sdf + (size_t)own * ORL_BRICK_VERTS + cell_of(q, f);
    for (int a = 0; a < 3; a++) {
        int32_t d[2];
        for (int k = 0; k < 2; k++) {
            int32_t to = q[a] + (k ? 2 << 12 : -(2 << 12));
            if (to >= 0 && to < 8 << 12) {
                d[k] = interpolate(v + (k ? PITCH[a] : -PITCH[a]), f);
                continue;
            }
            int32_t y[3] = { p[0], p[1], p[2] }, r[3], b = -1;
            y[a] += to - q[a];
            if (y[a] >= 0 && y[a] < (int32_t)s->nb[a] << 15) b = brick_of(s, y);
            local(y, b < 0 ? p : y, r);
            d[k] = brick_sdf(s, b < 0 ? own : b, r);
        }
        grad[a] = d[1] - d[0];
    }
}

enum { STRIDE = 8 };

/* Whether the box round what the ball sweeps in the next STRIDE cells holds bricks, or too many places to look at. */
static int brick_on_way(const orl_scene *s, const double o[3], const double d[3], double spread, double t)
{
    int lo[3], hi[3];
    for (int a = 0; a < 3; a++) {
        double p = o[a] + t * d[a], q = o[a] + (t + STRIDE) * d[a], r = t * spread, e = (t + STRIDE) * spread, nb = s->nb[a];
        double low = (p - r < q - e ? p - r : q - e) / 8, high = (p + r > q + e ? p + r : q + e) / 8;
        if (!(high - low < 4)) return 1;
        lo[a] = low > 0 ? low < nb ? (int)low : (int)nb : 0;
        hi[a] = high < 0 ? -1 : high < nb ? (int)high : (int)nb - 1;
    }
    for (int z = lo[2]; z <= hi[2]; z++)
        for (int y = lo[1]; y <= hi[1]; y++) {
            const int32_t *row = s->bmap + ((size_t)z * s->nb[1] + (size_t)y) * s->nb[0];
            for (int x = lo[0]; x <= hi[0]; x++) if (row[x] >= 0) return 1;
        }
    return 0;
}

/* Up to when x + t v stays below 0, from t on. 0: it is not below. */
static double reach(double x, double v, double t) { return x + t * v > 0 ? 0 : v > 0 ? -x / v : 1e12; }

/* Boxes without bricks are passed one after the other, the ball of radius t spread in each of them, or where they are small the places that it sweeps; beyond the grid everything is free. */
double orl_march_freely(const orl_scene *s, const double o[3], const double d[3], double spread)
{
    const double never = 1e12;
    double t = 0;
    for (int k = 0; k < 256; k++) {
        double c[3], next = 0;
        int beside = 0, at[3];
        for (int a = 0; a < 3; a++) {
            double size = 8.0 * s->nb[a], sign = 0, edge = 0;
            c[a] = o[a] + t * d[a];
            if (!(c[a] > -1e9 && c[a] < 1e9)) return 0;
            if (c[a] < 0) sign = 1;
            else if (c[a] >= size) { sign = -1; edge = size; }
            at[a] = (int)(sign > 0 ? 0 : sign < 0 ? size - 1 : c[a]) >> 3;
            if (sign == 0) continue;
            double out = reach(sign * (o[a] - edge), sign * d[a] + spread, t);
            beside = 1;
            next = out > next ? out : next;
        }
        if (!beside) {
            int32_t b = s->bmap[((size_t)at[2] * s->nb[1] + (size_t)at[1]) * s->nb[0] + (size_t)at[0]];
            next = b < 0 ? never : 0;
            for (int a = 0; b < 0 && a < 3; a++) {
                int lo = at[a] + b + 1, hi = at[a] - b;
                double up = hi < (int)s->nb[a] ? reach(o[a] - 8.0 * hi, d[a] + spread, t) : never, down = lo > 0 ? reach(8.0 * lo - o[a], spread - d[a], t) : never;
                next = up < next ? up : next;
                next = down < next ? down : next;
            }
        }
        if (!(next > t + STRIDE) && !brick_on_way(s, o, d, spread, t)) next = t + STRIDE;
        if (!(next > t + 0.5)) break;
        if (next >= never) return never;
        t = next;
    }
    return t > 1 ? t - 1.0 / 16 : 0;
}

/* Base colour at a place (cells Q12) in a brick, where the SDF's gradient is grad. */
static void colour(const orl_scene *s, int32_t brick, const int32_t grad[3], const int32_t at[3], uint32_t rgb[3])
{
    int32_t q[3];
    uint32_t entry = s->skin[brick];
    int face = orl_skin_face(orl_skin_mask(entry), grad);
    local(at, at, q);
    orl_skin_colour(s->albedo + (size_t)orl_skin_texture(entry, face) * ORL_SKIN_TEXELS * 3, face, q, rgb);
}

void orl_march_surface(const orl_scene *s, orl_hit *h)
{
    gradient(s, h->at, h->brick, h->grad);
    colour(s, h->brick, h->grad, h->at, h->albedo);
}

/* Eight corner weights that sum to 256 exactly: the last takes what rounding left, 0 at the least. */
static inline void weights(const int32_t f[3], uint16_t w[8])
{
    int32_t rest = 256;
    for (int k = 0; k < 7; k++) {
        int32_t v = ((k & 1 ? f[0] : 256 - f[0]) * (k & 2 ? f[1] : 256 - f[1]) * (k & 4 ? f[2] : 256 - f[2]) + (1 << 15)) >> 16;
        v = v < rest ? v : rest;
        w[k] = (uint16_t)v;
        rest -= v;
    }
    w[7] = (uint16_t)rest;
}

typedef uint16_t u16x8 __attribute__((vector_size(16)));
typedef uint8_t u8x8 __attribute__((vector_size(8)));
typedef int16_t i16x8 __attribute__((vector_size(16)));
typedef int8_t i8x8 __attribute__((vector_size(8)));
static inline u16x8 eight(const uint8_t *p) { u8x8 v; memcpy(&v, p, 8); return __builtin_convertvector(v, u16x8); }
static inline u16x8 eight_signed(const int8_t *p) { i8x8 v; memcpy(&v, p, 8); return (u16x8)__builtin_convertvector(v, i16x8); }

void orl_march_light(const orl_scene *s, int32_t brick, const int32_t at[3], uint16_t lite[ORL_LITE_BYTES], int16_t phi[ORL_SHADOW_DIM])
{
    static const size_t CORNER[8] = { 0, 1, 3, 4, 9, 10, 12, 13 };
    uint16_t w[8], open = 255 * 256;
    u16x8 horizon[ORL_HORIZON / 8] = { { 0 } }, dark = { 0 };          /* dark: two's complement */
    _Static_assert((int)ORL_HORIZON == 16 && (int)ORL_SHADOW_DIM == 8, "vectors");
    if (brick >= 0) {
        int32_t q[3], f[3];
        size_t v = 0;
        local(at, at, q);
        for (int a = 2; a >= 0; a--) {                                                  /* light vertices stand 4 cells apart */
            int i = q[a] >> 14 ? 1 : 0;
            f[a] = (q[a] - (i << 14)) >> 6;
            v = v * 3 + (size_t)i;
        }
        weights(f, w);
        v += (size_t)brick * ORL_LITE_VERTS;
        if (s->lite) open = 0;
        for (int k = 0; s->lite && k < 8; k++) {
            const uint8_t *l = s->lite + (v + CORNER[k]) * ORL_LITE_BYTES;
            open = (uint16_t)(open + w[k] * l[0]);
            horizon[0] += w[k] * eight(l + 1);
            horizon[1] += w[k] * eight(l + 9);
        }
        for (int k = 0; s->shadow && k < 8; k++) dark += w[k] * eight_signed(s->shadow + (v + CORNER[k]) * ORL_SHADOW_DIM);
    }
    lite[0] = open;
    memcpy(lite + 1, horizon, sizeof horizon);
    memcpy(phi, &dark, sizeof dark);
}
