/* Packed sections: SCENE.md 5 in code (numbers in brackets cite it).
 *
 * A lattice (a brick's distances, a texture, light vertices, an image) is walked from coarse to fine: each vertex is predicted from the ones around it that are known already, and what is left is rounded to a step and
 * coded. Writer and reader walk with the same code, and the writer predicts from what the reader will have, so that errors do not add up and writing what was read gives the same bytes.
 * Vertices that a brick shares with one before it are taken from there. */
#include "formats/pack.h"
#include <stdlib.h>
#include <string.h>

/* ---- range coder [5.1] */

typedef struct { uint16_t fast, slow; } prob;

typedef struct {
    uint32_t range;
    /* reading */
    uint32_t code;
    const uint8_t *in, *end;
    size_t over;                    /* bytes asked for beyond the end */
    /* writing */
    uint64_t low, pending;
    uint8_t cache, *out;
    size_t n, cap;
    int failed;
} coder;

enum { RATE_FAST = 4, RATE_SLOW = 7, RANGE_LEAST = 1 << 24 };

static void prob_reset(prob *p, size_t n) { for (size_t i = 0; i < n; i++) p[i] = (prob){ 1 << 15, 1 << 15 }; }

static void put_byte(coder *c, uint8_t b)
{
    if (c->n == c->cap) {
        size_t cap = 2 * c->cap + 4096;
        uint8_t *more = c->failed ? NULL : realloc(c->out, cap);
        if (!more) { c->failed = 1; return; }
        c->out = more;
        c->cap = cap;
    }
    c->out[c->n++] = b;
}

/* The top byte of low leaves once no carry can reach it any more. */
static void shift_low(coder *c)
{
    if (c->low < 0xff000000u || c->low >> 32) {
        uint8_t carry = (uint8_t)(c->low >> 32);
        put_byte(c, (uint8_t)(c->cache + carry));
        for (; c->pending > 1; c->pending--) put_byte(c, (uint8_t)(0xff + carry));
        c->pending = 0;
        c->cache = (uint8_t)(c->low >> 24);
    }
    c->pending++;
    c->low = (c->low & 0xffffff) << 8;
}

static inline uint8_t get_byte(coder *c)
{
    if (c->in < c->end) return *c->in++;
    c->over++;
    return 0;
}

static void write_start(coder *c) { *c = (coder){ .range = UINT32_MAX, .pending = 1 }; }
static void write_end(coder *c) { for (int i = 0; i < 5; i++) shift_low(c); }

static void read_start(coder *c, const uint8_t *bytes, size_t n)
{
    *c = (coder){ .range = UINT32_MAX, .in = bytes, .end = bytes + n };
    for (int i = 0; i < 5; i++) c->code = c->code << 8 | get_byte(c);
}

static int read_ended(const coder *c) { return c->in == c->end && !c->over; }

/* One bit under p; `writing` is a constant where it is inlined. */
static inline __attribute__((always_inline)) int code_bit(coder *c, prob *p, int bit, const int writing)
{
    uint32_t bound = (c->range >> 15) * ((uint32_t)(p->fast + p->slow) >> 2);       /* never 0, nor all: slow stays within 127 .. 65408 */
    if (!writing) bit = c->code < bound;
    if (bit) {
        c->range = bound;
        p->fast += (uint16_t)((65535 - p->fast) >> RATE_FAST);
        p->slow += (uint16_t)((65535 - p->slow) >> RATE_SLOW);
    } else {
        c->range -= bound;
        if (writing) c->low += bound; else c->code -= bound;
        p->fast -= p->fast >> RATE_FAST;
        p->slow -= p->slow >> RATE_SLOW;
    }
    while (__builtin_expect(c->range < RANGE_LEAST, 0)) {
        c->range <<= 8;
        if (writing) shift_low(c); else c->code = c->code << 8 | get_byte(c);
    }
    return bit;
}

