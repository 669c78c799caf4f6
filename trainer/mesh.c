/* Meshes (mesh.h) by naive surface nets (Gibson 1998): a vertex in each cell with a change of sign, at the mean of the crossings of its edges and then drawn onto the zero of the cell's
 * trilinear SDF; a quad around each edge with a change of sign, where the four cells about it have bricks. And `oriel-train mesh`. */
#include "trainer/mesh.h"
#include <getopt.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include "oriel/image.h"
#include "trainer/commands.h"

enum { CELLS = ORL_BRICK * ORL_BRICK * ORL_BRICK };

typedef struct { const orl_scene *s; mesh *m; uint32_t *index; uint32_t vcap, qcap; } net;     /* index: vertex + 1 of each cell of each brick */

static int brick_of(const orl_scene *s, const int cell[3])
{
    size_t at = 0;
    for (int a = 2; a >= 0; a--) {
        if (cell[a] < 0 || cell[a] >= ORL_BRICK * (int)s->nb[a]) return -1;
        at = at * s->nb[a] + (size_t)(cell[a] / ORL_BRICK);
    }
    return s->bmap[at];
}

static uint32_t vertex_of(const net *t, const int cell[3])
{
    int b = brick_of(t->s, cell);
    return b < 0 ? 0 : t->index[(size_t)b * CELLS + (size_t)(cell[0] % 8 + 8 * (cell[1] % 8) + 64 * (cell[2] % 8))];
}

static int grow(void *array, uint32_t n, uint32_t cap, size_t bytes)   /* array: address of the pointer */
{
    void *p;
    memcpy(&p, array, sizeof p);
    if (n < cap) return 1;
    if (!(p = realloc(p, 2 * (size_t)cap * bytes))) return 0;
    memcpy(array, &p, sizeof p);
    return 1;
}

/* Trilinear value at q in [0, 1]^3 of corner values f[x + 2 y + 4 z], and its gradient. */
static float trilinear(const float f[8], const float q[3], float grad[3])
{
    float v = 0;
    grad[0] = grad[1] = grad[2] = 0;
    for (int k = 0; k < 8; k++) {
        float w[3], d[3];
        for (int a = 0; a < 3; a++) {
            w[a] = k >> a & 1 ? q[a] : 1 - q[a];
            d[a] = k >> a & 1 ? 1 : -1;
        }
        v += f[k] * w[0] * w[1] * w[2];
        grad[0] += f[k] * d[0] * w[1] * w[2];
        grad[1] += f[k] * w[0] * d[1] * w[2];
        grad[2] += f[k] * w[0] * w[1] * d[2];
    }
    return v;
}

static int place_vertex(const float f[8], float q[3])
{
    int n = 0;
    q[0] = q[1] = q[2] = 0;
    for (int a = 0; a < 3; a++)
        for (int k = 0; k < 8; k++) {
            int far = k | 1 << a;
            if (k & 1 << a || (f[k] < 0) == (f[far] < 0)) continue;
            for (int c = 0; c < 3; c++) q[c] += c == a ? f[k] / (f[k] - f[far]) : (float)(k >> c & 1);
            n++;
        }
    if (!n) return 0;
    for (int a = 0; a < 3; a++) q[a] /= (float)n;
    for (int i = 0; i < 4; i++) {
        float g[3], v = trilinear(f, q, g), gg = g[0] * g[0] + g[1] * g[1] + g[2] * g[2];
        for (int a = 0; a < 3 && gg > 1e-6f; a++) q[a] = fminf(fmaxf(q[a] - v * g[a] / gg, 0), 1);
    }
    return 1;
}

static uint8_t to_srgb(float linear)
{
    return (uint8_t)(fminf(orl_light_encode(linear), 1) * 255 + 0.5f);
}

