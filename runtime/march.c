/* Marching one ray: clipped to the box and converted to fixed point in double (+ - * / only), then integers alone, so that every machine finds the same surface.
 *
 * Positions are cells Q20, the ray's parameter t cells Q16, directions Q30, distances Q16. Empty space is left in one step by the brick map's Chebyshev distance: no brick within d - 1 bricks.
 * Inside bricks the trilinear SDF (8-bit fractions) gives the step: 7/8 of the distance, 1/4 to 3.5 cells.
 *
 * What counts as a hit: the first sample that is not positive after free space. Space without bricks is free: a ray that leaves it straight into the solid (a wall's back at the box border,
 * the cut side of bricks that nobody saw) hits there and gets the SDF's own normal; what a cut shows is the view's to say (view.c). A ray that starts inside the solid sees through it until
 * the first free sample. */
#include "runtime/march.h"
#include <string.h>

enum { MAX_STEPS = 4096, T_ONE = 1 << 16, EMPTY = 8 * T_ONE, STEP_MIN = T_ONE / 4, STEP_MAX = 7 * T_ONE / 2, NUDGE = T_ONE / 64, CUT = T_ONE / 32 };

typedef struct {
    const orl_scene *s;
    int64_t p0[3];                      /* Q20, in the box */
    int64_t d[3];                       /* Q30; 0 if below 2^-20 */
    int64_t inv[3], off[3];             /* Q28: t at which axis a reaches cell plane f = f inv + off */
    int64_t top[3];                     /* last position inside the box */
    int64_t end;                        /* t at which the ray leaves it */
} ray;

static int64_t fixed(double v, int q) { v *= (double)(1LL << q); return (int64_t)(v < 0 ? v - 0.5 : v + 0.5); }

static int ray_init(ray *r, const orl_scene *s, const double o[3], const double dir[3], double *start)
{
    double t0 = 0, t1 = 1e12;
    for (int a = 0; a < 3; a++) {
        double size = 8.0 * s->nb[a];
        if (!(o[a] > -1e9 && o[a] < 1e9) || !(dir[a] >= -1.001 && dir[a] <= 1.001)) return 0;
        if (dir[a] > -1e-9 && dir[a] < 1e-9) {
            if (o[a] <= 0 || o[a] >= size) return 0;
            continue;
        }
        double ta = (0 - o[a]) / dir[a], tb = (size - o[a]) / dir[a];
        if (ta > tb) { double x = ta; ta = tb; tb = x; }
        if (ta > t0) t0 = ta;
        if (tb < t1) t1 = tb;
    }
    if (!(t0 < t1) || t1 - t0 > 1e5) return 0;
    r->s = s;
    r->end = fixed(t1 - t0, 16);
    for (int a = 0; a < 3; a++) {
        r->top[a] = ((int64_t)s->nb[a] << 23) - 1;
        int64_t p = fixed(o[a] + t0 * dir[a], 20);
        r->p0[a] = p < 0 ? 0 : p > r->top[a] ? r->top[a] : p;
        r->d[a] = fixed(dir[a], 30);
        r->inv[a] = r->off[a] = 0;
        if (r->d[a] > -1024 && r->d[a] < 1024) { r->d[a] = 0; continue; }
        double inv = (double)(1LL << 30) / (double)r->d[a];
        r->inv[a] = fixed(inv, 28);
        r->off[a] = fixed(-inv * ((double)r->p0[a] / (double)(1 << 20)), 28);
    }
    *start = t0;
    return 1;
}

