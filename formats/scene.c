/* The scene file: SCENE.md in code (numbers in brackets cite it).
 *
 * Reading maps the file: parse() establishes that header, table and section sizes agree with the bytes that are there, unpack() gets the surface out of its packed sections (pack.c), validate() sees that what they
 * hold is in range. The light model is decoded into the struct, all else is pointed to. Writing lays the file out in memory, reads it back through the same steps, and replaces the target atomically.
 * A file that another process shortens while it is mapped is not guarded against. */
#include "oriel/scene.h"
#include <fcntl.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>
#include "formats/pack.h"
#include "oriel/image.h"
#include "oriel/parallel.h"

#if __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "the scene is used in place: little-endian machines only"
#endif

enum { FACE_ONE = 32767, HEADER = 64, ENTRY = 32, MAX_SECTIONS = 32, VERSION = 1, EXP_MIN = -40, EXP_MAX = 15, MAX_CODES = 65536, TRI = ORL_CODE * (ORL_CODE + 1) / 2 };
enum { HEAD, PMAP, PSDF, PSKN, PALB, PLIT, PSHD, GRND, PGRN, BACK, PBAK, FACE, SKYD, SKYG, PRIO, CODE, META, VPHO, VWID, TAGS };
static const char tags[TAGS][5] = { "HEAD", "PMAP", "PSDF", "PSKN", "PALB", "PLIT", "PSHD", "GRND", "PGRN", "BACK", "PBAK", "FACE", "SKYD", "SKYG", "PRIO", "CODE", "META", "VPHO", "VWID" };
static const int PACKED_AS[ORL_PACKED] = { [ORL_PACK_SDF] = PSDF, [ORL_PACK_ALBEDO] = PALB, [ORL_PACK_LITE] = PLIT, [ORL_PACK_SHADOW] = PSHD, [ORL_PACK_GROUND] = PGRN, [ORL_PACK_BACK] = PBAK };
static const char magic[8] = { 'O', 'R', 'I', 'E', 'L', 'S', 'C', 'N' };

typedef struct { uint32_t nb[3], nbricks; double world_to_grid[12]; float cell_world, shadow_scale[ORL_SHADOW_DIM]; uint8_t reserved[4]; } head_bytes;                       /* [4.1] */
typedef struct { float plane[3]; } grnd_bytes;                                                                                                                              /* [4.8] */
typedef struct { int32_t mean_exp, basis_exp[ORL_ENV_DIM]; uint16_t ground[3]; uint8_t reserved[22]; int16_t mean[ORL_ENV][3], basis[ORL_ENV_DIM][ORL_ENV][3]; } skyd_bytes;    /* [4.11] */
typedef struct { int32_t exp[ORL_SKY_Q]; uint8_t sky_mean[3], sky_std[3], reserved[2]; int16_t gen[ORL_SKY_Q][3][ORL_SKY_Y]; } skyg_bytes;                                                             /* [4.12] */
typedef struct { float mean[ORL_CODE], prec[TRI]; } prio_bytes;                                                                                                             /* [4.13] */
_Static_assert(sizeof(head_bytes) == 152 && sizeof(grnd_bytes) == 12 && sizeof(orl_backdrop) == 12 && sizeof(skyd_bytes) == 13888 && sizeof(skyg_bytes) == 820 && sizeof(prio_bytes) == 2960, "sizes of SCENE.md");

typedef struct { const uint8_t *at; uint64_t bytes; } span;
typedef struct { orl_scene_section list[MAX_SECTIONS]; int count; span known[TAGS]; } layout;

static uint64_t align64(uint64_t x) { return (x + 63) & ~(uint64_t)63; }
static uint32_t get32(const uint8_t *p) { uint32_t v; memcpy(&v, p, 4); return v; }
static uint64_t get64(const uint8_t *p) { uint64_t v; memcpy(&v, p, 8); return v; }
static int all_zero(const uint8_t *p, uint64_t n) { for (uint64_t i = 0; i < n; i++) if (p[i]) return 0; return 1; }
static int within(float v, float limit) { return v >= -limit && v <= limit; }      /* false for NaN */

static uint32_t header_crc(const uint8_t *b, uint32_t n)
{
    static const uint8_t zero[4];
    return orl_crc32(b + 28, HEADER - 28 + (size_t)n * ENTRY, orl_crc32(zero, 4, orl_crc32(b, 24, 0)));
}

/* ---- parse: header, table, sizes [2, 3] */