static inline int even_bit(coder *c, int bit, const int writing)
{
    prob p = { 1 << 15, 1 << 15 };
    return code_bit(c, &p, bit, writing);
}

/* ---- which bricks and textures there are [5.2] */

enum { MAP_CONTEXTS = 512, SKIN_CONTEXTS = 27 };

static size_t place_at(const orl_scene *s, const int q[3]) { return ((size_t)q[2] * s->nb[1] + (size_t)q[1]) * s->nb[0] + (size_t)q[0]; }

/* Brick at a place, -1 where there is none, and outside. */
static inline int32_t brick_at(const orl_scene *s, const int32_t *bmap, const int q[3])
{
    for (int a = 0; a < 3; a++) if (q[a] < 0 || q[a] >= (int)s->nb[a]) return -1;
    int32_t b = bmap[place_at(s, q)];
    return b < 0 ? -1 : b;
}

static inline int32_t brick_beside(const orl_scene *s, const int32_t *bmap, const int q[3], int dx, int dy, int dz) { return brick_at(s, bmap, (const int[3]){ q[0] + dx, q[1] + dy, q[2] + dz }); }

/* bmap: of the writer; of the reader, filled place by place with brick numbers or -1. Returns how many bricks there are; stops where the bytes do. */
static inline __attribute__((always_inline)) uint32_t code_map(coder *c, const orl_scene *s, const int32_t *bmap, int32_t *filled, const int writing)
{
    static const int8_t NEAR[9][3] = { { -1, 0, 0 }, { 0, -1, 0 }, { 0, 0, -1 }, { -1, -1, 0 }, { 1, -1, 0 }, { -1, 0, -1 }, { 1, 0, -1 }, { 0, -1, -1 }, { 0, 1, -1 } };
    prob has[MAP_CONTEXTS];
    prob_reset(has, MAP_CONTEXTS);
    uint32_t n = 0;
    int q[3];
    for (q[2] = 0; q[2] < (int)s->nb[2]; q[2]++)
        for (q[1] = 0; q[1] < (int)s->nb[1] && !c->over; q[1]++)
            for (q[0] = 0; q[0] < (int)s->nb[0]; q[0]++) {
                int around = 0;
                for (int k = 0; k < 9; k++) around |= (brick_beside(s, bmap, q, NEAR[k][0], NEAR[k][1], NEAR[k][2]) >= 0) << k;
                int bit = code_bit(c, &has[around], writing && bmap[place_at(s, q)] >= 0, writing);
                if (!writing) filled[place_at(s, q)] = bit ? (int32_t)n : -1;
                n += (uint32_t)bit;
            }
    return n;
}

/* Faces of each brick, six bits: by those of the bricks before it along x, y, z. Brick by brick in the order of places. Returns bricks that had any. */
static inline __attribute__((always_inline)) uint32_t code_skin(coder *c, const orl_scene *s, const int32_t *bmap, const uint32_t *skin, uint32_t *filled, uint32_t *textures, const int writing)
{
    prob has[ORL_SKIN_FACES][SKIN_CONTEXTS];
    prob_reset(has[0], ORL_SKIN_FACES * SKIN_CONTEXTS);
    uint32_t n = 0, first = 0;
    int q[3];
    for (q[2] = 0; q[2] < (int)s->nb[2]; q[2]++)
        for (q[1] = 0; q[1] < (int)s->nb[1] && !c->over; q[1]++)
            for (q[0] = 0; q[0] < (int)s->nb[0]; q[0]++) {
                int32_t b = bmap[place_at(s, q)], near[3] = { brick_beside(s, bmap, q, -1, 0, 0), brick_beside(s, bmap, q, 0, -1, 0), brick_beside(s, bmap, q, 0, 0, -1) };
                if (b < 0) continue;
                unsigned faces = 0;
                for (int f = 0; f < ORL_SKIN_FACES; f++) {
                    int around = 0;
                    for (int k = 0; k < 3; k++) around = 3 * around + (near[k] < 0 ? 0 : 1 + (int)(orl_skin_mask(skin[near[k]]) >> f & 1));
                    faces |= (unsigned)code_bit(c, &has[f][around], writing && orl_skin_mask(skin[b]) >> f & 1, writing) << f;
                }
                if (!writing) filled[b] = first << 6 | faces;
                first += (uint32_t)__builtin_popcount(faces);
                n += faces != 0;
            }
    *textures = first;
    return n;
}

