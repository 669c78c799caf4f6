/* Meshes: a sphere in bricks, turned and scaled: closed, on the surface, facing outwards; the PLY holds what its header says. */
#include "tests/scratch.h"
#include <math.h>
#include "oriel/image.h"
#include "trainer/mesh.h"

enum { NB = 4, BRICKS = NB * NB * NB };
static const double CENTRE[3] = { 15.7, 16.2, 15.9 }, RADIUS = 11.3, SCALE = 20, COS = 0.8, SIN = 0.6;
static int8_t sdf[BRICKS * ORL_BRICK_VERTS];
static uint8_t albedo[BRICKS * ORL_SKIN_TEXELS * 3];
static uint32_t skin[BRICKS];
static int32_t bmap[BRICKS];

static double distance(const double p[3]) { return sqrt((p[0] - CENTRE[0]) * (p[0] - CENTRE[0]) + (p[1] - CENTRE[1]) * (p[1] - CENTRE[1]) + (p[2] - CENTRE[2]) * (p[2] - CENTRE[2])) - RADIUS; }

static orl_scene sphere(void)
{
    orl_scene s = { .nb = { NB, NB, NB }, .cell_world = (float)(1 / SCALE), .bmap = bmap, .sdf = sdf, .skin = skin, .albedo = albedo, .title = "a ball",
                    .world_to_grid = { SCALE * COS, SCALE * -SIN, 0, 3, SCALE * SIN, SCALE * COS, 0, -4, 0, 0, SCALE, 5 } };
    memset(albedo, 128, sizeof albedo);
    for (unsigned b = 0; b < BRICKS; b++) skin[b] = b << 6 | 1u << b % 6;
    for (int b = 0; b < BRICKS; b++) {
        int lo = 127, hi = -128, o[3] = { b % NB * 8, b / NB % NB * 8, b / NB / NB * 8 };
        for (int v = 0; v < ORL_BRICK_VERTS; v++) {
            double q = floor(distance((double[3]){ o[0] + v % 9, o[1] + v / 9 % 9, o[2] + v / 81 }) * ORL_SDF_UNIT + 0.5);
            int i = (int)fmin(fmax(q, -128), 127);
            sdf[s.nbricks * ORL_BRICK_VERTS + (unsigned)v] = (int8_t)i;
            lo = i < lo ? i : lo;
            hi = i > hi ? i : hi;
        }
        bmap[b] = lo < 0 && hi > 0 ? (int32_t)s.nbricks++ : -1;
    }
    return s;
}

static void to_grid(const orl_scene *s, const float x[3], double p[3])
{
    for (int a = 0; a < 3; a++) p[a] = s->world_to_grid[4 * a] * x[0] + s->world_to_grid[4 * a + 1] * x[1] + s->world_to_grid[4 * a + 2] * x[2] + s->world_to_grid[4 * a + 3];
}

static int by_edge(const void *a, const void *b) { return memcmp(a, b, 8); }

static void closed(void **state)
{
    (void)state;
    orl_scene s = sphere();
    mesh m;
    assert_int_equal(mesh_build(&s, &m), ORL_OK);
    size_t n = 4 * (size_t)m.nquads;
    uint32_t (*e)[2] = malloc(n * sizeof *e);
    for (size_t i = 0; i < n; i++) {
        uint32_t a = m.quad[i / 4][i % 4], b = m.quad[i / 4][(i + 1) % 4];
        assert_true(a < m.nverts && b < m.nverts && a != b);
        e[i][0] = a < b ? a : b;
        e[i][1] = a < b ? b : a;
    }
    qsort(e, n, sizeof *e, by_edge);
    for (size_t i = 0; i < n; i += 2) {
        assert_memory_equal(e[i], e[i + 1], 8);
        if (i + 2 < n) assert_memory_not_equal(e[i], e[i + 2], 8);
    }
    assert_int_equal((int)m.nverts - (int)(n / 2) + (int)m.nquads, 2);
    free(e);
    mesh_free(&m);
}

static void on_the_surface(void **state)
{
    (void)state;
    orl_scene s = sphere();
    mesh m;
    assert_int_equal(mesh_build(&s, &m), ORL_OK);
    double worst = 0, least = 1;
    for (uint32_t i = 0; i < m.nverts; i++) {
        double p[3], dot = 0;
        float tip[3];
        to_grid(&s, m.x[i], p);
        worst = fmax(worst, fabs(distance(p)));
        for (int a = 0; a < 3; a++) tip[a] = m.x[i][a] + m.n[i][a];
        double q[3];
        to_grid(&s, tip, q);
        for (int a = 0; a < 3; a++) dot += (q[a] - p[a]) / SCALE * (p[a] - CENTRE[a]) / RADIUS;
        least = fmin(least, dot);
        for (int c = 0; c < 3; c++) assert_int_equal(m.rgb[i][c], (int)(orl_light_encode(128 / 255.0f * 128 / 255.0f) * 255 + 0.5f));
    }
    assert_true(worst < 0.05);
    assert_true(least > 0.98);
    mesh_free(&m);
}

static void ply(void **state)
{
    (void)state;
    orl_scene s = sphere();
    mesh m;
    assert_int_equal(mesh_build(&s, &m), ORL_OK);
    for (int colour = MESH_PLAIN; colour <= MESH_NORMAL; colour++) {
        uint8_t *file;
        size_t bytes, vertex = colour == MESH_PLAIN ? 24 : 27;
        unsigned nv, nf;
        assert_int_equal(mesh_write_ply(at("ball.ply"), &m, &s, (mesh_colour)colour), ORL_OK);
        assert_int_equal(orl_file_read(at("ball.ply"), 1 << 24, &file, &bytes), ORL_OK);
        char *end = memmem(file, bytes, "end_header\n", 11);
        assert_non_null(end);
        assert_int_equal(sscanf(strstr((char *)file, "element vertex"), "element vertex %u", &nv), 1);
        assert_int_equal(sscanf(strstr((char *)file, "element face"), "element face %u", &nf), 1);
        assert_int_equal(!memmem(file, bytes, "property uchar red", 18), colour == MESH_PLAIN);
        const uint8_t *p = (uint8_t *)end + 11;
        assert_int_equal(file + bytes - p, vertex * nv + 17u * nf);
        float x[6];
        memcpy(x, p + vertex * 5, sizeof x);    /* the test runs on little-endian machines */
        assert_memory_equal(x, m.x[5], 12);
        assert_memory_equal(x + 3, m.n[5], 12);
        for (p += vertex * nv; nf--; p += 17) {
            assert_int_equal(p[0], 4);
            uint32_t q[4];
            memcpy(q, p + 1, sizeof q);
            for (int k = 0; k < 4; k++) assert_true(q[k] < nv);
        }
        free(file);
    }
    mesh_free(&m);
    s.nbricks = 0;
    for (int b = 0; b < BRICKS; b++) bmap[b] = -127;
    assert_int_equal(mesh_build(&s, &m), ORL_E_DEGENERATE);
}

int main(void)
{
    const struct CMUnitTest tests[] = { cmocka_unit_test(closed), cmocka_unit_test(on_the_surface), cmocka_unit_test_setup_teardown(ply, scratch_make, scratch_remove) };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
