/* `oriel relight`: the scene under a chosen sky, as a picture for display, as linear layers, or as a clip of a day. Colours are float, light by oriel/light.h without tone, so that an EXR
 * holds linear radiance in the panorama's units. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <unistd.h>
#include "oriel/math.h"
#include "oriel/parallel.h"
#include "runtime/commands.h"
#include "oriel/relight.h"
#include "runtime/sink.h"
#include "oriel/widen.h"

static const char HELP[] =
    "Usage: oriel relight --scene FILE --sky SKY (--pose FILE | --colmap DIR --photo NAME) [OPTION]... -o PICTURE\n"
    "       oriel relight --day LATITUDE[,DAY] ... -o CLIP.y4m\n"
    "Render the scene under an environment map. PICTURE: .png or .jpg for display, or .exr for work.\n\n"
    "  --scene FILE     scene file made by oriel-train\n"
    "  --sky FILE       equirectangular OpenEXR or Radiance (.hdr) picture, zenith at the top; the world's +X in the centre column, +Y a quarter to the left of it\n"
    "  --rotate DEG     turn the map counter-clockwise\n"
    "  --sun AZ,EL      move the map's sun, with its energy, to this azimuth and elevation (degrees; 0 the world's +X, 90 +Y)\n"
    "  --day LAT[,DAY]  a clip from sunrise to sunset at this latitude (degrees, south negative) and day (MM-DD or 1..366; 81, an equinox). The map's sun goes along, weaker and redder\n"
    "                   where it shines through more air than in the map; the sky dims with the sun's height. A map with a high sun gives the best days. CLIP: .y4m, - for standard output\n"
    "  --north DEG      for --day: the azimuth of north; 90\n"
    "  --frames N       for --day: pictures, 25 a second; 125\n"
    "  --tone TONE      display pictures and clips: neutral, warm, cool, faded, mono, contrast, or a text file of 12 numbers, the rows of [A b] in rgb = A e + b, e the sRGB colour in 0..1\n"
    "  --exposure EV    display pictures and clips: brighter by EV stops than the automatic exposure\n"
    "  --pose FILE      camera; the second line, where there is one, is the view rendered\n"
    "  --colmap DIR     or: a SCENE folder or COLMAP model, with\n"
    "  --photo NAME     the photo whose camera it is\n"
    "  --widen F        field of view, times the camera's; 1\n"
    "  --size WxH       size of the picture\n"
    "  --threads N      0: one per core\n"
    "  --help           this text\n\n"
    "An EXR is linear, in the map's units, 32-bit float, never toned or exposed: R, G, B; A (how much of a pixel is surface); albedo.R G B; normal.X Y Z (world);\n"
    "Z (along the optical axis, world units, 0 = sky); shadow.Y (the sun's visibility times the learned shadow); irradiance.R G B (sun, sky and ground, shadows in it);\n"
    "sky.R G B (times 1 - A). R = A * albedo.R * irradiance.R / pi + sky.R, and so on.\n";

#define PI 3.14159265f
#define DEG (PI / 180)

typedef struct {
    const char *scene, *sky, *photo, *out, *tone;
    orl_view_request view;
    double rotate, exposure, sun_az, sun_el, north;
    orl_day day;
    int moved, daily, directed, frames, threads;
} options;

/* What one run owns. */
typedef struct {
    const options *o;
    orl_day day;
    orl_scene scene;
    orl_view view;
    orl_panorama sky;
    orl_relight light;
    orl_tone tone;
    float *linear, *scratch;
    orl_image rgb;
    void *block;
} studio;

/* ---- pictures ---- */

static const char LAYERS[] = "R,G,B,A,albedo.R,albedo.G,albedo.B,normal.X,normal.Y,normal.Z,Z,shadow.Y,irradiance.R,irradiance.G,irradiance.B,sky.R,sky.G,sky.B";
enum { LAYER_CHANNELS = 18 };

typedef struct { const studio *s; double world[9]; float *px; } layer_job;      /* world: scene frame -> world */

static void layer_rows(void *user, int begin, int end)
{
    layer_job *j = user;
    const orl_view *v = &j->s->view;
    for (int y = begin; y < end; y++)
        for (int x = 0; x < v->w; x++) {
            uint16_t depth = v->depth[(size_t)y * (size_t)v->stride + (size_t)x];
            float *p = j->px + ((size_t)y * (size_t)v->w + (size_t)x) * LAYER_CHANNELS;
            orl_layers l;
            double ray[3];
            orl_relight_pixel(&j->s->light, x, y, &l);
            orl_camera_unproject(&v->cam, x + 0.5, y + 0.5, ray);
            for (int c = 0; c < 3; c++) {
                p[c] = l.rgb[c];
                p[4 + c] = l.albedo[c];
                for (int k = 0; k < 3; k++) p[7 + c] += (float)j->world[3 * c + k] * l.normal[k];
                p[12 + c] = l.irradiance[c];
                p[15 + c] = l.sky[c];
            }
            p[3] = l.cov;
            p[10] = depth == 65535 ? 0 : (float)depth / 16 * j->s->scene.cell_world / sqrtf((float)(ray[0] * ray[0] + ray[1] * ray[1] + 1));
            p[11] = l.shadow;
        }
}