static orl_err finish(coder *c, uint8_t **bytes, size_t *n)
{
    write_end(c);
    if (c->failed) { free(c->out); return orl_fail(ORL_E_MEMORY, "no memory to pack a scene"); }
    *bytes = c->out;
    *n = c->n;
    return ORL_OK;
}

orl_err pack_index(const orl_scene *s, uint8_t **map, size_t *map_bytes, uint8_t **skin, size_t *skin_bytes)
{
    coder c;
    uint32_t textures;
    write_start(&c);
    code_map(&c, s, s->bmap, NULL, 1);
    orl_err e = finish(&c, map, map_bytes);
    if (e) return e;
    write_start(&c);
    code_skin(&c, s, s->bmap, s->skin, NULL, &textures, 1);
    return finish(&c, skin, skin_bytes);
}

/* Minus the Chebyshev distance to the nearest brick: one sweep forward, one back, each over the 13 neighbours behind it, is exact for this metric. */
static void distances(const orl_scene *s, int32_t *bmap)
{
    enum { FAR = -127 };
    size_t places = (size_t)s->nb[0] * s->nb[1] * s->nb[2];
    for (size_t i = 0; i < places; i++) if (bmap[i] < 0) bmap[i] = FAR;
    for (int back = 0; back < 2; back++)
        for (size_t i = 0; i < places; i++) {
            size_t at = back ? places - 1 - i : i;
            if (bmap[at] >= -1) continue;
            int q[3] = { (int)(at % s->nb[0]), (int)(at / s->nb[0] % s->nb[1]), (int)(at / s->nb[0] / s->nb[1]) }, lo[3], hi[3];
            for (int a = 0; a < 3; a++) { lo[a] = q[a] ? -1 : 0; hi[a] = q[a] + 1 < (int)s->nb[a]; }
            int32_t best = bmap[at];
            for (int z = back ? 0 : lo[2]; z <= (back ? hi[2] : 0); z++)
                for (int y = lo[1]; y <= hi[1]; y++)
                    for (int x = lo[0]; x <= hi[0]; x++) {
                        int32_t d = bmap[at + ((size_t)z * s->nb[1] + (size_t)y) * s->nb[0] + (size_t)x];
                        d = d >= 0 ? -1 : d - 1;
                        if (d > best) best = d;
                    }
            bmap[at] = best;
        }
}

orl_err unpack_index(const orl_scene *s, const uint8_t *map, size_t map_bytes, const uint8_t *skin_from, size_t skin_bytes, const char *name, int32_t *bmap, uint32_t *skin, uint32_t *textures)
{
    size_t places = (size_t)s->nb[0] * s->nb[1] * s->nb[2];
    coder c;
    for (size_t i = 0; i < places; i++) bmap[i] = -1;
    read_start(&c, map, map_bytes);
    uint32_t n = code_map(&c, s, bmap, bmap, 0);
    if (!read_ended(&c)) return orl_fail(ORL_E_FORMAT, "%s: section PMAP: does not end where its bytes do", name);
    if (n != s->nbricks) return orl_fail(ORL_E_RANGE, "%s: section PMAP: %u bricks, HEAD has %u", name, n, s->nbricks);
    read_start(&c, skin_from, skin_bytes);
    n = code_skin(&c, s, bmap, skin, skin, textures, 0);
    if (!read_ended(&c)) return orl_fail(ORL_E_FORMAT, "%s: section PSKN: does not end where its bytes do", name);
    if (n != s->nbricks) return orl_fail(ORL_E_RANGE, "%s: section PSKN: a brick has no texture", name);
    distances(s, bmap);
    return ORL_OK;
}

