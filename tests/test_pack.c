/* Packed sections: nothing lost at steps of 1, bounded loss and the same bytes again at others, what does not count left to the writer, damage that is refused or harmless, the same values on every machine. */
#include "tests/scratch.h"
#include "oriel/image.h"
#include "tests/synth_scene.h"

enum { NB = 5, PLACES = NB * NB * NB };

static uint32_t rng;
static uint32_t draw(void) { rng ^= rng << 13; rng ^= rng >> 17; return rng ^= rng << 5; }

static uint32_t hash(uint32_t a, uint32_t b, uint32_t c, uint32_t d)
{
    uint32_t h = a * 0x9e3779b1u ^ b * 0x85ebca77u ^ c * 0xc2b2ae3du ^ d * 0x27d4eb2fu;
    h = (h ^ h >> 15) * 0x2c1b3c6du;
    return h ^ h >> 13;
}

/* Bricks at random places, values by their places in the grid, so that what bricks share is the same in all. rough: noise, extremes too; otherwise slopes. */
static uint8_t value(int rough, uint32_t x, uint32_t y, uint32_t z, uint32_t c)
{
    uint32_t h = hash(x, y, z, c);
    if (!rough) return (uint8_t)(40 + 3 * (x % 32) + 2 * (y % 24) + z % 40 + c + (h & 3));
    return h % 5 ? (uint8_t)(h >> 8) : h & 64 ? 255 : 0;
}

typedef struct { orl_scene s; uint8_t *texel_used, *light_used; int q[PLACES][3]; } random_scene;

static void random_make(random_scene *r, int rough)
{
    orl_scene *s = &r->s;
    synth_scene_make(s, NB, NB, NB);
    int32_t *map = (int32_t *)s->bmap;
    uint32_t n = 0, t = 0;
    for (int i = 0; i < PLACES; i++) {
        int q[3] = { i % NB, i / NB % NB, i / NB / NB };
        map[i] = draw() % 3 ? -1 : (int32_t)n;
        if (map[i] >= 0) memcpy(r->q[n++], q, sizeof q);
    }
    free((void *)s->sdf); free((void *)s->skin); free((void *)s->albedo); free((void *)s->lite); free((void *)s->shadow);
    uint32_t *skin = malloc((n + 1) * sizeof *skin);
    uint8_t *sdf = malloc((size_t)n * ORL_BRICK_VERTS + 1), *base = malloc((size_t)n * 6 * ORL_SKIN_TEXELS * 3 + 1), *lite = malloc((size_t)n * 27 * ORL_LITE_BYTES + 1), *shadow = malloc((size_t)n * 27 * ORL_SHADOW_DIM + 1);
    for (uint32_t b = 0; b < n; b++) {
        const int *q = r->q[b];
        unsigned faces = draw() % 63 + 1;
        skin[b] = t << 6 | faces;
        for (uint32_t v = 0; v < ORL_BRICK_VERTS; v++) sdf[b * ORL_BRICK_VERTS + v] = value(rough, 8 * (uint32_t)q[0] + v % 9, 8 * (uint32_t)q[1] + v / 9 % 9, 8 * (uint32_t)q[2] + v / 81, 0);
        for (int f = 0; f < 6; f++) {
            if (!(faces >> f & 1)) continue;
            int a = f >> 1;
            for (uint32_t v = 0; v < ORL_SKIN_TEXELS * 3; v++)
                base[(size_t)t * ORL_SKIN_TEXELS * 3 + v] = value(rough, 16 * (uint32_t)q[(a + 1) % 3] + v / 3 % 17, 16 * (uint32_t)q[(a + 2) % 3] + v / 51, 1000 * (uint32_t)f + (uint32_t)q[a], v % 3);
            t++;
        }
        for (uint32_t v = 0; v < 27; v++) {
            uint32_t x = 2 * (uint32_t)q[0] + v % 3, y = 2 * (uint32_t)q[1] + v / 3 % 3, z = 2 * (uint32_t)q[2] + v / 9;
            for (uint32_t c = 0; c < ORL_LITE_BYTES; c++) lite[(b * 27 + v) * ORL_LITE_BYTES + c] = value(rough, x, y, z, c);
            for (uint32_t c = 0; c < ORL_SHADOW_DIM; c++) shadow[(b * 27 + v) * ORL_SHADOW_DIM + c] = value(rough, x, y, z, 20 + c);
        }
    }
    s->nbricks = n;
    s->ntextures = t;
    s->skin = skin;
    s->sdf = (int8_t *)sdf;
    s->albedo = base;
    s->lite = lite;
    s->shadow = (int8_t *)shadow;
    uint8_t *ground = malloc(ORL_GROUND_SIDE * ORL_GROUND_SIDE * 3), *back = malloc(ORL_BACK_TEXELS * 4);
    for (uint32_t i = 0; i < ORL_GROUND_SIDE * ORL_GROUND_SIDE * 3; i++) ground[i] = value(rough, i / 3 % ORL_GROUND_SIDE, i / 3 / ORL_GROUND_SIDE, 0, i % 3);
    for (uint32_t i = 0; i < ORL_BACK_TEXELS * 4; i++) back[i] = value(rough, i / 4 % ORL_BACK_COLS, i / 4 / ORL_BACK_COLS, 0, i % 4);
    s->ground_albedo = ground;
    s->backdrop = (orl_backdrop){ { 4 * NB, 4 * NB + 2 }, 9 };
    s->backdrop_rgba = back;
    r->texel_used = calloc((size_t)t * ORL_SKIN_TEXELS + 1, 1);
    r->light_used = calloc((size_t)n * 27 + 1, 1);
}

