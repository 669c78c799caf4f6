/* SCENE folders: the layouts, who trains and who tests, what test photos must not give away, masks, photos and cameras without each other, files that do not decode or are
 * turned by EXIF, split files by many hands; and the real data folders, where they are at hand. */
#include "tests/scratch.h"
#include <math.h>
#include "oriel/dataset.h"

/* Whether the build looks for leaks. */
#ifdef __has_feature
#define LEAKS_COUNT __has_feature(address_sanitizer)
#elif defined __SANITIZE_ADDRESS__
#define LEAKS_COUNT 1
#else
#define LEAKS_COUNT 0
#endif

enum { W = 48, H = 32 };
static warnings warn;
static orl_err open_dir(const char *dir, orl_dataset *d) { warn.n = 0; return orl_dataset_open(at("%s", dir), on_warn, &warn, d); }

/* Refused, output untouched, the words named. */
#define REFUSED(dir, want, ...) do { \
    orl_dataset r_, was_; \
    memset(&r_, 0x5a, sizeof r_); \
    was_ = r_; \
    failed(open_dir(dir, &r_), want, __VA_ARGS__, NULL); \
    assert_memory_equal(&r_, &was_, sizeof r_); \
} while (0)

/* A W x H picture in four colours, A B over C D, the way the file's ending says. */
static const uint8_t ABCD[4][3] = { { 230, 40, 40 }, { 40, 200, 60 }, { 50, 60, 220 }, { 225, 225, 225 } };
static void photo(const char *path)
{
    orl_image im;
    make_way(path);
    ok(orl_image_alloc(&im, W, H, 3));
    for (int y = 0; y < H; y++) for (int x = 0; x < W; x++) memcpy(im.px + 3 * (y * W + x), ABCD[(2 * y >= H) * 2 + (2 * x >= W)], 3);
    ok(orl_image_write(path, &im));
    orl_image_free(&im);
}

static void expect_corners(const orl_image *im, const char *order)
{
    for (int k = 0; k < 4; k++) {
        const uint8_t *p = im->px + 3 * ((k / 2 ? im->h - 3 : 2) * im->w + (k % 2 ? im->w - 3 : 2)), *want = ABCD[order[k] - 'A'];
        for (int a = 0; a < 3; a++) if (abs(p[a] - want[a]) > 8) fail_msg("corner %d of %s: %d %d %d", k, order, p[0], p[1], p[2]);
    }
}

/* A model of n photos, one camera each of focal length 40 + k; sees[k]: the points that photo k sees, a letter each, '-' for none. points: how many letters there are. */
static void model(const char *dir, int n, const char *const *names, const char *const *sees, int points)
{
    static orl_camera cam[32];
    static orl_colmap_image im[32];
    static orl_colmap_obs obs[512];
    static orl_colmap_point pt[26];
    orl_colmap m = { cam, (uint32_t)n, im, (uint32_t)n, obs, 0, pt, (uint32_t)points };
    memset(im, 0, sizeof im);
    memset(pt, 0, sizeof pt);
    for (int k = 0; k < points; k++) pt[k] = (orl_colmap_point){ .xyz = { k, 1, 2 }, .rgb = { (uint8_t)k, 7, 9 }, .error_px = 0.5f };
    for (int k = 0; k < n; k++) {
        ok(orl_camera_from_params(&cam[k], ORL_CAM_PINHOLE, W, H, (double[4]){ 40 + k, 41 + k, W / 2.0, H / 2.0 }, 4));
        snprintf(im[k].name, sizeof im[k].name, "%s", names[k]);
        im[k].id = (uint32_t)k + 1;
        im[k].camera = k;
        ok(orl_pose_from_quat(&im[k].pose, (double[4]){ 1, 0, 0, 0 }, (double[3]){ k, 0, 5 }));
        im[k].obs_begin = m.nobs;
        for (const char *s = sees ? sees[k] : ""; *s; s++) obs[m.nobs++] = (orl_colmap_obs){ (float)im[k].obs_count++, (float)k, *s == '-' ? -1 : *s - 'a' };
    }
    make_way(at("%s/x", dir));
    ok(orl_colmap_write_text(at("%s", dir), &m));
}

static const char *const FOUR[] = { "a.png", "b.jpg", "c.png", "t.png" };
static const char *const FOUR_SEE[] = { "ab-dd", "acb", "abe", "abcff" };

/* The four photos in place/photos, their model in place/sparse/0. */
static void place(const char *name)
{
    for (int k = 0; k < 4; k++) photo(at("%s/photos/%s", name, FOUR[k]));
    model(({ static char s[300]; snprintf(s, sizeof s, "%s/sparse/0", name); s; }), 4, FOUR, FOUR_SEE, 6);
}

static const orl_photo *find(const orl_dataset *d, const char *name)
{
    const orl_photo *p = NULL;
    for (uint32_t k = 0; k < d->nphotos; k++) if (!strcmp(d->photos[k].name, name)) { assert_null(p); p = &d->photos[k]; }
    return p;
}

static int tests_in(const orl_dataset *d) { int n = 0; for (uint32_t k = 0; k < d->nphotos; k++) n += d->photos[k].test; return n; }