static orl_err parse_table(const uint8_t *b, size_t n, const char *name, layout *out)
{
    if (n < HEADER) return orl_fail(ORL_E_FORMAT, "%s: %zu bytes, shorter than the header", name, n);
    if (memcmp(b, magic, 8)) return orl_fail(ORL_E_FORMAT, "%s: offset 0: not a scene file", name);
    uint32_t version = get32(b + 8), count = get32(b + 12);
    if (version != VERSION) return orl_fail(ORL_E_UNSUPPORTED, "%s: offset 8: version %u, this build reads %d", name, version, VERSION);
    if (count < 1 || count > MAX_SECTIONS) return orl_fail(ORL_E_RANGE, "%s: offset 12: %u sections", name, count);
    if (count > (n - HEADER) / ENTRY) return orl_fail(ORL_E_FORMAT, "%s: offset 12: table of %u sections exceeds the file", name, count);
    if (get64(b + 16) != n) return orl_fail(ORL_E_FORMAT, "%s: offset 16: size %llu, the file has %zu bytes", name, (unsigned long long)get64(b + 16), n);
    if (get32(b + 24) != header_crc(b, count)) return orl_fail(ORL_E_FORMAT, "%s: offset 24: header checksum differs", name);
    if (!all_zero(b + 28, 4)) return orl_fail(ORL_E_FORMAT, "%s: offset 28: reserved bytes are not 0", name);
    layout l = { .count = (int)count };
    uint64_t total = HEADER + (uint64_t)count * ENTRY;
    int last = -1;
    for (uint32_t i = 0; i < count; i++) {
        const uint8_t *e = b + HEADER + i * ENTRY;
        orl_scene_section *s = &l.list[i];
        for (int k = 0; k < 4; k++) {
            s->tag[k] = (char)e[k];
            if (!((e[k] >= 'A' && e[k] <= 'Z') || (e[k] >= 'a' && e[k] <= 'z') || (e[k] >= '0' && e[k] <= '9'))) return orl_fail(ORL_E_FORMAT, "%s: section %u: tag is not text", name, i);
        }
        s->crc = get32(e + 4);
        s->offset = get64(e + 8);
        s->bytes = get64(e + 16);
        if (!all_zero(e + 24, 8)) return orl_fail(ORL_E_FORMAT, "%s: section %s: reserved bytes are not 0", name, s->tag);
        uint64_t start = align64(total);
        if (s->offset != start) return orl_fail(ORL_E_FORMAT, "%s: section %s: offset %llu, expected %llu", name, s->tag, (unsigned long long)s->offset, (unsigned long long)start);
        if (start > n || s->bytes > n - start) return orl_fail(ORL_E_FORMAT, "%s: section %s: %llu bytes exceed the file", name, s->tag, (unsigned long long)s->bytes);
        if (!all_zero(b + total, start - total)) return orl_fail(ORL_E_FORMAT, "%s: section %s: padding before it is not 0", name, s->tag);
        total = start + s->bytes;
        int t = 0;
        while (t < TAGS && memcmp(s->tag, tags[t], 4)) t++;
        if (t == TAGS) {
            if (s->tag[0] >= 'a') continue;                                                     /* [3.4] */
            return orl_fail(ORL_E_UNSUPPORTED, "%s: section %s is unknown (made by another version?)", name, s->tag);
        }
        if (t <= last) return orl_fail(ORL_E_FORMAT, "%s: section %s is out of order or doubled", name, s->tag);
        last = t;
        l.known[t] = (span){ b + start, s->bytes };
    }
    uint64_t end = align64(total);
    if (end != n) return orl_fail(ORL_E_FORMAT, "%s: sections end at %llu, the file has %zu bytes", name, (unsigned long long)end, n);
    if (!all_zero(b + total, end - total)) return orl_fail(ORL_E_FORMAT, "%s: padding after the last section is not 0", name);
    *out = l;
    return ORL_OK;
}

static orl_err need(const layout *l, int t, int required, uint64_t bytes, const char *name)
{
    if (!l->known[t].at) return required ? orl_fail(ORL_E_FORMAT, "%s: section %s is missing", name, tags[t]) : ORL_OK;
    if (l->known[t].bytes != bytes)
        return orl_fail(ORL_E_FORMAT, "%s: section %s: %llu bytes, expected %llu", name, tags[t], (unsigned long long)l->known[t].bytes, (unsigned long long)bytes);
    return ORL_OK;
}