/* ---- lattices [5.3] */

enum { LEVELS = 7, AROUND = 8, BESIDE = 4, UNARY = 16, ESCAPE = 8, MAG = 3, ORDERED = 4, SHARED = 27 };

/* Channels are coded in order. Those from place `second` on have the second step and probabilities; those from `led` on take the size and sign of the one before for a hint, and where `lead` is set they are expected
 * to depart from their neighbours as it did. */
static const struct {
    uint16_t side[3], top;          /* vertices along each axis; stride of the coarsest, a power of two */
    uint8_t channels, sign;         /* sign: 128 where values are int8, flips them into 0 .. 255 */
    uint8_t finer;                  /* step of each coarser level, in quarters of the next finer's */
    uint8_t second, led, lead, order[ORDERED];
} KINDS[ORL_PACKED] = {
    [ORL_PACK_SDF] = { { 9, 9, 9 }, 8, 1, 128, 3, 1, 1, 0, { 0 } },
    [ORL_PACK_ALBEDO] = { { 17, 17, 1 }, 16, 3, 0, 3, 1, 1, 1, { 1, 0, 2 } },
    [ORL_PACK_LITE] = { { 3, 3, 3 }, 2, ORL_LITE_BYTES, 0, 2, 1, 2, 1, { 0 } },
    [ORL_PACK_SHADOW] = { { 3, 3, 3 }, 2, ORL_SHADOW_DIM, 128, 2, ORL_SHADOW_DIM, 1, 0, { 0 } },
    [ORL_PACK_GROUND] = { { ORL_GROUND_SIDE, ORL_GROUND_SIDE, 1 }, 32, 3, 0, 3, 1, 1, 1, { 1, 0, 2 } },
    [ORL_PACK_BACK] = { { ORL_BACK_COLS, ORL_BACK_ROWS, 1 }, 32, 4, 0, 3, 2, 2, 1, { 3, 1, 0, 2 } },
};

/* A vertex in the order of the walk. Offsets in values; of the coarsest level 0 where the lattice ends. */
typedef struct {
    uint16_t at;
    uint8_t level, axes, befores;
    int32_t back[3], ahead[3];      /* along the axes that it is between two vertices of: the vertices; the one behind twice where there is none ahead */
    int32_t before[3];              /* of its level, coded before it */
} visit;

typedef struct {
    struct { prob zero[2][LEVELS][AROUND][BESIDE], sign[2][3], more[2][4][UNARY], escape[2][ESCAPE]; } p;
    int kind, nodes, channels, order[ORL_LITE_BYTES], step[LEVELS][2], far;
    visit *walk;                    /* [nodes] */
    uint8_t *known, *mag;           /* [nodes], [nodes][channels]: taken from a block before; size of what was coded, MAG at most */
} lattice;

static int block_nodes(int kind) { return KINDS[kind].side[0] * KINDS[kind].side[1] * KINDS[kind].side[2]; }

/* Coarse to fine; of a level first the vertices between two along one axis, then two, then three. */
static void plan(lattice *l)
{
    const uint16_t *side = KINDS[l->kind].side;
    int level = 0, n = 0, C = l->channels, stride[3] = { C, C * side[0], C * side[0] * side[1] };
    for (int s = KINDS[l->kind].top; s; s >>= 1, level++)
        for (int odd = level ? 1 : 0; odd <= (level ? 3 : 0); odd++)
            for (int at = 0; at < l->nodes; at++) {
                int x[3] = { at % side[0], at / side[0] % side[1], at / side[0] / side[1] }, between = 0, on = 1;
                for (int a = 0; a < 3; a++) {
                    on &= x[a] % s == 0;
                    between += level && x[a] / s & 1;
                }
                if (!on || between != odd) continue;
                visit v = { .at = (uint16_t)at, .level = (uint8_t)level };
                for (int a = 0; a < 3; a++) {
                    int d = s * stride[a], more = x[a] + s < side[a];
                    if (level && x[a] >= 2 * s) v.before[v.befores++] = -2 * d;
                    if (level && !(x[a] / s & 1)) continue;
                    v.back[v.axes] = level || x[a] ? -d : 0;
                    v.ahead[v.axes++] = more ? d : level ? -d : 0;
                }
                l->walk[n++] = v;
            }
}