/* Counts and names that hold of any data set. */
static void sound(const orl_dataset *d)
{
    uint32_t *track = calloc(d->npoints + 1, sizeof *track), *last = calloc(d->npoints + 1, sizeof *last);
    for (uint32_t k = 0; k < d->nphotos; k++) {
        const orl_photo *p = &d->photos[k];
        if (k) assert_true(strcmp(d->photos[k - 1].name, p->name) < 0);
        assert_int_equal(access(p->path, R_OK), 0);
        assert_true(p->test == 0 || p->test == 1);
        if (p->test) assert_int_equal(p->obs_count, 0);
        assert_true(p->obs_begin <= d->nobs && p->obs_count <= d->nobs - p->obs_begin);
        for (uint32_t i = 0; i < p->obs_count; i++) {
            int at_ = d->obs[p->obs_begin + i].point;
            assert_true(at_ >= -1 && at_ < (int)d->npoints);
            if (at_ >= 0 && last[at_] != k + 1) { last[at_] = k + 1; track[at_]++; }
        }
    }
    for (uint32_t k = 0; k < d->npoints; k++) { assert_int_equal(d->points[k].track_length, track[k]); assert_true(track[k] >= 2); }
    free(track);
    free(last);
}

static void opens(void **state)
{
    (void)state;
    orl_dataset d;
    place("square");
    for (int slash = 0; slash < 3; slash++) {
        ok(open_dir(slash == 0 ? "square" : slash == 1 ? "square/" : "square//", &d));
        assert_int_equal(warn.n, 0);
        sound(&d);
        assert_string_equal(d.name, "square");
        assert_string_equal(d.dir, at("square"));
        assert_int_equal(d.nphotos, 4);
        assert_int_equal(tests_in(&d), 0);              /* no split: all train */
        for (int k = 0; k < 4; k++) {
            const orl_photo *p = &d.photos[k];
            assert_string_equal(p->name, FOUR[k]);
            assert_string_equal(p->path, at("square/photos/%s", FOUR[k]));
            assert_string_equal(p->mask, "");
            assert_true(p->cam.fx == 40 + k && p->cam.fy == 41 + k && p->cam.w == W && p->pose.t[0] == k && p->pose.t[2] == 5);
            assert_int_equal(p->obs_count, strlen(FOUR_SEE[k]));
        }
        assert_int_equal(d.npoints, 3);                 /* a b c; d, e and f are seen by one photo each, though twice */
        static const uint32_t TRACK[] = { 4, 4, 2 };
        for (int k = 0; k < 3; k++) assert_true(d.points[k].track_length == TRACK[k] && d.points[k].xyz[0] == k && d.points[k].rgb[0] == k && d.points[k].error_px == 0.5f);
        orl_dataset_free(&d);
        assert_true(!d.photos && !d.nphotos && !d.nobs && !d.npoints);
        orl_dataset_free(&d);                           /* idempotent */
    }
}

static void test_photos_give_nothing(void **state)
{
    (void)state;
    orl_dataset d;
    place("m");
    put_text(at("m/split.tsv"), "filename\tid\tsplit\tdataset\na.png\t0\ttrain\tm\nb.jpg\t1\ttrain\tm\nc.png\t2\ttrain\tm\nt.png\t3\ttest\tm\n");
    put_text(at("m/aaa.tsv"), "filename\tsplit\na.png\ttest\n");      /* split.tsv comes before others */
    ok(open_dir("m", &d));
    assert_int_equal(warn.n, 0);
    sound(&d);
    assert_int_equal(tests_in(&d), 1);
    const orl_photo *t = find(&d, "t.png"), *a = find(&d, "a.png");
    assert_true(t->test && t->obs_count == 0 && t->obs_begin == 0 && t->cam.fx == 43);
    assert_int_equal(d.npoints, 2);                     /* c is left with b.jpg alone */
    assert_true(d.points[0].track_length == 3 && d.points[1].track_length == 3);
    static const int WANT[] = { 0, 1, -1, -1, -1 };
    for (uint32_t k = 0; k < 5; k++) assert_true(d.obs[a->obs_begin + k].point == WANT[k] && d.obs[a->obs_begin + k].x == (float)k && d.obs[a->obs_begin + k].y == 0);
    assert_int_equal(d.nobs, 5 + 3 + 3);
    orl_dataset_free(&d);
}