/* Sizes of all sections from HEAD's counts, pointers into the file [4]. */
static orl_err parse(const uint8_t *b, size_t n, const char *name, layout *l, orl_scene *s)
{
    orl_err e = parse_table(b, n, name, l);
    if (e) return e;
    for (int i = 0; i < l->count; i++)
        if (orl_crc32(b + l->list[i].offset, l->list[i].bytes, 0) != l->list[i].crc) return orl_fail(ORL_E_FORMAT, "%s: section %s: checksum differs", name, l->list[i].tag);
    int scene = l->known[HEAD].at != NULL;
    if (scene) {
        if ((e = need(l, HEAD, 1, sizeof(head_bytes), name))) return e;
        const head_bytes *h = (const head_bytes *)l->known[HEAD].at;
        for (int a = 0; a < 3; a++) if (h->nb[a] < 1 || h->nb[a] > 512) return orl_fail(ORL_E_RANGE, "%s: section HEAD: nb[%d] = %u", name, a, h->nb[a]);
        uint64_t places = (uint64_t)h->nb[0] * h->nb[1] * h->nb[2];                             /* at most 2^27 */
        if (places > 1u << 24) return orl_fail(ORL_E_RANGE, "%s: section HEAD: %llu brick places", name, (unsigned long long)places);
        if (h->nbricks > places || h->nbricks > ORL_BRICKS_MOST) return orl_fail(ORL_E_RANGE, "%s: section HEAD: %u bricks in %llu places", name, h->nbricks, (unsigned long long)places);
    }
    const uint64_t want[TAGS] = { [HEAD] = sizeof(head_bytes), [GRND] = sizeof(grnd_bytes), [BACK] = sizeof(orl_backdrop), [SKYD] = sizeof(skyd_bytes), [SKYG] = sizeof(skyg_bytes), [PRIO] = sizeof(prio_bytes),
        [META] = sizeof s->title };
    for (int t = 0; t < TAGS; t++) {
        if (!scene && t <= FACE && l->known[t].at) return orl_fail(ORL_E_FORMAT, "%s: section %s without HEAD", name, tags[t]);
        int required = t <= PALB ? scene : t == PGRN || t == PBAK ? l->known[t - 1].at != NULL : t > FACE && t != CODE && t < VPHO;
        if (required && !l->known[t].at) return orl_fail(ORL_E_FORMAT, "%s: section %s is missing", name, tags[t]);
        if (want[t] && (e = need(l, t, required, want[t], name))) return e;
        if ((t == PGRN || t == PBAK) && l->known[t].at && !required) return orl_fail(ORL_E_FORMAT, "%s: section %s without %s", name, tags[t], tags[t - 1]);
    }
    for (int k = 0; k < ORL_VIEWS; k++) {
        s->view[k] = l->known[VPHO + k].at;
        s->view_bytes[k] = l->known[VPHO + k].bytes;
        if (!s->view[k] != !s->view[0] || (s->view[k] && scene)) return orl_fail(ORL_E_FORMAT, "%s: section %s: a baked file has both views and no HEAD", name, tags[VPHO + k]);
    }
    span face = l->known[FACE], code = l->known[CODE];
    if (face.at && (face.bytes % 6 || face.bytes == 0 || face.bytes / 6 > ORL_FACINGS)) return orl_fail(ORL_E_FORMAT, "%s: section FACE: %llu bytes", name, (unsigned long long)face.bytes);
    uint64_t one = ORL_CODE * sizeof(float);
    if (code.at && (code.bytes % one || code.bytes == 0 || code.bytes / one > MAX_CODES))
        return orl_fail(ORL_E_FORMAT, "%s: section CODE: %llu bytes", name, (unsigned long long)code.bytes);
    if (scene) {
        const head_bytes *h = (const head_bytes *)l->known[HEAD].at;
        memcpy(s->nb, h->nb, sizeof s->nb);
        s->nbricks = h->nbricks;
        memcpy(s->world_to_grid, h->world_to_grid, sizeof s->world_to_grid);
        s->cell_world = h->cell_world;
        memcpy(s->shadow_scale, h->shadow_scale, sizeof s->shadow_scale);
        if (l->known[BACK].at && !l->known[GRND].at) return orl_fail(ORL_E_FORMAT, "%s: section BACK without GRND", name);
        if (l->known[GRND].at) memcpy(s->ground, l->known[GRND].at, sizeof s->ground);
        if (l->known[BACK].at) memcpy(&s->backdrop, l->known[BACK].at, sizeof s->backdrop);
    }
    s->codes = (const float *)code.at;
    s->ncodes = (uint32_t)(code.bytes / one);
    memcpy(s->title, l->known[META].at, sizeof s->title);
    return ORL_OK;
}

/* ---- unpack [5]: the map and the textures that there are first, all else from them */

typedef struct { const layout *l; const orl_scene *s; uint8_t *to[ORL_PACKED]; orl_pack_step step[ORL_PACKED]; orl_err e[ORL_PACKED]; } unpack_job;

static void unpack_kinds(void *user, int begin, int end)
{
    unpack_job *j = user;
    for (int k = begin; k < end; k++) {
        span from = j->l->known[PACKED_AS[k]];
        if (from.at) j->e[k] = unpack_values(k, j->s, from.at, from.bytes, j->to[k], &j->step[k]);
    }
}