static orl_err lattice_make(lattice *l, int kind, const orl_pack_step *step)
{
    int nodes = block_nodes(kind), channels = KINDS[kind].channels, levels = 0;
    *l = (lattice){ .kind = kind, .nodes = nodes, .channels = channels, .far = step->far, .walk = malloc((size_t)nodes * (sizeof(visit) + 1 + (size_t)channels)) };
    if (!l->walk) return orl_fail(ORL_E_MEMORY, "no memory for a packed section");
    l->known = (uint8_t *)(l->walk + nodes);
    l->mag = l->known + nodes;
    memset(l->known, 0, (size_t)nodes);
    for (int s = KINDS[kind].top; s; s >>= 1) levels++;
    for (int set = 0; set < 2; set++)
        for (int k = levels - 1, q = step->step[set] ? step->step[set] : 1; k >= 0; k--, q = q * KINDS[kind].finer >> 2) l->step[k][set] = q ? q : 1;
    for (int i = 0; i < channels; i++) l->order[i] = channels <= ORDERED ? KINDS[kind].order[i] : i;
    prob_reset((prob *)&l->p, sizeof l->p / sizeof(prob));
    plan(l);
    return ORL_OK;
}

static inline int clamp8(int v) { return v < 0 ? 0 : v > 255 ? 255 : v; }

/* Mean of the vertices around, of channel p of vertex v [5.3.2]. */
static inline __attribute__((always_inline)) int expected(const lattice *l, const visit *v, const uint8_t *p, const int C, const int flip)
{
    static const int SHARE[4] = { 0, 1 << 15, 1 << 14, 10923 };
    int sum = 0, n = 0;
    if (v->level) {
        for (int a = 0; a < v->axes; a++) sum += (p[v->back[a]] ^ flip) + (p[v->ahead[a]] ^ flip);
        return (sum * SHARE[v->axes] + (1 << 15)) >> 16;
    }
    for (int a = 0; a < 3; a++) {
        if (v->back[a]) { sum += p[v->back[a]] ^ flip; n++; }
        if (v->ahead[a] && l->known[v->at + v->ahead[a] / C]) { sum += p[v->ahead[a]] ^ flip; n++; }
    }
    return n ? (2 * sum + n) / (2 * n) : 128;
}

/* Steps that a value departs from what was expected, sign and size [5.3.4]. */
static inline __attribute__((always_inline)) int code_steps(lattice *l, coder *c, prob *zero, int set, int around, int lead, int steps, const int writing)
{
    int neg = steps < 0, mag = neg ? -steps : steps, n = 1;
    if (__builtin_expect(!code_bit(c, zero, mag > 0, writing), 1)) return 0;
    neg = code_bit(c, &l->p.sign[set][lead], neg, writing);
    prob *more = l->p.more[set][around > 5 ? 3 : around > 2 ? 2 : around > 0];
    while (n < UNARY && code_bit(c, &more[n - 1], mag > n, writing)) n++;
    if (n == UNARY) {
        int rest = mag - UNARY + 1, bits = 0, v = 1;
        while (bits < ESCAPE && code_bit(c, &l->p.escape[set][bits], rest >> (bits + 1) > 0, writing)) bits++;
        while (bits--) v = v << 1 | even_bit(c, rest >> bits & 1, writing);
        n = UNARY + v - 1;
    }
    return neg ? -n : n;
}

