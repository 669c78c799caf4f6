/* Rays in plain C: the specification of the other variants (rays.h). */
#include "runtime/kernels/rays.h"

typedef struct { float p[3], f; int i[3], brick; } place;

static float clamped(float v, float lo, float hi) { v = v < lo ? lo : v; return v > hi ? hi : v; }
static float near_step(float f) { return clamped(f * 0.875f, ORL_RAY_LEAST, ORL_RAY_MOST); }

static void go_to(const orl_scene *s, const orl_rays *r, int k, float t, place *at)
{
    for (int a = 0; a < 3; a++) {
        at->p[a] = clamped(r->o[a][k] + t * r->d[a][k], 0, (float)(8 * s->nb[a]) - 1 / 1024.0f);
        at->i[a] = (int)at->p[a];
    }
    at->brick = s->bmap[((size_t)(at->i[2] >> 3) * s->nb[1] + (size_t)(at->i[1] >> 3)) * s->nb[0] + (size_t)(at->i[0] >> 3)];
}

static float between(int a, int b, float f) { return (float)a + (float)(b - a) * f; }

static void sample(const orl_scene *s, place *at)
{
    const int8_t *v = s->sdf + (size_t)at->brick * ORL_BRICK_VERTS + (at->i[0] & 7) + 9 * (at->i[1] & 7) + 81 * (at->i[2] & 7);
    float f[3];
    for (int a = 0; a < 3; a++) f[a] = at->p[a] - (float)at->i[a];
    float a0 = between(v[0], v[1], f[0]), a1 = between(v[9], v[10], f[0]), a2 = between(v[81], v[82], f[0]), a3 = between(v[90], v[91], f[0]);
    float b0 = a0 + (a1 - a0) * f[1], b1 = a2 + (a3 - a2) * f[1];
    at->f = (b0 + (b1 - b0) * f[2]) * (1.0f / ORL_SDF_UNIT);
}

static float leave(const orl_rays *r, int k, const float inv[3], const place *at)
{
    float out = 0;
    for (int a = 0; a < 3; a++) {
        int b = at->i[a] >> 3;
        float e = ((float)(8 * (r->d[a][k] > 0 ? b - at->brick : b + at->brick + 1)) - r->o[a][k]) * inv[a];
        out = a == 0 || e < out ? e : out;
    }
    return out;
}

static void refine_hit(const orl_scene *s, orl_rays *r, int k, float lo, float flo, float hi, float fhi)
{
    place at;
    float last = hi, t = hi;
    for (int j = 0; j < ORL_RAY_REFINES; j++) {
        t = lo + (hi - lo) * flo / (flo - fhi);
        go_to(s, r, k, t, &at);
        at.f = ORL_RAY_FREE;
        if (at.brick >= 0) sample(s, &at);
        if (at.f < ORL_RAY_FINE && at.f > -ORL_RAY_FINE) break;
        if (at.f > 0) { lo = t; flo = at.f; } else { hi = t; fhi = at.f; }
    }
    go_to(s, r, k, t, &at);
    if (at.brick < 0) { t = last; go_to(s, r, k, t, &at); }
    r->t[k] = t;
    r->brick[k] = at.brick;
}

static void march(const orl_scene *s, int refine, orl_rays *r, int k)
{
    float t = 0, prev_t = 0, prev = 1, end = r->end[k], inv[3];
    int inside = 0, entered = 0, far = 0;
    r->t[k] = -1;
    r->brick[k] = -1;
    r->cut[k] = 0;
    for (int a = 0; a < 3; a++) inv[a] = 1 / r->d[a][k];
    for (int n = 0; n < ORL_RAY_STEPS && t < end; n++) {
        place at;
        go_to(s, r, k, t, &at);
        if (at.brick >= 0) sample(s, &at);
        if (far && (at.brick < 0 || at.f + prev < t - prev_t)) {
            t = prev_t + near_step(prev);
            far = 0;
            continue;
        }
        if (at.brick < 0) {
            float out = leave(r, k, inv, &at);
            t = (out > t ? out : t) + ORL_RAY_NUDGE;
            prev = 1;
            prev_t = t;
            inside = 0;
            entered = 1;
            continue;
        }
        if (n == 0 && at.f <= 0) inside = r->within[k];
        if (at.f <= 0 && !inside) {
            r->t[k] = t;
            r->brick[k] = at.brick;
            r->cut[k] = entered && at.f < ORL_RAY_CUT ? -1 : 0;
            if (refine) refine_hit(s, r, k, prev_t, prev, t, at.f);
            return;
        }
        entered = far = 0;
        if (at.f <= 0) {
            t += 0.5f;
            prev = 1;
            prev_t = t;
            continue;
        }
        float dt = t - prev_t, fall = prev - at.f, step = near_step(at.f);
        inside = 0;
        if (dt > 0 && dt + fall > 0) {
            float touch = (2 * at.f) * dt / (dt + fall) * 0.875f, leap = fall > 0 ? at.f * dt / fall * 1.125f : ORL_RAY_LEAP;
            touch = touch > ORL_RAY_FAR ? ORL_RAY_FAR : touch;
            leap = leap > ORL_RAY_LEAP ? ORL_RAY_LEAP : leap;
            if (touch > step) { step = touch; far = 1; }
            if (leap > step) { step = leap; far = 0; }
        }
        prev = at.f > ORL_RAY_FLAT ? at.f : ORL_RAY_FLAT;
        prev_t = t;
        t += step;
    }
}

void orl_rays_march_ref(const orl_scene *s, int n, int refine, orl_rays *r)
{
    for (int k = 0; k < n; k++) march(s, refine, r, k);
}
