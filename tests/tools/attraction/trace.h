/* Small analytic ray tracer: vectors, repeatable random numbers, primitives, and a bounding volume hierarchy over them.
 * Metres; ray directions have unit length; the ground is the plane z = 0. A surface is a primitive with a material, an id and a mean
 * base colour; what it looks like up close is place.h. Included by attraction.c alone. */
#ifndef ATTRACTION_TRACE_H
#define ATTRACTION_TRACE_H
#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

typedef float v3 __attribute__((vector_size(16)));     /* x, y, z, unused */
#define V(x, y, z) ((v3){ (x), (y), (z), 0 })
#define PI 3.14159265f
#define DEG (PI / 180)

static float dot(v3 a, v3 b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
static v3 cross(v3 a, v3 b) { return V(a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]); }
static v3 unit(v3 a) { return a * (1 / sqrtf(dot(a, a))); }
static float clampf(float x, float lo, float hi) { return x < lo ? lo : x > hi ? hi : x; }
static float mixf(float a, float b, float t) { return a + (b - a) * t; }
static v3 mix(v3 a, v3 b, float t) { return a + (b - a) * t; }
static float smooth(float a, float b, float x) { x = clampf((x - a) / (b - a), 0, 1); return x * x * (3 - 2 * x); }
static float luminance(v3 c) { return 0.2126f * c[0] + 0.7152f * c[1] + 0.0722f * c[2]; }

/* ---- random numbers: PCG32, one stream per purpose, so that no thread or photo disturbs another ---- */
typedef struct { uint64_t state, inc; } rng;
static uint32_t rng_next(rng *r)
{
    uint64_t old = r->state;
    r->state = old * 6364136223846793005ull + r->inc;
    uint32_t x = (uint32_t)(((old >> 18) ^ old) >> 27), rot = (uint32_t)(old >> 59);
    return x >> rot | x << (-rot & 31);
}
static rng rng_make(uint64_t seed, uint64_t stream)
{
    rng r = { 0, stream * 2 + 1 };
    rng_next(&r);
    r.state += seed * 0x9e3779b97f4a7c15ull + stream;
    rng_next(&r);
    return r;
}
static float uniform(rng *r, float lo, float hi) { return lo + (hi - lo) * (float)(rng_next(r) >> 8) * 0x1p-24f; }
/* Several draws in a stated order: C leaves that of arguments and initialisers open. */
static v3 uniform3(rng *r, v3 lo, v3 hi)
{
    v3 u = { 0 };
    for (int i = 0; i < 3; i++) u[i] = uniform(r, lo[i], hi[i]);
    return u;
}
static float gauss(rng *r)
{
    float radius = sqrtf(-2 * logf(uniform(r, 1e-7f, 1))), turn = uniform(r, 0, 2 * PI);
    return radius * cosf(turn);
}
static uint32_t hash(int x, int y, int z)
{
    uint32_t h = (uint32_t)x * 0x8da6b343u ^ (uint32_t)y * 0xd8163841u ^ (uint32_t)z * 0xcb1ab31fu;
    h = (h ^ h >> 15) * 0x2c1b3c6du;
    h = (h ^ h >> 12) * 0x297a2d39u;
    return h ^ h >> 15;
}
static float hash01(int x, int y, int z) { return (float)(hash(x, y, z) >> 8) * 0x1p-24f; }
static float noise(float x, float y, float z)           /* value noise, 0..1 */
{
    int i = (int)floorf(x), j = (int)floorf(y), k = (int)floorf(z);
    float u = smooth(0, 1, x - i), v = smooth(0, 1, y - j), w = smooth(0, 1, z - k), r[2];
    for (int d = 0; d < 2; d++)
        r[d] = mixf(mixf(hash01(i, j, k + d), hash01(i + 1, j, k + d), u), mixf(hash01(i, j + 1, k + d), hash01(i + 1, j + 1, k + d), u), v);
    return mixf(r[0], r[1], w);
}
static float fbm(float x, float y, float z, int octaves)
{
    float sum = 0, gain = 0.5f;
    for (; octaves--; gain *= 0.5f, x = x * 2.03f + 7, y = y * 2.03f + 3, z *= 2.03f) sum += gain * noise(x, y, z);
    return sum;
}

