/* COLMAP models: every camera model through binary and text, comments and line ends, sorted orders, which file wins, photos left out by name; the quartet on each
 * binary file (truncation, extra bytes, counts that lie, wrong references), bad lines of text, flipped bytes. Writes its own binary; needs no COLMAP. */
#include "tests/scratch.h"
#include <math.h>
#include "oriel/colmap.h"
#include "oriel/image.h"

/* A model as COLMAP would hold it: ids neither dense nor ordered. */
typedef struct { uint32_t id; int model; uint64_t w, h; double p[8]; } cam_spec;
typedef struct { double x, y; uint64_t point; } obs_spec;
typedef struct { uint32_t id; double q[4], t[3]; uint32_t cam; char name[300]; int nobs; obs_spec obs[5]; } image_spec;
typedef struct { uint64_t id; double xyz[3]; uint8_t rgb[3]; double error; int ntrack; uint32_t track[4][2]; } point_spec;
typedef struct { int nc, ni, np; cam_spec c[6]; image_spec i[6]; point_spec p[6]; } model;

#define NONE UINT64_MAX
static const int NPARAMS[] = { 3, 4, 4, 5, 8 };
static const char *const NAMES[] = { "SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV" };
static const char *const PARTS[] = { "cameras", "images", "points3D" };

static const model GOOD = {
    5, 5, 4,
    { { 70, 4, 640, 480, { 500.125, 510.5, 320.25, 240.75, -0.1, 0.03, 1e-3, -2e-3 } },
      { 3, 0, 1000, 750, { 800.12345678901234, 500, 375 } },
      { 4000000000u, 2, 65535, 1, { 70000, 32767.5, 0.5, 0.0123456789012345678 } },
      { 12, 1, 320, 240, { 250, 255, 161, 119 } },
      { 5, 3, 1024, 768, { 900.3, 511, 385, -0.05, 0.25 } } },
    { { 9, { 0.5, -0.5, 0.5, 0.5 }, { 1, 2, 3 }, 12, "dusk.jpg", 3, { { 1.5, 2.25, 90 }, { 100.1, 7, NONE }, { 3, 4, 1ull << 40 } } },
      { 2, { 2, 0, 0, 0 }, { -0.125, 1e-9, 1e9 }, 4000000000u, "sub/a photo.jpg", 0, { { 0, 0, 0 } } },
      { 4000000001u, { 0.1, 0.7, -0.2, 0.4 }, { 0, 0, 0 }, 70, "Bell.JPG", 4, { { 0, 0, 7 }, { 639.5, 479.5, 90 }, { 12, 13, 12345 }, { 5, 6, 3 } } },
      { 1, { -3, 1, 1, 1 }, { 4, 5, 6 }, 3, "10.png", 2, { { 8, 9, 7 }, { -1.5, 1e6, 90 } } },
      { 77, { 1, 1e-8, 0, 0 }, { 0, 0, -1 }, 5, "9.png", 0, { { 0, 0, 0 } } } },
    { { 90, { 1.1, -2.2, 3.3 }, { 255, 0, 128 }, 0.75, 3, { { 9, 0 }, { 4000000001u, 1 }, { 1, 1 } } },
      { 7, { 1e-30, 0, -0.0 }, { 1, 2, 3 }, 0.5, 2, { { 4000000001u, 0 }, { 1, 0 } } },
      { 1ull << 40, { 1e6, 1e7, -1e8 }, { 4, 5, 6 }, 1.25, 1, { { 9, 2 } } },
      { 3, { 0, 0, 1 }, { 0, 0, 0 }, 0, 1, { { 4000000001u, 3 } } } },
};

/* Bytes of a file to be. */
static struct { uint8_t p[8192]; size_t n; } b;
static void le(uint64_t v, int n) { for (; n--; v >>= 8) b.p[b.n++] = (uint8_t)v; }
static void f64(double d) { uint64_t v; memcpy(&v, &d, 8); le(v, 8); }

/* COLMAP's binary files by its own documentation (https://colmap.github.io/format.html). part: 0 cameras, 1 images, 2 points. */
static void binary(const model *m, int part)
{
    b.n = 0;
    le((uint64_t)(part == 0 ? m->nc : part == 1 ? m->ni : m->np), 8);
    for (const cam_spec *c = m->c; part == 0 && c < m->c + m->nc; c++) {
        le(c->id, 4); le((uint32_t)c->model, 4); le(c->w, 8); le(c->h, 8);
        for (int k = 0; k < NPARAMS[c->model >= 0 && c->model < 5 ? c->model : 0]; k++) f64(c->p[k]);
    }
    for (const image_spec *i = m->i; part == 1 && i < m->i + m->ni; i++) {
        le(i->id, 4);
        for (int k = 0; k < 4; k++) f64(i->q[k]);
        for (int k = 0; k < 3; k++) f64(i->t[k]);
        le(i->cam, 4);
        for (const char *s = i->name; ; s++) { le((uint8_t)*s, 1); if (!*s) break; }
        le((uint64_t)i->nobs, 8);
        for (int k = 0; k < i->nobs; k++) { f64(i->obs[k].x); f64(i->obs[k].y); le(i->obs[k].point, 8); }
    }
    for (const point_spec *p = m->p; part == 2 && p < m->p + m->np; p++) {
        le(p->id, 8);
        for (int k = 0; k < 3; k++) f64(p->xyz[k]);
        for (int k = 0; k < 3; k++) le(p->rgb[k], 1);
        f64(p->error);
        le((uint64_t)p->ntrack, 8);
        for (int k = 0; k < p->ntrack; k++) { le(p->track[k][0], 4); le(p->track[k][1], 4); }
    }
}

