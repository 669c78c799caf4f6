/* The procedural attraction, made tiny and twice: same bytes whatever the thread count; what it wrote reads back through the library,
 * and its poses, points, depth and pose files agree with one another. */
#include <ftw.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <unistd.h>
#define main attraction_main
#include "tests/tools/attraction.c"
#undef main
#include <cmocka.h>
#include "oriel/dataset.h"

static char top[64], one[80], two[80];
static int files_seen, files_differ;

static int remove_entry(const char *path, const struct stat *st, int flag, struct FTW *ftw)
{
    (void)st, (void)flag, (void)ftw;
    return remove(path);
}
static int setup(void **state)
{
    (void)state;
    strcpy(top, "/tmp/attraction_XXXXXX");
    if (!mkdtemp(top)) return -1;
    snprintf(one, sizeof one, "%s/one", top), snprintf(two, sizeof two, "%s/two", top);
    options o = { .dir = one, .photos = 4, .tests = 1, .width = 96, .frames = 2, .points = 300, .threads = 1, .seed = 5, .masks = true };
    orl_err err = attraction_make(&o);
    o.dir = two, o.threads = 2;
    if (!err) err = attraction_make(&o);
    if (err) print_message("%s\n", orl_error_text());
    return err ? -1 : 0;
}
static int teardown(void **state)
{
    (void)state;
    return nftw(top, remove_entry, 16, FTW_DEPTH | FTW_PHYS);
}