/* ---- primitives and their bounding volume hierarchy ---- */
enum { BOX, FRUSTUM, SPHERE, CONVEX, ARCH, CAPSULE };
enum { STONE, TRIM, MARBLE, BRICK, TILE, PAVE, GLASS, DOOR, COPPER, PLASTER, HOUSE, LEAF, PLAIN, CLOCK, STEP };
typedef struct {
    int kind, material, axis, id;
    v3 lo, hi, tint;            /* bounds; mean base colour, linear */
    v3 a, b;                    /* SPHERE: centre; CAPSULE: ends; ARCH: centre of the hole; FRUSTUM: (u, v, start), (r0, r1, end) */
    float r;
    int nplanes;
    v3 plane[6];                /* CONVEX: n.p <= plane[3] */
} prim;
typedef struct { v3 bound[2]; int first, count, axis; } node;   /* lower, upper; count 0: children at first and first + 1 */
typedef struct { prim *p; int n, cap, nnodes; node *nodes; } set;
typedef struct { float t; v3 n; const prim *q; } hit;           /* q NULL: the ground */

static const v3 pave_tint = { 0.33f, 0.30f, 0.265f, 0 }, stone = { 0.56f, 0.48f, 0.36f, 0 }, trim = { 0.66f, 0.60f, 0.49f, 0 },
    marble = { 0.70f, 0.665f, 0.59f, 0 }, brick = { 0.37f, 0.155f, 0.095f, 0 }, tile = { 0.36f, 0.145f, 0.08f, 0 },
        slate = { 0.15f, 0.17f, 0.20f, 0 },
    copper = { 0.20f, 0.42f, 0.34f, 0 }, glass = { 0.045f, 0.055f, 0.065f, 0 }, wood = { 0.16f, 0.075f, 0.035f, 0 },
        iron = { 0.05f, 0.055f, 0.05f, 0 };

static prim *add(set *s, int kind, int material, v3 tint)
{
    if (s->n == s->cap) {
        s->cap = s->cap ? 2 * s->cap : 256;
        if (!(s->p = realloc(s->p, (size_t)s->cap * sizeof *s->p))) abort();
    }
    prim *q = &s->p[s->n];
    *q = (prim){ .kind = kind, .material = material, .tint = tint, .id = s->n++ };
    return q;
}
static void box(set *s, int m, v3 tint, float x0, float x1, float y0, float y1, float z0, float z1)
{
    prim *q = add(s, BOX, m, tint);
    q->lo = V(x0, y0, z0), q->hi = V(x1, y1, z1);
}
/* Cone frustum along an axis (2: upright) through (cu, cv) in the two axes that follow it, radius r0 at a0 to r1 at a1. */
static void frustum(set *s, int m, v3 tint, int axis, float cu, float cv, float a0, float r0, float a1, float r1)
{
    prim *q = add(s, FRUSTUM, m, tint);
    int u = (axis + 1) % 3, v = (axis + 2) % 3;
    float r = fmaxf(r0, r1);
    q->axis = axis, q->a = V(cu, cv, a0), q->b = V(r0, r1, a1);
    q->lo[u] = cu - r, q->hi[u] = cu + r, q->lo[v] = cv - r, q->hi[v] = cv + r, q->lo[axis] = a0, q->hi[axis] = a1;
}
static void sphere(set *s, int m, v3 tint, float x, float y, float z, float r)
{
    prim *q = add(s, SPHERE, m, tint);
    q->a = V(x, y, z), q->r = r, q->lo = q->a - r, q->hi = q->a + r;
}
static void capsule(set *s, v3 tint, v3 a, v3 b, float r)
{
    prim *q = add(s, CAPSULE, PLAIN, tint);
    q->a = a, q->b = b, q->r = r;
    for (int i = 0; i < 3; i++) q->lo[i] = fminf(a[i], b[i]) - r, q->hi[i] = fmaxf(a[i], b[i]) + r;
}
/* A box with a round hole right through it along axis (0 or 1): the top of an arched opening, springing from the box's foot. */
static void arch(set *s, int m, v3 tint, int axis, float x0, float x1, float y0, float y1, float z0, float z1)
{
    prim *q = add(s, ARCH, m, tint);
    q->axis = axis, q->lo = V(x0, y0, z0), q->hi = V(x1, y1, z1);
    q->a = V((x0 + x1) / 2, (y0 + y1) / 2, z0), q->r = (axis == 1 ? x1 - x0 : y1 - y0) / 2;
}
static void plane(prim *q, v3 n, v3 through)
{
    n = unit(n);
    n[3] = dot(n, through);
    q->plane[q->nplanes++] = n;
}
/* Roof with its ridge along axis (0 or 1) from a0 to a1, spanning u0..u1 across; its ends lean in by hip at the ridge (0: gables). */
static void roof(set *s, int m, v3 tint, int axis, float a0, float a1, float u0, float u1, float z0, float z1, float hip)
{
    prim *q = add(s, CONVEX, m, tint);
    int u = 1 - axis;
    q->lo[axis] = a0, q->hi[axis] = a1, q->lo[u] = u0, q->hi[u] = u1, q->lo[2] = z0, q->hi[2] = z1;
    plane(q, V(0, 0, -1), q->lo);
    for (int side = 0; side < 2; side++) {
        v3 n = V(0, 0, (u1 - u0) / 2), e = V(0, 0, hip);
        n[u] = side ? z1 - z0 : z0 - z1;
        e[axis] = side ? z1 - z0 : z0 - z1;
        plane(q, n, side ? V(q->hi[0], q->hi[1], z0) : q->lo);
        plane(q, e, side ? V(q->hi[0], q->hi[1], z0) : q->lo);
    }
}
/* Sloping beam in a plane of constant y: its upper edge runs from (x0, z0) to (x1, z1). */
static void beam(set *s, int m, v3 tint, float x0, float z0, float x1, float z1, float thick, float y0, float y1)
{
    prim *q = add(s, CONVEX, m, tint);
    q->lo = V(x0, y0, fminf(z0, z1) - 2 * thick), q->hi = V(x1, y1, fmaxf(z0, z1));
    v3 up = unit(V(z0 - z1, 0, x1 - x0));
    plane(q, up, V(x0, 0, z0)), plane(q, -up, V(x0, 0, z0) - up * thick);
    plane(q, V(-1, 0, 0), q->lo), plane(q, V(1, 0, 0), q->hi), plane(q, V(0, -1, 0), q->lo), plane(q, V(0, 1, 0), q->hi);
}