static void say(const char *fmt, ...)
{
    va_list ap;
    va_start(ap, fmt);
    b.n += (size_t)vsnprintf((char *)b.p + b.n, sizeof b.p - b.n, fmt, ap);
    va_end(ap);
}

/* Text: nl ends a line; noise adds comments and blank lines where COLMAP allows them. */
static void text(const model *m, int part, const char *nl, int noise)
{
    b.n = 0;
    if (noise) say("# by hand%s%s#%s \t %s", nl, nl, nl, nl);
    for (const cam_spec *c = m->c; part == 0 && c < m->c + m->nc; c++) {
        say("%u %s %llu %llu", c->id, NAMES[c->model], (unsigned long long)c->w, (unsigned long long)c->h);
        for (int k = 0; k < NPARAMS[c->model]; k++) say(" %.17g", c->p[k]);
        say("%s%s", nl, noise ? nl : "");
    }
    for (const image_spec *i = m->i; part == 1 && i < m->i + m->ni; i++) {
        say("%u", i->id);
        for (int k = 0; k < 4; k++) say(" %.17g", i->q[k]);
        for (int k = 0; k < 3; k++) say(noise ? "  %.17g" : " %.17g", i->t[k]);
        say(" %u %s%s", i->cam, i->name, nl);
        if (noise) say("# its observations:%s", nl);
        for (int k = 0; k < i->nobs; k++) say("%s%.17g %.17g %lld", k ? " " : "", i->obs[k].x, i->obs[k].y, (long long)i->obs[k].point);
        say("%s", nl);
        if (noise) say("%s# next%s", nl, nl);
    }
    for (const point_spec *p = m->p; part == 2 && p < m->p + m->np; p++) {
        say("%llu %.17g %.17g %.17g %d %d %d %.17g", (unsigned long long)p->id, p->xyz[0], p->xyz[1], p->xyz[2], p->rgb[0], p->rgb[1], p->rgb[2], p->error);
        for (int k = 0; k < p->ntrack; k++) say(" %u %u", p->track[k][0], p->track[k][1]);
        say("%s", nl);
    }
}

static void write_part(const char *dir, int part, const char *ending) { put_bytes(at("%s/%s.%s", dir, PARTS[part], ending), b.p, b.n); }
static void write_binary(const char *dir, const model *m) { for (int k = 0; k < 3; k++) { binary(m, k); write_part(dir, k, "bin"); } }
static void write_text(const char *dir, const model *m, const char *nl, int noise) { for (int k = 0; k < 3; k++) { text(m, k, nl, noise); write_part(dir, k, "txt"); } }

static warnings warn;
static orl_err read_dir(const char *dir, orl_colmap *m) { warn.n = 0; return orl_colmap_read(at("%s", dir), on_warn, &warn, m); }

/* Refused, output untouched, the words named. */
#define REFUSED(dir, want, ...) do { \
    orl_colmap r_, was_; \
    memset(&r_, 0x5a, sizeof r_); \
    was_ = r_; \
    failed(read_dir(dir, &r_), want, __VA_ARGS__, NULL); \
    assert_memory_equal(&r_, &was_, sizeof r_); \
} while (0)

static void rotate(const double q[4], const double v[3], double out[3])    /* v + 2 u x (u x v + w v), q of any length */
{
    double n = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]), w = q[0] / n, u[3] = { q[1] / n, q[2] / n, q[3] / n }, a[3];
    for (int i = 0; i < 3; i++) { int j = (i + 1) % 3, k = (i + 2) % 3; a[i] = u[j] * v[k] - u[k] * v[j] + w * v[i]; }
    for (int i = 0; i < 3; i++) { int j = (i + 1) % 3, k = (i + 2) % 3; out[i] = v[i] + 2 * (u[j] * a[k] - u[k] * a[j]); }
}

static int point_rank(const model *m, uint64_t id)
{
    int at_ = -1, below = 0;
    for (int k = 0; k < m->np; k++) { below += m->p[k].id < id; if (m->p[k].id == id) at_ = k; }
    return at_ < 0 ? -1 : below;
}