static void random_free(random_scene *r)
{
    free(r->texel_used);
    free(r->light_used);
    free((void *)r->s.ground_albedo);
    free((void *)r->s.backdrop_rgba);
    synth_scene_free(&r->s);
}

/* Marks by place in the grid, so that bricks agree. */
static void random_marks(random_scene *r)
{
    uint32_t t = 0;
    for (uint32_t b = 0; b < r->s.nbricks; b++) {
        const int *q = r->q[b];
        for (uint32_t v = 0; v < 27; v++) r->light_used[b * 27 + v] = hash(2 * (uint32_t)q[0] + v % 3, 2 * (uint32_t)q[1] + v / 3 % 3, 2 * (uint32_t)q[2] + v / 9, 7) & 1;
        for (int f = 0; f < 6; f++) {
            if (!(r->s.skin[b] >> f & 1)) continue;
            for (uint32_t v = 0; v < ORL_SKIN_TEXELS; v++)
                r->texel_used[t * ORL_SKIN_TEXELS + v] = hash(16 * (uint32_t)q[((f >> 1) + 1) % 3] + v % 17, 16 * (uint32_t)q[((f >> 1) + 2) % 3] + v / 17, 1000 * (uint32_t)f + (uint32_t)q[f >> 1], 9) & 1;
            t++;
        }
    }
    r->s.texel_used = r->texel_used;
    r->s.light_used = r->light_used;
}

static uint8_t *load(const char *name, size_t *n)
{
    uint8_t *raw, *b;
    assert_int_equal(orl_file_read(name, 1 << 28, &raw, n), ORL_OK);
    b = aligned_alloc(64, (*n + 127) & ~(size_t)63);
    assert_non_null(b);
    memcpy(b, raw, *n);
    free(raw);
    return b;
}

/* Written, read, written again: the same bytes. Leaves what was read in *out. */
static void there_and_back(const orl_scene *s, orl_scene *out)
{
    size_t a, b;
    if (orl_scene_write(at("a.oriel"), s, NULL)) fail_msg("%s", orl_error_text());
    assert_int_equal(orl_scene_open(at("a.oriel"), out), ORL_OK);
    assert_int_equal(orl_scene_write(at("b.oriel"), out, NULL), ORL_OK);
    uint8_t *fa = load(at("a.oriel"), &a), *fb = load(at("b.oriel"), &b);
    assert_int_equal(a, b);
    assert_memory_equal(fa, fb, a);
    free(fa);
    free(fb);
}