static orl_err brick_vertices(net *t, const int at[3], size_t b)
{
    const int8_t *sdf = t->s->sdf + b * ORL_BRICK_VERTS;
    uint32_t skin = t->s->skin[b];
    mesh *m = t->m;
    for (int i = 0; i < CELLS; i++) {
        int x = i % 8, y = i / 8 % 8, z = i / 64, corner[8];
        float f[8], q[3];
        for (int k = 0; k < 8; k++) {
            corner[k] = x + (k & 1) + 9 * (y + (k >> 1 & 1) + 9 * (z + (k >> 2)));
            f[k] = (float)sdf[corner[k]] / ORL_SDF_UNIT;
        }
        if (!place_vertex(f, q)) continue;
        if (!grow(&m->x, m->nverts, t->vcap, sizeof *m->x) || !grow(&m->rgb, m->nverts, t->vcap, sizeof *m->rgb)) return orl_fail(ORL_E_MEMORY, "mesh: no memory for %u vertices", m->nverts);
        if (m->nverts == t->vcap) t->vcap *= 2;
        float *p = m->x[m->nverts];
        p[0] = (float)(8 * at[0] + x) + q[0];
        p[1] = (float)(8 * at[1] + y) + q[1];
        p[2] = (float)(8 * at[2] + z) + q[2];
        float g[3];
        int32_t grad[3], in[3];
        uint32_t rgb[3];
        trilinear(f, q, g);
        for (int a = 0; a < 3; a++) {
            grad[a] = (int32_t)(g[a] * 65536);
            in[a] = (int32_t)(((float)(a == 0 ? x : a == 1 ? y : z) + q[a]) * 4096);
        }
        int face = orl_skin_face(orl_skin_mask(skin), grad);
        orl_skin_colour(t->s->albedo + (size_t)orl_skin_texture(skin, face) * ORL_SKIN_TEXELS * 3, face, in, rgb);
        for (int c = 0; c < 3; c++) m->rgb[m->nverts][c] = to_srgb((float)rgb[c] / 65535);
        t->index[b * CELLS + (size_t)i] = ++m->nverts;
    }
    return ORL_OK;
}

/* Edges that start at the least corner of this brick's cells. */
static orl_err brick_quads(net *t, const int at[3], size_t b)
{
    const int8_t *sdf = t->s->sdf + b * ORL_BRICK_VERTS;
    static const int STEP[3] = { 1, 9, 81 };
    mesh *m = t->m;
    for (int i = 0; i < CELLS; i++) {
        int p[3] = { i % 8, i / 8 % 8, i / 64 }, v = p[0] + 9 * (p[1] + 9 * p[2]);
        if (!t->index[b * CELLS + (size_t)i]) continue;
        for (int a = 0; a < 3; a++) {
            int solid = sdf[v] < 0, u = (a + 1) % 3, w = (a + 2) % 3, whole = 1;
            if (solid == (sdf[v + STEP[a]] < 0)) continue;
            uint32_t q[4];
            for (int k = 0; k < 4; k++) {       /* around the edge, counter-clockwise seen against its direction */
                int c[3];
                for (int d = 0; d < 3; d++) c[d] = 8 * at[d] + p[d];
                c[u] -= k == 1 || k == 2;
                c[w] -= k >= 2;
                whole &= (q[k] = vertex_of(t, c)) > 0;
            }
            if (!whole) continue;
            if (!grow(&m->quad, m->nquads, t->qcap, sizeof *m->quad)) return orl_fail(ORL_E_MEMORY, "mesh: no memory for %u quads", m->nquads);
            if (m->nquads == t->qcap) t->qcap *= 2;
            for (int k = 0; k < 4; k++) m->quad[m->nquads][k] = q[solid ? k : 3 - k] - 1;
            m->nquads++;
        }
    }
    return ORL_OK;
}