static void layouts(void **state)
{
    (void)state;
    static const struct { const char *photos, *sparse; } LAYOUT[] = {
        { "photos", "sparse/0" }, { "images", "sparse/0" }, { "photos", "sparse" }, { "images", "sparse" }, { "dense/images", "dense/sparse" }, { "dense/images", "dense/sparse/0" },
    };
    static const char *const NAMES[] = { "x.png", "y.png" }, *const SEES[] = { "ab", "ba" };
    orl_dataset d;
    for (size_t k = 0; k < sizeof LAYOUT / sizeof *LAYOUT; k++) {
        char dir[32], sparse[64];
        snprintf(dir, sizeof dir, "l%zu", k);
        snprintf(sparse, sizeof sparse, "%s/%s", dir, LAYOUT[k].sparse);
        for (int i = 0; i < 2; i++) photo(at("%s/%s/%s", dir, LAYOUT[k].photos, NAMES[i]));
        REFUSED(dir, ORL_E_IO, at("%s", dir), "sparse");
        model(sparse, 2, NAMES, SEES, 2);
        ok(open_dir(dir, &d));
        assert_int_equal(warn.n, 0);
        sound(&d);
        assert_int_equal(d.nphotos, 2);
        assert_int_equal(d.npoints, 2);
        assert_string_equal(d.name, dir);
        assert_string_equal(d.photos[1].path, at("%s/%s/y.png", dir, LAYOUT[k].photos));
        orl_dataset_free(&d);
    }
    make_way(at("none/sparse/0/x"));
    model("none/sparse/0", 2, NAMES, SEES, 2);
    REFUSED("none", ORL_E_IO, at("none"), "photos");
    make_way(at("none/photos/x"));
    REFUSED("none", ORL_E_FORMAT, at("none"), "no photo has a camera");
    assert_int_equal(warned(&warn, "x.png", "camera without photo"), 1);
    REFUSED("nowhere", ORL_E_IO, at("nowhere"));
    put_text(at("file"), "");
    REFUSED("file", ORL_E_IO, at("file"));
    /* The model's own errors come through, its files named. */
    place("m");
    put_text(at("m/sparse/0/images.txt"), "1 1 0 0\n");
    REFUSED("m", ORL_E_FORMAT, "m/sparse/0/images.txt", "image quaternion");
    place("m");
    put_text(at("m/sparse_test/0/cameras.txt"), "1 PINHOLE 5\n");
    put_text(at("m/sparse_test/0/images.txt"), "");
    REFUSED("m", ORL_E_FORMAT, "m/sparse_test/0/cameras.txt");
}

/* IMC-PT Phototourism: images and model under dense, NeRF-W's file beside them or above, among those of other places. */
static void phototourism(void **state)
{
    (void)state;
    static const char *const TSV = "filename\tid\tsplit\tdataset\nx.png\t0\ttest\tgate\ny.png\t\t\t\nz.png\t1\ttrain\tgate\nw.png\t2\ttrain\tgate\n",
                      *const OTHER = "filename\tid\tsplit\tdataset\n1.jpg\t0\ttest\tother\nX.PNG\t1\ttrain\tother\n";
    static const char *const NAMES[] = { "w.png", "x.png", "y.png", "z.png" }, *const SEES[] = { "ab", "ab", "ab", "ab" };
    orl_dataset d;
    for (int k = 0; k < 5; k++) {
        char dir[32], root[64];
        snprintf(dir, sizeof dir, "imc%d/gate%s", k, k == 4 ? "/dense" : "");
        snprintf(root, sizeof root, "imc%d/gate/dense", k);
        for (int i = 0; i < 4; i++) photo(at("%s/images/%s", root, NAMES[i]));
        snprintf(root, sizeof root, "imc%d/gate/dense/sparse", k);
        model(root, 4, NAMES, SEES, 2);
        switch (k) {
        case 0: put_text(at("imc0/gate/gate.tsv"), TSV); break;                                             /* beside */
        case 1: put_text(at("imc1/gate.tsv"), TSV); break;                                                  /* above */
        case 2: put_text(at("imc2/other.tsv"), OTHER), put_text(at("imc2/aaa.tsv"), "no split at all"), put_text(at("imc2/zzz.tsv"), TSV), put_text(at("imc2/gate/notes.tsv"), "a\tb\n"); break;
        case 3: put_text(at("imc3/gate.tsv"), OTHER), put_text(at("imc3/gate/gate.tsv"), TSV), put_text(at("imc3/split.tsv"), "filename\tid\tsplit\tdataset\nx.png\t0\ttrain\tgate\n"); break;    /* the nearer one */
        default: put_text(at("imc4/gate/gate.tsv"), TSV);                                                   /* seen from dense, above */
        }
        ok(open_dir(dir, &d));
        sound(&d);
        assert_int_equal(d.nphotos, 3);
        assert_int_equal(tests_in(&d), 1);
        assert_int_equal(find(&d, "x.png")->test, 1);
        assert_null(find(&d, "y.png"));                 /* listed, but used by no one */
        assert_int_equal(warn.n, 1);
        assert_int_equal(warned(&warn, "y.png", "split file"), 1);
        assert_string_equal(find(&d, "z.png")->path, at("imc%d/gate/dense/images/z.png", k));
        orl_dataset_free(&d);
    }
    /* All files there are speak of other places: no split. */
    unlink(at("imc1/gate.tsv"));
    put_text(at("imc1/other.tsv"), OTHER);
    ok(open_dir("imc1/gate", &d));
    assert_true(d.nphotos == 4 && tests_in(&d) == 0 && warn.n == 0);
    orl_dataset_free(&d);
}