static void test_nothing_lost(void **state)
{
    (void)state;
    for (int rough = 0; rough < 2; rough++)
        for (int k = 0; k < 2; k++) {
            random_scene w;
            orl_scene r;
            random_make(&w, rough);
            there_and_back(&w.s, &r);
            size_t n = w.s.nbricks;
            assert_int_equal(r.nbricks, n);
            assert_int_equal(r.ntextures, w.s.ntextures);
            assert_memory_equal(r.skin, w.s.skin, n * sizeof *r.skin);
            assert_memory_equal(r.sdf, w.s.sdf, n * ORL_BRICK_VERTS);
            assert_memory_equal(r.albedo, w.s.albedo, (size_t)r.ntextures * ORL_SKIN_TEXELS * 3);
            assert_memory_equal(r.lite, w.s.lite, n * 27 * ORL_LITE_BYTES);
            assert_memory_equal(r.shadow, w.s.shadow, n * 27 * ORL_SHADOW_DIM);
            assert_memory_equal(r.ground_albedo, w.s.ground_albedo, ORL_GROUND_SIDE * ORL_GROUND_SIDE * 3);
            assert_memory_equal(r.backdrop_rgba, w.s.backdrop_rgba, ORL_BACK_TEXELS * 4);
            for (int i = 0; i < PLACES; i++) {          /* the distance by its definition */
                int best = 127, q[3] = { i % NB, i / NB % NB, i / NB / NB };
                for (size_t b = 0; b < n; b++) {
                    int d = 0;
                    for (int a = 0; a < 3; a++) d = abs(w.q[b][a] - q[a]) > d ? abs(w.q[b][a] - q[a]) : d;
                    best = d < best ? d : best;
                }
                assert_int_equal(r.bmap[i], w.s.bmap[i] >= 0 ? w.s.bmap[i] : -best);
            }
            orl_scene_close(&r);
            random_free(&w);
        }
}

/* No used value is farther off than 5/8 of its step, which `far` lets grow. */
static void bounded(const char *name, const uint8_t *w, const uint8_t *r, size_t n, int channels, int flip, int first, orl_pack_step step, const uint8_t *used)
{
    for (size_t i = 0; i < n; i++) {
        int q = step.step[(int)(i % (size_t)channels) != first], off = (w[i] ^ flip) - (r[i] ^ flip);
        q += q * 128 * step.far >> 10;
        if ((!used || used[i / (size_t)channels]) && 8 * abs(off) > 5 * q) fail_msg("%s: value %zu is off by %d, the step is %d", name, i, off, q);
    }
}

static void test_loss_is_bounded(void **state)
{
    (void)state;
    for (int k = 0; k < 12; k++) {
        random_scene w;
        orl_scene r;
        random_make(&w, k % 2);
        for (int i = 0; i < ORL_PACKED; i++) w.s.step[i] = (orl_pack_step){ { (uint8_t)(1 + draw() % 40), (uint8_t)(1 + draw() % 60) }, (uint8_t)(i == ORL_PACK_SDF ? draw() % 128 : 0) };
        if (k == 11) for (int i = 0; i < ORL_PACKED; i++) w.s.step[i] = (orl_pack_step){ { 255, 255 }, i == ORL_PACK_SDF ? 255 : 0 };
        if (k % 3 == 2) random_marks(&w);
        there_and_back(&w.s, &r);
        size_t n = r.nbricks;
        const orl_pack_step *p = w.s.step;
        assert_memory_equal(r.step, p, sizeof r.step);
        bounded("sdf", (const uint8_t *)w.s.sdf, (const uint8_t *)r.sdf, n * ORL_BRICK_VERTS, 1, 128, 0, p[ORL_PACK_SDF], NULL);
        bounded("albedo", w.s.albedo, r.albedo, (size_t)r.ntextures * ORL_SKIN_TEXELS * 3, 3, 0, 1, p[ORL_PACK_ALBEDO], w.s.texel_used);
        bounded("lite", w.s.lite, r.lite, n * 27 * ORL_LITE_BYTES, ORL_LITE_BYTES, 0, 0, p[ORL_PACK_LITE], w.s.light_used);
        orl_pack_step one = p[ORL_PACK_SHADOW];
        one.step[1] = one.step[0];
        bounded("shadow", (const uint8_t *)w.s.shadow, (const uint8_t *)r.shadow, n * 27 * ORL_SHADOW_DIM, ORL_SHADOW_DIM, 128, 0, one, w.s.light_used);
        bounded("ground", w.s.ground_albedo, r.ground_albedo, ORL_GROUND_SIDE * ORL_GROUND_SIDE * 3, 3, 0, 1, p[ORL_PACK_GROUND], NULL);
        orl_scene_close(&r);
        random_free(&w);
    }
}