static int compare_entry(const char *path, const struct stat *st, int flag, struct FTW *ftw)
{
    (void)st, (void)ftw;
    char other[1200];
    uint8_t *a = NULL, *b = NULL;
    size_t na = 0, nb = 0;
    if (flag != FTW_F) return 0;
    snprintf(other, sizeof other, "%s%s", two, path + strlen(one));
    files_seen++;
    if (orl_file_read(path, 1 << 26, &a, &na) || orl_file_read(other, 1 << 26, &b, &nb) || na != nb || memcmp(a, b, na)) {
        print_message("%s differs\n", path);
        files_differ++;
    }
    free(a), free(b);
    return 0;
}
static void same_bytes_for_any_thread_count(void **state)
{
    (void)state;
    files_seen = files_differ = 0;
    assert_int_equal(nftw(one, compare_entry, 16, FTW_PHYS), 0);
    assert_int_equal(files_differ, 0);
    /* photos, masks, EXRs, models, split.tsv, kiosk and its wide truth, the tables and the wide photo in gt */
    assert_int_equal(files_seen, 5 + 5 + 3 + 6 + 1 + 3 + 2 + 4);
}
static void points_reproject(void **state)
{
    (void)state;
    char dir[128];
    orl_colmap m;
    snprintf(dir, sizeof dir, "%s/sparse/0", one);
    assert_int_equal(orl_colmap_read(dir, NULL, NULL, &m), ORL_OK);
    assert_int_equal(m.nimages, 4);
    assert_int_equal(m.ncameras, 4);
    assert_in_range(m.npoints, 150, 300);
    double sum = 0, worst = 0;
    for (uint32_t i = 0; i < m.nimages; i++)
        for (uint32_t k = 0; k < m.images[i].obs_count; k++) {
            const orl_colmap_obs *o = &m.obs[m.images[i].obs_begin + k];
            double cam[3], uv[2];
            assert_true(o->point >= 0);
            orl_pose_apply(&m.images[i].pose, m.points[o->point].xyz, cam);
            assert_true(orl_camera_project(&m.cameras[m.images[i].camera], cam, uv));
            double d = hypot(uv[0] - o->x, uv[1] - o->y);
            sum += d, worst = d > worst ? d : worst;
        }
    assert_true(m.nobs >= 2 * m.npoints);
    assert_true(worst < 3);
    assert_true(sum / m.nobs > 0.2 && sum / m.nobs < 1);
    /* Up is hidden: no axis of the model runs along a camera's downward axis. */
    for (int k = 0; k < 3; k++) assert_true(fabs(m.images[0].pose.R[3 + k]) < 0.9);
    orl_colmap_free(&m);
}
static void opens_as_a_scene(void **state)
{
    (void)state;
    orl_dataset d;
    assert_int_equal(orl_dataset_open(one, NULL, NULL, &d), ORL_OK);
    assert_int_equal(d.nphotos, 5);
    assert_true(d.npoints > 150);
    int tests = 0;
    for (uint32_t i = 0; i < d.nphotos; i++) {
        const orl_photo *p = &d.photos[i];
        tests += p->test;
        assert_true(p->test ? p->obs_count == 0 : p->obs_count > 20);
        orl_image im;
        assert_int_equal(orl_photo_load(p, 0, &im, NULL), ORL_OK);
        assert_int_equal(im.w, p->cam.w);
        assert_int_equal(im.h, p->cam.h);
        double mean = 0;
        for (int k = 0; k < im.w * im.h * 3; k++) mean += im.px[k];
        mean /= im.w * im.h * 3;
        assert_true(mean > 40 && mean < 225);
        orl_image_free(&im);
    }
    assert_int_equal(tests, 1);
    orl_dataset_free(&d);
}
/* Points of the model lie on the test photo's depth, or behind what hides them. */
static void depth_agrees_with_the_model(void **state)
{
    (void)state;
    const double scale = model_world().scale;
    char path[128];
    orl_colmap m, t;
    orl_imagef depth, normal;
    snprintf(path, sizeof path, "%s/sparse/0", one);
    assert_int_equal(orl_colmap_read(path, NULL, NULL, &m), ORL_OK);
    snprintf(path, sizeof path, "%s/sparse_test/0", one);
    assert_int_equal(orl_colmap_read(path, NULL, NULL, &t), ORL_OK);
    snprintf(path, sizeof path, "%s/gt/test_000_depth.exr", one);
    assert_int_equal(orl_exr_read(path, "Y", &depth), ORL_OK);
    snprintf(path, sizeof path, "%s/gt/test_000_normal.exr", one);
    assert_int_equal(orl_exr_read(path, "RGB", &normal), ORL_OK);
    int seen = 0, on = 0, before = 0;
    for (uint32_t i = 0; i < m.npoints; i++) {
        double cam[3], uv[2];
        orl_pose_apply(&t.images[0].pose, m.points[i].xyz, cam);
        if (!orl_camera_project(&t.cameras[0], cam, uv) || uv[0] < 0 || uv[1] < 0 || uv[0] >= depth.w || uv[1] >= depth.h) continue;
        int at = (int)uv[1] * depth.w + (int)uv[0];
        double truth = depth.px[at], z = cam[2] / scale;
        if (truth == 0) continue;
        float *n = &normal.px[3 * at];
        assert_true(fabsf(n[0] * n[0] + n[1] * n[1] + n[2] * n[2] - 1) < 0.01f);
        seen++, on += fabs(z - truth) < 0.04 * truth, before += z < 0.93 * truth;
    }
    assert_true(seen > 50);
    assert_true(on > seen * 6 / 10);
    assert_true(before < seen / 12);
    orl_imagef_free(&depth), orl_imagef_free(&normal), orl_colmap_free(&m), orl_colmap_free(&t);
}
static void pose_files_read(void **state)
{
    (void)state;
    static const struct { const char *file; double factor; } want[] = { { "kiosk/camera.txt", 2.2 }, { "gt/wide_test_000.txt", 1.8 } };
    for (int i = 0; i < 2; i++) {
        char path[128];
        orl_view_pose v[3];
        int count = 0;
        snprintf(path, sizeof path, "%s/%s", one, want[i].file);
        assert_int_equal(orl_posefile_read(path, v, 3, &count), ORL_OK);
        assert_int_equal(count, 2);
        double narrow = v[0].cam.w / v[0].cam.fx, wide = v[1].cam.w / v[1].cam.fx;
        assert_true(fabs(wide / narrow - want[i].factor) < 1e-3);
        for (int k = 0; k < 3; k++) assert_true(fabs(v[0].pose.t[k] - v[1].pose.t[k]) < 1e-9);
    }
}
static void clip_has_its_frames(void **state)
{
    (void)state;
    char path[128];
    uint8_t *bytes;
    size_t n;
    snprintf(path, sizeof path, "%s/kiosk/kiosk.y4m", one);
    assert_int_equal(orl_file_read(path, 1 << 26, &bytes, &n), ORL_OK);
    const char *end = memchr(bytes, '\n', n);
    assert_non_null(end);
    assert_memory_equal(bytes, "YUV4MPEG2 W96 H72 ", 18);
    assert_int_equal(n - (size_t)(end + 1 - (char *)bytes), 2 * (6 + 96 * 72 * 3 / 2));
    free(bytes);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(same_bytes_for_any_thread_count), cmocka_unit_test(points_reproject), cmocka_unit_test(opens_as_a_scene),
        cmocka_unit_test(depth_agrees_with_the_model), cmocka_unit_test(pose_files_read), cmocka_unit_test(clip_has_its_frames),
    };
    return cmocka_run_group_tests(tests, setup, teardown);
}