/* What was read is the model: cameras in file order, images by name, points by id, observations of each image in their order. */
static void check(const orl_colmap *r, const model *m)
{
    assert_int_equal(r->ncameras, m->nc);
    assert_int_equal(r->nimages, m->ni);
    assert_int_equal(r->npoints, m->np);
    for (int k = 0; k < m->nc; k++) {
        const cam_spec *s = &m->c[k];
        const orl_camera *c = &r->cameras[k];
        const double *p = s->p;
        assert_int_equal(c->model, s->model);
        assert_int_equal(c->w, s->w);
        assert_int_equal(c->h, s->h);
        double want[5][8] = { { p[0], p[0], p[1], p[2] }, { p[0], p[1], p[2], p[3] }, { p[0], p[0], p[1], p[2], p[3] }, { p[0], p[0], p[1], p[2], p[3], p[4] },
                              { p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7] } };
        double got[8] = { c->fx, c->fy, c->cx, c->cy, c->k1, c->k2, c->p1, c->p2 };
        for (int a = 0; a < 8; a++) assert_true(got[a] == want[s->model][a]);
    }
    uint32_t nobs = 0;
    for (int k = 0; k < m->ni; k++) {
        const image_spec *s = &m->i[k];
        int rank = 0;
        for (int j = 0; j < m->ni; j++) rank += strcmp(m->i[j].name, s->name) < 0;
        const orl_colmap_image *im = &r->images[rank];
        assert_string_equal(im->name, s->name);
        assert_int_equal(im->id, s->id);
        assert_true(im->camera >= 0 && im->camera < m->nc);
        assert_int_equal(m->c[im->camera].id, s->cam);
        for (int a = 0; a < 3; a++) {
            double e[3] = { a == 0, a == 1, a == 2 }, v[3];
            rotate(s->q, e, v);
            for (int i = 0; i < 3; i++) assert_true(fabs(im->pose.R[3 * i + a] - v[i]) < 1e-14);
            assert_true(im->pose.t[a] == s->t[a]);
        }
        assert_int_equal(im->obs_count, s->nobs);
        assert_true(im->obs_begin + im->obs_count <= r->nobs);
        for (int j = 0; j < s->nobs; j++) {
            const orl_colmap_obs *o = &r->obs[im->obs_begin + (uint32_t)j];
            assert_true(o->x == (float)s->obs[j].x && o->y == (float)s->obs[j].y);
            assert_int_equal(o->point, point_rank(m, s->obs[j].point));
        }
        nobs += (uint32_t)s->nobs;
    }
    assert_int_equal(r->nobs, nobs);
    for (int k = 0; k < m->np; k++) {
        const point_spec *s = &m->p[k];
        const orl_colmap_point *p = &r->points[point_rank(m, s->id)];
        for (int a = 0; a < 3; a++) { assert_true(p->xyz[a] == s->xyz[a]); assert_int_equal(p->rgb[a], s->rgb[a]); }
        assert_true(p->error_px == (float)s->error);
        assert_int_equal(p->track_length, s->ntrack);
    }
}

/* Two models read are the same in every field; turn bounds the difference of rotations. */
static void same(const orl_colmap *x, const orl_colmap *y, double turn)
{
    assert_int_equal(x->ncameras, y->ncameras);
    assert_int_equal(x->nimages, y->nimages);
    assert_int_equal(x->npoints, y->npoints);
    assert_int_equal(x->nobs, y->nobs);
    for (uint32_t k = 0; k < x->ncameras; k++) {
        const orl_camera *c = &x->cameras[k], *d = &y->cameras[k];
        assert_true(c->model == d->model && c->w == d->w && c->h == d->h && c->fx == d->fx && c->fy == d->fy && c->cx == d->cx && c->cy == d->cy);
        assert_true(c->k1 == d->k1 && c->k2 == d->k2 && c->p1 == d->p1 && c->p2 == d->p2);
    }
    for (uint32_t k = 0; k < x->nimages; k++) {
        const orl_colmap_image *i = &x->images[k], *j = &y->images[k];
        assert_string_equal(i->name, j->name);
        assert_true(i->id == j->id && i->camera == j->camera && i->obs_count == j->obs_count);
        for (int a = 0; a < 9; a++) assert_true(fabs(i->pose.R[a] - j->pose.R[a]) <= turn);
        for (int a = 0; a < 3; a++) assert_true(i->pose.t[a] == j->pose.t[a]);
        for (uint32_t n = 0; n < i->obs_count; n++) {
            const orl_colmap_obs *o = &x->obs[i->obs_begin + n], *p = &y->obs[j->obs_begin + n];
            assert_true(o->x == p->x && o->y == p->y && o->point == p->point);
        }
    }
    for (uint32_t k = 0; k < x->npoints; k++) {
        const orl_colmap_point *p = &x->points[k], *q = &y->points[k];
        for (int a = 0; a < 3; a++) assert_true(p->xyz[a] == q->xyz[a] && p->rgb[a] == q->rgb[a]);
        assert_true(p->error_px == q->error_px && p->track_length == q->track_length);
    }
}

static void reads_binary(void **state)
{
    (void)state;
    orl_colmap r;
    write_binary("m", &GOOD);
    ok(read_dir("m", &r));
    assert_int_equal(warn.n, 0);
    check(&r, &GOOD);
    orl_colmap_free(&r);
    assert_null(r.cameras);
    assert_int_equal(r.nimages, 0);
    orl_colmap_free(&r);            /* idempotent */
}

static void reads_text(void **state)
{
    (void)state;
    orl_colmap r, bin;
    write_binary("b", &GOOD);
    ok(read_dir("b", &bin));
    for (int k = 0; k < 4; k++) {
        write_text("m", &GOOD, k & 1 ? "\r\n" : "\n", k & 2);
        ok(read_dir("m", &r));
        assert_int_equal(warn.n, 0);
        check(&r, &GOOD);
        same(&r, &bin, 0);
        orl_colmap_free(&r);
    }
    /* The last line may lack its end, and the last image its line of observations (it has none). */
    for (int part = 0; part < 3; part++) {
        text(&GOOD, part, "\n", 0);
        while (b.p[b.n - 1] == '\n') b.n--;
        write_part("m", part, "txt");
    }
    ok(read_dir("m", &r));
    check(&r, &GOOD);
    orl_colmap_free(&r);
    orl_colmap_free(&bin);
}