static orl_err unpack(const layout *l, orl_scene *s, const char *name)
{
    size_t map = align64(4 * (size_t)s->nb[0] * s->nb[1] * s->nb[2]), total = 0, at[ORL_PACKED];
    uint8_t *index = s->block[0] = aligned_alloc(64, map + align64(4 * (size_t)s->nbricks));
    if (!index) return orl_fail(ORL_E_MEMORY, "%s: no memory for %u bricks", name, s->nbricks);
    s->bmap = (const int32_t *)index;
    s->skin = (const uint32_t *)(index + map);
    orl_err e = unpack_index(s, l->known[PMAP].at, l->known[PMAP].bytes, l->known[PSKN].at, l->known[PSKN].bytes, name, (int32_t *)index, (uint32_t *)(index + map), &s->ntextures);
    if (e) return e;
    for (int k = 0; k < ORL_PACKED; k++) {
        at[k] = total;
        if (l->known[PACKED_AS[k]].at) total += align64(pack_bytes(k, s));
    }
    uint8_t *block = s->block[1] = aligned_alloc(64, total + 64);
    if (!block) return orl_fail(ORL_E_MEMORY, "%s: no memory for a surface of %zu bytes", name, total);
    unpack_job j = { .l = l, .s = s };
    for (int k = 0; k < ORL_PACKED; k++) j.to[k] = l->known[PACKED_AS[k]].at ? block + at[k] : NULL;
    orl_parallel(0, ORL_PACKED, 1, unpack_kinds, &j);
    for (int k = 0; k < ORL_PACKED; k++) {
        if (j.e[k]) return orl_fail(j.e[k], j.e[k] == ORL_E_MEMORY ? "%s: section %s: no memory" : "%s: section %s: no steps, or it does not end where its bytes do", name, tags[PACKED_AS[k]]);
        s->step[k] = j.step[k];
    }
    s->sdf = (const int8_t *)j.to[ORL_PACK_SDF];
    s->albedo = j.to[ORL_PACK_ALBEDO];
    s->lite = j.to[ORL_PACK_LITE];
    s->shadow = (const int8_t *)j.to[ORL_PACK_SHADOW];
    s->ground_albedo = j.to[ORL_PACK_GROUND];
    s->backdrop_rgba = j.to[ORL_PACK_BACK];
    return ORL_OK;
}

/* ---- validate: ranges and finite numbers */

static orl_err validate_head(const layout *l, const orl_scene *s, const char *name)
{
    const head_bytes *h = (const head_bytes *)l->known[HEAD].at;
    if (!all_zero(h->reserved, sizeof h->reserved)) return orl_fail(ORL_E_FORMAT, "%s: section HEAD: reserved bytes are not 0", name);
    const double *m = s->world_to_grid;
    for (int i = 0; i < 12; i++)
        if (!(m[i] > -1e9 && m[i] < 1e9)) return orl_fail(ORL_E_RANGE, "%s: section HEAD: world_to_grid[%d] is not finite or absurd", name, i);
    double g[6], det = m[0] * (m[5] * m[10] - m[6] * m[9]) - m[1] * (m[4] * m[10] - m[6] * m[8]) + m[2] * (m[4] * m[9] - m[5] * m[8]);
    for (int i = 0, k = 0; i < 3; i++)
        for (int j = i; j < 3; j++) g[k++] = m[4 * i] * m[4 * j] + m[4 * i + 1] * m[4 * j + 1] + m[4 * i + 2] * m[4 * j + 2];
    double tol = 4e-6 * g[0];
#define OFF(x) (!((x) <= tol && (x) >= -tol))
    if (!(g[0] > 1e-18) || !(det > 0) || OFF(g[1]) || OFF(g[2]) || OFF(g[4]) || OFF(g[3] - g[0]) || OFF(g[5] - g[0]))
        return orl_fail(ORL_E_RANGE, "%s: section HEAD: world_to_grid is not a similarity", name);
#undef OFF
    double unit = (double)s->cell_world * s->cell_world * g[0];
    if (!(s->cell_world > 0) || !(unit > 0.998 && unit < 1.002))
        return orl_fail(ORL_E_RANGE, "%s: section HEAD: cell_world %g does not fit world_to_grid", name, (double)s->cell_world);
    for (int k = 0; k < ORL_SHADOW_DIM; k++) {
        uint32_t bits;
        memcpy(&bits, &s->shadow_scale[k], 4);
        int e = (int)(bits >> 23) - 127;
        if (s->shadow ? (bits & 0x7fffff) || e < EXP_MIN || e > EXP_MAX : bits != 0) return orl_fail(ORL_E_RANGE, "%s: section HEAD: shadow_scale[%d] = %g", name, k, (double)s->shadow_scale[k]);
    }
    for (int k = 0; s->ground_albedo && k < 3; k++)
        if (!within(s->ground[k], k ? 1 : 1e6f)) return orl_fail(ORL_E_RANGE, "%s: section GRND: plane[%d] = %g", name, k, (double)s->ground[k]);
    const orl_backdrop *room = &s->backdrop;
    for (int a = 0; s->backdrop_rgba && a < 2; a++)
        if (!(room->half[a] >= 4 * (float)s->nb[a] && room->half[a] <= 1e6f)) return orl_fail(ORL_E_RANGE, "%s: section BACK: half[%d] = %g", name, a, (double)room->half[a]);
    if (s->backdrop_rgba && !(room->height > 0.01f && room->height <= 1e6f)) return orl_fail(ORL_E_RANGE, "%s: section BACK: height %g", name, (double)room->height);
    return ORL_OK;
}