static void splits(void **state)
{
    (void)state;
    static char name[300], far[4000], text[9000];
    memset(name, 'n', 251);
    strcpy(name + 251, ".png");
    const char *const names[] = { "a.png", "b.png", "c.png", name };
    for (int k = 0; k < 3; k++) photo(at("m/photos/%s", names[k]));
    photo(at("m/photos/short.png"));
    assert_int_equal(rename(at("m/photos/short.png"), at("m/photos/%s", name)), 0);
    model("m/sparse/0", 4, names, NULL, 0);
    memset(far, 'f', sizeof far - 1);
    /* want: T test, t train, - left out, for a, b, c and the long name. */
    const struct { const char *text, *want; int ignored; } CASE[] = {
        { "filename\tid\tsplit\tdataset\na.png\t0\ttest\tm\nb.png\t1\ttrain\tm\nc.png\t2\ttrain\tm\n%s\t3\ttest\tm\n", "TttT", 0 },
        { "filename\tid\tsplit\tdataset\r\na.png\t0\ttest\tm\r\nb.png\t1\ttrain\tm\r\nc.png\t2\ttest\tm\r\n", "TtT-", 0 },
        { "split\tfilename\ntest\ta.png\ntrain\tb.png\ntest\tc.png\ntrain\t%s", "TtTt", 0 },               /* other columns, no last line end */
        { "1\t2\t3\t4\t5\t6\tsplit\tfilename\t9\t10\n\t\t\t\t\t\ttest\ta.png\t\t\t\t\n", "T---", 0 },     /* empty fields count */
        { "filename\tsplit\na.png\ttesting\nb.png\tTEST\nc.png\ttes\n%s\ttest", "---T", 0 },               /* only the words themselves */
        { "filename\tsplit\na.png\nb.png\ttrain\n\n\t\n\t\t\t\t\t\t\t\t\t\t\t\t\n", "-t--", 0 },          /* short, empty, long rows */
        { "filename\tsplit\na.png\ttest\na.png\ttrain\nb.png\ttrain\n", "Tt--", 0 },                       /* the first row counts */
        { "filename\tsplit\na.pn\ttest\na.pngg\ttest\n a.png\ttest\nA.PNG\ttest\nb.png\ttrain\n", "-t--", 0 },
        { "filename\tsplit\n../photos/a.png\ttest\n../../../../etc/passwd\ttest\n/etc/passwd\ttrain\nb.png\ttrain\n", "-t--", 0 },
        { "filename\tsplit\n%s%s\ttest\nb.png\ttrain\n", "-t--", 0 },                                      /* far longer than any name */
        { "filename\tsplit\n%s.png\ttest\n", "tttt", 1 }, { "filename\tsplit\n", "tttt", 1 }, { "filename\tsplit", "tttt", 1 },
    };
    orl_dataset d;
    for (size_t k = 0; k < sizeof CASE / sizeof *CASE; k++) {
        const char *filler = strstr(CASE[k].text, "%s%s") ? far : name;
        snprintf(text, sizeof text, CASE[k].text, filler, far);
        put_text(at("m/split.tsv"), text);
        ok(open_dir("m", &d));
        int out = 0;
        for (int i = 0; i < 4; i++) {
            const orl_photo *p = find(&d, names[i]);
            char got = !p ? '-' : p->test ? 'T' : 't';
            if (got != CASE[k].want[i]) fail_msg("case %zu: photo %d is %c", k, i, got);
            out += !p;
            assert_int_equal(warned(&warn, names[i], "skipped"), !p);
        }
        assert_int_equal(warned(&warn, "split.tsv", "ignored"), CASE[k].ignored);
        assert_int_equal(warn.n, out + CASE[k].ignored);
        orl_dataset_free(&d);
    }
    put_text(at("m/split.tsv"), "filename\tsplit\na.png\tTest\nb.png\tTrain\n");          /* words of its own: nobody is used, rather than all */
    REFUSED("m", ORL_E_FORMAT, at("m"), "no photo");
    /* Without its headings split.tsv says nothing; training on test photos is no way out. */
    static const char *const BAD[] = { "", "\n", "a.png\t0\ttest\tm\nb.png\t1\ttrain\tm\n", "filename\tid\tdataset\na.png\t0\tm\n", "name\tid\tsplit\na.png\t0\ttest\n", "Filename\tSplit\na.png\ttest\n",
                                       "filename,id,split,dataset\na.png,0,test,m\n", "\nfilename\tsplit\na.png\ttest\n", "1\t2\t3\t4\t5\t6\t7\t8\tfilename\tsplit\n" };
    for (size_t k = 0; k < sizeof BAD / sizeof *BAD; k++) {
        put_text(at("m/split.tsv"), BAD[k]);
        REFUSED("m", ORL_E_FORMAT, at("m/split.tsv"), "filename", "split");
    }
    put_bytes(at("m/split.tsv"), "filename\tsplit\na.png\ttest\0\nb.png\ttest\n", 38);     /* text ends at the first zero */
    ok(open_dir("m", &d));
    assert_true(d.nphotos == 1 && d.photos[0].test && warned(&warn, "b.png", "skipped"));
    orl_dataset_free(&d);
    unlink(at("m/split.tsv"));
    mkdir(at("m/split.tsv"), 0777);
    REFUSED("m", ORL_E_IO, at("m/split.tsv"));
}