/* Normals from the quads around each vertex, weighted by area; then everything from the grid into the world. */
static void finish(mesh *m, const orl_scene *s)
{
    const double *g = s->world_to_grid;
    double scale2 = g[0] * g[0] + g[1] * g[1] + g[2] * g[2];
    for (uint32_t i = 0; i < m->nquads; i++) {
        float d[2][3];
        const uint32_t *q = m->quad[i];
        for (int a = 0; a < 3; a++) { d[0][a] = m->x[q[2]][a] - m->x[q[0]][a]; d[1][a] = m->x[q[3]][a] - m->x[q[1]][a]; }
        for (int a = 0; a < 3; a++) {
            float n = d[0][(a + 1) % 3] * d[1][(a + 2) % 3] - d[0][(a + 2) % 3] * d[1][(a + 1) % 3];
            for (int k = 0; k < 4; k++) m->n[q[k]][a] += n;
        }
    }
    for (uint32_t i = 0; i < m->nverts; i++) {
        float *x = m->x[i], *n = m->n[i], len = sqrtf(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
        double p[3], q[3];
        for (int a = 0; a < 3; a++) {
            p[a] = x[a] - g[4 * a + 3];
            q[a] = len > 0 ? n[a] / len : a == 2;
        }
        for (int a = 0; a < 3; a++) {
            x[a] = (float)((g[a] * p[0] + g[4 + a] * p[1] + g[8 + a] * p[2]) / scale2);
            n[a] = (float)((g[a] * q[0] + g[4 + a] * q[1] + g[8 + a] * q[2]) / sqrt(scale2));
        }
    }
}

orl_err mesh_build(const orl_scene *s, mesh *out)
{
    mesh m = { 0 };
    net t = { s, &m, calloc((size_t)s->nbricks * CELLS + 1, sizeof *t.index), 4096, 4096 };
    m.x = malloc(t.vcap * sizeof *m.x);
    m.rgb = malloc(t.vcap * sizeof *m.rgb);
    m.quad = malloc(t.qcap * sizeof *m.quad);
    orl_err e = t.index && m.x && m.rgb && m.quad ? ORL_OK : orl_fail(ORL_E_MEMORY, "mesh: no memory for %u bricks", s->nbricks);
    for (int pass = 0; pass < 2; pass++)
        for (size_t i = 0; !e && i < (size_t)s->nb[0] * s->nb[1] * s->nb[2]; i++) {
            int at[3] = { (int)(i % s->nb[0]), (int)(i / s->nb[0] % s->nb[1]), (int)(i / ((size_t)s->nb[0] * s->nb[1])) };
            if (s->bmap[i] >= 0) e = (pass ? brick_quads : brick_vertices)(&t, at, (size_t)s->bmap[i]);
        }
    free(t.index);
    if (!e && !m.nquads) e = orl_fail(ORL_E_DEGENERATE, "mesh: the scene has no surface");
    if (!e && !(m.n = calloc(m.nverts, sizeof *m.n))) e = orl_fail(ORL_E_MEMORY, "mesh: no memory for %u normals", m.nverts);
    if (e) { mesh_free(&m); return e; }
    finish(&m, s);
    *out = m;
    return ORL_OK;
}

void mesh_free(mesh *m)
{
    free(m->x);
    free(m->n);
    free(m->rgb);
    free(m->quad);
    memset(m, 0, sizeof *m);
}

static void put32(uint8_t *p, uint32_t v) { for (int k = 0; k < 4; k++) p[k] = (uint8_t)(v >> 8 * k); }
static void put_float(uint8_t *p, float v) { uint32_t u; memcpy(&u, &v, 4); put32(p, u); }

orl_err mesh_write_ply(const char *path, const mesh *m, const orl_scene *s, mesh_colour colour)
{
    char head[1024];
    size_t vertex = colour == MESH_PLAIN ? 24 : 27;
    int n = snprintf(head, sizeof head, "ply\nformat binary_little_endian 1.0\ncomment Oriel: %s\ncomment frame: world of the COLMAP model, in its units; a cell is %.6g units\nelement vertex %u\n"
                     "property float x\nproperty float y\nproperty float z\nproperty float nx\nproperty float ny\nproperty float nz\n%selement face %u\nproperty list uchar int vertex_indices\nend_header\n",
                     s->title, s->cell_world, m->nverts, colour == MESH_PLAIN ? "" : "property uchar red\nproperty uchar green\nproperty uchar blue\n", m->nquads);
    size_t bytes = (size_t)n + vertex * m->nverts + (size_t)17 * m->nquads;
    uint8_t *file = malloc(bytes), *p = file;
    if (!file) return orl_fail(ORL_E_MEMORY, "%s: no memory for %zu bytes", path, bytes);
    memcpy(p, head, (size_t)n);
    p += n;
    const double *g = s->world_to_grid, scale = sqrt(g[0] * g[0] + g[1] * g[1] + g[2] * g[2]);
    for (uint32_t i = 0; i < m->nverts; i++, p += vertex) {
        for (int a = 0; a < 3; a++) {
            put_float(p + 4 * a, m->x[i][a]);
            put_float(p + 12 + 4 * a, m->n[i][a]);
            if (colour == MESH_BASE) p[24 + a] = m->rgb[i][a];
            if (colour == MESH_NORMAL) {
                double v = (g[4 * a] * m->n[i][0] + g[4 * a + 1] * m->n[i][1] + g[4 * a + 2] * m->n[i][2]) / scale;
                p[24 + a] = (uint8_t)fmin(fmax(127.5 * v + 128, 0), 255);
            }
        }
    }
    for (uint32_t i = 0; i < m->nquads; i++, p += 17) {
        p[0] = 4;
        for (int k = 0; k < 4; k++) put32(p + 1 + 4 * k, m->quad[i][k]);
    }
    orl_err e = orl_file_write(path, file, bytes);
    free(file);
    return e;
}

static const char HELP[] =
    "Usage: oriel-train mesh FILE.oriel -o FILE.ply [options]\n"
    "Writes a scene's surface as a mesh of quads: binary PLY in the frame and units of the COLMAP model.\n\n"
    "  -o, --output FILE     PLY to write\n"
    "      --colour WHAT     base (base colour, default), normal (z up) or none\n"
    "      --help\n";

int cmd_mesh(int argc, char **argv)
{
    static const struct option LONG[] = { { "output", 1, 0, 'o' }, { "colour", 1, 0, 'c' }, { "help", 0, 0, 'h' }, { 0 } };
    static const char *const NAMES[] = { "none", "base", "normal" };
    const char *output = NULL;
    int c, colour = MESH_BASE;
    while ((c = getopt_long(argc, argv, "o:h", LONG, NULL)) != -1) switch (c) {
        case 'o': output = optarg; break;
        case 'c':
            for (colour = 0; colour < 3 && strcmp(NAMES[colour], optarg); colour++) { }
            if (colour == 3) { fprintf(stderr, "oriel-train mesh: --colour %s: none, base or normal\n", optarg); return 2; }
            break;
        case 'h': fputs(HELP, stdout); return 0;
        default: fputs(HELP, stderr); return 2;
    }
    if (optind + 1 != argc || !output) { fputs(HELP, stderr); return 2; }
    orl_scene s = { 0 };
    mesh m = { 0 };
    orl_err e = orl_scene_open(argv[optind], &s);
    if (!e && !s.nbricks) e = orl_fail(ORL_E_DEGENERATE, "%s: holds no surface", argv[optind]);
    if (!e) e = mesh_build(&s, &m);
    if (!e) e = mesh_write_ply(output, &m, &s, (mesh_colour)colour);
    if (e) fprintf(stderr, "oriel-train: %s\n", orl_error_text());
    else printf("%s: %u vertices, %u quads\n", output, m.nverts, m.nquads);
    mesh_free(&m);
    orl_scene_close(&s);
    return e ? 1 : 0;
}