static void writes_text(void **state)
{
    (void)state;
    orl_colmap x, y;
    write_binary("b", &GOOD);
    ok(read_dir("b", &x));
    make_way(at("t/x"));
    ok(orl_colmap_write_text(at("t"), &x));
    assert_int_equal(entries(at("t")), 3);
    ok(read_dir("t", &y));
    same(&x, &y, 1e-15);
    /* Tracks name the image's id and the place of the observation in it: point 4 (id 90) is seen by 1 (second), 9 (first), 4000000001 (second). */
    uint8_t *bytes;
    size_t n;
    ok(orl_file_read(at("t/points3D.txt"), 1 << 20, &bytes, &n));
    assert_non_null(strstr((char *)bytes, "\n3 1.1000000000000001 -2.2000000000000002 3.2999999999999998 255 0 128 0.75 1 1 9 0 4000000001 1\n"));
    free(bytes);
    failed(orl_colmap_write_text(at("nowhere"), &x), ORL_E_IO, "nowhere/cameras.txt", NULL);
    orl_colmap_free(&x);
    orl_colmap_free(&y);
    /* Nothing at all is a model too. */
    memset(&x, 0, sizeof x);
    ok(orl_colmap_write_text(at("t"), &x));
    ok(read_dir("t", &y));
    assert_int_equal(y.ncameras + y.nimages + y.npoints + y.nobs, 0);
    orl_colmap_free(&y);
}

/* A long model: buffers grow, orders hold, whatever the order of the records. */
static void any_order(void **state)
{
    (void)state;
    enum { N = 700 };
    static orl_colmap_image im[N];
    static orl_colmap_point pt[N];
    static orl_colmap_obs ob[3 * N];
    orl_camera cam;
    ok(orl_camera_from_params(&cam, 0, 640, 480, (double[3]){ 500, 320, 240 }, 3));
    orl_colmap m = { &cam, 1, im, N, ob, 3 * N, pt, N }, x, y;
    for (int k = 0; k < N; k++) {
        for (int a = 0; a < 3; a++) pt[k].xyz[a] = uniform(-9, 9);
        pt[k].error_px = (float)k;
        snprintf(im[k].name, sizeof im[k].name, "%d.jpg", k * 7919 % 9973);
        im[k].id = (uint32_t)(k + 1);
        ok(orl_pose_from_quat(&im[k].pose, (double[4]){ uniform(-1, 1), uniform(-1, 1), 1, uniform(-1, 1) }, (double[3]){ k, 0, 0 }));
        im[k].obs_begin = (uint32_t)(3 * k);
        im[k].obs_count = 3;
        for (int j = 0; j < 3; j++) ob[3 * k + j] = (orl_colmap_obs){ (float)j, (float)k, (k + 31 * j) % N };
    }
    make_way(at("t/x"));
    ok(orl_colmap_write_text(at("t"), &m));
    ok(read_dir("t", &x));
    assert_int_equal(x.nimages, N);
    assert_int_equal(x.npoints, N);
    for (uint32_t k = 0; k < N; k++) {
        if (k) assert_true(strcmp(x.images[k - 1].name, x.images[k].name) < 0);
        const orl_colmap_image *r = &x.images[k], *w = &im[(int)r->pose.t[0]];
        assert_string_equal(r->name, w->name);
        assert_true(x.points[k].error_px == (float)k);      /* ids were given in order */
        assert_int_equal(x.points[k].track_length, 3);
        for (uint32_t j = 0; j < 3; j++) assert_int_equal(x.obs[r->obs_begin + j].point, ob[w->obs_begin + j].point);
    }
    /* The lines of points3D and the pairs of images backwards. */
    for (int part = 1; part < 3; part++) {
        uint8_t *bytes;
        size_t n;
        ok(orl_file_read(at("t/%s.txt", PARTS[part]), 1 << 24, &bytes, &n));
        char *out = malloc(n + 1), *line[2 * N + 1];
        int lines = 0;
        for (char *s = strtok((char *)bytes, "\n"); s; s = strtok(NULL, "\n")) if (*s != '#') line[lines++] = s;
        assert_int_equal(lines, part == 1 ? 2 * N : N);
        size_t k = 0;
        for (int i = lines - (part == 1 ? 2 : 1); i >= 0; i -= part == 1 ? 2 : 1)
            for (int j = 0; j < (part == 1 ? 2 : 1); j++) k += (size_t)sprintf(out + k, "%s\n", line[i + j]);
        put_bytes(at("t/%s.txt", PARTS[part]), out, k);
        free(out);
        free(bytes);
    }
    ok(read_dir("t", &y));
    same(&x, &y, 0);
    orl_colmap_free(&x);
    orl_colmap_free(&y);
}

static void which_file(void **state)
{
    (void)state;
    orl_colmap r;
    model other = GOOD;
    other.c[0].p[0] = 444;
    strcpy(other.i[0].name, "other.jpg");
    other.p[0].xyz[0] = 4;
    /* Binary wins, part by part. */
    for (int parts = 0; parts < 8; parts++) {
        model want = GOOD;
        write_text("m", &GOOD, "\n", 0);
        for (int k = 0; k < 3; k++) {
            if (!(parts >> k & 1)) { unlink(at("m/%s.bin", PARTS[k])); continue; }
            binary(&other, k);
            write_part("m", k, "bin");
        }
        if (parts & 1) want.c[0] = other.c[0];
        if (parts & 2) want.i[0] = other.i[0];
        if (parts & 4) want.p[0] = other.p[0];
        ok(read_dir("m", &r));
        check(&r, &want);
        orl_colmap_free(&r);
    }
    /* A broken binary file is not passed over. */
    put_text(at("m/points3D.bin"), "");
    REFUSED("m", ORL_E_FORMAT, "points3D.bin");
    /* Points may be absent; cameras and images may not. */
    for (int k = 0; k < 2; k++) {
        model none = GOOD;
        none.np = 0;
        write_binary("p", &GOOD);
        if (k) write_text("p", &GOOD, "\n", 0), unlink(at("p/cameras.bin")), unlink(at("p/images.bin")), unlink(at("p/points3D.txt"));
        unlink(at("p/points3D.bin"));
        ok(read_dir("p", &r));
        check(&r, &none);
        orl_colmap_free(&r);
    }
    for (int k = 0; k < 2; k++) {
        write_binary("q", &GOOD);
        unlink(at("q/%s.bin", PARTS[k]));
        REFUSED("q", ORL_E_IO, at("q"));
    }
    REFUSED("nowhere", ORL_E_IO, at("nowhere"));
}