static bool box_interval(const prim *q, v3 o, v3 inv, float t[2], int face[2])
{
    t[0] = -INFINITY, t[1] = INFINITY;
    for (int i = 0; i < 3; i++) {
        float a = (q->lo[i] - o[i]) * inv[i], b = (q->hi[i] - o[i]) * inv[i];
        float near = a < b ? a : b, far = a < b ? b : a;
        if (near > t[0]) t[0] = near, face[0] = i;
        if (far < t[1]) t[1] = far, face[1] = i;
    }
    return t[0] <= t[1];
}
/* Roots of a t^2 + 2 b t + c. */
static bool roots(float a, float b, float c, float t[2])
{
    float d = b * b - a * c;
    if (d < 0 || fabsf(a) < 1e-12f) return false;
    d = sqrtf(d);
    t[0] = (-b - d) / a, t[1] = (-b + d) / a;
    if (t[0] > t[1]) { float swap = t[0]; t[0] = t[1], t[1] = swap; }
    return true;
}
static bool take(hit *h, const prim *q, float t, float tmin, v3 n)
{
    if (!(t > tmin && t < h->t)) return false;
    *h = (hit){ t, n, q };
    return true;
}
/* Nearest crossing beyond tmin and before h->t, kept in h. Curved shapes move the origin next to the shape first: float loses the rest. */
static bool intersect(const prim *q, v3 o, v3 d, v3 inv, float tmin, hit *h)
{
    float t[2];
    int face[2] = { 0, 0 };
    bool any = false;
    switch (q->kind) {
    case BOX: {
        if (!box_interval(q, o, inv, t, face)) return false;
        v3 n = { 0 };
        int side = t[0] > tmin ? 0 : 1;
        n[face[side]] = d[face[side]] > 0 ? -1 : 1;
        return take(h, q, t[side], tmin, n);
    }
    case ARCH: {
        if (!box_interval(q, o, inv, t, face)) return false;
        int u = 1 - q->axis;
        float shift = t[0], hole[2] = { INFINITY, INFINITY }, ou = o[u] + d[u] * shift - q->a[u], oz = o[2] + d[2] * shift - q->a[2];
        float a = d[u] * d[u] + d[2] * d[2];
        if (a < 1e-9f ? ou * ou + oz * oz < q->r * q->r : false) return false;
        if (roots(a, d[u] * ou + d[2] * oz, ou * ou + oz * oz - q->r * q->r, hole)) hole[0] += shift, hole[1] += shift;
        if (t[0] > tmin && !(hole[0] <= t[0] + 1e-5f && hole[1] > t[0])) {
            v3 n = { 0 };
            n[face[0]] = d[face[0]] > 0 ? -1 : 1;
            if (take(h, q, t[0], tmin, n)) return true;
        }
        if (hole[1] < t[1] && hole[1] > t[0]) {
            v3 n = q->a - (o + d * hole[1]);
            n[q->axis] = 0;
            return take(h, q, hole[1], tmin, unit(V(n[0], n[1], n[2])));
        }
        return false;
    }
    case SPHERE: {
        float shift = dot(q->a - o, d);
        v3 near = o + d * shift - q->a;
        if (!roots(1, 0, dot(near, near) - q->r * q->r, t)) return false;
        for (int i = 0; i < 2 && !any; i++) any = take(h, q, t[i] + shift, tmin, (near + d * t[i]) * (1 / q->r));
        return any;
    }
    case CAPSULE: {
        v3 ab = q->b - q->a;
        float len = sqrtf(dot(ab, ab)), shift = dot(q->a - o, d);
        v3 axis = ab * (1 / len), near = o + d * shift - q->a;
        float dz = dot(d, axis), nz = dot(near, axis);
        v3 dp = d - axis * dz, np = near - axis * nz;
        if (roots(dot(dp, dp), dot(dp, np), dot(np, np) - q->r * q->r, t)) {
            float z = nz + dz * t[0];
            if (z >= 0 && z <= len) any = take(h, q, t[0] + shift, tmin, (np + dp * t[0]) * (1 / q->r));
        }
        for (int end = 0; end < 2; end++) {
            v3 c = o - (end ? q->b : q->a);
            float s = -dot(c, d);
            c = c + d * s;
            if (roots(1, 0, dot(c, c) - q->r * q->r, t)) any |= take(h, q, t[0] + s, tmin, (c + d * t[0]) * (1 / q->r));
        }
        return any;
    }
    case FRUSTUM: {
        int w = q->axis, u = (w + 1) % 3, v = (w + 2) % 3;
        v3 c = { 0 };
        c[u] = q->a[0], c[v] = q->a[1], c[w] = (q->a[2] + q->b[2]) / 2;
        float shift = dot(c - o, d), slope = (q->b[1] - q->b[0]) / (q->b[2] - q->a[2]);
        v3 near = o + d * shift - c;
        float r0 = (q->b[0] + q->b[1]) / 2 + slope * near[w], half = (q->b[2] - q->a[2]) / 2;
        if (roots(d[u] * d[u] + d[v] * d[v] - slope * slope * d[w] * d[w], d[u] * near[u] + d[v] * near[v] - slope * r0 * d[w],
                  near[u] * near[u] + near[v] * near[v] - r0 * r0, t))
            for (int i = 0; i < 2 && !any; i++) {
                v3 p = near + d * t[i], n = p;
                if (fabsf(p[w]) > half) continue;
                n[w] = -slope * (r0 + slope * d[w] * t[i]);
                any = take(h, q, t[i] + shift, tmin, unit(V(n[0], n[1], n[2])));
            }
        for (int end = 0; end < 2; end++) {             /* the lids */
            float at = (end ? half : -half), r = end ? q->b[1] : q->b[0], s = (at - near[w]) / d[w];
            v3 p = near + d * s, n = { 0 };
            n[w] = end ? 1 : -1;
            if (p[u] * p[u] + p[v] * p[v] < r * r) any |= take(h, q, s + shift, tmin, n);
        }
        return any;
    }
    default: {
        int enter = 0;
        t[0] = -INFINITY, t[1] = INFINITY;
        for (int i = 0; i < q->nplanes; i++) {
            float dn = dot(q->plane[i], d), gap = q->plane[i][3] - dot(q->plane[i], o);
            if (dn == 0) { if (gap < 0) return false; continue; }
            float s = gap / dn;
            if (dn < 0) { if (s > t[0]) t[0] = s, enter = i; }
            else if (s < t[1]) t[1] = s;
        }
        return t[0] <= t[1] && take(h, q, t[0], tmin, V(q->plane[enter][0], q->plane[enter][1], q->plane[enter][2]));
    }
    }
}