static orl_err validate_facings(const layout *l, orl_facings *f, const char *name)
{
    const int16_t *q = (const int16_t *)l->known[FACE].at;
    f->n = (int)(l->known[FACE].bytes / 6);
    for (int k = 0; k < f->n; k++, q += 3) {
        float len = 0;
        for (int a = 0; a < 3; a++) {
            f->dir[k][a] = (float)q[a] / FACE_ONE;
            len += f->dir[k][a] * f->dir[k][a];
        }
        if (!(len > 0.999f && len < 1.001f)) return orl_fail(ORL_E_RANGE, "%s: section FACE: direction %d is not of unit length", name, k);
    }
    return ORL_OK;
}

/* 2^e for e in EXP_MIN .. EXP_MAX */
static float exp2i(int e) { uint32_t bits = (uint32_t)(e + 127) << 23; float f; memcpy(&f, &bits, 4); return f; }

static orl_err decode(const int16_t *q, int n, int e, float *out, const char *section, const char *name)
{
    if (e < EXP_MIN || e > EXP_MAX) return orl_fail(ORL_E_RANGE, "%s: section %s: exponent %d", name, section, e);
    float scale = exp2i(e);
    for (int i = 0; i < n; i++) out[i] = (float)q[i] * scale;
    return ORL_OK;
}

static orl_err validate_light(const layout *l, orl_light_model *m, const char *name)
{
    const skyd_bytes *d = (const skyd_bytes *)l->known[SKYD].at;
    const skyg_bytes *g = (const skyg_bytes *)l->known[SKYG].at;
    const prio_bytes *p = (const prio_bytes *)l->known[PRIO].at;
    orl_err e = ORL_OK;
    if (!all_zero(d->reserved, sizeof d->reserved)) return orl_fail(ORL_E_FORMAT, "%s: section SKYD: reserved bytes are not 0", name);
    if (!all_zero(g->reserved, sizeof g->reserved)) return orl_fail(ORL_E_FORMAT, "%s: section SKYG: reserved bytes are not 0", name);
    if ((e = decode(d->mean[0], 3 * ORL_ENV, d->mean_exp, m->env_mean[0], "SKYD", name))) return e;
    for (int k = 0; k < ORL_ENV_DIM; k++) if ((e = decode(d->basis[k][0], 3 * ORL_ENV, d->basis_exp[k], m->env_basis[k][0], "SKYD", name))) return e;
    for (int c = 0; c < 3; c++) {
        m->ground[c] = (float)d->ground[c] / 65536;
        m->sky_mean[c] = (float)g->sky_mean[c] / 255;
        m->sky_std[c] = (float)g->sky_std[c] / 255;
    }
    for (int j = 0; j < ORL_SKY_Q; j++) if ((e = decode(g->gen[j][0], 3 * ORL_SKY_Y, g->exp[j], m->sky_gen[j][0], "SKYG", name))) return e;
    for (int i = 0, k = 0; i < ORL_CODE; i++) {
        if (!within(p->mean[i], 1e12f)) return orl_fail(ORL_E_RANGE, "%s: section PRIO: mean[%d]", name, i);
        m->prior_mean[i] = p->mean[i];
        for (int j = 0; j <= i; j++, k++) {
            if (!within(p->prec[k], 1e12f) || (i == j && p->prec[k] < 0)) return orl_fail(ORL_E_RANGE, "%s: section PRIO: precision[%d][%d]", name, i, j);
            m->prior_prec[i][j] = m->prior_prec[j][i] = p->prec[k];
        }
    }
    return ORL_OK;
}