/* Each length that is too short is refused; the file and a field are named. */
static void truncated(void **state)
{
    (void)state;
    for (int part = 0; part < 3; part++) {
        write_binary("m", &GOOD);
        binary(&GOOD, part);
        for (size_t n = 0; n < b.n; n++) {
            put_bytes(at("m/%s.bin", PARTS[part]), b.p, n);
            char file[32];
            snprintf(file, sizeof file, "%s.bin: ", PARTS[part]);
            REFUSED("m", ORL_E_FORMAT, file, n < 8 ? " count at byte 0" : " at byte ", part == 0 ? "camera " : part == 2 ? "point " : "");
            assert_true(part != 1 || strstr(orl_error_text(), ": image ") || strstr(orl_error_text(), ": observation"));
            unsigned long byte = strtoul(strstr(orl_error_text(), " at byte ") + 9, NULL, 10);
            assert_true(byte <= n);
        }
    }
}

/* COLMAP reads as many records as were announced; what follows is nobody's. */
static void extra_bytes(void **state)
{
    (void)state;
    orl_colmap r;
    for (int part = 0; part < 3; part++)
        for (int more = 1; more <= 200; more += more < 9 ? 1 : 37) {
            write_binary("m", &GOOD);
            binary(&GOOD, part);
            for (int k = 0; k < more; k++) b.p[b.n + (size_t)k] = (uint8_t)(more & 1 ? 0xff : 0);
            b.n += (size_t)more;
            write_part("m", part, "bin");
            ok(read_dir("m", &r));
            check(&r, &GOOD);
            orl_colmap_free(&r);
        }
}

/* A count is compared with the bytes that remain as soon as it is read: the error stands right behind it. */
static void counts_that_lie(void **state)
{
    (void)state;
    static const uint64_t LIE[] = { 1u << 16, 1u << 31, 0xffffffffu, 1ull << 32, (1ull << 32) + 1, (1ull << 61) + 1, 1ull << 63, UINT64_MAX, UINT64_MAX / 24 + 2, UINT64_MAX / 51 + 2, UINT64_MAX / 8 + 2 };
    size_t image0 = 8 + 4 + 56 + 4 + strlen(GOOD.i[0].name) + 1, point0 = 8 + 8 + 24 + 3 + 8;
    const struct { int part; size_t offset; const char *field; } COUNT[] = {
        { 0, 0, "camera count" }, { 1, 0, "image count" }, { 2, 0, "point count" }, { 1, image0, "observation count" }, { 2, point0, "point track length" },
    };
    for (size_t k = 0; k < sizeof COUNT / sizeof *COUNT; k++)
        for (size_t i = 0; i < sizeof LIE / sizeof *LIE; i++) {
            char where[64];
            write_binary("m", &GOOD);
            binary(&GOOD, COUNT[k].part);
            size_t n = b.n;
            b.n = COUNT[k].offset;
            le(LIE[i], 8);
            b.n = n;
            write_part("m", COUNT[k].part, "bin");
            snprintf(where, sizeof where, "%s.bin: %s at byte %zu", PARTS[COUNT[k].part], COUNT[k].field, COUNT[k].offset + 8);
            REFUSED("m", ORL_E_FORMAT, where);
        }
    /* One too many, small enough to pass that test where a record is longer than the shortest: runs out of bytes instead. */
    for (int part = 0; part < 3; part++) {
        write_binary("m", &GOOD);
        binary(&GOOD, part);
        b.p[0]++;
        write_part("m", part, "bin");
        REFUSED("m", ORL_E_FORMAT, PARTS[part]);
    }
}

static void unknown_models(void **state)
{
    (void)state;
    static const int ID[] = { 5, 6, 10, 255, 65536, -1, INT32_MIN };
    for (size_t k = 0; k < sizeof ID / sizeof *ID; k++) {
        char name[32];
        model m = GOOD;
        m.c[1].model = ID[k];
        write_binary("m", &m);
        snprintf(name, sizeof name, "model %d", ID[k]);
        REFUSED("m", ORL_E_UNSUPPORTED, "cameras.bin", "camera 3", name);
    }
    write_text("t", &GOOD, "\n", 0);
    put_text(at("t/cameras.txt"), "3 OPENCV_FISHEYE 640 480 1 2 3 4 5 6 7 8\n");
    REFUSED("t", ORL_E_UNSUPPORTED, "cameras.txt", "camera 3", "OPENCV_FISHEYE");
}

/* The model without its image k: what a reader leaves. */
static model without(int k)
{
    model m = GOOD;
    memmove(m.i + k, m.i + k + 1, sizeof *m.i * (size_t)(m.ni - k - 1));
    m.ni--;
    return m;
}