static float area(v3 lo, v3 hi) { v3 e = hi - lo; return e[0] * e[1] + e[1] * e[2] + e[2] * e[0]; }
static void grow(v3 *lo, v3 *hi, const prim *q)
{
    for (int i = 0; i < 3; i++) (*lo)[i] = fminf((*lo)[i], q->lo[i]), (*hi)[i] = fmaxf((*hi)[i], q->hi[i]);
}
static int by_centre(const void *x, const void *y, void *axis)
{
    const prim *a = x, *b = y;
    int i = *(int *)axis;
    float d = a->lo[i] + a->hi[i] - b->lo[i] - b->hi[i];
    return d < 0 ? -1 : d > 0 ? 1 : a->id - b->id;
}
static void split(set *s, int self, float *cost)
{
    node *me = &s->nodes[self];
    int first = me->first, n = me->count, best_axis = -1, best = 0;
    v3 lo0 = V(INFINITY, INFINITY, INFINITY), hi0 = -lo0;
    for (int i = 0; i < n; i++) grow(&lo0, &hi0, &s->p[first + i]);
    me->bound[0] = lo0, me->bound[1] = hi0;
    float least = n * area(lo0, hi0);
    for (int axis = 0; axis < 3 && n > 2; axis++) {      /* full sweep by the surface area heuristic: sets are small */
        qsort_r(s->p + first, (size_t)n, sizeof *s->p, by_centre, &axis);
        v3 lo = V(INFINITY, INFINITY, INFINITY), hi = -lo, rlo = lo, rhi = hi;
        for (int i = n - 1; i > 0; i--) grow(&rlo, &rhi, &s->p[first + i]), cost[i] = (n - i) * area(rlo, rhi);
        for (int i = 1; i < n; i++) {
            grow(&lo, &hi, &s->p[first + i - 1]);
            float c = i * area(lo, hi) + cost[i] + area(lo0, hi0);
            if (c < least) least = c, best_axis = axis, best = i;
        }
    }
    if (best_axis < 0) return;
    qsort_r(s->p + first, (size_t)n, sizeof *s->p, by_centre, &best_axis);
    int child = s->nnodes;
    s->nnodes += 2;
    s->nodes[child] = (node){ .first = first, .count = best };
    s->nodes[child + 1] = (node){ .first = first + best, .count = n - best };
    me->first = child, me->count = 0, me->axis = best_axis;
    split(s, child, cost), split(s, child + 1, cost);
}
static void set_build(set *s)
{
    if (!s->n) return;
    float *cost = malloc((size_t)s->n * sizeof *cost);
    s->nodes = malloc((size_t)s->n * 2 * sizeof *s->nodes);
    if (!cost || !s->nodes) abort();
    s->nodes[0] = (node){ .count = s->n };
    s->nnodes = 1;
    split(s, 0, cost);
    free(cost);
}
static void set_free(set *s) { free(s->p), free(s->nodes), *s = (set){ 0 }; }