/* One block at out; of the writer, values: what it should be. */
static inline __attribute__((always_inline)) void code_block(lattice *l, coder *shared, uint8_t *out, const uint8_t *values, const uint8_t *used, const int writing)
{
    const int kind = l->kind, C = KINDS[kind].channels, flip = KINDS[kind].sign;
    const visit *end = l->walk + l->nodes;
    coder own = *shared, *c = &own;             /* bytes that are stored may not be it: it can stay in registers */
    memset(l->mag, 0, (size_t)(l->nodes * C));
    for (const visit *v = l->walk; v < end; v++) {
        if (l->known[v->at]) continue;
        int departs = 0, before = 0;
        for (int i = 0; i < C; i++) {
            int set = i >= KINDS[kind].second, led = i >= KINDS[kind].led, around = 0, beside = 0;
            size_t at = v->at * (size_t)C + (size_t)l->order[i];
            uint8_t *p = out + at, *m = l->mag + at;
            int base = expected(l, v, p, C, flip), want = led && KINDS[kind].lead ? clamp8(base + departs) : base, q = l->step[v->level][set], steps = 0;
            if (kind == ORL_PACK_SDF) {
                int off = want > 128 ? want - 128 : 128 - want;
                q += q * off * l->far >> 10;
                beside = off < 16 ? 0 : off < 48 ? 1 : off < 96 ? 2 : 3;
            }
            if (v->level) {
                for (int a = 0; a < v->axes; a++) around += m[v->back[a]] + (v->ahead[a] == v->back[a] ? 0 : m[v->ahead[a]]);
                for (int a = 0; a < v->befores; a++) around += 2 * m[v->before[a]];
                around = around < AROUND ? around : AROUND - 1;
            }
            if (led) beside = before;
            if (writing && (!used || used[v->at])) {        /* what lies within 5/8 of a step is none */
                int off = (values[at] ^ flip) - want, mag = off < 0 ? -off : off;
                steps = (8 * mag + 3 * q) / (8 * q);
                if (off < 0) steps = -steps;
            }
            steps = code_steps(l, c, &l->p.zero[set][v->level][around][beside], set, around, !led || !departs ? 0 : departs < 0 ? 1 : 2, steps, writing);
            int value = clamp8(want + steps * q), size = steps < 0 ? -steps : steps;
            *m = (uint8_t)(size < MAG ? size : MAG);
            before = *m;
            departs = value - base;
            *p = (uint8_t)(value ^ flip);
        }
    }
    *shared = own;
}

/* Takes what block `own` of brick b at q shares with the blocks before it; face: of a texture, else -1 [5.3.1]. */
static void share(lattice *l, const orl_scene *s, const int q[3], int face, size_t own, uint8_t *all)
{
    const uint16_t *side = KINDS[l->kind].side;
    size_t C = (size_t)l->channels, block = (size_t)l->nodes * C;
    memset(l->known, 0, (size_t)l->nodes);
    for (int k = 0; k < SHARED; k++) {
        int o[3] = { k % 3 - 1, k / 3 % 3 - 1, k / 9 - 1 }, at[3], lo[3], hi[3], from[3];
        if (k == SHARED / 2 || (face >= 0 && o[2])) continue;
        for (int a = 0; a < 3; a++) {
            int axis = face < 0 ? a : ((face >> 1) + 1 + a) % 3;
            at[axis] = q[axis] + o[a];
        }
        int32_t b = brick_at(s, s->bmap, at);
        if (b < 0 || (face >= 0 && !(orl_skin_mask(s->skin[b]) >> face & 1))) continue;
        size_t other = face < 0 ? (size_t)b : orl_skin_texture(s->skin[b], face);
        if (other >= own) continue;
        for (int a = 0; a < 3; a++) {
            int last = side[a] - 1;
            lo[a] = o[a] > 0 ? last : 0;
            hi[a] = o[a] < 0 ? 0 : last;
            from[a] = -o[a] * last;
        }
        for (int z = lo[2]; z <= hi[2]; z++)
            for (int y = lo[1]; y <= hi[1]; y++)
                for (int x = lo[0]; x <= hi[0]; x++) {
                    size_t i = (size_t)(x + side[0] * (y + side[1] * z)), j = (size_t)(x + from[0] + side[0] * (y + from[1] + side[1] * (z + from[2])));
                    if (l->known[i]) continue;
                    l->known[i] = 1;
                    memcpy(all + own * block + i * C, all + other * block + j * C, C);
                }
    }
}