static inline void position(const ray *r, int64_t t, int32_t p[3])
{
    for (int a = 0; a < 3; a++) {
        int64_t q = r->p0[a] + ((r->d[a] * t) >> 26);
        p[a] = (int32_t)((q < 0 ? 0 : q > r->top[a] ? r->top[a] : q) >> 8);     /* Q12: 8-bit fractions of a cell and four bits to spare */
    }
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

/* Trilinear SDF, Q16 cells. */
static inline int32_t brick_sdf(const orl_scene *s, int32_t brick, const int32_t q[3])
{
    int32_t f[3];
    const int8_t *v = s->sdf + (size_t)brick * ORL_BRICK_VERTS + cell_of(q, f);
    int32_t a0 = v[0] * 256 + (v[1] - v[0]) * f[0], a1 = v[9] * 256 + (v[10] - v[9]) * f[0], a2 = v[81] * 256 + (v[82] - v[81]) * f[0], a3 = v[90] * 256 + (v[91] - v[90]) * f[0];
    int32_t b0 = a0 * 256 + (a1 - a0) * f[1], b1 = a2 * 256 + (a3 - a2) * f[1];         /* Q21 */
    return (b0 * (256 - f[2]) + b1 * f[2]) >> 13;                                       /* Q29 -> Q16 */
}

static inline void local(const int32_t p[3], const int32_t of[3], int32_t q[3]) { for (int a = 0; a < 3; a++) q[a] = p[a] - (of[a] & ~0x7fff); }

static int32_t sdf_at(const ray *r, int64_t t)
{
    int32_t p[3], q[3];
    position(r, t, p);
    int32_t b = brick_of(r->s, p);
    if (b < 0) return EMPTY;
    local(p, p, q);
    return brick_sdf(r->s, b, q);
}

/* Central differences over +-2 cells; where a neighbour has no brick, the nearest point of the hit's own. */
static void gradient(const orl_scene *s, const int32_t p[3], int32_t own, int32_t grad[3])
{
    for (int a = 0; a < 3; a++) {
        int32_t v[2];
        for (int k = 0; k < 2; k++) {
            int32_t y[3] = { p[0], p[1], p[2] }, q[3], b = -1;
            y[a] += k ? 2 << 12 : -(2 << 12);
            if (y[a] >= 0 && y[a] < (int32_t)s->nb[a] << 15) b = brick_of(s, y);
            local(y, b < 0 ? p : y, q);
            v[k] = brick_sdf(s, b < 0 ? own : b, q);
        }
        grad[a] = v[1] - v[0];
    }
}

/* Eight corner weights that sum to 2^16 exactly: the last takes what rounding left. */
static inline void weights(const int32_t f[3], uint32_t w[8])
{
    uint32_t rest = 1 << 16;
    for (int k = 0; k < 8; k++) {
        uint32_t v = (uint32_t)(k & 1 ? f[0] : 256 - f[0]) * (uint32_t)(k & 2 ? f[1] : 256 - f[1]) * (uint32_t)(k & 4 ? f[2] : 256 - f[2]) >> 8;
        w[k] = k == 7 ? rest : v;
        rest -= w[k];
    }
}

static void attributes(const orl_scene *s, const int32_t p[3], int32_t brick, orl_hit *h)
{
    int32_t q[3], f[3];
    uint32_t w[8], entry = s->skin[brick];
    local(p, p, q);
    int face = orl_skin_face(orl_skin_mask(entry), h->grad);
    orl_skin_colour(s->albedo + (size_t)orl_skin_texture(entry, face) * ORL_SKIN_TEXELS * 3, face, q, h->albedo);
    memset(h->lite, 0, sizeof h->lite);
    memset(h->phi, 0, sizeof h->phi);
    if (!s->lite) h->lite[0] = 255 << 16;
    if (!s->lite && !s->shadow) return;
    int first = 0;
    for (int a = 2; a >= 0; a--) {                                                      /* light vertices stand 4 cells apart */
        int i = q[a] >> 14 ? 1 : 0;
        f[a] = (q[a] - (i << 14)) >> 6;
        first = first * 3 + i;
    }
    weights(f, w);
    for (int k = 0; k < 8; k++) {
        size_t v = (size_t)brick * ORL_LITE_VERTS + (size_t)(first + (k & 1) + 3 * (k >> 1 & 1) + 9 * (k >> 2));
        if (s->lite) for (int c = 0; c < ORL_LITE_BYTES; c++) h->lite[c] += w[k] * s->lite[v * ORL_LITE_BYTES + (size_t)c];
        if (s->shadow) for (int c = 0; c < ORL_SHADOW_DIM; c++) h->phi[c] += (int32_t)w[k] * s->shadow[v * ORL_SHADOW_DIM + (size_t)c];
    }
}

/* Crossing between free lo and solid hi by regula falsi, to 1/256 cell of distance. */
static int64_t refine(const ray *r, int64_t lo, int32_t flo, int64_t hi, int32_t fhi)
{
    int64_t t = hi;
    for (int i = 0; i < 5 && hi > lo; i++) {
        t = lo + (hi - lo) * flo / (flo - fhi);
        int32_t f = sdf_at(r, t);
        if (f > -T_ONE / 256 && f < T_ONE / 256) break;
        if (f > 0) { lo = t; flo = f; } else { hi = t; fhi = f; }
    }
    return t;
}

int orl_march(const orl_scene *s, const double origin[3], const double dir[3], orl_hit *out)
{
    ray r;
    double start;
    if (!ray_init(&r, s, origin, dir, &start)) return 0;
    int64_t t = 0, prev_t = 0;
    int32_t prev = T_ONE, p[3], q[3];
    int inside = 0, entered = 0;
    for (int k = 0; k < MAX_STEPS && t < r.end; k++) {
        position(&r, t, p);
        int32_t b = brick_of(s, p);
        if (b < 0) {
            int64_t exit = r.end;
            for (int a = 0; a < 3; a++) {
                if (!r.d[a]) continue;
                int64_t face = 8 * (int64_t)(r.d[a] > 0 ? (p[a] >> 15) - b : (p[a] >> 15) + b + 1), e = (face * r.inv[a] + r.off[a]) >> 12;
                exit = e < exit ? e : exit;
            }
            t = (exit > t ? exit : t) + NUDGE;
            prev = T_ONE;
            prev_t = t;
            inside = 0;
            entered = 1;
            continue;
        }
        local(p, p, q);
        int32_t f = brick_sdf(s, b, q);
        if (f <= 0 && k == 0 && start <= 0) inside = 1;
        if (f <= 0 && !inside) {
            int64_t at = refine(&r, prev_t, prev, t, f);
            int32_t hit[3];
            position(&r, at, hit);
            int32_t own = brick_of(s, hit);
            if (own < 0) { at = t; memcpy(hit, p, sizeof hit); own = b; }
            out->t = at + fixed(start < 1e9 ? start : 1e9, 16);
            out->cut = entered && f < -CUT;
            gradient(s, hit, own, out->grad);
            attributes(s, hit, own, out);
            return 1;
        }
        if (f > 0) inside = 0;
        entered = 0;
        prev = f > 64 ? f : 64;
        prev_t = t;
        f -= f >> 3;
        t += inside ? T_ONE / 2 : f < STEP_MIN ? STEP_MIN : f > STEP_MAX ? STEP_MAX : f;
    }
    return 0;
}