/* Closest hit before h->t, or with any set the first one found. */
static bool set_trace(const set *s, v3 o, v3 d, float tmin, hit *h, bool any)
{
    if (!s->n) return false;
    v3 inv;
    for (int i = 0; i < 3; i++) inv[i] = 1 / (fabsf(d[i]) < 1e-9f ? copysignf(1e-9f, d[i]) : d[i]);
    int stack[64], top = 0, back[3] = { inv[0] < 0, inv[1] < 0, inv[2] < 0 };
    bool found = false;
    for (stack[top++] = 0; top;) {
        const node *nd = &s->nodes[stack[--top]];
        float t0 = tmin, t1 = h->t;
        for (int i = 0; i < 3; i++) {
            float near = (nd->bound[back[i]][i] - o[i]) * inv[i], far = (nd->bound[!back[i]][i] - o[i]) * inv[i];
            t0 = near > t0 ? near : t0;
            t1 = far < t1 ? far : t1;
        }
        if (t0 > t1) continue;
        if (nd->count) {
            for (int i = 0; i < nd->count; i++)
                if (intersect(&s->p[nd->first + i], o, d, inv, tmin, h)) { found = true; if (any) return true; }
        } else {
            int far = !back[nd->axis];
            stack[top++] = nd->first + far, stack[top++] = nd->first + !far;
        }
    }
    return found;
}
typedef struct { const set *place, *people; } world;
static bool trace(world w, v3 o, v3 d, hit *h)
{
    *h = (hit){ .t = 1e5f };
    bool found = false;
    if (d[2] < 0 && -o[2] / d[2] > 1e-3f) h->t = -o[2] / d[2], h->n = V(0, 0, 1), found = true;
    found |= set_trace(w.place, o, d, 1e-3f, h, false);
    return set_trace(w.people, o, d, 1e-3f, h, false) | found;
}
static bool occluded(world w, v3 o, v3 d, float far)
{
    hit h = { .t = far };
    return set_trace(w.place, o, d, 1e-3f, &h, true) || set_trace(w.people, o, d, 1e-3f, &h, true);
}
#endif
