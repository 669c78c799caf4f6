/* Rays in lanes: rays_ref.c's arithmetic with a lane a ray. The includer says what lanes are: F and I vectors of floats and int32, M of truths; splat, splat_i, load, load_i, store, store_i; less(a, b),
 * negative(i); both, but(a, not b), either; any; pick, pick_i(m, a, b); truths (of an I, by its sign) and signs (the way back); real, whole (towards 0); look(i32 table, index), look_bytes(table, index: four
 * bytes from there, no two of which need be read). No variant is built from this file alone. */
#include "runtime/kernels/rays.h"

typedef struct { F o[3], d[3]; } line;
typedef struct { F p[3]; I i[3], brick; } spot;

INLINE F clamped(F v, F lo, F hi) { v = pick(less(v, lo), lo, v); return pick(less(hi, v), hi, v); }
INLINE F near_step(F f) { return clamped(f * splat(0.875f), splat(ORL_RAY_LEAST), splat(ORL_RAY_MOST)); }

INLINE void go_to(const orl_scene *s, const line *l, F t, spot *at)
{
    for (int a = 0; a < 3; a++) {
        at->p[a] = clamped(l->o[a] + t * l->d[a], splat(0), splat((float)(8 * s->nb[a]) - 1 / 1024.0f));
        at->i[a] = whole(at->p[a]);
    }
    at->brick = look(s->bmap, ((at->i[2] >> 3) * splat_i((int32_t)s->nb[1]) + (at->i[1] >> 3)) * splat_i((int32_t)s->nb[0]) + (at->i[0] >> 3));
}

/* Between a row's first two bytes. */
INLINE F along(I row, F f)
{
    I a = row << 24 >> 24, b = row << 16 >> 24;
    return real(a) + real(b - a) * f;
}

/* Of lanes without a brick: anything. */
INLINE F sample(const orl_scene *s, const spot *at)
{
    I brick = pick_i(negative(at->brick), splat_i(0), at->brick);
    I v = brick * splat_i(ORL_BRICK_VERTS) + (at->i[0] & splat_i(7)) + (at->i[1] & splat_i(7)) * splat_i(9) + (at->i[2] & splat_i(7)) * splat_i(81);
    F f[3];
    for (int a = 0; a < 3; a++) f[a] = at->p[a] - real(at->i[a]);
    F a0 = along(look_bytes(s->sdf, v), f[0]), a1 = along(look_bytes(s->sdf + 9, v), f[0]), a2 = along(look_bytes(s->sdf + 81, v), f[0]), a3 = along(look_bytes(s->sdf + 90, v), f[0]);
    F b0 = a0 + (a1 - a0) * f[1], b1 = a2 + (a3 - a2) * f[1];
    return (b0 + (b1 - b0) * f[2]) * splat(1.0f / ORL_SDF_UNIT);
}

/* Between free lo and solid hi; lanes that did not hit have 0, 1, 0, -1. */
INLINE F refined(const orl_scene *s, const line *l, M hit, F lo, F flo, F hi, F fhi)
{
    F last = hi, t = hi;
    M busy = hit;
    spot at;
    for (int j = 0; j < ORL_RAY_REFINES && any(busy); j++) {
        t = pick(busy, lo + (hi - lo) * flo / (flo - fhi), t);
        go_to(s, l, t, &at);
        F f = pick(negative(at.brick), splat(ORL_RAY_FREE), sample(s, &at));
        busy = but(busy, both(less(f, splat(ORL_RAY_FINE)), less(splat(-ORL_RAY_FINE), f)));
        M up = both(busy, less(splat(0), f)), down = but(busy, up);
        lo = pick(up, t, lo);
        flo = pick(up, f, flo);
        hi = pick(down, t, hi);
        fhi = pick(down, f, fhi);
    }
    go_to(s, l, t, &at);
    return pick(negative(at.brick), last, t);
}

