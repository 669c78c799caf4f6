/* The training set: one SfM point in twenty trains nothing. */
#include "tests/scratch.h"
#include "oriel/image.h"
#include "trainer/world.h"

enum { VIEWS = 3, POINTS = 120, W = 64, H = 48 };

static void held_out_share(void **state)
{
    (void)state;
    int n = 0;
    for (uint64_t id = 0; id < 100000; id++) n += world_held_out(&(orl_colmap_point){ .id = id });
    assert_in_range(n, 4800, 5200);
}

/* Three photos of a wall of points. */
static void write_scene(void)
{
    orl_camera cam[VIEWS];
    orl_colmap_image im[VIEWS];
    static orl_colmap_obs obs[VIEWS * POINTS];
    static orl_colmap_point pt[POINTS];
    memset(im, 0, sizeof im);
    for (int i = 0; i < POINTS; i++) pt[i] = (orl_colmap_point){ .xyz = { (i % 12 - 5.5) * 0.3, (i / 12 - 4.5) * 0.3, 5 + 0.3 * (i % 5) }, .error_px = 0.5f };
    for (int k = 0; k < VIEWS; k++) {
        orl_image photo;
        assert_int_equal(orl_camera_from_params(&cam[k], ORL_CAM_PINHOLE, W, H, (double[4]){ 60, 60, W / 2.0, H / 2.0 }, 4), ORL_OK);
        snprintf(im[k].name, sizeof im[k].name, "%d.png", k);
        im[k].id = (uint32_t)k + 1;
        im[k].camera = k;
        im[k].pose = (orl_pose){ .R = { 1, 0, 0, 0, 1, 0, 0, 0, 1 }, .t = { 0.5 * (1 - k), 0, 0 } };
        im[k].obs_begin = (uint32_t)(k * POINTS);
        im[k].obs_count = POINTS;
        for (int i = 0; i < POINTS; i++) {
            double x[3], uv[2];
            orl_pose_apply(&im[k].pose, pt[i].xyz, x);
            assert_true(orl_camera_project(&cam[k], x, uv));
            obs[k * POINTS + i] = (orl_colmap_obs){ (float)uv[0], (float)uv[1], i };
        }
        assert_int_equal(orl_image_alloc(&photo, W, H, 3), ORL_OK);
        for (int i = 0; i < 3 * W * H; i++) photo.px[i] = (uint8_t)(i * 7 + k);
        make_way(at("photos/x"));
        assert_int_equal(orl_image_write(at("photos/%d.png", k), &photo), ORL_OK);
        orl_image_free(&photo);
    }
    make_way(at("sparse/0/x"));
    orl_colmap m = { cam, VIEWS, im, VIEWS, obs, VIEWS * POINTS, pt, POINTS };
    assert_int_equal(orl_colmap_write_text(at("sparse/0"), &m), ORL_OK);
}

static void held_out_points_do_not_train(void **state)
{
    (void)state;
    if (!strstr(orl_image_formats(), "png")) skip();
    orl_dataset d;
    world w;
    uint32_t kept = 0, out = 0;
    write_scene();
    assert_int_equal(orl_dataset_open(scratch, NULL, NULL, &d), ORL_OK);
    assert_int_equal(world_load(&d, W, 64, 1, 1, &w), ORL_OK);
    for (uint32_t i = 0; i < d.nobs; i++) {
        if (d.obs[i].point < 0) continue;
        if (world_held_out(&d.points[d.obs[i].point])) out++;
        else kept++;
    }
    assert_true(out > 0);
    assert_int_equal(w.nobs, kept);
    for (uint32_t i = 0; i < w.nobs; i++) assert_false(world_held_out(&d.points[w.obs[i].point]));
    world_free(&w);
    orl_dataset_free(&d);
}

int main(void)
{
    const struct CMUnitTest tests[] = { cmocka_unit_test(held_out_share), cmocka_unit_test_setup_teardown(held_out_points_do_not_train, scratch_make, scratch_remove) };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