static orl_err write_layers(const studio *s, const double R[9])
{
    orl_imagef im;
    orl_err e = orl_imagef_alloc(&im, s->view.w, s->view.h, LAYER_CHANNELS);
    if (e) return e;
    layer_job j = { .s = s, .px = im.px };
    for (int i = 0; i < 9; i++) j.world[i] = R[i % 3 * 3 + i / 3];
    orl_parallel(s->o->threads, s->view.h, 8, layer_rows, &j);
    e = orl_exr_write_float(s->o->out, &im, LAYERS);
    orl_imagef_free(&im);
    return e;
}

/* The factor on linear radiance that puts the bright surfaces of a picture at 0.8. */
static float gain_for(const studio *s, float bright) { return (bright > 0 ? 0.8f / bright : s->light.level) * orl_expf((float)s->o->exposure * 0.69314718f); }

static orl_err write_display(studio *s)
{
    orl_relight_linear(&s->light, s->o->threads, s->linear);
    orl_relight_display(&s->light, s->o->threads, s->linear, gain_for(s, orl_relight_bright(&s->light, s->linear, s->scratch)), &s->tone, s->rgb.px);
    return orl_image_write(s->o->out, &s->rgb);
}

/* ---- a day ---- */

static void show_at(studio *s, const orl_sun *sun)
{
    orl_relight_set(&s->light, sun);
    orl_relight_trace(&s->light, s->o->threads);
    orl_relight_linear(&s->light, s->o->threads, s->linear);
}

/* One exposure for all of a clip: that of the brightest of five hours. */
static float day_gain(studio *s, float rise)
{
    float top = 0;
    for (int i = 0; i < 5; i++) {
        orl_sun sun = orl_day_sun(&s->day, rise * (0.8f - 0.4f * (float)i), &s->sky);
        show_at(s, &sun);
        float bright = orl_relight_bright(&s->light, s->linear, s->scratch);
        top = bright > top ? bright : top;
    }
    return gain_for(s, top);
}

/* Every frame on a terminal, elsewhere a plain line every half minute. */
static void progress(double start, double *told, int done, int frames)
{
    int terminal = isatty(STDERR_FILENO);
    double t = orl_seconds();
    if (done < frames && t - *told < (terminal ? 0.5 : 30)) return;
    int left = (int)((t - start) * (frames - done) / done + 0.5);
    *told = t;
    fprintf(stderr, terminal ? "\rframe %d of %d, %d:%02d left\033[K%s" : "frame %d of %d, %d:%02d left%s", done, frames, left / 60, left % 60, terminal && done < frames ? "" : "\n");
}

static orl_err put_day(studio *s, orl_sink *sink, float rise)
{
    const options *o = s->o;
    double start = orl_seconds(), told = start;
    float gain = day_gain(s, rise);
    orl_err e = ORL_OK;
    for (int i = 0; !e && i < o->frames; i++) {
        orl_sun sun = orl_day_sun(&s->day, rise * (1 - (2 * (float)i + 1) / (float)o->frames), &s->sky);
        show_at(s, &sun);
        orl_relight_display(&s->light, o->threads, s->linear, gain, &s->tone, s->rgb.px);
        e = orl_sink_put(sink, s->rgb.px, (size_t)s->view.w * 3);
        progress(start, &told, i + 1, o->frames);
    }
    return e;
}

static orl_err write_day(studio *s)
{
    const char *out = s->o->out;
    char tmp[4200];
    int stream = !strcmp(out, "-");
    float rise;
    orl_sink *sink = NULL;
    orl_err e = orl_day_rise(&s->day, &rise);
    if (e) return e;
    if (snprintf(tmp, sizeof tmp, stream ? "%s" : "%s.tmp%ld", out, (long)getpid()) >= (int)sizeof tmp) return orl_fail(ORL_E_RANGE, "%s: path is too long", out);
    orl_sun noon = orl_day_sun(&s->day, 0, &s->sky);
    orl_relight_init(&s->view, &s->scene.light, &s->sky, &noon, &s->light);
    if ((e = orl_sink_y4m(tmp, s->view.w, s->view.h, 25, 1, &sink))) return e;
    e = put_day(s, sink, rise);
    orl_err last = orl_sink_close(sink, NULL, 0);
    e = e ? e : last;
    if (!e && !stream) return orl_file_replace(tmp, out);
    if (!stream) unlink(tmp);
    return e;
}