INLINE void march(const orl_scene *s, int refine, orl_rays *r, int k)
{
    line l;
    F inv[3], t = splat(0), prev_t = t, prev = splat(1), end = load(r->end + k), lo = t, flo = prev, hi = t, fhi = splat(-1);
    M up[3], none = less(t, t), inside = none, entered = none, far = none, hit = none, cut = none, active = less(t, end), within = truths(load_i(r->within + k));
    for (int a = 0; a < 3; a++) {
        l.o[a] = pick(active, load(r->o[a] + k), splat(0));
        l.d[a] = pick(active, load(r->d[a] + k), splat(1));
        inv[a] = splat(1) / l.d[a];
        up[a] = less(splat(0), l.d[a]);
    }
    for (int n = 0; n < ORL_RAY_STEPS && any(active); n++) {
        spot at;
        go_to(s, &l, t, &at);
        M empty = negative(at.brick), full = but(active, empty);
        F f = splat(ORL_RAY_FREE), out = t;
        if (any(full)) f = sample(s, &at);
        M back = both(far, both(active, either(empty, less(f + prev, t - prev_t)))), leaves = but(both(active, empty), back);
        full = but(full, back);
        M free = both(full, less(splat(0), f)), deep = but(full, free);
        if (n == 0) inside = both(within, deep);
        M hits = but(deep, inside);
        deep = both(deep, inside);
        lo = pick(hits, prev_t, lo);
        flo = pick(hits, prev, flo);
        hi = pick(hits, t, hi);
        fhi = pick(hits, f, fhi);
        cut = either(cut, both(hits, both(entered, less(f, splat(ORL_RAY_CUT)))));
        hit = either(hit, hits);
        active = but(active, hits);
        if (any(leaves)) {
            for (int a = 0; a < 3; a++) {
                I b = at.i[a] >> 3;
                F e = (real((b + pick_i(up[a], -at.brick, at.brick + splat_i(1))) << 3) - l.o[a]) * inv[a];
                out = a == 0 ? e : pick(less(e, out), e, out);
            }
            out = pick(less(t, out), out, t) + splat(ORL_RAY_NUDGE);
        }
        F dt = t - prev_t, fall = prev - f, step = near_step(f), sum = dt + fall;
        M known = both(free, both(less(splat(0), dt), less(splat(0), sum)));
        F touch = (f * splat(2)) * dt / sum * splat(0.875f), leap = pick(less(splat(0), fall), f * dt / fall * splat(1.125f), splat(ORL_RAY_LEAP));
        touch = pick(less(splat(ORL_RAY_FAR), touch), splat(ORL_RAY_FAR), touch);
        leap = pick(less(splat(ORL_RAY_LEAP), leap), splat(ORL_RAY_LEAP), leap);
        M farther = both(known, less(step, touch));
        step = pick(farther, touch, step);
        M leaps = both(known, less(step, leap));
        step = pick(leaps, leap, step);
        M fresh = either(leaves, deep);
        F next = pick(free, t + step, pick(leaves, out, pick(back, prev_t + near_step(prev), pick(deep, t + splat(0.5f), t))));
        prev = pick(free, pick(less(splat(ORL_RAY_FLAT), f), f, splat(ORL_RAY_FLAT)), pick(fresh, splat(1), prev));
        prev_t = pick(free, t, pick(fresh, next, prev_t));
        inside = but(inside, either(free, leaves));
        entered = but(either(entered, leaves), full);
        far = but(farther, leaps);
        t = next;
        active = both(active, less(t, end));
    }
    F found = refine && any(hit) ? refined(s, &l, hit, lo, flo, hi, fhi) : hi;
    spot at;
    go_to(s, &l, found, &at);
    store(r->t + k, pick(hit, found, splat(-1)));
    store_i(r->brick + k, pick_i(hit, at.brick, splat_i(-1)));
    store_i(r->cut + k, signs(cut));
}