static orl_err validate(const layout *l, orl_scene *s, const char *name)
{
    orl_err e = s->bmap ? validate_head(l, s, name) : ORL_OK;
    if (!e) e = validate_facings(l, &s->facings, name);
    if (!e) e = validate_light(l, &s->light, name);
    for (uint32_t i = 0; !e && i < s->ncodes * ORL_CODE; i++)
        if (!within(s->codes[i], 1e6f)) e = orl_fail(ORL_E_RANGE, "%s: section CODE: code %u entry %u", name, i / ORL_CODE, i % ORL_CODE);
    size_t end = strnlen(s->title, sizeof s->title);
    int bad = end == sizeof s->title || !all_zero((const uint8_t *)s->title + end, sizeof s->title - end);
    for (size_t i = 0; i < end; i++) bad |= (uint8_t)s->title[i] < 32 || s->title[i] == 127;
    return e ? e : bad ? orl_fail(ORL_E_FORMAT, "%s: section META: title", name) : ORL_OK;
}

orl_err orl_scene_parse(const void *bytes, size_t n, const char *name, orl_scene *out)
{
    if ((uintptr_t)bytes & 63) return orl_fail(ORL_E_RANGE, "%s: memory is not aligned to 64 bytes", name);
    layout l;
    orl_scene s = { 0 };
    orl_err e = parse(bytes, n, name, &l, &s);
    if (!e && l.known[HEAD].at) e = unpack(&l, &s, name);
    if (!e) e = validate(&l, &s, name);
    if (!e) *out = s;
    else orl_scene_close(&s);
    return e;
}

/* ---- files */

static orl_err map_file(const char *path, void **map, size_t *n)
{
    int fd = open(path, O_RDONLY | O_CLOEXEC);
    struct stat st;
    orl_err e = ORL_OK;
    if (fd < 0) return orl_fail(ORL_E_IO, "%s: %m", path);
    if (fstat(fd, &st)) e = orl_fail(ORL_E_IO, "%s: %m", path);
    else if (!S_ISREG(st.st_mode)) e = orl_fail(ORL_E_IO, "%s: not a regular file", path);
    else if (st.st_size < HEADER || (uint64_t)st.st_size > SIZE_MAX) e = orl_fail(ORL_E_FORMAT, "%s: %lld bytes, not a scene file", path, (long long)st.st_size);
    else {
        void *p = mmap(NULL, (size_t)st.st_size, PROT_READ, MAP_PRIVATE, fd, 0);
        if (p == MAP_FAILED) e = orl_fail(ORL_E_IO, "%s: mapping failed: %m", path);
        else { *map = p; *n = (size_t)st.st_size; }
    }
    close(fd);
    return e;
}

orl_err orl_scene_open(const char *path, orl_scene *out)
{
    void *map = NULL;
    size_t n = 0;
    orl_err e = map_file(path, &map, &n);
    if (e) return e;
    orl_scene s;
    if ((e = orl_scene_parse(map, n, path, &s))) { munmap(map, n); return e; }
    s.map = map;
    s.map_bytes = n;
    *out = s;
    return ORL_OK;
}

void orl_scene_close(orl_scene *s)
{
    if (s->map) munmap(s->map, s->map_bytes);
    for (int k = 0; k < 2; k++) free(s->block[k]);
    memset(s, 0, sizeof *s);
}

orl_err orl_scene_sections(const char *path, orl_scene_section *out, int cap, int *count)
{
    void *map = NULL;
    size_t n = 0;
    orl_err e = map_file(path, &map, &n);
    if (e) return e;
    layout l;
    if (!(e = parse_table(map, n, path, &l))) {
        if (l.count > cap) e = orl_fail(ORL_E_MEMORY, "%s: %d sections, room for %d", path, l.count, cap);
        else {
            memcpy(out, l.list, (size_t)l.count * sizeof *out);
            *count = l.count;
        }
    }
    munmap(map, n);
    return e;
}

/* ---- write */

/* Smallest exponent at which v fits int16 [4.12.1]. */
static orl_err encode(const float *v, int n, int16_t *q, int32_t *exponent, const char *field, const char *path)
{
    float top = 0;
    for (int i = 0; i < n; i++) {
        float a = v[i] < 0 ? -v[i] : v[i];
        if (!(a <= 32767 * exp2i(EXP_MAX))) return orl_fail(ORL_E_RANGE, "%s: %s[%d] is not finite or absurd", path, field, i);
        if (a > top) top = a;
    }
    int e = EXP_MIN;
    while (top > 32767 * exp2i(e)) e++;
    float inv = exp2i(-e);
    for (int i = 0; i < n; i++) q[i] = (int16_t)(v[i] < 0 ? -(int)(0.5f - v[i] * inv) : (int)(v[i] * inv + 0.5f));
    *exponent = e;
    return ORL_OK;
}

static uint8_t byte_of(float v) { return (uint8_t)(v > 0 ? v < 1 ? (int)(v * 255 + 0.5f) : 255 : 0); }

