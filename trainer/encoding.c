/* The two position encodings (encoding.h): addresses, interpolation, its reverse, Adam. */
#include "trainer/encoding.h"
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include "oriel/parallel.h"

const char *const ENC_NAME[ENC_KINDS] = { "ours", "textbook" };

enum { TEXT_ENTRIES = 1 << 19, TILES = 1 << 13, OUR_LEVELS = 4, CHUNK = 256, AHEAD = 16, ADAM_WORDS = 64 };
static const float OUR_CELL[OUR_LEVELS] = { 1, 2.5f, 6, 16 };
static const uint32_t PRIME[3] = { 1, 2654435761u, 805459861u };

typedef struct { uint32_t i[4]; float w[4]; } our_cell;
typedef struct { uint32_t i[8]; float f[3]; } text_cell;

/* Large pages where the system has them: positions are scattered, and small pages would cost a table walk each. */
static void *map(size_t bytes)
{
    void *p = mmap(NULL, bytes, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS | MAP_NORESERVE, -1, 0);
    if (p == MAP_FAILED) return NULL;
    madvise(p, bytes, MADV_HUGEPAGE);
    return p;
}

/* Tables of one level; returns its units. */
static size_t level_init(encoding *e, enc_level *v, const int dims[3], float cell, int *ok)
{
    int our = e->kind == ENC_OURS, shift = our ? 2 : 0, t[3];
    size_t count = 1;
    v->scale = 1 / cell;
    for (int a = 0; a < 3; a++) {
        int top = (int)ceilf((float)dims[a] / cell);
        v->n[a] = ((top < 1 ? 1 : top) + 1 + 3) & ~3;
        v->top[a] = (float)(v->n[a] - 2) + 0.9999f;
        t[a] = v->n[a] >> shift;
        count *= (size_t)t[a];
    }
    size_t cap = our ? TILES : TEXT_ENTRIES;
    v->mask = count > cap ? (uint32_t)(our ? TILES * GRID_TILE : TEXT_ENTRIES) - 1 : 0;
    for (int a = 0; a < 3; a++) {
        v->axis[a] = malloc((size_t)v->n[a] * sizeof(uint32_t));
        if (!v->axis[a]) { *ok = 0; return 0; }
        uint32_t step = v->mask ? PRIME[a] : a == 0 ? 1 : a == 1 ? (uint32_t)t[0] : (uint32_t)(t[0] * t[1]);
        for (int i = 0; i < v->n[a]; i++)
            v->axis[a][i] = our ? ((uint32_t)(i >> 2) * step) << 6 | (uint32_t)(i & 3) << 2 * a : (uint32_t)i * step;
    }
    size_t used = count < cap ? count : cap;
    return our ? used * GRID_TILE : (used + 3) / 4;
}

orl_err enc_init(encoding *e, enc_kind kind, const int dims[3], uint64_t seed, int threads)
{
    memset(e, 0, sizeof *e);
    e->kind = kind;
    e->threads = threads < GRID_THREADS ? threads : GRID_THREADS;
    e->levels = kind == ENC_OURS ? OUR_LEVELS : 16;
    int longest = 0, ok = 1;
    for (int a = 0; a < 3; a++) longest = dims[a] > longest ? dims[a] : longest;
    /* The textbook's 16 levels grow by one factor from 16 cells along the box to its fine cells. */
    float growth = powf((float)longest / 16, 1.0f / 15);
    for (int l = 0; l < e->levels; l++) {
        float cell = kind == ENC_OURS ? OUR_CELL[l] : (float)longest / 16 / powf(growth, (float)l);
        e->level[l].first = e->units;
        e->units += (level_init(e, &e->level[l], dims, cell, &ok) + 63) & ~(size_t)63;
    }
    e->keep = kind == ENC_OURS ? OUR_LEVELS * sizeof(our_cell) : 16 * sizeof(text_cell);
    ok = ok && (e->p = map(e->units * sizeof(v8)));
    if (ok && threads) ok = (e->mv = map(e->units * 2 * sizeof(v8))) != NULL;
    for (int k = 0; ok && k < e->threads; k++) ok = (e->g[k] = map(e->units * sizeof(v8))) && (e->dirty[k] = map(e->units / 8));
    if (!ok) {
        enc_free(e);
        return orl_fail(ORL_E_MEMORY, "no memory for an encoding of %zu units", e->units);
    }
    rng r = rng_make(seed, 0xe5c, 0);
    for (size_t i = 0; threads && i < e->units * 8; i++) ((float *)e->p)[i] = 1e-4f * (2 * rng_f(&r) - 1);
    return ORL_OK;
}