/* ---- the command ---- */

static int ends(const char *name, const char *with)
{
    size_t n = strlen(name), m = strlen(with);
    return n > m && !strcasecmp(name + n - m, with);
}

/* R: world -> scene frame; world: the scene azimuth of its azimuth 0. */
static orl_err set_up(studio *s, double R[9], float *world)
{
    const options *o = s->o;
    orl_view_pose from, to;
    orl_err e = orl_tone_find(o->tone ? o->tone : "neutral", &s->tone);
    if (!e) e = orl_place_open(o->scene, &s->scene);
    if (!e) e = orl_panorama_open(o->sky, &s->sky);
    if (!e && (o->moved || o->daily) && !s->sky.has_sun) e = orl_fail(ORL_E_DEGENERATE, "%s: no sun in it that --%s could move", o->sky, o->moved ? "sun" : "day");
    if (!e) e = orl_views_find(&o->view, o->photo ? o->photo : "", 0, 0, &from, &to);
    if (e) return e;
    size_t pixels = (size_t)to.cam.w * (size_t)to.cam.h, need = orl_view_need(to.cam.w, to.cam.h);
    s->block = orl_widen_block(need);
    s->linear = malloc(pixels * 3 * sizeof *s->linear);
    s->scratch = malloc(pixels * sizeof *s->scratch);
    if (!s->block || !s->linear || !s->scratch) return orl_fail(ORL_E_MEMORY, "no memory for a view of %d x %d", to.cam.w, to.cam.h);
    if ((e = orl_image_alloc(&s->rgb, to.cam.w, to.cam.h, 3))) return e;
    if ((e = orl_view_build(&s->scene, &to.cam, &to.pose, 2, o->threads, s->block, need, &s->view))) return e;
    const double *m = s->scene.world_to_grid;
    double scale = sqrt(m[0] * m[0] + m[1] * m[1] + m[2] * m[2]);
    for (int i = 0; i < 9; i++) R[i] = m[i / 3 * 4 + i % 3] / scale;
    /* The map's zenith is the scene's; its centre column is where the world's +X points (+Y, a quarter on, if +X is the vertical). */
    int y_axis = R[0] * R[0] + R[3] * R[3] < 0.01;
    *world = orl_atan2f((float)R[3 + y_axis], (float)R[y_axis]) - (float)y_axis * PI / 2;
    s->sky.turn = *world + (float)o->rotate * DEG;
    s->day = o->day;
    s->day.north = *world + (float)o->north * DEG;
    return ORL_OK;
}

static orl_err relight(const options *o)
{
    studio *s = calloc(1, sizeof *s);
    double R[9];
    if (!s) return orl_fail(ORL_E_MEMORY, "relight: no memory");
    s->o = o;
    float world = 0;
    orl_err e = set_up(s, R, &world);
    if (!e && o->daily) e = write_day(s);
    else if (!e) {
        orl_sun sun = orl_panorama_sun(&s->sky);
        if (o->moved) {
            sun.az = world + (float)o->sun_az * DEG;
            sun.el = (float)o->sun_el * DEG;
            sun.moved = 1;
        }
        orl_relight_init(&s->view, &s->scene.light, &s->sky, &sun, &s->light);
        orl_relight_trace(&s->light, o->threads);
        e = ends(o->out, ".exr") ? write_layers(s, R) : write_display(s);
    }
    free(s->linear); free(s->scratch); free(s->block);
    orl_image_free(&s->rgb);
    orl_panorama_close(&s->sky);
    orl_scene_close(&s->scene);
    free(s);
    return e;
}

/* LATITUDE[,DAY], DAY a number or MM-DD. */
static orl_err parse_day(const char *text, orl_day *d)
{
    static const int BEFORE[] = { 0, 31, 59, 90, 120, 151, 181, 212, 243, 273, 304, 334 }, LENGTH[] = { 31, 29, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31 };
    int month, day, used = 0;
    const char *rest = strchr(text, ',');
    d->day = 81;
    if (sscanf(text, "%lf%n", &d->latitude, &used) != 1 || !(fabs(d->latitude) <= 90) || text + used != (rest ? rest : text + strlen(text)))
        return orl_fail(ORL_E_RANGE, "--day %s: not LATITUDE[,DAY] with a latitude in -90..90", text);
    if (!rest) return ORL_OK;
    if (sscanf(++rest, "%2d-%2d%n", &month, &day, &used) == 2 && !rest[used] && month >= 1 && month <= 12 && day >= 1 && day <= LENGTH[month - 1]) d->day = BEFORE[month - 1] + day;
    else if (sscanf(rest, "%3d%n", &d->day, &used) != 1 || rest[used] || d->day < 1 || d->day > 366) return orl_fail(ORL_E_RANGE, "--day %s: the day is neither MM-DD nor in 1..366", text);
    return ORL_OK;
}