static orl_err encode_light(const orl_light_model *m, skyd_bytes *d, skyg_bytes *g, prio_bytes *p, const char *path)
{
    orl_err e = encode(m->env_mean[0], 3 * ORL_ENV, d->mean[0], &d->mean_exp, "env_mean", path);
    for (int k = 0; !e && k < ORL_ENV_DIM; k++) e = encode(m->env_basis[k][0], 3 * ORL_ENV, d->basis[k][0], &d->basis_exp[k], "env_basis", path);
    for (int j = 0; !e && j < ORL_SKY_Q; j++) e = encode(m->sky_gen[j][0], 3 * ORL_SKY_Y, g->gen[j][0], &g->exp[j], "sky_gen", path);
    for (int c = 0; c < 3; c++) {
        float v = m->ground[c] * 65536 + 0.5f;
        d->ground[c] = (uint16_t)(v >= 65535 ? 65535 : v > 0 ? v : 0);
        g->sky_mean[c] = byte_of(m->sky_mean[c]);
        g->sky_std[c] = byte_of(m->sky_std[c]);
    }
    memcpy(p->mean, m->prior_mean, sizeof p->mean);
    for (int i = 0, k = 0; i < ORL_CODE; i++) for (int j = 0; j <= i; j++) p->prec[k++] = m->prior_prec[i][j];
    return e;
}

/* The surface's packed sections, malloc'd. */
static orl_err pack(const char *path, const orl_scene *s, uint8_t *data[TAGS], size_t bytes[TAGS])
{
    uint64_t places = 1, textures = 0;
    uint32_t n = 0;
    for (int a = 0; a < 3; a++) {
        if (s->nb[a] < 1 || s->nb[a] > 512) return orl_fail(ORL_E_RANGE, "%s: nb[%d] = %u", path, a, s->nb[a]);
        places *= s->nb[a];
    }
    if (places > 1u << 24 || s->nbricks > places || s->nbricks > ORL_BRICKS_MOST) return orl_fail(ORL_E_RANGE, "%s: %u bricks in %llu places", path, s->nbricks, (unsigned long long)places);
    for (uint64_t i = 0; i < places; i++)
        if (s->bmap[i] >= 0 && ((uint32_t)s->bmap[i] != n++ || n > s->nbricks)) return orl_fail(ORL_E_RANGE, "%s: brick %d stands at place %llu, out of order", path, s->bmap[i], (unsigned long long)i);
    if (n != s->nbricks) return orl_fail(ORL_E_RANGE, "%s: %u bricks, %u on the map", path, s->nbricks, n);
    for (uint32_t i = 0; i < n; i++) {
        unsigned faces = orl_skin_mask(s->skin[i]);
        if (!faces || orl_skin_first(s->skin[i]) != textures) return orl_fail(ORL_E_RANGE, "%s: textures of brick %u: %u", path, i, s->skin[i]);
        textures += (unsigned)__builtin_popcount(faces);
    }
    if (textures != s->ntextures) return orl_fail(ORL_E_FORMAT, "%s: %u textures, bricks have %llu", path, s->ntextures, (unsigned long long)textures);
    orl_err e = pack_index(s, &data[PMAP], &bytes[PMAP], &data[PSKN], &bytes[PSKN]);
    const void *values[ORL_PACKED] = { s->sdf, s->albedo, s->lite, s->shadow, s->ground_albedo, s->backdrop_rgba };
    const uint8_t *used[ORL_PACKED] = { [ORL_PACK_ALBEDO] = s->texel_used, [ORL_PACK_LITE] = s->light_used, [ORL_PACK_SHADOW] = s->light_used };
    for (int k = 0; !e && k < ORL_PACKED; k++) {
        int t = PACKED_AS[k];
        if (values[k] || t <= PALB) e = pack_values(k, s, values[k], used[k], &data[t], &bytes[t]);
    }
    return e;
}