/* In binary and in text: the image is named, the reason too, and the others stay. */
static void leaves_out(const model *m, int k, const char *reason, int lines)
{
    model want = without(k);
    for (int text_ = 0; text_ < 2; text_++) {
        orl_colmap r;
        if (text_) write_text("lt", m, "\n", 0);
        else write_binary("lb", m);
        ok(read_dir(text_ ? "lt" : "lb", &r));
        if (warn.n != lines || warned(&warn, GOOD.i[k].name, reason) != 1) fail_msg("%d lines, wanted %s for %s: %s", warn.n, reason, GOOD.i[k].name, warn.n ? warn.line[warn.n - 1] : "");
        for (int j = 0; j < GOOD.nc; j++) if (m->c[j].id != GOOD.i[k].cam || lines == 1) want.c[j] = GOOD.c[j]; else memset(&want.c[j], 0, sizeof *want.c), want.c[j].id = m->c[j].id;
        if (lines == 2) {           /* the camera's place remains, so that indices hold; nothing points at it */
            for (uint32_t i = 0; i < r.nimages; i++) assert_int_not_equal(want.c[r.images[i].camera].w, 0);
            for (int j = 0; j < want.nc; j++) if (!want.c[j].w) r.cameras[j] = (orl_camera){ 0 };
        }
        check(&r, &want);
        orl_colmap_free(&r);
        ok(orl_colmap_read(at(text_ ? "lt" : "lb"), NULL, NULL, &r));       /* nobody listens */
        assert_int_equal(r.nimages, want.ni);
        orl_colmap_free(&r);
    }
}

static void photos_left_out(void **state)
{
    (void)state;
    model m = GOOD;
    m.i[2].cam = 71;
    leaves_out(&m, 2, "camera is missing", 1);
    static const double FOCAL[] = { 0, -800, 1e9, 1e-3, 1e300, 49.9, 100001, (double)NAN, (double)INFINITY };
    for (size_t k = 0; k < sizeof FOCAL / sizeof *FOCAL; k++) {
        m = GOOD;
        m.c[1].p[0] = FOCAL[k];
        leaves_out(&m, 3, "camera is absurd", 2);
        assert_int_equal(warned(&warn, "camera 3 is left out", isfinite(FOCAL[k]) ? "focal length" : "not finite"), 1);
    }
    static const uint64_t SIDE[] = { 0, 65536, (1ull << 32) + 1000, 1ull << 63, UINT64_MAX };
    for (size_t k = 0; k < 2 * (sizeof SIDE / sizeof *SIDE); k++) {
        m = GOOD;
        *(k & 1 ? &m.c[1].w : &m.c[1].h) = SIDE[k / 2];
        leaves_out(&m, 3, "camera is absurd", 2);
        assert_int_equal(warned(&warn, "camera 3 is left out", "image size"), 1);
    }
    static const double Q[][4] = { { 0, 0, 0, 0 }, { 1e-200, 0, 0, 1e-200 }, { (double)NAN, 0, 0, 0 }, { 1, 0, (double)INFINITY, 0 } };
    for (int k = 0; k < 5; k++)
        for (size_t j = 0; j < sizeof Q / sizeof *Q; j++) {
            m = GOOD;
            memcpy(m.i[k].q, Q[j], sizeof Q[j]);
            leaves_out(&m, k, "singular", 1);
        }
    m = GOOD;
    m.i[0].t[1] = (double)NAN;
    leaves_out(&m, 0, "translation", 1);
}

/* Ids and names are keys: two records under one are refused, for no order between them would repeat. */
static void duplicates(void **state)
{
    (void)state;
    for (int text_ = 0; text_ < 2; text_++)
        for (int k = 0; k < 3; k++) {
            model m = GOOD;
            if (k == 0) m.c[4].id = m.c[0].id;
            if (k == 1) strcpy(m.i[3].name, m.i[0].name);
            if (k == 2) m.p[3].id = m.p[0].id;
            if (text_) write_text("t", &m, "\n", 0);
            else write_binary("b", &m);
            REFUSED(text_ ? "t" : "b", ORL_E_FORMAT, PARTS[k], k == 0 ? "camera 70" : k == 1 ? "dusk.jpg" : "point 90", "twice");
        }
}

static void values_that_are_none(void **state)
{
    (void)state;
    for (int text_ = 0; text_ < 2; text_++) {
        orl_colmap r;
        model m = GOOD, want;
        m.p[0].xyz[1] = (double)NAN;                    /* dropped: a point that is nowhere */
        m.p[1].error = (double)NAN;                     /* 0 */
        m.p[3].error = -1;
        m.i[2].obs[3].x = (double)INFINITY;             /* seen nowhere: belongs to no point */
        m.i[3].obs[0].y = (double)NAN;
        want = m;
        want.p[0] = want.p[3];
        want.np = 3;
        want.p[1].error = want.p[0].error = 0;
        want.i[2].obs[3] = (obs_spec){ 0, 0, NONE };
        want.i[3].obs[0] = (obs_spec){ 0, 0, NONE };
        if (text_) write_text("t", &m, "\n", 0);
        else write_binary("b", &m);
        ok(read_dir(text_ ? "t" : "b", &r));
        check(&r, &want);
        orl_colmap_free(&r);
    }
}

