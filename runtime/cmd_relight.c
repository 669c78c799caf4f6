/* `oriel relight`: the scene under a chosen sky. In: an equirectangular EXR (zenith at the top, azimuth (0.5 - u) * 360 degrees from the world's +X, counter-clockwise seen from above).
 * The sun is cut out of it, the rest becomes the light model's 8 x 32 map; colours are float, light by oriel/light.h without tone, so that an EXR holds linear radiance in the map's units. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include "oriel/math.h"
#include "oriel/parallel.h"
#include "oriel/view.h"
#include "runtime/commands.h"
#include "runtime/widen.h"

static const char HELP[] =
    "Usage: oriel relight --scene FILE --sky ENV.exr (--pose FILE | --colmap DIR --photo NAME) [OPTION]... -o PICTURE\n"
    "Render the scene under an environment map. PICTURE: .png or .jpg for display; .exr with linear R, G, B, albedo, normal (world), Z (along the optical axis, 0 = sky).\n\n"
    "  --scene FILE     scene file made by oriel-train\n"
    "  --sky FILE       equirectangular EXR, zenith at the top; the world's +X in the centre column\n"
    "  --rotate DEG     turn the map counter-clockwise\n"
    "  --sun AZ,EL      move the map's sun to this azimuth and elevation (degrees, azimuth as in the map)\n"
    "  --exposure EV    display pictures: brighter by EV stops than the automatic exposure\n"
    "  --pose FILE      camera; the second line, where there is one, is the view rendered\n"
    "  --colmap DIR     or: a SCENE folder or COLMAP model, with\n"
    "  --photo NAME     the photo whose camera it is\n"
    "  --widen F        field of view, times the camera's; 1\n"
    "  --size WxH       size of the picture\n"
    "  --threads N      0: one per core\n"
    "  --help           this text\n";

#define PI 3.14159265f
#define DEG (PI / 180)
#define LOBE (8 * DEG)                  /* the sun's energy lies within this of the brightest pixel */
#define RING (20 * DEG)                 /* the sky around it, from 1.5 lobes to here */

typedef struct {
    const char *scene, *sky, *photo, *out;
    orl_view_request view;
    double rotate, exposure, sun_az, sun_el;
    int moved, threads;
} options;

/* The map, with what is needed to ask it in the scene frame. */
typedef struct {
    orl_imagef map;
    float turn;                         /* scene azimuth of the map's centre column */
    int has_sun;
    float sun_az, sun_el, sun[3];       /* scene frame; irradiance at normal incidence */
    float rest[3];                      /* radiance that stands where the sun was cut out */
    float peak[3];                      /* direction of the lobe in the map's frame */
} sky;

static void direction(float az, float el, float d[3])
{
    float c = orl_cosf(el);
    d[0] = c * orl_cosf(az);
    d[1] = c * orl_sinf(az);
    d[2] = orl_sinf(el);
}