/* A smooth scene packs well, better by coarser steps, and better where little of it counts. */
static void test_smaller(void **state)
{
    (void)state;
    orl_scene s;
    size_t fine, coarse, less;
    synth_scene_make(&s, 8, 8, 6);
    size_t raw = (size_t)s.nbricks * (ORL_BRICK_VERTS + 27 * (ORL_LITE_BYTES + ORL_SHADOW_DIM)) + (size_t)s.ntextures * ORL_SKIN_TEXELS * 3;
    uint8_t *none = calloc((size_t)s.ntextures * ORL_SKIN_TEXELS + (size_t)s.nbricks * 27, 1);
    assert_int_equal(orl_scene_write(at("a.oriel"), &s, &fine), ORL_OK);
    for (int i = 0; i < ORL_PACKED; i++) s.step[i] = (orl_pack_step){ { 6, 6 }, 0 };
    assert_int_equal(orl_scene_size("size", &s, &coarse), ORL_OK);
    assert_int_equal(orl_scene_write(at("a.oriel"), &s, &less), ORL_OK);
    assert_int_equal(less, coarse);
    s.texel_used = s.light_used = none;
    assert_int_equal(orl_scene_write(at("a.oriel"), &s, &less), ORL_OK);
    print_message("figure: %zu bytes of surface in a file of %zu, %zu by steps of 6, %zu with nothing in use\n", raw, fine, coarse, less);
    assert_true(fine < raw / 4 && coarse < fine * 3 / 4 && less < coarse);
    free(none);
    s.texel_used = s.light_used = NULL;
    synth_scene_free(&s);
}

static uint32_t section(uint8_t *b, int i, size_t *at_byte)
{
    uint64_t o, n;
    memcpy(&o, b + 64 + 32 * i + 8, 8);
    memcpy(&n, b + 64 + 32 * i + 16, 8);
    *at_byte = (size_t)o;
    return (uint32_t)n;
}

static void seal(uint8_t *b, int sections)
{
    static const uint8_t zero[4];
    for (int i = 0; i < sections; i++) {
        size_t o, n = section(b, i, &o);
        uint32_t crc = orl_crc32(b + o, n, 0);
        memcpy(b + 64 + 32 * i + 4, &crc, 4);
    }
    uint32_t crc = orl_crc32(b + 28, 36 + 32 * (size_t)sections, orl_crc32(zero, 4, orl_crc32(b, 24, 0)));
    memcpy(b + 24, &crc, 4);
}