/* The file in memory, malloc'd. */
static orl_err lay_out(const char *path, const orl_scene *s, uint8_t **out, size_t *n)
{
    static const head_bytes head_zero;
    head_bytes head = head_zero;
    uint8_t *packed[TAGS] = { NULL }, *file;
    size_t packed_bytes[TAGS] = { 0 };
    uint64_t total = 0;
    skyd_bytes skyd = { 0 };
    skyg_bytes skyg = { 0 };
    prio_bytes prio;
    int16_t face[ORL_FACINGS][3];
    orl_err e = encode_light(&s->light, &skyd, &skyg, &prio, path);
    if (e) return e;
    const void *data[TAGS] = { [SKYD] = &skyd, [SKYG] = &skyg, [PRIO] = &prio, [CODE] = s->ncodes ? s->codes : NULL };
    uint64_t bytes[TAGS] = { [SKYD] = sizeof skyd, [SKYG] = sizeof skyg, [PRIO] = sizeof prio, [CODE] = (uint64_t)s->ncodes * ORL_CODE * sizeof(float), [META] = sizeof s->title };
    if (s->facings.n < 0 || s->facings.n > ORL_FACINGS) return orl_fail(ORL_E_RANGE, "%s: %d directions that walls face", path, s->facings.n);
    for (int k = 0; k < s->facings.n; k++)
        for (int a = 0; a < 3; a++) {
            float v = s->facings.dir[k][a] * FACE_ONE;
            if (!within(v, FACE_ONE)) return orl_fail(ORL_E_RANGE, "%s: direction %d that walls face", path, k);
            face[k][a] = (int16_t)(v < 0 ? -(int)(0.5f - v) : (int)(v + 0.5f));
        }
    char title[sizeof s->title] = { 0 };
    memcpy(title, s->title, strnlen(s->title, sizeof title - 1));
    data[META] = title;
    for (int k = 0; k < ORL_VIEWS; k++) {
        data[VPHO + k] = s->view[k];
        bytes[VPHO + k] = s->view_bytes[k];
    }
    if (s->bmap) {
        memcpy(head.nb, s->nb, sizeof head.nb);
        head.nbricks = s->nbricks;
        memcpy(head.world_to_grid, s->world_to_grid, sizeof head.world_to_grid);
        head.cell_world = s->cell_world;
        if (s->shadow) memcpy(head.shadow_scale, s->shadow_scale, sizeof head.shadow_scale);
        if ((e = pack(path, s, packed, packed_bytes))) goto done;
        for (int t = PMAP; t < FACE; t++) { data[t] = packed[t]; bytes[t] = packed_bytes[t]; }
        data[HEAD] = &head;
        bytes[HEAD] = sizeof head;
        if (s->ground_albedo) { data[GRND] = s->ground; bytes[GRND] = sizeof s->ground; }
        if (s->backdrop_rgba) { data[BACK] = &s->backdrop; bytes[BACK] = sizeof s->backdrop; }
        if (s->facings.n) { data[FACE] = face; bytes[FACE] = (uint64_t)s->facings.n * sizeof *face; }
    }
    uint32_t count = 0;
    for (int t = 0; t < TAGS; t++) count += data[t] != NULL;
    total = align64(HEADER + (uint64_t)count * ENTRY);
    for (int t = 0; t < TAGS; t++) if (data[t]) total = align64(total + bytes[t]);
    file = total <= SIZE_MAX ? aligned_alloc(64, (size_t)total) : NULL;
    if (!file) { e = orl_fail(ORL_E_MEMORY, "%s: no memory for %llu bytes", path, (unsigned long long)total); goto done; }
    memset(file, 0, HEADER + (size_t)count * ENTRY);
    memcpy(file, magic, 8);
    uint32_t version = VERSION;
    memcpy(file + 8, &version, 4);
    memcpy(file + 12, &count, 4);
    memcpy(file + 16, &total, 8);
    uint64_t at = HEADER + (uint64_t)count * ENTRY;
    uint8_t *entry = file + HEADER;
    for (int t = 0; t < TAGS; t++) {
        if (!data[t]) continue;
        uint64_t start = align64(at);
        memset(file + at, 0, (size_t)(start - at));
        if (bytes[t]) memcpy(file + start, data[t], (size_t)bytes[t]);
        uint32_t crc = orl_crc32(file + start, bytes[t], 0);
        memcpy(entry, tags[t], 4);
        memcpy(entry + 4, &crc, 4);
        memcpy(entry + 8, &start, 8);
        memcpy(entry + 16, &bytes[t], 8);
        entry += ENTRY;
        at = start + bytes[t];
    }
    memset(file + at, 0, (size_t)(total - at));
    uint32_t crc = header_crc(file, count);
    memcpy(file + 24, &crc, 4);
    *out = file;
    *n = (size_t)total;
done:
    for (int t = 0; t < TAGS; t++) free(packed[t]);
    return e;
}

orl_err orl_scene_write(const char *path, const orl_scene *s, size_t *bytes_out)
{
    uint8_t *file;
    size_t n;
    orl_scene check;
    orl_err e = lay_out(path, s, &file, &n);
    if (e) return e;
    e = orl_scene_parse(file, n, path, &check);         /* never leave a file behind that cannot be read */
    if (!e) {
        orl_scene_close(&check);
        e = orl_file_write(path, file, n);
    }
    free(file);
    if (!e && bytes_out) *bytes_out = n;
    return e;
}

orl_err orl_scene_size(const char *path, const orl_scene *s, size_t *bytes_out)
{
    uint8_t *file;
    orl_err e = lay_out(path, s, &file, bytes_out);
    if (!e) free(file);
    return e;
}