void enc_free(encoding *e)
{
    if (e->p) munmap(e->p, e->units * sizeof(v8));
    if (e->mv) munmap(e->mv, e->units * 2 * sizeof(v8));
    for (int k = 0; k < GRID_THREADS; k++) {
        if (e->g[k]) munmap(e->g[k], e->units * sizeof(v8));
        if (e->dirty[k]) munmap(e->dirty[k], e->units / 8);
    }
    for (int l = 0; l < ENC_LEVELS; l++) for (int a = 0; a < 3; a++) free(e->level[l].axis[a]);
    memset(e, 0, sizeof *e);
}

static inline __attribute__((always_inline)) void locate(const enc_level *v, const float x[3], int i[3], float f[3])
{
    for (int a = 0; a < 3; a++) {
        float t = x[a] * v->scale;
        t = t > 0 ? (t < v->top[a] ? t : v->top[a]) : 0;
        i[a] = (int)t;
        f[a] = t - (float)i[a];
    }
}

static inline __attribute__((always_inline)) uint32_t join(uint32_t x, uint32_t y, uint32_t z, const int hashed, uint32_t mask) { return hashed ? (x ^ y ^ z) & mask : x + y + z; }

/* The tetrahedron of the cube's six that holds the point: from the cell's first vertex along the axis of the largest fraction, then the middle one, then the smallest. */
static inline __attribute__((always_inline)) void our_find(const enc_level *v, const float x[3], our_cell *c, const int hashed)
{
    int i[3];
    float f[3];
    locate(v, x, i, f);
    const uint32_t *px = v->axis[0] + i[0], *py = v->axis[1] + i[1], *pz = v->axis[2] + i[2];
    uint32_t x0 = px[0], x1 = px[1], y0 = py[0], y1 = py[1], z0 = pz[0], z1 = pz[1];
    int xy = f[0] >= f[1], yz = f[1] >= f[2], xz = f[0] >= f[2], yx = !xy, zy = !yz, zx = !xz;
    float top = fmaxf(fmaxf(f[0], f[1]), f[2]), low = fminf(fminf(f[0], f[1]), f[2]), mid = f[0] + f[1] + f[2] - top - low;
    c->i[0] = join(x0, y0, z0, hashed, v->mask);
    c->i[1] = join((xy & xz) ? x1 : x0, (yx & yz) ? y1 : y0, (zx & zy) ? z1 : z0, hashed, v->mask);
    c->i[2] = join((yx & zx) ? x0 : x1, (xy & zy) ? y0 : y1, (xz & yz) ? z0 : z1, hashed, v->mask);
    c->i[3] = join(x1, y1, z1, hashed, v->mask);
    c->w[0] = 1 - top; c->w[1] = top - mid; c->w[2] = mid - low; c->w[3] = low;
}

static inline __attribute__((always_inline)) void our_level(const encoding *e, int l, int n, const float (*x)[3], float *out, our_cell *keep, const int hashed)
{
    const enc_level *v = &e->level[l];
    const v8 *p = e->p + v->first;
    for (int s = 0; s < n; s++) {
        our_find(v, x[s], &keep[s], hashed);
        for (int k = 0; k < 4; k++) __builtin_prefetch(&p[keep[s].i[k]]);
    }
    for (int s = 0; s < n; s++) {
        const our_cell *c = &keep[s];
        *(v8 *)(out + (size_t)s * ENC_WIDTH + (size_t)(8 * l)) = c->w[0] * p[c->i[0]] + c->w[1] * p[c->i[1]] + c->w[2] * p[c->i[2]] + c->w[3] * p[c->i[3]];
    }
}

