/* Sub-commands of oriel, and what their command lines share. Each parses its own options (getopt_long; argv[0] is the sub-command's name) and returns the exit code: 0 done,
 * 1 bad input or device, 2 usage; with 1 and 2 the reason is orl_error_text(), which main prints. */
#ifndef RUNTIME_COMMANDS_H
#define RUNTIME_COMMANDS_H
#include <getopt.h>
#include "oriel/camera.h"
#include "oriel/image.h"
#include "oriel/scene.h"

int orl_cmd_info(int argc, char **argv);
int orl_cmd_extend(int argc, char **argv);
int orl_cmd_relight(int argc, char **argv);
int orl_cmd_bake(int argc, char **argv);
int orl_cmd_bench(int argc, char **argv);
int orl_cmd_run(int argc, char **argv);

enum { ORL_EXIT_DONE = 0, ORL_EXIT_FAILED = 1, ORL_EXIT_USAGE = 2 };

/* Next option of a table (long options only but for -o); -1 at the end, '?' after recording what is wrong. Call with *first = 1 before the first. */
int orl_option_next(int argc, char **argv, const struct option *table, int *first);
/* A whole argument as a number in [lo, hi] or ORL_E_RANGE naming the option. */
orl_err orl_option_int(const char *option, const char *text, int lo, int hi, int *out);
orl_err orl_option_real(const char *option, const char *text, double lo, double hi, double *out);
orl_err orl_option_size(const char *option, const char *text, int *w, int *h);          /* WxH */

/* Which views: --pose, --colmap, --widen, --size. */
typedef struct { const char *pose, *colmap; double widen, otherwise; int w, h; } orl_view_request;     /* widen 0, w 0: not given; otherwise: the default of widen */
/* The camera that took `name` (its last path component; any with --pose), at the size of the picture w x h (0: as recorded), and the wide view wanted:
 * the pose file's second line, unless widen or size ask for another; without either the field of view `otherwise` times as wide. Size: the photo's scale, at most 4096 pixels. */
orl_err orl_views_find(const orl_view_request *q, const char *name, int w, int h, orl_view_pose *photo, orl_view_pose *wide);

/* Those options, 'p', 'c', 'w', 'z' in a table: 1 if c is one of them, with optarg taken or *e what is wrong with it. */
int orl_option_view(int c, orl_view_request *v, orl_err *e);
/* A camera at the size of the pictures that come from `name`: ORL_E_FORMAT if they have another shape. */
orl_err orl_camera_fit(orl_camera *c, const char *name, int w, int h);

/* A scene file to render: one that holds a sky decoder alone is ORL_E_FORMAT. */
orl_err orl_place_open(const char *path, orl_scene *out);
/* The rows of `oriel bench --mlp`. */
orl_err orl_bench_mlp(int json);
double orl_seconds(void);       /* monotonic */
void orl_json_string(const char *s);    /* to standard output, in quotes, escaped */

/* Seconds from a pose and a photo to the first whole picture (cmd_bench_pose.c), the best of some runs: views, light without the wide view's sun, that sun, the rest; and all. */
typedef struct { double views, light, sun, picture, all; } orl_pose_seconds;
orl_err orl_bench_pose(const orl_scene *s, const orl_view_pose *from, const orl_view_pose *to, const uint8_t *photo, int quick, int threads, orl_pose_seconds *out);

/* Part of `oriel bench`: conversion kernels. say gets a row: name, variant, seconds, bytes read and written. */
typedef void orl_bench_say(void *user, const char *name, const char *variant, double seconds, size_t bytes);
orl_err orl_bench_convert(orl_bench_say *say, void *user);
#endif
