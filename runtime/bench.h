/* What the parts of `oriel bench` share: rows, errors, the picture that errors are taken against. Private to cmd_bench*.c. */
#ifndef RUNTIME_BENCH_H
#define RUNTIME_BENCH_H
#include "oriel/view.h"
#include "runtime/kernels/shade.h"
#include "oriel/widen.h"

enum { ORL_BENCH_RUNS = 9, ORL_BENCH_POINTS = 96, ORL_BENCH_SAME_DB = 999 };     /* SAME_DB: what stands for an infinite PSNR */

/* A setting's place in the plot: milliseconds, dB. series: a kernel variant, or the two below. */
enum { ORL_BENCH_VARIANTS = 5, ORL_BENCH_FLOAT = ORL_BENCH_VARIANTS, ORL_BENCH_POSE, ORL_BENCH_SERIES };
extern const char *const orl_bench_variant[ORL_BENCH_VARIANTS];
typedef struct { int series; char label[48]; double ms, db; } orl_bench_point;
typedef struct { int json; orl_bench_point point[ORL_BENCH_POINTS]; int points; } orl_bench;

/* NAN, 0, NULL: the row has none. */
typedef struct {
    const char *name, *variant;
    double seconds;
    double error_db; const char *error_of;      /* against what, where it is not the float model on the same view */
    size_t bytes;                               /* read and written */
    double once;                                /* seconds spent once a pose, on top */
    double without;                             /* seconds without this skip */
    double change_db;                           /* what the skip does to the picture: infinite where nothing */
} orl_bench_row;
#define ORL_BENCH_ROW .error_db = NAN, .once = NAN, .without = NAN, .change_db = NAN     /* first among a row's initialisers */
void orl_bench_put(const orl_bench *b, const orl_bench_row *r);

/* Of two pictures of n bytes; infinite where they are the same. */
double orl_bench_psnr(const uint8_t *a, const uint8_t *b, size_t n);
/* The float model on the view's own pixels, in 8 bits as the kernels write them. rgb: [h][w][3] */
void orl_bench_float(const orl_view *v, const orl_light *l, uint8_t *rgb);

/* Every quality setting of a pose: time and error against `exact` (the wide picture, tight RGB; NULL: made here, the densest that the runtime can). baked: of the same camera, or NULL. */
typedef struct {
    const orl_scene *scene;
    const orl_camera *cam, *photo_cam;
    const orl_pose *pose, *photo_pose;
    const orl_light *light;
    const orl_view *baked;
    const uint8_t *exact; const char *exact_name;
} orl_bench_place;
orl_err orl_bench_settings(orl_bench *b, const orl_bench_place *p);
/* A baked view alone. exact: NULL, the float model on the same view. */
orl_err orl_bench_baked(orl_bench *b, const orl_view *v, const orl_light *l, const uint8_t *exact, const char *exact_name);
orl_err orl_bench_plot(const orl_bench *b, const char *path, const char *title);
/* What is skipped, with and without, on views that are there. photo: at its camera's size. place: NULL without a scene; baked_path: NULL, or the file to be opened again. */
orl_err orl_bench_skips(const orl_bench *b, orl_widen *w, const orl_light *l, const uint8_t *photo, const orl_bench_place *place, const char *baked_path);
#endif