static inline __attribute__((always_inline)) void text_find(const enc_level *v, const float x[3], text_cell *c, const int hashed)
{
    int i[3];
    locate(v, x, i, c->f);
    const uint32_t *px = v->axis[0] + i[0], *py = v->axis[1] + i[1], *pz = v->axis[2] + i[2];
    for (int k = 0; k < 8; k++) c->i[k] = join(px[k & 1], py[k >> 1 & 1], pz[k >> 2], hashed, v->mask);
}

static inline __attribute__((always_inline)) void weights8(const float f[3], float w[8])
{
    float x1 = f[0], x0 = 1 - x1, y1 = f[1], y0 = 1 - y1, z1 = f[2], z0 = 1 - z1, a = y0 * z0, b = y1 * z0, c = y0 * z1, d = y1 * z1;
    w[0] = x0 * a; w[1] = x1 * a; w[2] = x0 * b; w[3] = x1 * b; w[4] = x0 * c; w[5] = x1 * c; w[6] = x0 * d; w[7] = x1 * d;
}

typedef float v2 __attribute__((vector_size(8)));

static inline __attribute__((always_inline)) void text_level(const encoding *e, int l, int n, const float (*x)[3], float *out, text_cell *keep, const int hashed)
{
    const enc_level *v = &e->level[l];
    const v2 *p = (const v2 *)(e->p + v->first);
    for (int s = 0; s < n; s++) {
        text_find(v, x[s], &keep[s], hashed);
        for (int k = 0; k < 8; k++) __builtin_prefetch(&p[keep[s].i[k]]);
    }
    for (int s = 0; s < n; s++) {
        const text_cell *c = &keep[s];
        float w[8];
        weights8(c->f, w);
        v2 a = w[0] * p[c->i[0]] + w[1] * p[c->i[1]], b = w[2] * p[c->i[2]] + w[3] * p[c->i[3]];
        a += w[4] * p[c->i[4]] + w[5] * p[c->i[5]];
        b += w[6] * p[c->i[6]] + w[7] * p[c->i[7]];
        *(v2 *)(out + (size_t)s * ENC_WIDTH + (size_t)(2 * l)) = a + b;
    }
}

/* Level after level over a chunk of positions: a level's hot part stays in cache, and the loop has one shape. */
void enc_forward(const encoding *e, int n, const float (*x)[3], float *out, void *keep)
{
    for (int b = 0; b < n; b += CHUNK) {
        int m = n - b < CHUNK ? n - b : CHUNK;
        for (int l = 0; l < e->levels; l++) {
            float *o = out + (size_t)b * ENC_WIDTH;
            char *k = (char *)keep + (size_t)b * e->keep + (size_t)(l * m) * (e->keep / (size_t)e->levels);
            int hashed = e->level[l].mask != 0;
            if (e->kind == ENC_OURS) {
                if (hashed) our_level(e, l, m, x + b, o, (our_cell *)k, 1);
                else our_level(e, l, m, x + b, o, (our_cell *)k, 0);
            } else {
                if (hashed) text_level(e, l, m, x + b, o, (text_cell *)k, 1);
                else text_level(e, l, m, x + b, o, (text_cell *)k, 0);
            }
        }
    }
}

static void our_back(v8 *g, uint64_t *dirty, int l, int n, const our_cell *keep, const float *dout)
{
    for (int s = 0; s < n; s++) {
        const our_cell *c = &keep[s];
        if (s + AHEAD < n) for (int k = 0; k < 4; k++) __builtin_prefetch(&g[keep[s + AHEAD].i[k]], 1);
        v8 d = *(const v8 *)(dout + (size_t)s * ENC_WIDTH + (size_t)(8 * l));
        for (int k = 0; k < 4; k++) {
            g[c->i[k]] += c->w[k] * d;
            dirty[c->i[k] >> 6] |= 1ull << (c->i[k] & 63);
        }
    }
}