static orl_err parse_sun(const char *text, options *o)
{
    int used = 0;
    o->moved = 1;
    if (sscanf(text, "%lf,%lf%n", &o->sun_az, &o->sun_el, &used) == 2 && !text[used] && fabs(o->sun_az) <= 360 && o->sun_el >= 0 && o->sun_el <= 90) return ORL_OK;
    return orl_fail(ORL_E_RANGE, "--sun %s: not AZIMUTH,ELEVATION with |azimuth| <= 360 and elevation in 0..90", text);
}

/* What options must not do together. */
static orl_err check(const options *o)
{
    if (!o->scene || !o->sky || !o->out || !o->view.pose == !o->view.colmap || (o->view.colmap && !o->photo)) return orl_fail(ORL_E_RANGE, "wanted are --scene, --sky, -o, and either --pose or --colmap with --photo");
    int clip = !strcmp(o->out, "-") || ends(o->out, ".y4m");
    if (clip != o->daily) return orl_fail(ORL_E_RANGE, o->daily ? "-o %s: --day makes a .y4m clip" : "-o %s: a clip is made with --day", o->out);
    if (o->daily && o->moved) return orl_fail(ORL_E_RANGE, "--sun and --day both move the sun");
    if (!o->daily && o->directed) return orl_fail(ORL_E_RANGE, "--north and --frames go with --day");
    return ORL_OK;
}

static int parse(int argc, char **argv, options *o)
{
    static const struct option TABLE[] = {
        { "scene", required_argument, NULL, 's' }, { "sky", required_argument, NULL, 'k' }, { "pose", required_argument, NULL, 'p' }, { "colmap", required_argument, NULL, 'c' },
        { "photo", required_argument, NULL, 'n' }, { "widen", required_argument, NULL, 'w' }, { "size", required_argument, NULL, 'z' }, { "rotate", required_argument, NULL, 'r' },
        { "sun", required_argument, NULL, 'S' }, { "day", required_argument, NULL, 'd' }, { "north", required_argument, NULL, 'N' }, { "frames", required_argument, NULL, 'f' },
        { "tone", required_argument, NULL, 'T' }, { "exposure", required_argument, NULL, 'e' }, { "threads", required_argument, NULL, 't' }, { "output", required_argument, NULL, 'o' },
        { "help", no_argument, NULL, 'h' }, { 0 } };
    int first = 1;
    orl_err e = ORL_OK;
    for (int c; !e && (c = orl_option_next(argc, argv, TABLE, &first)) != -1; ) {
        if (orl_option_view(c, &o->view, &e)) continue;
        switch (c) {
        case 's': o->scene = optarg; break;
        case 'k': o->sky = optarg; break;
        case 'n': o->photo = optarg; break;
        case 'r': e = orl_option_real("--rotate", optarg, -360, 360, &o->rotate); break;
        case 'e': e = orl_option_real("--exposure", optarg, -20, 20, &o->exposure); break;
        case 'S': e = parse_sun(optarg, o); break;
        case 'd': e = parse_day(optarg, &o->day); o->daily = 1; break;
        case 'N': e = orl_option_real("--north", optarg, -360, 360, &o->north); o->directed = 1; break;
        case 'f': e = orl_option_int("--frames", optarg, 1, 1 << 20, &o->frames); o->directed = 1; break;
        case 'T': o->tone = optarg; break;
        case 't': e = orl_option_int("--threads", optarg, 0, 64, &o->threads); break;
        case 'o': o->out = optarg; break;
        case 'h': printf("%s", HELP); return -1;
        default: return ORL_EXIT_USAGE;
        }
    }
    if (!e && argc != optind) e = orl_fail(ORL_E_RANGE, "%s: not an option", argv[optind]);
    return e || check(o) ? ORL_EXIT_USAGE : ORL_EXIT_DONE;
}

int orl_cmd_relight(int argc, char **argv)
{
    options o = { .view.otherwise = 1, .north = 90, .frames = 125 };
    int code = parse(argc, argv, &o);
    if (code) return code < 0 ? ORL_EXIT_DONE : code;
    return relight(&o) ? ORL_EXIT_FAILED : ORL_EXIT_DONE;
}