static void split_noise(void **state)
{
    (void)state;
    static const char GOOD[] = "filename\tid\tsplit\tdataset\na.png\t0\ttrain\tm\nb.jpg\t1\ttrain\tm\nc.png\t2\ttrain\tm\nt.png\t3\ttest\tm\n";
    char b[sizeof GOOD];
    int opened = 0;
    seed_print();
    place("m");
    for (int round = 0; round < 400; round++) {
        size_t n = round & 3 ? sizeof GOOD - 1 : rnd() % sizeof GOOD;
        memcpy(b, GOOD, sizeof GOOD);
        for (int k = 0; k < round % 5; k++) b[rnd() % sizeof GOOD] = rnd() & 1 ? "\t\n\r\0atest"[rnd() % 9] : (char)rnd();
        put_bytes(at("m/split.tsv"), b, n);
        orl_dataset d;
        orl_err e = open_dir("m", &d);
        if (e) { failed(e, ORL_E_FORMAT, at("m"), NULL); continue; }
        opened++;
        sound(&d);
        orl_dataset_free(&d);
    }
    assert_true(opened > 50 && opened < 400);
}

static void test_cameras_apart(void **state)
{
    (void)state;
    static const char *const TEST[] = { "s.png", "t.png" }, *const SEES[] = { "abc", "ab" };
    orl_dataset d;
    place("m");
    photo(at("m/photos/s.png"));
    model("m/sparse_test/0", 2, TEST, SEES, 3);
    for (int split = 0; split < 3; split++) {
        if (split) put_text(at("m/split.tsv"), split == 1 ? "filename\tsplit\na.png\ttrain\nb.jpg\ttrain\nc.png\ttrain\ns.png\ttest\nt.png\ttest\n" : "filename\tsplit\na.png\ttrain\nb.jpg\ttrain\nc.png\ttrain\ns.png\ttrain\nt.png\ttrain\n");
        ok(open_dir("m", &d));
        assert_int_equal(warn.n, 0);
        sound(&d);
        assert_int_equal(d.nphotos, 5);
        assert_int_equal(tests_in(&d), 2);
        for (int k = 0; k < 2; k++) {
            const orl_photo *p = find(&d, TEST[k]);
            assert_true(p->test && p->obs_count == 0 && p->cam.fx == 40 + k && p->pose.t[0] == k);    /* t.png is in both models: its camera apart counts, and it does not train */
        }
        assert_int_equal(d.npoints, 2);
        assert_true(d.points[0].track_length == 3 && d.points[1].track_length == 3);
        orl_dataset_free(&d);
    }
    /* Without photos they are named. */
    unlink(at("m/photos/s.png"));
    ok(open_dir("m", &d));
    assert_int_equal(d.nphotos, 4);
    assert_int_equal(warned(&warn, "s.png", "camera without photo"), 1);
    orl_dataset_free(&d);
}

static void without_each_other(void **state)
{
    (void)state;
    orl_dataset d;
    place("m");
    unlink(at("m/photos/b.jpg"));
    photo(at("m/photos/lonely.png"));
    put_text(at("m/photos/.hidden"), "");
    put_text(at("m/photos/Thumbs.db"), "");
    make_way(at("m/photos/folder/x"));
    ok(open_dir("m", &d));
    sound(&d);
    assert_int_equal(warned(&warn, "b.jpg", "camera without photo"), 1);
    assert_int_equal(warned(&warn, "lonely.png", "photo without camera"), 1);
    assert_int_equal(warned(&warn, "Thumbs.db", "photo without camera"), 1);
    assert_int_equal(warn.n, 3);
    assert_int_equal(d.nphotos, 3);
    assert_null(find(&d, "b.jpg"));
    assert_null(find(&d, "lonely.png"));
    assert_int_equal(d.npoints, 2);                     /* what b.jpg saw counts no more: c is t.png's alone */
    assert_true(d.points[0].track_length == 3 && d.points[1].track_length == 3);
    orl_dataset_free(&d);
    ok(orl_dataset_open(at("m"), NULL, NULL, &d));      /* nobody listens */
    assert_int_equal(d.nphotos, 3);
    orl_dataset_free(&d);
    /* A camera that the model's reader leaves out is named by it. */
    place("n");
    put_text(at("n/sparse/0/cameras.txt"), "1 PINHOLE 48 32 40 40 24 16\n2 PINHOLE 48 32 1e7 1e7 24 16\n3 PINHOLE 48 32 40 40 24 16\n4 PINHOLE 48 32 40 40 24 16\n");
    ok(open_dir("n", &d));
    assert_int_equal(d.nphotos, 3);
    assert_int_equal(warned(&warn, "image b.jpg is left out", "absurd"), 1);
    orl_dataset_free(&d);
}

/* Names with folders in them are found; names that lead out are not followed. */
static void names_with_folders(void **state)
{
    (void)state;
    static const char *const NAMES[] = { "../outside.png", "a/../../outside.png", "a/..", "day/one.png", "day/two..png", "..three.png" };
    orl_dataset d;
    photo(at("m/outside.png"));
    photo(at("m/photos/a/x.png"));
    for (int k = 3; k < 6; k++) photo(at("m/photos/%s", NAMES[k]));
    put_text(at("m/masks/day/one.png"), "");
    model("m/sparse/0", 6, NAMES, NULL, 0);
    ok(open_dir("m", &d));
    sound(&d);
    assert_int_equal(d.nphotos, 3);
    for (int k = 0; k < 6; k++) {
        const orl_photo *p = find(&d, NAMES[k]);
        assert_true(!p == (k < 3));
        assert_int_equal(warned(&warn, NAMES[k], "leads out"), k < 3 ? k == 1 ? 1 : 2 : 0);       /* the second name holds the other two */
        if (k >= 3) assert_string_equal(p->path, at("m/photos/%s", NAMES[k]));
    }
    assert_string_equal(find(&d, "day/one.png")->mask, at("m/masks/day/one.png"));
    orl_dataset_free(&d);
}