static void text_back(v2 *g, uint64_t *dirty, int l, int n, const text_cell *keep, const float *dout)
{
    for (int s = 0; s < n; s++) {
        const text_cell *c = &keep[s];
        if (s + AHEAD < n) for (int k = 0; k < 8; k++) __builtin_prefetch(&g[keep[s + AHEAD].i[k]], 1);
        float w[8];
        v2 d = *(const v2 *)(dout + (size_t)s * ENC_WIDTH + (size_t)(2 * l));
        weights8(c->f, w);
        for (int k = 0; k < 8; k++) {
            g[c->i[k]] += w[k] * d;
            dirty[c->i[k] >> 8] |= 1ull << (c->i[k] >> 2 & 63);
        }
    }
}

void enc_backward(encoding *e, int thread, int n, const void *keep, const float *dout)
{
    for (int b = 0; b < n; b += CHUNK) {
        int m = n - b < CHUNK ? n - b : CHUNK;
        for (int l = 0; l < e->levels; l++) {
            const float *d = dout + (size_t)b * ENC_WIDTH;
            const char *k = (const char *)keep + (size_t)b * e->keep + (size_t)(l * m) * (e->keep / (size_t)e->levels);
            v8 *g = e->g[thread] + e->level[l].first;
            uint64_t *dirty = e->dirty[thread] + e->level[l].first / 64;
            if (e->kind == ENC_OURS) our_back(g, dirty, l, m, (const our_cell *)k, d);
            else text_back((v2 *)g, dirty, l, m, (const text_cell *)k, d);
        }
    }
}

typedef struct { encoding *e; float lr; size_t *visited; } adam_job;
typedef int32_t i8 __attribute__((vector_size(32)));

static inline v8 root(v8 x)
{
    float f[8] __attribute__((aligned(32)));
    *(v8 *)f = x;
    for (int i = 0; i < 8; i++) f[i] = sqrtf(f[i]);
    return *(v8 *)f;
}

/* Words [begin, end) of the bits: first a list of what was touched, then the list with its memory on the way. */
static void adam_words(void *user, int begin, int end)
{
    adam_job *job = user;
    encoding *e = job->e;
    int T = e->threads, n = 0;
    uint32_t list[ADAM_WORDS * 64];
    for (int w = begin; w < end; w++) {
        uint64_t bits = 0;
        for (int k = 0; k < T; k++) bits |= e->dirty[k][w];
        for (; bits; bits &= bits - 1) list[n++] = (uint32_t)w * 64 + (uint32_t)__builtin_ctzll(bits);
    }
    for (int i = 0; i < n; i++) {
        if (i + AHEAD < n) {
            uint32_t u = list[i + AHEAD];
            for (int k = 0; k < T; k++) __builtin_prefetch(&e->g[k][u], 1);
            __builtin_prefetch(&e->mv[u], 1);
            __builtin_prefetch(&e->p[u], 1);
        }
        uint32_t u = list[i];
        v8 d = { 0 };
        for (int k = 0; k < T; k++) {
            if (!(e->dirty[k][u >> 6] >> (u & 63) & 1)) continue;
            d += e->g[k][u];
            e->g[k][u] = (v8){ 0 };
        }
        i8 hit = d != 0;
        v8 *mv = e->mv[u], m = 0.9f * mv[0] + 0.1f * d, v = 0.99f * mv[1] + 0.01f * d * d, step = job->lr * m / (root(v) + 1e-15f);
        mv[0] = (v8)(((i8)m & hit) | ((i8)mv[0] & ~hit));
        mv[1] = (v8)(((i8)v & hit) | ((i8)mv[1] & ~hit));
        e->p[u] -= (v8)((i8)step & hit);
    }
    for (int k = 0; k < T; k++) memset(&e->dirty[k][begin], 0, (size_t)(end - begin) * sizeof(uint64_t));
    __atomic_fetch_add(job->visited, (size_t)n, __ATOMIC_RELAXED);
}

size_t enc_adam(encoding *e, float lr, int threads)
{
    size_t visited = 0;
    adam_job job = { e, lr, &visited };
    orl_parallel(threads, (int)(e->units / 64), ADAM_WORDS, adam_words, &job);
    return visited;
}