/* Damage under right checksums: an error that names file and section, or a scene that can be walked. */
static void test_damage(void **state)
{
    (void)state;
    random_scene w;
    size_t n;
    int refused = 0, taken = 0, sections;
    random_make(&w, 0);
    for (int i = 0; i < ORL_PACKED; i++) w.s.step[i] = (orl_pack_step){ { 5, 7 }, (uint8_t)(i == ORL_PACK_SDF ? 64 : 0) };
    assert_int_equal(orl_scene_write(at("a.oriel"), &w.s, NULL), ORL_OK);
    random_free(&w);
    uint8_t *file = load(at("a.oriel"), &n), *b = aligned_alloc(64, (n + 127) & ~(size_t)63);
    sections = file[12];
    for (int k = 0; k < 300; k++) {
        size_t o;
        memcpy(b, file, n);
        int i = (int)(draw() % 9);              /* HEAD to PBAK */
        uint32_t bytes = section(b, i, &o);
        for (uint32_t e = draw() % 4 + 1; e; e--) b[o + draw() % bytes] = (uint8_t)draw();
        seal(b, sections);
        orl_scene s;
        if (orl_scene_parse(b, n, "damaged", &s)) {
            assert_memory_equal(orl_error_text(), "damaged: section ", 17);
            refused++;
            continue;
        }
        taken++;
        for (uint32_t p = 0, t = 0; p < s.nb[0] * s.nb[1] * s.nb[2]; p++) {
            if (s.bmap[p] < 0) continue;
            assert_true((uint32_t)s.bmap[p] < s.nbricks && orl_skin_mask(s.skin[s.bmap[p]]) && orl_skin_first(s.skin[s.bmap[p]]) == t);
            t += (uint32_t)__builtin_popcount(orl_skin_mask(s.skin[s.bmap[p]]));
            assert_true(t <= s.ntextures);
        }
        orl_scene_close(&s);
    }
    print_message("figure: %d damaged files refused, %d read\n", refused, taken);
    assert_true(refused > 0);
    free(b);
    free(file);
}

/* The values that come out, and the bytes that go in, by checksum: any machine's. */
static void test_the_same_everywhere(void **state)
{
    (void)state;
    random_scene w;
    orl_scene r;
    size_t n;
    rng = 12345;
    random_make(&w, 0);
    for (int i = 0; i < ORL_PACKED; i++) w.s.step[i] = (orl_pack_step){ { 5, 7 }, (uint8_t)(i == ORL_PACK_SDF ? 64 : 0) };
    assert_int_equal(orl_scene_write(at("a.oriel"), &w.s, NULL), ORL_OK);
    assert_int_equal(orl_scene_open(at("a.oriel"), &r), ORL_OK);
    uint32_t crc = orl_crc32((const uint8_t *)r.sdf, (size_t)r.nbricks * ORL_BRICK_VERTS, 0);
    crc = orl_crc32(r.albedo, (size_t)r.ntextures * ORL_SKIN_TEXELS * 3, crc);
    crc = orl_crc32(r.lite, (size_t)r.nbricks * 27 * ORL_LITE_BYTES, crc);
    crc = orl_crc32((const uint8_t *)r.shadow, (size_t)r.nbricks * 27 * ORL_SHADOW_DIM, crc);
    crc = orl_crc32(r.backdrop_rgba, ORL_BACK_TEXELS * 4, orl_crc32(r.ground_albedo, ORL_GROUND_SIDE * ORL_GROUND_SIDE * 3, crc));
    uint8_t *file = load(at("a.oriel"), &n);
    uint64_t end;
    memcpy(&end, file + 64 + 32 * 11 + 8, 8);           /* SKYD, after what is packed */
    assert_int_equal(crc, 0x17519a6b);
    assert_int_equal(orl_crc32(file + 64 + 32 * (size_t)file[12], (size_t)end - 64 - 32 * (size_t)file[12], 0), 0xac1876d4);
    free(file);
    orl_scene_close(&r);
    random_free(&w);
}

static int setup(void **state)
{
    rng = getenv("SEED") ? (uint32_t)atoi(getenv("SEED")) | 1 : (uint32_t)time(NULL) | 1;
    print_message("seed %u\n", rng);
    return scratch_make(state);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_nothing_lost), cmocka_unit_test(test_loss_is_bounded), cmocka_unit_test(test_smaller), cmocka_unit_test(test_damage), cmocka_unit_test(test_the_same_everywhere),
    };
    return cmocka_run_group_tests(tests, setup, scratch_remove);
}