static void names(void **state)
{
    (void)state;
    orl_colmap r;
    model m = GOOD;
    memset(m.i[1].name, 'n', 255);
    m.i[1].name[255] = 0;
    for (int text_ = 0; text_ < 2; text_++) {           /* the longest that fits */
        if (text_) write_text("t", &m, "\n", 0);
        else write_binary("b", &m);
        ok(read_dir(text_ ? "t" : "b", &r));
        check(&r, &m);
        orl_colmap_free(&r);
    }
    strcpy(m.i[1].name + 255, "n");
    for (int k = 0; k < 2; k++) {                       /* too long, none */
        write_text("t", &m, "\n", 0);
        write_binary("b", &m);
        REFUSED("t", ORL_E_FORMAT, "images.txt", "image name");
        REFUSED("b", ORL_E_FORMAT, "images.bin", "image name");
        m.i[1].name[0] = 0;
    }
}

static void bad_lines(void **state)
{
    (void)state;
    static const struct { int part; const char *text, *field; } BAD[] = {
        { 0, "x", "camera id" }, { 0, "4294967308 PINHOLE 640 480 500 500 320 240", "camera id" }, { 0, "-1 PINHOLE 640 480 500 500 320 240", "camera id" }, { 0, "1 PINHOLE", "camera line" }, { 0, "1 PINHOLE 640", "camera line" }, { 0, "1 PINHOLE w 480 500 500 320 240", "camera line" },
        { 0, "1 PINHOLE 640 480 500 500 320", "camera parameter" }, { 0, "1 PINHOLE 640 480 500 500 320 z", "camera parameter" },
        { 1, "x", "image id" }, { 1, "4294967297 1 0 0 0 0 0 0 3 a.jpg", "image id" }, { 1, "1", "image quaternion" }, { 1, "1 1 0 0\n\n", "image quaternion" }, { 1, "1 1 0 0 0 0 0", "image translation" }, { 1, "1 1 0 0 0 0 0 0", "image camera" },
        { 1, "1 1 0 0 0 0 0 0 cam a.jpg", "image camera" }, { 1, "1 1 0 0 0 0 0 0 -1 a.jpg", "image camera" }, { 1, "1 1 0 0 0 0 0 0 1e30 a.jpg", "image camera" },
        { 1, "1 1 0 0 0 0 0 0 nan a.jpg", "image camera" }, { 1, "1 1 0 0 0 0 0 0 3", "image name" }, { 1, "1 1 0 0 0 0 0 0 3  \n", "image name" },
        { 1, "1 1 0 0 0 0 0 0 3 a.jpg\n1 2", "image observation" }, { 1, "1 1 0 0 0 0 0 0 3 a.jpg\n1 2 -1 5", "image observation" },
        { 1, "1 1 0 0 0 0 0 0 3 a.jpg\n1 x -1", "image observation" }, { 1, "1 1 0 0 0 0 0 0 3 a.jpg\n1 2 -1 rest", "image observation" },
        { 1, "1 1 0 0 0 0 0 0 3 a.jpg\n2 1 0 0 0 0 0 0 3 b.jpg", "image observation" },    /* the line of observations was dropped */
        { 2, "1", "point position" }, { 2, "x", "point position" }, { 2, "1 0 0 z", "point position" }, { 2, "1 0 0 0 1 2", "point colour" }, { 2, "1 0 0 0 256 0 0 0", "point colour" },
        { 2, "1 0 0 0 0 -1 0 0", "point colour" }, { 2, "1 0 0 0 0 0 nan 0", "point colour" }, { 2, "1 0 0 0 1 2 3", "point error" },
    };
    for (size_t k = 0; k < sizeof BAD / sizeof *BAD; k++) {
        char file[32];
        write_text("t", &GOOD, "\n", 0);
        put_text(at("t/%s.txt", PARTS[BAD[k].part]), BAD[k].text);
        snprintf(file, sizeof file, "%s.txt", PARTS[BAD[k].part]);
        REFUSED("t", ORL_E_FORMAT, file, BAD[k].field);
    }
    /* Sizes beyond any int are no sizes; they do not wrap into good ones. */
    orl_colmap r;
    write_text("t", &GOOD, "\n", 0);
    put_text(at("t/cameras.txt"), "12 PINHOLE 4294967936 480 500 500 320 240\n70 PINHOLE -640 480 500 500 320 240\n3 PINHOLE 640 99999999999999999999999 500 500 320 240\n");
    ok(read_dir("t", &r));
    assert_int_equal(warned(&warn, "camera 12 is left out", "image size"), 1);
    assert_int_equal(warned(&warn, "camera 3 is left out", "image size"), 1);
    assert_int_equal(warned(&warn, "camera 70 is left out", "image size"), 1);
    assert_int_equal(r.nimages, 0);
    orl_colmap_free(&r);
}