static void masks(void **state)
{
    (void)state;
    orl_dataset d;
    orl_image m, r;
    place("m");
    ok(orl_image_alloc(&m, W, H, 1));
    for (int y = 0; y < H; y++) for (int x = 0; x < W; x++) m.px[y * W + x] = y < 8 ? 128 : x >= 40 ? 255 : 0;
    make_way(at("m/masks/x"));
    ok(orl_image_write(at("m/masks/a.png"), &m));
    ok(orl_image_write(at("m/masks/b.png"), &m));
    put_text(at("m/masks/t.png"), "no picture");
    ok(open_dir("m", &d));
    assert_string_equal(find(&d, "a.png")->mask, at("m/masks/a.png"));
    assert_string_equal(find(&d, "b.jpg")->mask, at("m/masks/b.png"));
    assert_string_equal(find(&d, "c.png")->mask, "");
    ok(orl_photo_load_mask(find(&d, "b.jpg"), W, H, &r));
    assert_true(r.w == W && r.h == H && r.c == 1);
    assert_memory_equal(r.px, m.px, W * H);
    orl_image_free(&r);
    static const int SIZE[][2] = { { 24, 16 }, { 17, 11 }, { 96, 64 }, { 1, 1 }, { 48, 5 } };
    for (size_t k = 0; k < sizeof SIZE / sizeof *SIZE; k++) {       /* labels are picked, never mixed: the one under the pixel's centre */
        int w = SIZE[k][0], h = SIZE[k][1];
        ok(orl_photo_load_mask(find(&d, "a.png"), w, h, &r));
        assert_true(r.w == w && r.h == h);
        for (int y = 0; y < h; y++)
            for (int x = 0; x < w; x++) assert_int_equal(r.px[y * w + x], m.px[(int)floor((y + 0.5) * H / h) * W + (int)floor((x + 0.5) * W / w)]);
        orl_image_free(&r);
    }
    memset(&r, 0, sizeof r);
    failed(orl_photo_load_mask(find(&d, "c.png"), W, H, &r), ORL_E_IO, "c.png", NULL);
    failed(orl_photo_load_mask(find(&d, "t.png"), W, H, &r), ORL_E_FORMAT, at("m/masks/t.png"), NULL);
    failed(orl_photo_load_mask(find(&d, "a.png"), 0, H, &r), ORL_E_RANGE, NULL);
    assert_null(r.px);
    orl_image_free(&m);
    orl_dataset_free(&d);
}

static void loads(void **state)
{
    (void)state;
    orl_dataset d;
    orl_image full, r, want;
    orl_camera c;
    place("m");
    ok(open_dir("m", &d));
    for (int k = 0; k < 2; k++) {
        const orl_photo *p = &d.photos[k];
        for (int side = 0; side < 3; side++) {          /* full; larger never enlarges */
            ok(orl_photo_load(p, side == 0 ? 0 : side == 1 ? W : 1000, &full, &c));
            assert_true(full.w == W && full.h == H && full.c == 3);
            assert_true(c.w == W && c.h == H && c.fx == p->cam.fx && c.cy == p->cam.cy);
            expect_corners(&full, "ABCD");
            if (side < 2) orl_image_free(&full);
        }
        ok(orl_photo_load(p, 18, &r, &c));
        assert_true(r.w == 18 && r.h == 12 && r.c == 3);
        assert_true(c.w == 18 && c.h == 12 && fabs(c.fx - p->cam.fx * 18 / W) < 1e-12 && fabs(c.fy - p->cam.fy * 12 / H) < 1e-12 && fabs(c.cx - 9) < 1e-12 && fabs(c.cy - 6) < 1e-12);
        ok(orl_image_resize_area(&full, 18, 12, &want));
        assert_memory_equal(r.px, want.px, 18 * 12 * 3);
        orl_image_free(&r);
        ok(orl_photo_load(p, 18, &r, NULL));
        orl_image_free(&r);
        orl_image_free(&want);
        orl_image_free(&full);
    }
    orl_dataset_free(&d);
    /* Grey is spread, transparency dropped. */
    orl_image g;
    orl_photo p = { .cam = { .w = W, .h = H } };
    for (int ch = 1; ch <= 4; ch += 3) {
        ok(orl_image_alloc(&g, W, H, ch));
        for (int i = 0; i < W * H * ch; i++) g.px[i] = (uint8_t)(ch == 4 && i % 4 == 3 ? 255 : i / ch % 251);
        snprintf(p.path, sizeof p.path, "%s", at("g%d.png", ch));
        ok(orl_image_write(p.path, &g));
        ok(orl_photo_load(&p, 0, &r, NULL));
        assert_int_equal(r.c, 3);
        for (int i = 0; i < W * H; i++) for (int a = 0; a < 3; a++) assert_int_equal(r.px[3 * i + a], i % 251);
        orl_image_free(&r);
        orl_image_free(&g);
    }
}