/* All blocks of a section; ends where the bytes do. */
static inline __attribute__((always_inline)) void code_blocks(lattice *l, coder *c, const orl_scene *s, uint8_t *out, const uint8_t *values, const uint8_t *used, const int writing)
{
    const int kind = l->kind;
    size_t block = (size_t)(l->nodes * l->channels), places = (size_t)s->nb[0] * s->nb[1] * s->nb[2];
    if (kind >= ORL_PACK_GROUND) {
        code_block(l, c, out, values, used, writing);
        return;
    }
    for (size_t i = 0; i < places && !c->over; i++) {
        int32_t b = s->bmap[i];
        if (b < 0) continue;
        int q[3] = { (int)(i % s->nb[0]), (int)(i / s->nb[0] % s->nb[1]), (int)(i / s->nb[0] / s->nb[1]) }, textures = kind == ORL_PACK_ALBEDO;
        for (int f = 0; f < (textures ? ORL_SKIN_FACES : 1); f++) {
            if (textures && !(orl_skin_mask(s->skin[b]) >> f & 1)) continue;
            size_t own = textures ? orl_skin_texture(s->skin[b], f) : (size_t)b;
            share(l, s, q, textures ? f : -1, own, out);
            code_block(l, c, out + own * block, writing ? values + own * block : NULL, used ? used + own * (size_t)l->nodes : NULL, writing);
        }
    }
}

uint64_t pack_bytes(int kind, const orl_scene *s)
{
    uint64_t blocks = kind >= ORL_PACK_GROUND ? 1 : kind == ORL_PACK_ALBEDO ? s->ntextures : s->nbricks;
    return blocks * (uint64_t)block_nodes(kind) * KINDS[kind].channels;
}

orl_err pack_values(int kind, const orl_scene *s, const void *values, const uint8_t *used, uint8_t **bytes, size_t *n)
{
    lattice l;
    coder c;
    uint8_t *out = malloc(pack_bytes(kind, s) + 1);
    orl_err e = out ? lattice_make(&l, kind, &s->step[kind]) : orl_fail(ORL_E_MEMORY, "no memory to pack a scene");
    if (!e) {
        write_start(&c);
        for (int k = 0; k < PACK_HEAD; k++) put_byte(&c, (uint8_t)(k < 2 ? s->step[kind].step[k] + !s->step[kind].step[k] : k == 2 && kind == ORL_PACK_SDF ? s->step[kind].far : 0));
        code_blocks(&l, &c, s, out, values, used, 1);
        e = finish(&c, bytes, n);
        free(l.walk);
    }
    free(out);
    return e;
}

orl_err unpack_values(int kind, const orl_scene *s, const uint8_t *bytes, size_t n, void *values, orl_pack_step *step)
{
    lattice l;
    coder c;
    if (n < PACK_HEAD || !bytes[0] || !bytes[1] || (bytes[2] && kind != ORL_PACK_SDF) || memcmp(bytes + 3, (const uint8_t[PACK_HEAD - 3]){ 0 }, PACK_HEAD - 3)) return ORL_E_FORMAT;
    *step = (orl_pack_step){ { bytes[0], bytes[1] }, bytes[2] };
    orl_err e = lattice_make(&l, kind, step);
    if (e) return e;
    read_start(&c, bytes + PACK_HEAD, n - PACK_HEAD);
    code_blocks(&l, &c, s, values, NULL, NULL, 0);
    free(l.walk);
    return read_ended(&c) ? ORL_OK : ORL_E_FORMAT;
}