/* Flipped bytes, sometimes cut or doubled: an error or a model whose every index holds. */
static void random_bytes(void **state)
{
    (void)state;
    seed_print();
    uint8_t was[3][2][8192];
    size_t len[3][2];
    int read_ = 0, refused = 0;
    for (int part = 0; part < 3; part++)
        for (int text_ = 0; text_ < 2; text_++) {
            if (text_) text(&GOOD, part, "\n", 1);
            else binary(&GOOD, part);
            memcpy(was[part][text_], b.p, len[part][text_] = b.n);
        }
    write_binary("b", &GOOD);
    write_text("t", &GOOD, "\n", 1);
    for (int round = 0; round < 6000; round++) {
        int part = (int)(rnd() % 3), text_ = round & 1;
        orl_colmap r;
        memcpy(b.p, was[part][text_], b.n = len[part][text_]);
        for (uint32_t k = rnd() % 6 + 1; k--;) {
            uint32_t where = rnd() % (uint32_t)b.n;
            switch (rnd() % 4) {
            case 0: b.p[where] = (uint8_t)rnd(); break;
            case 1: b.p[where] ^= (uint8_t)(1u << rnd() % 8); break;
            case 2: b.p[where] = text_ ? (uint8_t)" \n\r-.e9#"[rnd() % 8] : (uint8_t)(rnd() & 1 ? 0xff : 0); break;
            default: memmove(b.p + where, b.p + b.n - 1 - (b.n - 1 - where) / 2, (b.n - 1 - where) / 2 + 1);
            }
        }
        if (!(rnd() % 5)) b.n = rnd() % (uint32_t)(b.n + 1);
        write_part(text_ ? "t" : "b", part, text_ ? "txt" : "bin");
        memset(&r, 0x5a, sizeof r);
        orl_err e = read_dir(text_ ? "t" : "b", &r);
        if (e) {
            refused++;
            failed(e, e, at(text_ ? "t" : "b"), NULL);
            assert_true(e == ORL_E_FORMAT || e == ORL_E_UNSUPPORTED);
            for (size_t k = 0; k < sizeof r; k++) assert_int_equal(((uint8_t *)&r)[k], 0x5a);
        } else {
            uint64_t sum = 0;
            read_++;
            for (uint32_t k = 0; k < r.nimages; k++) {
                const orl_colmap_image *im = &r.images[k];
                assert_non_null(memchr(im->name, 0, sizeof im->name));
                assert_true(!k || strcmp(r.images[k - 1].name, im->name) < 0);
                assert_true(im->camera >= 0 && (uint32_t)im->camera < r.ncameras && r.cameras[im->camera].w > 0 && r.cameras[im->camera].fx > 0);
                assert_true(im->obs_begin <= r.nobs && im->obs_count <= r.nobs - im->obs_begin);
                for (int a = 0; a < 12; a++) assert_true(a < 9 ? fabs(im->pose.R[a]) < 1.0001 : isfinite(im->pose.t[a - 9]));
                sum += im->obs_count;
            }
            assert_int_equal(sum, r.nobs);
            for (uint32_t k = 0; k < r.nobs; k++) assert_true(r.obs[k].point >= -1 && r.obs[k].point < (int64_t)r.npoints);
            for (uint32_t k = 0; k < r.npoints; k++) assert_true(isfinite(r.points[k].xyz[0] + r.points[k].xyz[1] + r.points[k].xyz[2]) && r.points[k].error_px >= 0);
            orl_colmap_free(&r);
        }
        memcpy(b.p, was[part][text_], b.n = len[part][text_]);
        write_part(text_ ? "t" : "b", part, text_ ? "txt" : "bin");
    }
    print_message("%d read, %d refused\n", read_, refused);
    assert_true(read_ > 300 && refused > 300);          /* both ways were walked */
}

/* COLMAP's own files, where they are at hand: the text and the binary of one model. */
static void real_models(void **state)
{
    (void)state;
    orl_colmap x, y;
    char real[1024];
    if (!realpath("../shared/data/basilica/sparse/0", real)) { print_message("no ../shared/data/basilica\n"); skip(); }
    make_way(at("t/x"));
    for (int k = 0; k < 3; k++) assert_int_equal(symlink(({ static char s[1100]; snprintf(s, sizeof s, "%s/%s.txt", real, PARTS[k]); s; }), at("t/%s.txt", PARTS[k])), 0);
    ok(orl_colmap_read(real, on_warn, &warn, &x));
    ok(read_dir("t", &y));
    assert_int_equal(x.nimages, 48);
    assert_int_equal(x.npoints, 6150);
    assert_int_equal(x.ncameras, y.ncameras);
    assert_int_equal(x.nimages, y.nimages);
    assert_int_equal(x.npoints, y.npoints);
    assert_int_equal(x.nobs, y.nobs);
    for (uint32_t k = 0; k < x.nobs; k++) assert_int_equal(x.obs[k].point, y.obs[k].point);
    for (uint32_t k = 0; k < x.nimages; k++) assert_string_equal(x.images[k].name, y.images[k].name);
    for (uint32_t k = 0; k < x.npoints; k++) {
        assert_int_equal(x.points[k].track_length, y.points[k].track_length);
        for (int a = 0; a < 3; a++) assert_true(fabs(x.points[k].xyz[a] - y.points[k].xyz[a]) <= 1e-6 * (1 + fabs(x.points[k].xyz[a])));
    }
    orl_colmap_free(&x);
    orl_colmap_free(&y);
    if (access("../shared/data/fountain_p11/gt/cameras.txt", R_OK)) return;
    warn.n = 0;
    ok(orl_colmap_read("../shared/data/fountain_p11/gt", on_warn, &warn, &x));      /* poses only */
    assert_int_equal(warn.n, 0);
    assert_int_equal(x.nimages, 11);
    assert_int_equal(x.npoints, 0);
    assert_int_equal(x.nobs, 0);
    orl_colmap_free(&x);
}

#define TEST(f) cmocka_unit_test_setup_teardown(f, scratch_make, scratch_remove)
int main(void)
{
    const struct CMUnitTest tests[] = {
        TEST(reads_binary), TEST(reads_text), TEST(writes_text), TEST(any_order), TEST(which_file), TEST(truncated), TEST(extra_bytes), TEST(counts_that_lie), TEST(unknown_models),
        TEST(photos_left_out), TEST(duplicates), TEST(values_that_are_none), TEST(names), TEST(bad_lines), TEST(random_bytes), TEST(real_models),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