static float dot3(const float *a, const float *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
static float luminance(const float *c) { return 0.2126f * c[0] + 0.7152f * c[1] + 0.0722f * c[2]; }

/* Centre of map pixel (x, y), in the map's own frame; dw: its solid angle. */
static void map_pixel(const orl_imagef *m, float x, float y, float d[3], float *dw)
{
    float el = (0.5f - y / (float)m->h) * PI;
    direction((0.5f - x / (float)m->w) * 2 * PI, el, d);
    *dw = 2 * PI / (float)m->w * PI / (float)m->h * orl_cosf(el);
}

static int by_value(const void *a, const void *b)
{
    float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

static int in_lobe(const sky *s, const float d[3], const float *px) { return dot3(d, s->peak) > orl_cosf(LOBE) && luminance(px) > 4 * luminance(s->rest); }

/* The brightest pixel above the horizon, the sky around it, and what stands out of that sky. It is a sun if that lights a face turned to it more than a twentieth of what the sky does. */
static orl_err find_sun(sky *s)
{
    const orl_imagef *m = &s->map;
    size_t n = (size_t)m->w * (size_t)(m->h / 2), best = 0, count = 0;
    float d[3], dw, sun_dir[3] = { 0 }, whole = 0;
    float *ring = malloc(n * 3 * sizeof *ring);
    if (!ring) return orl_fail(ORL_E_MEMORY, "relight: no memory for the sky");
    for (size_t i = 0; i < n; i++) {
        if (luminance(m->px + 3 * i) > luminance(m->px + 3 * best)) best = i;
        map_pixel(m, 0.5f, (float)(i / (size_t)m->w) + 0.5f, d, &dw);
        whole += luminance(m->px + 3 * i) * dw * d[2];
    }
    map_pixel(m, (float)(best % (size_t)m->w) + 0.5f, (float)(best / (size_t)m->w) + 0.5f, s->peak, &dw);
    for (size_t i = 0; i < n; i++) {
        map_pixel(m, (float)(i % (size_t)m->w) + 0.5f, (float)(i / (size_t)m->w) + 0.5f, d, &dw);
        float c = dot3(d, s->peak);
        if (c > orl_cosf(1.5f * LOBE) || c < orl_cosf(RING)) continue;
        for (int k = 0; k < 3; k++) ring[(size_t)k * n + count] = m->px[3 * i + (size_t)k];
        count++;
    }
    for (int k = 0; k < 3 && count; k++) {
        qsort(ring + (size_t)k * n, count, sizeof *ring, by_value);
        s->rest[k] = ring[(size_t)k * n + count / 2];
    }
    free(ring);
    for (size_t i = 0; i < n; i++) {
        const float *px = m->px + 3 * i;
        map_pixel(m, (float)(i % (size_t)m->w) + 0.5f, (float)(i / (size_t)m->w) + 0.5f, d, &dw);
        if (!in_lobe(s, d, px)) continue;
        for (int k = 0; k < 3; k++) {
            s->sun[k] += (px[k] > s->rest[k] ? px[k] - s->rest[k] : 0) * dw;
            sun_dir[k] += luminance(px) * dw * d[k];
        }
    }
    float len = sqrtf(dot3(sun_dir, sun_dir));
    s->has_sun = luminance(s->sun) > 0.05f * whole && len > 0;
    if (!s->has_sun) {
        memset(s->sun, 0, sizeof s->sun);
        memcpy(sun_dir, s->peak, sizeof sun_dir);
        len = 1;
    }
    s->sun_az = s->turn + orl_atan2f(sun_dir[1], sun_dir[0]);
    s->sun_el = orl_asinf(sun_dir[2] / len);
    return ORL_OK;
}

/* Mean radiance of each cell of the light model's map, sun left out. Small maps are sampled several times a pixel, so that no cell stays empty. */
static void light_map(const sky *s, float env[ORL_ENV][3])
{
    const orl_imagef *m = &s->map;
    int sub = m->w >= 1024 ? 1 : (1023 + m->w) / m->w;
    double sum[ORL_ENV][4];
    memset(sum, 0, sizeof sum);
    for (int y = 0; y < m->h * sub; y++) {
        float el = (0.5f - ((float)y + 0.5f) / (float)(m->h * sub)) * PI, dw = orl_cosf(el);
        if (el <= 0) break;
        int row = (int)((PI / 2 - el) * 16 / PI);
        row = row > ORL_ENV_ROWS - 1 ? ORL_ENV_ROWS - 1 : row;
        for (int x = 0; x < m->w * sub; x++) {
            float az = (0.5f - ((float)x + 0.5f) / (float)(m->w * sub)) * 2 * PI, t = (az + s->turn - s->sun_az) / (2 * PI) + 0.5f, d[3];
            const float *px = m->px + ((size_t)(y / sub) * (size_t)m->w + (size_t)(x / sub)) * 3;
            int col = (int)((t - floorf(t)) * ORL_ENV_COLS) % ORL_ENV_COLS;
            if (s->has_sun) {
                direction(az, el, d);
                px = in_lobe(s, d, px) ? s->rest : px;
            }
            double *c = sum[row * ORL_ENV_COLS + col];
            for (int k = 0; k < 3; k++) c[k] += (double)px[k] * (double)dw;
            c[3] += (double)dw;
        }
    }
    for (int i = 0; i < ORL_ENV; i++)
        for (int k = 0; k < 3; k++) env[i][k] = sum[i][3] > 0 ? (float)(sum[i][k] / sum[i][3]) : 0;
}

/* The map itself in a scene direction, bilinear. */
static void look_up(const sky *s, const float dir[3], float rgb[3])
{
    const orl_imagef *m = &s->map;
    float u = 0.5f - (orl_atan2f(dir[1], dir[0]) - s->turn) / (2 * PI), v = 0.5f - orl_asinf(dir[2]) / PI;
    float x = (u - floorf(u)) * (float)m->w - 0.5f, y = v * (float)m->h - 0.5f;
    int ix = (int)floorf(x), iy = (int)floorf(y);
    float fx = x - (float)ix, fy = y - (float)iy;
    rgb[0] = rgb[1] = rgb[2] = 0;
    for (int k = 0; k < 4; k++) {
        int px = (ix + (k & 1) + m->w) % m->w, py = iy + (k >> 1);
        py = py < 0 ? 0 : py >= m->h ? m->h - 1 : py;
        float w = (k & 1 ? fx : 1 - fx) * (k >> 1 ? fy : 1 - fy);
        for (int c = 0; c < 3; c++) rgb[c] += w * m->px[((size_t)py * (size_t)m->w + (size_t)px) * 3 + (size_t)c];
    }
}

/* ---- the picture ---- */

typedef struct { const orl_view *view; const orl_light *light; const sky *sky; float scale; float *linear; } shading;     /* scale: map units -> light; linear: [pixel][3] in map units */

static void shade(void *user, int begin, int end)
{
    shading *s = user;
    for (int y = begin; y < end; y++)
        for (int x = 0; x < s->view->w; x++) {
            orl_sample p;
            float *o = s->linear + ((size_t)y * (size_t)s->view->w + (size_t)x) * 3, e[3] = { 0, 0, 0 }, far[3] = { 0, 0, 0 };
            memset(&p, 0, sizeof p);
            orl_view_sample(s->view, x, y, &p);
            float cov = p.cov;
            p.cov = 1;
            if (cov > 0) orl_light_shade(s->light, &p, e);
            if (cov < 1) look_up(s->sky, p.dir, far);
            for (int c = 0; c < 3; c++) o[c] = cov * orl_light_decode_srgb(e[c]) / s->scale + (1 - cov) * far[c];
        }
}

/* 95th percentile of the surface's luminance. */
static float bright(const orl_view *v, const float *linear)
{
    size_t n = 0, cap = (size_t)v->w * (size_t)v->h;
    float *l = malloc(cap * sizeof *l), r = 0;
    for (int y = 0; l && y < v->h; y++)
        for (int x = 0; x < v->w; x++)
            if (v->cov[(size_t)y * (size_t)v->stride + (size_t)x] == 255) l[n++] = luminance(linear + ((size_t)y * (size_t)v->w + (size_t)x) * 3);
    if (n) {
        qsort(l, n, sizeof *l, by_value);
        r = l[n * 95 / 100];
    }
    free(l);
    return r;
}

static orl_err write_display(const options *o, const orl_view *v, const float *linear, float fallback)
{
    orl_image im;
    float top = bright(v, linear), gain = (top > 0 ? 0.8f / top : fallback) * orl_expf((float)o->exposure * 0.69314718f);
    orl_err e = orl_image_alloc(&im, v->w, v->h, 3);
    if (e) return e;
    for (size_t i = 0; i < (size_t)v->w * (size_t)v->h * 3; i++) {
        float d = orl_light_encode(linear[i] * gain);
        im.px[i] = (uint8_t)((d > 1 ? 1 : d > 0 ? d : 0) * 255 + 0.5f);
    }
    e = orl_image_write(o->out, &im);
    orl_image_free(&im);
    return e;
}

static orl_err write_linear(const options *o, const orl_view *v, const float *linear, const double R[9], float cell_world)
{
    orl_imagef im;
    orl_err e = orl_imagef_alloc(&im, v->w, v->h, 10);
    if (e) return e;
    for (int y = 0; y < v->h; y++)
        for (int x = 0; x < v->w; x++) {
            size_t i = (size_t)y * (size_t)v->w + (size_t)x;
            uint16_t depth = v->depth[(size_t)y * (size_t)v->stride + (size_t)x];
            float *p = im.px + 10 * i;
            orl_sample s;
            double ray[3];
            memset(&s, 0, sizeof s);
            orl_view_sample(v, x, y, &s);
            orl_camera_unproject(&v->cam, x + 0.5, y + 0.5, ray);
            for (int c = 0; c < 3; c++) {
                p[c] = linear[3 * i + (size_t)c];
                p[3 + c] = s.cov > 0 ? s.albedo[c] : 0;
                for (int k = 0; k < 3; k++) p[6 + c] += s.cov > 0 ? (float)R[3 * k + c] * s.normal[k] : 0;      /* scene frame -> world */
            }
            p[9] = depth == 65535 ? 0 : (float)depth / 16 * cell_world / sqrtf((float)(ray[0] * ray[0] + ray[1] * ray[1] + 1));
        }
    e = orl_exr_write(o->out, &im, "R,G,B,albedo.R,albedo.G,albedo.B,normal.X,normal.Y,normal.Z,Z");
    orl_imagef_free(&im);
    return e;
}

static orl_err relight(const options *o)
{
    orl_scene scene = { 0 };
    orl_view_pose from, to;
    orl_view view;
    sky s;
    orl_light *light = malloc(sizeof *light);
    float (*env)[3] = malloc(ORL_ENV * sizeof *env), *linear = NULL, code[ORL_CODE], up[3];
    void *block = NULL;
    memset(&s, 0, sizeof s);
    orl_err e = light && env ? orl_place_open(o->scene, &scene) : orl_fail(ORL_E_MEMORY, "relight: no memory");
    if (!e) e = orl_exr_read(o->sky, "RGB", &s.map);
    if (!e && (s.map.w < 8 || s.map.h < 4)) e = orl_fail(ORL_E_RANGE, "%s: %d x %d pixels are no environment map", o->sky, s.map.w, s.map.h);
    if (!e) e = orl_views_find(&o->view, o->photo ? o->photo : "", 0, 0, &from, &to);
    if (e) goto done;
    size_t pixels = (size_t)to.cam.w * (size_t)to.cam.h, need = orl_view_need(to.cam.w, to.cam.h);
    block = orl_widen_block(need);
    linear = malloc(pixels * 3 * sizeof *linear);
    if (!block || !linear) {
        e = orl_fail(ORL_E_MEMORY, "relight: no memory for a view of %d x %d", to.cam.w, to.cam.h);
        goto done;
    }
    if ((e = orl_view_build(&scene, &to.cam, &to.pose, 2, o->threads, block, need, &view))) goto done;

    double R[9], scale = sqrt(scene.world_to_grid[0] * scene.world_to_grid[0] + scene.world_to_grid[1] * scene.world_to_grid[1] + scene.world_to_grid[2] * scene.world_to_grid[2]);
    for (int i = 0; i < 9; i++) R[i] = scene.world_to_grid[i / 3 * 4 + i % 3] / scale;
    /* The map's zenith is the scene's; its centre column is where the world's +X points (+Y, a quarter on, if +X is the vertical). */
    int y_axis = R[0] * R[0] + R[3] * R[3] < 0.01;
    s.turn = orl_atan2f((float)R[3 + y_axis], (float)R[y_axis]) - (float)y_axis * PI / 2 + (float)o->rotate * DEG;
    if ((e = find_sun(&s))) goto done;
    if (o->moved && !s.has_sun) {
        e = orl_fail(ORL_E_DEGENERATE, "%s: no sun in it that --sun could move", o->sky);
        goto done;
    }
    if (o->moved) {
        s.sun_az = s.turn + (float)o->sun_az * DEG;
        s.sun_el = (float)o->sun_el * DEG;
    }
    light_map(&s, env);
    memcpy(code, scene.light.prior_mean, sizeof code);
    memset(code + ORL_C_TONE, 0, ORL_TONE_DIM * sizeof *code);
    code[ORL_C_SUN_AZ] = s.sun_az;
    code[ORL_C_SUN_EL] = s.sun_el;
    for (int k = 0; k < 3; k++) code[ORL_C_SUN_RGB + k] = orl_logf(s.sun[k]);
    orl_light_from_env(&scene.light, (const float (*)[3])env, code, light);
    orl_light_esky(light, (const float[]) { 0, 0, 1 }, up);
    for (int k = 0; k < 3; k++) up[k] += s.sun[k] * orl_sinf(s.sun_el);
    /* Light that makes a white floor about 1: in the middle of the model's range. */
    float level = luminance(up) > 0 ? PI / luminance(up) : 1;
    for (int i = 0; i < ORL_ENV; i++)
        for (int k = 0; k < 3; k++) env[i][k] *= level;
    for (int k = 0; k < 3; k++) code[ORL_C_SUN_RGB + k] = orl_logf(s.sun[k] * level);
    orl_light_from_env(&scene.light, (const float (*)[3])env, code, light);

    shading job = { &view, light, &s, level, linear };
    orl_parallel(o->threads, view.h, 8, shade, &job);
    size_t len = strlen(o->out);
    e = len > 4 && !strcasecmp(o->out + len - 4, ".exr") ? write_linear(o, &view, linear, R, scene.cell_world) : write_display(o, &view, linear, level);
done:
    free(light); free(env); free(linear); free(block);
    orl_imagef_free(&s.map);
    orl_scene_close(&scene);
    return e;
}

/* ---- the command ---- */

static int parse(int argc, char **argv, options *o)
{
    static const struct option TABLE[] = {
        { "scene", required_argument, NULL, 's' }, { "sky", required_argument, NULL, 'k' }, { "pose", required_argument, NULL, 'p' }, { "colmap", required_argument, NULL, 'c' },
        { "photo", required_argument, NULL, 'n' }, { "widen", required_argument, NULL, 'w' }, { "size", required_argument, NULL, 'z' }, { "rotate", required_argument, NULL, 'r' },
        { "sun", required_argument, NULL, 'S' }, { "exposure", required_argument, NULL, 'e' }, { "threads", required_argument, NULL, 't' },
        { "output", required_argument, NULL, 'o' }, { "help", no_argument, NULL, 'h' }, { 0 } };
    int first = 1, used = 0;
    orl_err e = ORL_OK;
    for (int c; !e && (c = orl_option_next(argc, argv, TABLE, &first)) != -1; ) {
        switch (c) {
        case 's': o->scene = optarg; break;
        case 'k': o->sky = optarg; break;
        case 'p': o->view.pose = optarg; break;
        case 'c': o->view.colmap = optarg; break;
        case 'n': o->photo = optarg; break;
        case 'w': e = orl_option_real("--widen", optarg, 0.1, 20, &o->view.widen); break;
        case 'z': e = orl_option_size("--size", optarg, &o->view.w, &o->view.h); break;
        case 'r': e = orl_option_real("--rotate", optarg, -360, 360, &o->rotate); break;
        case 'e': e = orl_option_real("--exposure", optarg, -20, 20, &o->exposure); break;
        case 'S':
            if (sscanf(optarg, "%lf,%lf%n", &o->sun_az, &o->sun_el, &used) != 2 || optarg[used] || !(fabs(o->sun_az) <= 360) || !(o->sun_el >= 0 && o->sun_el <= 90))
                e = orl_fail(ORL_E_RANGE, "--sun %s: not AZIMUTH,ELEVATION with |azimuth| <= 360 and elevation in 0..90", optarg);
            o->moved = 1;
            break;
        case 't': e = orl_option_int("--threads", optarg, 0, 64, &o->threads); break;
        case 'o': o->out = optarg; break;
        case 'h': printf("%s", HELP); return -1;
        default: return ORL_EXIT_USAGE;
        }
    }
    if (e) return ORL_EXIT_USAGE;
    if (argc != optind || !o->scene || !o->sky || !o->out || !o->view.pose == !o->view.colmap || (o->view.colmap && !o->photo)) {
        orl_fail(ORL_E_RANGE, "wanted are --scene, --sky, -o, and either --pose or --colmap with --photo");
        return ORL_EXIT_USAGE;
    }
    return ORL_EXIT_DONE;
}

int orl_cmd_relight(int argc, char **argv)
{
    options o = { .view.otherwise = 1 };
    int code = parse(argc, argv, &o);
    if (code) return code < 0 ? ORL_EXIT_DONE : code;
    return relight(&o) ? ORL_EXIT_FAILED : ORL_EXIT_DONE;
}