/* The file that does not decode, and the one of another size, are named when they are loaded. */
static void does_not_load(void **state)
{
    (void)state;
    orl_dataset d;
    orl_image r = { 0 };
    orl_camera c = { .w = 77 };
    place("m");
    put_text(at("m/photos/a.png"), "This is no picture.");
    put_text(at("m/photos/b.jpg"), "");
    ok(open_dir("m", &d));
    assert_int_equal(d.nphotos, 4);
    failed(orl_photo_load(&d.photos[0], 0, &r, &c), ORL_E_FORMAT, at("m/photos/a.png"), NULL);
    failed(orl_photo_load(&d.photos[1], 0, &r, &c), ORL_E_FORMAT, at("m/photos/b.jpg"), NULL);
    for (int k = 0; k < 4; k++) {
        orl_photo p = d.photos[2];
        if (k == 0) p.cam.w++;
        if (k == 1) p.cam.h--;
        if (k == 2) p.cam.w = H, p.cam.h = W;
        if (k == 3) p.cam.w *= 2, p.cam.h *= 2;
        failed(orl_photo_load(&p, 16, &r, &c), ORL_E_FORMAT, at("m/photos/c.png"), "48 x 32", NULL);
    }
    unlink(at("m/photos/t.png"));
    orl_err e = orl_photo_load(&d.photos[3], 0, &r, &c);
    failed(e, e, at("m/photos/t.png"), NULL);
    assert_int_not_equal(e, ORL_OK);
    assert_true(!r.px && c.w == 77);
    orl_dataset_free(&d);
    /* Cut short: no half of a photo is taken for one. */
    static const char *const NAME[] = { "a.png", "b.jpg" };
    for (int k = 0; k < 2; k++) {
        uint8_t *bytes;
        size_t n;
        place("n");
        ok(orl_file_read(at("n/photos/%s", NAME[k]), 1 << 20, &bytes, &n));
        ok(open_dir("n", &d));
        for (size_t m = 0; m < n - 1; m += m < n / 2 ? 37 : 5) {
            if (!k && m >= n - 12) break;               /* PNG's end mark alone: no pixel lacks */
            if (!k && LEAKS_COUNT) break;               /* OpenImageIO's PNG reader leaks a string at each of its errors */
            put_bytes(at("n/photos/%s", NAME[k]), bytes, m);
            e = orl_photo_load(&d.photos[k], 0, &r, NULL);
            if (!e) fail_msg("%s: %zu of %zu bytes were taken for a photo", NAME[k], m, n);
            failed(e, ORL_E_FORMAT, at("n/photos/%s", NAME[k]), NULL);
        }
        free(bytes);
        orl_dataset_free(&d);
    }
}

/* An EXIF block of one tag, the orientation, behind a JPEG's first two bytes. */
static void turn_by_exif(const char *path, int orientation)
{
    uint8_t *jpeg, head[] = { 0xff, 0xd8, 0xff, 0xe1, 0, 34, 'E', 'x', 'i', 'f', 0, 0, 'I', 'I', 42, 0, 8, 0, 0, 0, 1, 0, 0x12, 1, 3, 0, 1, 0, 0, 0, (uint8_t)orientation, 0, 0, 0, 0, 0, 0, 0 };
    size_t n;
    ok(orl_file_read(path, 1 << 20, &jpeg, &n));
    uint8_t *out = malloc(n + sizeof head);
    assert_non_null(out);
    memcpy(out, head, sizeof head);
    memcpy(out + sizeof head, jpeg + 2, n - 2);
    put_bytes(path, out, n - 2 + sizeof head);
    free(out);
    free(jpeg);
}

static void exif_orientation(void **state)
{
    (void)state;
    static const char *const SHOWN[] = { NULL, "ABCD", "BADC", "DCBA", "CDAB", "ACBD", "CADB", "DBCA", "BDAC" };
    for (int o = 1; o <= 8; o++) {
        orl_image r = { 0 };
        orl_camera c;
        orl_photo p = { .cam = { .model = ORL_CAM_PINHOLE, .w = o >= 5 ? H : W, .h = o >= 5 ? W : H, .fx = 40, .fy = 40, .cx = 10, .cy = 20 } };
        snprintf(p.path, sizeof p.path, "%s", at("o%d.jpg", o));
        photo(p.path);
        turn_by_exif(p.path, o);
        ok(orl_photo_load(&p, 0, &r, &c));              /* the camera is that of the picture as it is shown */
        assert_true(r.w == p.cam.w && r.h == p.cam.h && c.w == p.cam.w && c.h == p.cam.h && c.cx == 10);
        expect_corners(&r, SHOWN[o]);
        orl_image_free(&r);
        ok(orl_photo_load(&p, 24, &r, &c));
        assert_true(r.w == (o >= 5 ? 16 : 24) && r.h == (o >= 5 ? 24 : 16) && c.w == r.w && c.h == r.h);
        expect_corners(&r, SHOWN[o]);
        orl_image_free(&r);
        ok(orl_image_read(p.path, 3, &r));              /* the runtime's reader sees the same */
        expect_corners(&r, SHOWN[o]);
        orl_image_free(&r);
        int w = p.cam.w;
        p.cam.w = p.cam.h;
        p.cam.h = w;
        failed(orl_photo_load(&p, 0, &r, &c), ORL_E_FORMAT, p.path, o >= 5 ? "EXIF" : "48 x 32", NULL);
        assert_null(r.px);
    }
}

static void reads_floats(void **state)
{
    (void)state;
    orl_imagef w, r = { 0 };
    if (!strstr(orl_image_formats(), "exr")) { print_message("no exr in this build\n"); skip(); }
    ok(orl_imagef_alloc(&w, 9, 5, 3));
    for (int i = 0; i < 9 * 5 * 3; i++) w.px[i] = (float)i * 0.25f - 2;
    w.px[0] = NAN;
    w.px[1] = INFINITY;
    ok(orl_exr_write(at("a.exr"), &w, "R,G,B"));
    ok(orl_oiio_read_float(at("a.exr"), &r));
    assert_true(r.w == 9 && r.h == 5 && r.c == 3);
    assert_true(r.px[0] == 0 && r.px[1] == 65504);
    for (int i = 2; i < 9 * 5 * 3; i++) assert_true(r.px[i] == w.px[i]);
    orl_imagef_free(&r);
    orl_imagef_free(&w);
    put_text(at("b.hdr"), "#?RADIANCE\nbut then nothing");
    failed(orl_oiio_read_float(at("b.hdr"), &r), ORL_E_FORMAT, at("b.hdr"), NULL);
    orl_err e = orl_oiio_read_float(at("none.exr"), &r);
    failed(e, e, at("none.exr"), NULL);
    assert_int_not_equal(e, ORL_OK);
    assert_null(r.px);
}

/* ../shared/data, as its README counts it. */
static void real(const char *name, int train, int test, int lost)
{
    orl_dataset d;
    char dir[128];
    snprintf(dir, sizeof dir, "../shared/data/%s", name);
    if (access(dir, R_OK)) { print_message("no %s\n", dir); skip(); }
    warn.n = 0;
    ok(orl_dataset_open(dir, on_warn, &warn, &d));
    sound(&d);
    assert_string_equal(d.name, name);
    assert_int_equal(tests_in(&d), test);
    assert_int_equal(d.nphotos, train + test);
    assert_int_equal(warned(&warn, "camera without photo", ""), lost);
    assert_int_equal(warn.n, lost);
    assert_true(d.npoints > 1000);
    /* One photo of each kind fits its camera, and its observations lie on the points. */
    int seen = 0, near = 0;
    for (uint32_t k = 0; k < d.nphotos; k++) {
        const orl_photo *p = &d.photos[k];
        for (uint32_t i = 0; i < p->obs_count; i++) {
            const orl_colmap_obs *o = &d.obs[p->obs_begin + i];
            double x[3], uv[2];
            if (o->point < 0) continue;
            orl_pose_apply(&p->pose, d.points[o->point].xyz, x);
            seen++;
            near += orl_camera_project(&p->cam, x, uv) && hypot(uv[0] - (double)o->x, uv[1] - (double)o->y) < 4;
        }
    }
    assert_true(seen > 1000 && near > 0.97 * seen);
    for (int kind = 0; kind < 2; kind++)
        for (uint32_t k = 0; k < d.nphotos; k++) {
            orl_image im;
            orl_camera c;
            if (d.photos[k].test != kind) continue;
            ok(orl_photo_load(&d.photos[k], 64, &im, &c));
            assert_true((im.w > im.h ? im.w : im.h) == 64 && c.w == im.w && c.h == im.h);
            orl_image_free(&im);
            break;
        }
    orl_dataset_free(&d);
}

static void basilica(void **state) { (void)state; real("basilica", 48, 12, 0); }
static void reichstag(void **state) { (void)state; real("reichstag", 64, 10, 0); }
static void sacre_coeur(void **state) { (void)state; real("sacre_coeur", 10, 3, 2); }
static void herz_jesus(void **state) { (void)state; real("herz_jesus_p25", 21, 4, 0); }

/* The other two are no SCENEs: fountain_p11 has no model, sky no photos. */
static void no_scenes(void **state)
{
    (void)state;
    orl_dataset d;
    if (access("../shared/data/fountain_p11", R_OK)) { print_message("no ../shared/data\n"); skip(); }
    failed(orl_dataset_open("../shared/data/fountain_p11", NULL, NULL, &d), ORL_E_IO, "fountain_p11", "COLMAP", NULL);
    failed(orl_dataset_open("../shared/data/sky", NULL, NULL, &d), ORL_E_IO, "sky", "photos", NULL);
}

#define TEST(f) cmocka_unit_test_setup_teardown(f, scratch_make, scratch_remove)
int main(void)
{
    const struct CMUnitTest tests[] = {
        TEST(opens), TEST(test_photos_give_nothing), TEST(layouts), TEST(phototourism), TEST(splits), TEST(split_noise), TEST(test_cameras_apart), TEST(without_each_other),
        TEST(names_with_folders), TEST(masks), TEST(loads), TEST(does_not_load), TEST(exif_orientation), TEST(reads_floats), TEST(basilica), TEST(reichstag), TEST(sacre_coeur),
        TEST(herz_jesus), TEST(no_scenes),
    };
    if (!strstr(orl_image_formats(), "png") || !strstr(orl_image_formats(), "jpeg")) { print_message("skipped: this build writes no photos\n"); return 0; }
    return cmocka_run_group_tests(tests, NULL, NULL);
}
