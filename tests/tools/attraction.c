/* A small procedural attraction: a town hall with portico, tower and arcaded wing on a paved square, ray traced as a photo collection.
 * In: options. Out: a SCENE folder with exact poses, SfM points, ground truth and a recorded kiosk clip, for `make demo` and the tests.
 * Every photo has its own sun, sky, exposure, white balance and tone curve; half of the training photos have people in the way.
 *
 * Inside, the unit is the metre, z is up, the facade looks towards -y. The written model is turned, scaled and moved (gt/world.tsv), for a
 * COLMAP model knows neither up nor scale; gt normals are in the written world, gt depth is in metres along the optical axis.
 * Light: sun disc of 0.53 degrees plus a parametric sky, one diffuse bounce. Sky light is sampled sparsely and filtered over equal surfaces.
 * Not modelled: gloss, lens errors, motion blur, a second bounce. Same seed, same bytes, for any thread count. */
#include <errno.h>
#include <getopt.h>
#include <stdio.h>
#include <sys/stat.h>
#include "oriel/colmap.h"
#include "oriel/image.h"
#include "oriel/parallel.h"
#include "tests/tools/attraction/place.h"

/* ---- light ---- */
enum { SKY_W = 128, SKY_H = 32 };
typedef struct {
    int kind;                       /* 0 clear, 1 intermediate, 2 overcast */
    float azimuth, elevation, cover, drift;
    v3 sun, sun_e;                  /* towards it; irradiance at normal incidence */
    v3 sky_up;                      /* irradiance of an open horizontal face by the sky */
    v3 table[SKY_H][SKY_W];         /* radiance, rows of equal sine */
} light;
static v3 sky(const light *l, v3 d)
{
    float z = clampf(d[2], 0, 1), away = acosf(clampf(dot(d, l->sun), -1, 1)), low = smooth(30 * DEG, 4 * DEG, l->elevation);
    v3 warm = l->sun_e * (1 / fmaxf(l->sun_e[1], 1e-3f));
    v3 grey = V(0.66f, 0.69f, 0.73f) * ((1 + 2 * z) / 3);
    v3 blue = mix(V(0.50f, 0.60f, 0.72f), V(0.11f, 0.23f, 0.50f), 1 - powf(1 - z, 2.4f));
    blue = mix(blue, blue * warm * 0.9f, low * powf(1 - z, 3) * (0.6f + 0.4f * cosf(away)));
    blue = blue + warm * (0.42f * expf(-3.2f * away) + 1.4f * expf(-14 * away)) * (l->kind == 1 ? 1.3f : 1);
    float far = 1 / (z + 0.09f), thick = fbm(d[0] * far * 1.3f + l->drift, d[1] * far * 1.3f + 5, l->drift * 0.3f, 5) / 0.97f;
    if (l->kind == 2) return grey * (0.72f + 0.55f * thick) + warm * 0.12f * expf(-2.2f * away);
    float cloud = smooth(0.62f - 0.42f * l->cover, 0.86f - 0.42f * l->cover, thick) * smooth(0.0f, 0.14f, z);
    v3 white = warm * (0.42f + 0.35f * expf(-2 * away)) + V(0.30f, 0.33f, 0.38f) - (thick - 0.5f) * 0.5f;
    return mix(blue, white, 0.92f * cloud);
}
static v3 sky_lookup(const light *l, v3 d)
{
    int row = (int)(clampf(d[2], 0, 0.9999f) * SKY_H), col = (int)((atan2f(d[1], d[0]) / (2 * PI) + 0.5f) * SKY_W);
    return l->table[row][col < 0 ? 0 : col >= SKY_W ? SKY_W - 1 : col];
}
static void light_set(light *l)
{
    float el = l->elevation, mass = 1 / (sinf(el) + 0.15f * powf(el / DEG + 3.885f, -1.253f)), strength = l->kind == 0 ? 7.0f : l->kind == 1
        ? 4.4f : 0.12f;
    l->sun = V(cosf(el) * cosf(l->azimuth), cosf(el) * sinf(l->azimuth), sinf(el));
    l->sun_e = V(expf(-0.10f * mass), expf(-0.17f * mass), expf(-0.30f * mass)) * strength;
    l->sky_up = V(0, 0, 0);
    for (int r = 0; r < SKY_H; r++)
        for (int c = 0; c < SKY_W; c++) {
            float z = ((float)r + 0.5f) / SKY_H, a = 2 * PI * (((float)c + 0.5f) / SKY_W - 0.5f), q = sqrtf(1 - z * z);
            l->table[r][c] = sky(l, V(q * cosf(a), q * sinf(a), z));
            l->sky_up = l->sky_up + l->table[r][c] * (z * 2 * PI / (SKY_W * SKY_H));
        }
}
static void frame_of(v3 n, v3 *a, v3 *b)
{
    *a = unit(cross(fabsf(n[2]) < 0.9f ? V(0, 0, 1) : V(1, 0, 0), n));
    *b = cross(n, *a);
}
/* What a ray of sky light brings back: the sky, or a surface under sun and sky (openness guessed from its normal). */
static v3 incoming(world w, const light *l, v3 o, v3 d)
{
    hit h;
    if (!trace(w, o, d, &h)) return sky_lookup(l, d);
    v3 p = o + d * h.t, e = l->sky_up * (h.n[2] > 0.7f ? 0.7f : 0.38f) + l->sun_e * (h.n[2] > 0.7f ? 0 : 0.05f);
    float facing = dot(h.n, l->sun);
    if (facing > 0 && !occluded(w, p + h.n * 2e-3f, l->sun, 1e4f)) e = e + l->sun_e * facing;
    return (h.q ? h.q->tint : pave_tint) * e * (1 / PI);
}

/* ---- a shot: camera, light, tone, people ---- */
typedef struct { orl_camera cam; orl_pose pose; v3 eye, right, down, forward; } view;      /* pose in the written world, the rest in metres */
typedef struct { float exposure, wb[3], contrast, saturation, shoulder, filter[3][3], offset[3]; bool filtered; } tone;
typedef struct { char name[32]; bool test; view view; light light; tone tone; set people; uint64_t seed; } shot;
typedef struct { double scale, R[9], offset[3]; } model_frame;

static model_frame model_world(void)
{
    model_frame m = { 0.37, { 0 }, { 3, -1.5, 7 } };
    orl_pose p;
    orl_err err = orl_pose_from_quat(&p, (double[4]){ 0.35, 0.62, -0.2, 0.67 }, m.offset);
    if (err) abort();
    memcpy(m.R, p.R, sizeof m.R);
    return m;
}
static void to_model(const model_frame *m, const double x[3], double scale, double out[3])
{
    for (int i = 0; i < 3; i++) out[i] = scale * (m->R[3 * i] * x[0] + m->R[3 * i + 1] * x[1] + m->R[3 * i + 2] * x[2]);
}
static view view_make(v3 eye, v3 target, float roll, int w, int h, float focal_px)
{
    const model_frame m = model_world();
    view v = { .eye = eye, .forward = unit(target - eye) };
    v3 right = unit(cross(v.forward, V(0, 0, 1))), down = cross(v.forward, right);
    v.right = right * cosf(roll) + down * sinf(roll), v.down = down * cosf(roll) - right * sinf(roll);
    v.cam = (orl_camera){ .model = ORL_CAM_PINHOLE, .w = w, .h = h, .fx = focal_px, .fy = focal_px, .cx = w / 2.0, .cy = h / 2.0 };
    double c[3], e[3] = { eye[0], eye[1], eye[2] };
    to_model(&m, e, m.scale, c);
    for (int i = 0; i < 3; i++) {
        v3 row = i == 0 ? v.right : i == 1 ? v.down : v.forward;
        double d[3] = { row[0], row[1], row[2] };
        to_model(&m, d, 1, &v.pose.R[3 * i]);
        v.pose.t[i] = 0;
        for (int k = 0; k < 3; k++) v.pose.t[i] -= v.pose.R[3 * i + k] * (c[k] + m.offset[k]);
    }
    return v;
}
static v3 view_ray(const view *v, float x, float y)
{
    return unit(v->forward + v->right * (float)((x - v->cam.cx) / v->cam.fx) + v->down * (float)((y - v->cam.cy) / v->cam.fy));
}

static void shot_light(shot *s, float pick, rng *r)   /* pick: 0..1, from clear to overcast */
{
    s->light = (light){ .kind = pick < 0.5f ? 0 : pick < 0.8f ? 1 : 2 };
    s->light.elevation = uniform(r, 14, 58) * DEG, s->light.drift = uniform(r, 0, 50);
    s->light.azimuth = ((rng_next(r) & 7) == 5 ? 90 + uniform(r, -60, 60) : -90 + uniform(r, -72, 72)) * DEG;
    s->light.cover = s->light.kind == 0 ? uniform(r, 0.1f, 0.5f) : uniform(r, 0.7f, 1.05f);
    light_set(&s->light);
}
static void shot_tone(shot *s, rng *r)
{
    tone *t = &s->tone;
    v3 white = uniform3(r, V(-0.12f, -0.03f, 0), V(0.12f, 0.03f, 0)), curve = uniform3(r, V(-0.1f, 0.85f, 0.45f), V(0.45f, 1.3f, 0.8f));
    *t = (tone){ .wb = { 1 + white[0], 1 + white[1], 1 - white[0] }, .contrast = curve[0], .saturation = curve[1], .shoulder = curve[2] };
    t->exposure = exp2f(clampf(0.25f * gauss(r), -0.45f, 0.5f)), t->filtered = uniform(r, 0, 1) < 0.25f;
    float amount = t->filtered ? 1 : 0;
    for (int i = 0; i < 3; i++) {
        v3 talk = uniform3(r, V(-0.05f, -0.05f, -0.12f), V(0.2f, 0.2f, 0.06f)) * amount;      /* from the other two channels; gain */
        for (int k = 0; k < 3; k++) t->filter[i][k] = (1 + talk[2]) * (i == k ? 1 - talk[0] - talk[1] : talk[(k - i + 3) % 3 - 1]);
        t->offset[i] = amount * uniform(r, -0.03f, 0.05f);
    }
}
static shot shot_make(uint64_t seed, int index, bool test, int width, const set *place)
{
    shot s = { .test = test, .seed = seed * 1000 + (uint64_t)index + (test ? 500 : 0) };
    rng r = rng_make(seed, (uint64_t)index + (test ? 5000 : 1000));
    snprintf(s.name, sizeof s.name, "%s_%03d.jpg", test ? "test" : "train", index);
    int tall = width * 3 / 4;
    for (;;) {
        bool portrait = uniform(&r, 0, 1) < 0.18f;
        int w = portrait ? tall : width, h = portrait ? width : tall;
        /* Angles are spread evenly with some jitter, so that every side of the arc is seen whatever the number. */
        float arc = (test ? 40 : 50) * (2 * fmodf(0.618034f * (float)index + (test ? 0.31f : 0.5f), 1) - 1) + 3 * gauss(&r);
        float away = uniform(&r, 28, 50);
        float focal = portrait ? uniform(&r, 26, 40) : uniform(&r, 26, away > 40 ? 50 : away > 34 ? 40 : 32);
        float high = uniform(&r, 0, 1) < 0.7f ? uniform(&r, 1.5f, 2.2f) : uniform(&r, 2.2f, 8);
        v3 eye = V(-2 + away * sinf(arc * DEG), -3 - away * cosf(arc * DEG), high);
        v3 target = portrait ? uniform3(&r, V(4, 0, 9), V(17, 0, 13)) : uniform3(&r, V(-1, -2, 6.5f), V(-1, -2, 10.5f));
        if (!portrait) target[0] += 7 * gauss(&r);
        target[0] = clampf(target[0], -16, 14);
        s.view = view_make(eye, target, clampf(1.0f * gauss(&r), -2.2f, 2.2f) * DEG, w, h, focal / 36 * (float)width);
        hit h0 = { .t = 14 };
        bool blocked = false;                           /* not with the nose in a tree */
        for (int i = 0; i < 9; i++) {
            v3 d = view_ray(&s.view, (float)w * (0.1f + 0.4f * (float)(i % 3)), (float)h * (0.1f + 0.4f * (float)(i / 3)));
            blocked |= set_trace(place, eye, d, 1e-3f, &h0, true);
        }
        if (!blocked) break;
    }
    shot_light(&s, fmodf(0.618034f * (float)index + 0.25f, 1), &r), shot_tone(&s, &r);
    if (!test && index % 2 == 1) {
        int count = 3 + (int)(rng_next(&r) % 12), posing = rng_next(&r) % 3 ? 0 : 1 + (int)(rng_next(&r) % 2);
        for (int i = 0; i < count; i++) {
            float d = i < posing ? uniform(&r, 2.8f, 4.5f) : uniform(&r, 7, 36), x = uniform(&r, 0.08f, 0.92f) * (float)s.view.cam.w;
            v3 ray = view_ray(&s.view, x, (float)s.view.cam.cy);
            v3 at = s.view.eye + V(ray[0], ray[1], 0) * d;
            if (at[1] > -9.5f) continue;
            float heading = uniform(&r, 0, 2 * PI), phase = uniform(&r, 0, 2 * PI);
            person(&s.people, &r, at[0], at[1], heading, phase);
        }
        set_build(&s.people);
    }
    return s;
}

/* ---- rendering: 2 x 2 samples a pixel, sky light 4 rays a sample in interleaved strata, filtered over the surface ---- */
typedef struct { v3 p, n, base, sun, sky; float t; int label; } sample;     /* label as in masks; sky: radiance where label is 128 */
typedef struct { const view *view; const light *light; world world; uint64_t seed; int w, h; sample *s; v3 *linear; uint8_t *label; } job;
static void trace_rows(void *user, int begin, int end)
{
    job *j = user;
    int W = 2 * j->w;
    for (int y = begin; y < end; y++)
        for (int x = 0; x < W; x++) {
            sample *s = &j->s[(size_t)y * (size_t)W + (size_t)x];
            rng r = rng_make(j->seed, ((uint64_t)y << 20) + (uint64_t)x);
            float px = ((float)x + uniform(&r, 0.2f, 0.8f)) / 2, py = ((float)y + uniform(&r, 0.2f, 0.8f)) / 2;
            v3 d = view_ray(j->view, px, py);
            hit h;
            *s = (sample){ .label = 128 };
            if (!trace(j->world, j->view->eye, d, &h)) { s->sky = sky(j->light, d); continue; }
            const set *who = j->world.people;
            s->label = h.q && who->n && h.q >= who->p && h.q < who->p + who->n ? 255 : 0;
            s->t = h.t, s->n = h.n, s->p = j->view->eye + d * h.t;
            s->base = base_colour(h.q, s->p, h.n, h.t / (float)j->view->cam.fx * 0.6f / clampf(-dot(d, h.n), 0.25f, 1));
            v3 a, b, from = s->p + h.n * 2e-3f;
            frame_of(j->light->sun, &a, &b);
            float turn = uniform(&r, 0, 2 * PI), out = 0.00463f * sqrtf(uniform(&r, 0, 1));
            v3 to_sun = unit(j->light->sun + a * (out * cosf(turn)) + b * (out * sinf(turn)));
            float facing = dot(h.n, to_sun);
            if (facing > 0 && !occluded(j->world, from, to_sun, 1e4f)) s->sun = j->light->sun_e * facing;
            frame_of(h.n, &a, &b);
            int cell = (x & 3) + 4 * (y & 3);
            for (int k = 0; k < 4; k++) {               /* 64 strata shared by 4 x 4 neighbours */
                float u = ((float)((k & 1) * 4 + (cell & 3)) + uniform(&r, 0, 1)) / 8,
                    v = ((float)((k >> 1) * 4 + (cell >> 2)) + uniform(&r, 0, 1)) / 8;
                float q = sqrtf(u), up = sqrtf(1 - u);
                v3 w = a * (q * cosf(2 * PI * v)) + b * (q * sinf(2 * PI * v)) + h.n * up;
                s->sky = s->sky + incoming(j->world, j->light, from, w) * (PI / 4);
            }
        }
}
static void filter_rows(void *user, int begin, int end)
{
    job *j = user;
    int W = 2 * j->w, H = 2 * j->h;
    for (int y = begin; y < end; y++)
        for (int x = 0; x < j->w; x++) {
            v3 sum = { 0 };
            int sky_count = 0, people = 0;
            for (int k = 0; k < 4; k++) {
                int sx = 2 * x + (k & 1), sy = 2 * y + (k >> 1);
                const sample *s = &j->s[(size_t)sy * (size_t)W + (size_t)sx];
                if (s->label == 128) { sum = sum + s->sky, sky_count++; continue; }
                people += s->label == 255;
                v3 e = { 0 };
                float weight = 0, slack = 0.02f + 0.0012f * s->t;
                for (int v = sy - 3 < 0 ? 0 : sy - 3; v <= sy + 3 && v < H; v++)
                    for (int u = sx - 3 < 0 ? 0 : sx - 3; u <= sx + 3 && u < W; u++) {
                        const sample *o = &j->s[(size_t)v * (size_t)W + (size_t)u];
                        if (o->label != s->label || dot(o->n, s->n) < 0.85f || fabsf(dot(o->p - s->p, s->n)) > slack) continue;
                        float g = (float)((4 - abs(u - sx)) * (4 - abs(v - sy)));
                        e = e + o->sky * g, weight += g;
                    }
                sum = sum + s->base * (s->sun + e * (1 / weight)) * (1 / PI);
            }
            size_t at = (size_t)y * (size_t)j->w + (size_t)x;
            j->linear[at] = sum * 0.25f;
            j->label[at] = people ? 255 : sky_count > 1 ? 128 : 0;
        }
}
typedef struct { int w, h; sample *s; v3 *linear; uint8_t *label; } picture;
static void picture_free(picture *p) { free(p->s), free(p->linear), free(p->label), *p = (picture){ 0 }; }
static orl_err render(const view *v, const light *l, const set *place, const set *people, uint64_t seed, int threads, picture *out)
{
    const size_t n = (size_t)v->cam.w * (size_t)v->cam.h;
    picture p = { v->cam.w, v->cam.h, malloc(4 * n * sizeof *p.s), malloc(n * sizeof *p.linear), malloc(n) };
    if (!p.s || !p.linear || !p.label) {
        picture_free(&p);
        return orl_fail(ORL_E_MEMORY, "attraction: no memory for a picture of %d x %d", v->cam.w, v->cam.h);
    }
    job j = { v, l, { place, people }, seed, p.w, p.h, p.s, p.linear, p.label };
    orl_parallel(threads, 2 * p.h, 4, trace_rows, &j);
    orl_parallel(threads, p.h, 4, filter_rows, &j);
    *out = p;
    return ORL_OK;
}
/* Exposure that puts the place (not the sky) at about a quarter of full scale. */
static float meter(const picture *p)
{
    double sum = 0, n = 0;
    for (int i = 0; i < p->w * p->h; i++)
        if (p->label[i] != 128) sum += (double)sqrtf(luminance(p->linear[i])), n++;
    float mean = n ? (float)(sum / n) : 0.4f;
    return 0.245f / fmaxf(mean * mean, 1e-3f);
}
static float encode(float x) { return x <= 0.0031308f ? 12.92f * x : 1.055f * powf(x, 1 / 2.4f) - 0.055f; }
static orl_err develop(const picture *p, const tone *t, uint64_t seed, orl_image *out)
{
    orl_image im;
    orl_err err = orl_image_alloc(&im, p->w, p->h, 3);
    if (err) return err;
    rng r = rng_make(seed, 77);
    for (int i = 0; i < p->w * p->h; i++) {
        v3 c = p->linear[i] * t->exposure * V(t->wb[0], t->wb[1], t->wb[2]), f = V(t->offset[0], t->offset[1], t->offset[2]);
        for (int k = 0; k < 3; k++) {
            float over = c[k] - t->shoulder, room = 1 - t->shoulder;
            float e = encode(over > 0 ? t->shoulder + room * (1 - expf(-over / room)) : c[k]);
            c[k] = mixf(e, e * e * (3 - 2 * e), t->contrast);
        }
        c = mix(V(luminance(c), luminance(c), luminance(c)), c, t->saturation);
        for (int k = 0; k < 3; k++) f = f + V(t->filter[0][k], t->filter[1][k], t->filter[2][k]) * c[k];
        for (int k = 0; k < 3; k++) im.px[3 * i + k] = (uint8_t)(clampf(f[k] + (seed ? 0.005f * gauss(&r) : 0), 0, 1) * 255 + 0.5f);
    }
    *out = im;
    return ORL_OK;
}

/* ---- files ---- */
typedef struct { const char *dir; int photos, tests, width, frames, points, threads; uint64_t seed; bool masks; } options;

static orl_err folder(const char *dir, const char *name, char path[1024])
{
    if (snprintf(path, 1024, "%s%s%s", dir, *name ? "/" : "", name) >= 960) return orl_fail(ORL_E_RANGE, "%s: path too long", dir);
    if (mkdir(path, 0777) && errno != EEXIST) return orl_fail(ORL_E_IO, "%s: %s", path, strerror(errno));
    return ORL_OK;
}
/* A text in memory, written in one piece by text_close. */
typedef struct { FILE *f; char *bytes; size_t n; } text;
static orl_err text_open(text *t)
{
    *t = (text){ 0 };
    return (t->f = open_memstream(&t->bytes, &t->n)) ? ORL_OK : orl_fail(ORL_E_MEMORY, "attraction: no memory for a text");
}
static orl_err text_close(text *t, orl_err err, const char *dir, const char *name)
{
    char path[1200];
    if (t->f && fclose(t->f) && !err) err = orl_fail(ORL_E_MEMORY, "attraction: no memory for %s", name);
    snprintf(path, sizeof path, "%s/%s", dir, name);
    if (!err) err = orl_file_write(path, t->bytes, t->n);
    free(t->bytes);
    return err;
}
static void print_pose(FILE *f, const char *name, const orl_camera *c, const orl_pose *p)
{
    double q[4];
    orl_pose_to_quat(p, q);
    fprintf(f, "%s PINHOLE %d %d %.9g %.9g %.9g %.9g %.12g %.12g %.12g %.12g %.12g %.12g %.12g\n", name, c->w, c->h, c->fx, c->fy, c->cx,
        c->cy,
            q[0], q[1], q[2], q[3], p->t[0], p->t[1], p->t[2]);
}
static void wide_size(const orl_camera *c, int *w, int *h) { *w = c->w * 3 / 4 * 2, *h = c->h * 3 / 4 * 2; }
static view widened(const view *v, double factor)
{
    view wide = *v;
    int w, h;
    wide_size(&v->cam, &w, &h);
    wide.cam = orl_camera_widened(&v->cam, factor, w, h);
    return wide;
}
static orl_err write_pose_pair(const char *dir, const char *file, const char *name, const view *v, const char *wide_name, const view *wide)
{
    text t;
    orl_err err = text_open(&t);
    if (err) return err;
    fprintf(t.f, "# NAME MODEL WIDTH HEIGHT FX FY CX CY QW QX QY QZ TX TY TZ   (world-to-camera, x right, y down, z forward)\n");
    print_pose(t.f, name, &v->cam, &v->pose), print_pose(t.f, wide_name, &wide->cam, &wide->pose);
    return text_close(&t, ORL_OK, dir, file);
}
static orl_err write_image(const char *dir, const char *name, const orl_image *im)
{
    char path[1200];
    snprintf(path, sizeof path, "%s/%s", dir, name);
    return orl_image_write(path, im);
}
/* Depth and normal at pixel centres, base colour averaged. */
static orl_err write_truth(const shot *s, const set *place, const picture *p, const char *dir)
{
    const model_frame m = model_world();
    const set nobody = { 0 };
    orl_imagef depth = { 0 }, normal = { 0 }, albedo = { 0 };
    char path[1200], stem[32];
    orl_err err;
    snprintf(stem, sizeof stem, "%.*s", (int)strcspn(s->name, "."), s->name);
    if ((err = orl_imagef_alloc(&depth, p->w, p->h, 1)) || (err = orl_imagef_alloc(&normal, p->w, p->h, 3)) ||
        (err = orl_imagef_alloc(&albedo, p->w, p->h, 3))) goto done;
    for (int y = 0; y < p->h; y++)
        for (int x = 0; x < p->w; x++) {
            size_t at = (size_t)y * (size_t)p->w + (size_t)x;
            v3 d = view_ray(&s->view, (float)x + 0.5f, (float)y + 0.5f), base = { 0 };
            const sample *four = &p->s[4 * (size_t)y * (size_t)p->w + 2 * (size_t)x];
            for (int k = 0; k < 4; k++) base = base + four[(k >> 1) * 2 * p->w + (k & 1)].base * 0.25f;
            for (int k = 0; k < 3; k++) albedo.px[3 * at + (size_t)k] = base[k];
            hit h;
            if (!trace((world){ place, &nobody }, s->view.eye, d, &h)) continue;
            double n[3] = { h.n[0], h.n[1], h.n[2] }, turned[3];
            to_model(&m, n, 1, turned);
            depth.px[at] = h.t * dot(d, s->view.forward);
            for (int k = 0; k < 3; k++) normal.px[3 * at + (size_t)k] = (float)turned[k];
        }
    snprintf(path, sizeof path, "%s/%s_depth.exr", dir, stem);
    if ((err = orl_exr_write(path, &depth, "Y"))) goto done;
    snprintf(path, sizeof path, "%s/%s_normal.exr", dir, stem);
    if ((err = orl_exr_write(path, &normal, "R,G,B"))) goto done;
    snprintf(path, sizeof path, "%s/%s_albedo.exr", dir, stem);
    err = orl_exr_write(path, &albedo, "R,G,B");
done:
    orl_imagef_free(&depth), orl_imagef_free(&normal), orl_imagef_free(&albedo);
    return err;
}
static bool project(const view *v, v3 p, float uv[2], float *depth)
{
    v3 c = p - v->eye;
    *depth = dot(c, v->forward);
    if (*depth < 0.5f) return false;
    uv[0] = (float)v->cam.fx * dot(c, v->right) / *depth + (float)v->cam.cx,
        uv[1] = (float)v->cam.fy * dot(c, v->down) / *depth + (float)v->cam.cy;
    return uv[0] > 1 && uv[1] > 1 && uv[0] < (float)v->cam.w - 1 && uv[1] < (float)v->cam.h - 1;
}
typedef struct { int photo; orl_colmap_obs obs; } sighting;
/* SfM points where the surface has texture, seen by enough training photos; sightings are off by 0.4 px, points by what that makes of it. */
static orl_err write_model(const options *o, const char *dir, const shot *shots, const orl_image *photos, int n, const set *place,
    bool points)
{
    const model_frame m = model_world();
    const int enough = n >= 8 ? 3 : 2;
    const size_t cap = points ? (size_t)o->points * (size_t)n + 1 : 1;
    orl_colmap c = { .ncameras = (uint32_t)n, .nimages = (uint32_t)n };
    c.cameras = calloc((size_t)n, sizeof *c.cameras), c.images = calloc((size_t)n, sizeof *c.images);
    c.obs = calloc(cap, sizeof *c.obs), c.points = calloc((size_t)o->points + 1, sizeof *c.points);
    sighting *seen = malloc(cap * sizeof *seen);
    orl_err err = c.cameras && c.images && c.obs && c.points && seen ? ORL_OK : orl_fail(ORL_E_MEMORY, "attraction: no memory for the model");
    size_t nseen = 0;
    rng r = rng_make(o->seed, 3);
    for (int tries = 0; !err && points && tries < 60 * o->points && (int)c.npoints < o->points; tries++) {
        const shot *s = &shots[rng_next(&r) % (uint32_t)n];
        hit h;
        v3 px = uniform3(&r, V(0, 0, 0), V(s->view.cam.w, s->view.cam.h, 0)), d = view_ray(&s->view, px[0], px[1]);
        if (!trace((world){ place, &(set){ 0 } }, s->view.eye, d, &h) || h.t > 120) continue;
        v3 p = s->view.eye + d * h.t, a, b, at = p;
        frame_of(h.n, &a, &b);
        float lo = 1, hi = 0;
        for (int k = 0; k < 5; k++) {
            v3 q = p + (k == 0 ? a * 0 : k == 1 ? a : k == 2 ? -a : k == 3 ? b : -b) * 0.2f;
            float l = sqrtf(luminance(base_colour(h.q, q, h.n, 0.06f)));
            lo = fminf(lo, l), hi = fmaxf(hi, l);
        }
        if (hi - lo < uniform(&r, 0.02f, 0.12f)) continue;
        size_t first = nseen;
        float blur = 0, error = 0, rgb[3] = { 0 };
        for (int i = 0; i < n; i++) {
            float uv[2], depth;
            v3 to = shots[i].view.eye - p;
            float far = sqrtf(dot(to, to));
            bool keep = uniform(&r, 0, 1) < 0.85f;
            if (!keep || dot(to, h.n) < 0.17f * far || !project(&shots[i].view, p, uv, &depth)) continue;
            if (occluded((world){ place, &shots[i].people }, p + h.n * 5e-3f, to * (1 / far), far)) continue;
            for (int k = 0; k < 3; k++) rgb[k] += photos[i].px[3 * ((int)uv[1] * photos[i].w + (int)uv[0]) + k];
            blur += depth / (float)shots[i].view.cam.fx;
            for (int k = 0; k < 2; k++) uv[k] = clampf(uv[k] + 0.4f * gauss(&r), 0, (float)(k ? photos[i].h : photos[i].w));
            seen[nseen++] = (sighting){ i, { uv[0], uv[1], (int32_t)c.npoints } };
        }
        int track = (int)(nseen - first);
        if (track < enough) { nseen = first; continue; }
        for (int k = 0; k < 3; k++) at[k] += 0.4f * blur / (float)track / sqrtf((float)track) * gauss(&r);
        for (size_t i = first; i < nseen; i++) {
            float uv[2] = { seen[i].obs.x, seen[i].obs.y }, depth;
            project(&shots[seen[i].photo].view, at, uv, &depth);
            error += hypotf(uv[0] - seen[i].obs.x, uv[1] - seen[i].obs.y) / (float)track;
        }
        orl_colmap_point *q = &c.points[c.npoints++];
        to_model(&m, (double[3]){ at[0], at[1], at[2] }, m.scale, q->xyz);
        for (int k = 0; k < 3; k++) q->xyz[k] += m.offset[k], q->rgb[k] = (uint8_t)(rgb[k] / (float)track + 0.5f);
        q->error_px = error, q->track_length = (uint32_t)track;
    }
    for (int i = 0; i < n && !err; i++) {
        orl_colmap_image *im = &c.images[i];
        c.cameras[i] = shots[i].view.cam;
        snprintf(im->name, sizeof im->name, "%s", shots[i].name);
        im->id = (uint32_t)i + 1, im->camera = i, im->pose = shots[i].view.pose, im->obs_begin = c.nobs;
        for (size_t k = 0; k < nseen; k++)
            if (seen[k].photo == i) c.obs[c.nobs++] = seen[k].obs, im->obs_count++;
    }
    if (!err) err = orl_colmap_write_text(dir, &c);
    if (!err && points) printf("  %u points, %u sightings\n", c.npoints, c.nobs);
    free(c.cameras), free(c.images), free(c.obs), free(c.points), free(seen);
    return err;
}
static orl_err write_tables(const options *o, const shot *shots, int n, const char *gt)
{
    const model_frame m = model_world();
    text t;
    orl_err err = text_open(&t);
    if (err) return err;
    fprintf(t.f, "filename\tid\tsplit\tdataset\n");
    for (int i = 0; i < n; i++) fprintf(t.f, "%s\t%d\t%s\tattraction\n", shots[i].name, i, shots[i].test ? "test" : "train");
    if ((err = text_close(&t, ORL_OK, o->dir, "split.tsv")) || (err = text_open(&t))) return err;
    fprintf(t.f, "name\tsky\tsun_x\tsun_y\tsun_z\tsun_elevation_deg\tirradiance_r\tirradiance_g\tirradiance_b\texposure"
            "\twb_r\twb_g\twb_b\tcontrast\tsaturation\tshoulder\tfilter\tpeople\n");
    for (int i = 0; i < n; i++) {
        const shot *s = &shots[i];
        const tone *k = &s->tone;
        double d[3];
        to_model(&m, (double[3]){ s->light.sun[0], s->light.sun[1], s->light.sun[2] }, 1, d);
        fprintf(t.f, "%s\t%s\t%.6f\t%.6f\t%.6f\t%.3f\t%.5g\t%.5g\t%.5g\t%.5g\t%.4f\t%.4f\t%.4f\t%.4f\t%.4f\t%.4f\t%d\t%d\n", s->name,
                (const char *[]){ "clear", "intermediate", "overcast" }[s->light.kind], d[0], d[1], d[2], s->light.elevation / DEG,
                s->light.sun_e[0], s->light.sun_e[1], s->light.sun_e[2], k->exposure, k->wb[0], k->wb[1], k->wb[2], k->contrast,
                    k->saturation, k->shoulder, k->filtered, s->people.n > 0);
    }
    if ((err = text_close(&t, ORL_OK, gt, "photo_params.tsv")) || (err = text_open(&t))) return err;
    fprintf(t.f, "# model = scale * rotation * metres + offset; in metres x runs along the facade, y into the building, z up\n"
            "scale\t%.9g\nrotation", m.scale);
    for (int i = 0; i < 9; i++) fprintf(t.f, "\t%.12g", m.R[i]);
    fprintf(t.f, "\noffset\t%.9g\t%.9g\t%.9g\n", m.offset[0], m.offset[1], m.offset[2]);
    return text_close(&t, ORL_OK, gt, "world.tsv");
}
/* One frame of 4:2:0 planes, full-range BT.601. */
static void put_i420(FILE *f, const orl_image *im)
{
    fputs("FRAME\n", f);
    const uint8_t *px = im->px;
    for (int i = 0; i < im->w * im->h; i++, px += 3) fputc((int)(0.299f * px[0] + 0.587f * px[1] + 0.114f * px[2] + 0.5f), f);
    for (int plane = 0; plane < 2; plane++)
        for (int y = 0; y < im->h; y += 2)
            for (int x = 0; x < im->w; x += 2) {
                float c[3] = { 0 };
                for (int k = 0; k < 12; k++) c[k % 3] += im->px[3 * ((y + k / 6) * im->w + x + k / 3 % 2) + k % 3] * 0.25f;
                float luma = 0.299f * c[0] + 0.587f * c[1] + 0.114f * c[2], diff = plane ? (c[0] - luma) / 1.402f : (c[2] - luma) / 1.772f;
                fputc((int)clampf(128.5f + diff, 0, 255), f);
            }
}
/* A fixed camera, the sun moving along the facade, people walking by; the wide truth for the first, middle and last frame. */
static orl_err make_kiosk(const options *o, const set *place)
{
    const model_frame m = model_world();
    char dir[1024], wide_dir[1024], name[32];
    orl_err err;
    if ((err = folder(o->dir, "kiosk", dir)) || (err = folder(dir, "gt_wide", wide_dir))) return err;
    int w = o->width, h = w * 3 / 4;
    view v = view_make(V(-8.5f, -33, 2.6f), V(0.5f, -2, 6.6f), 0.6f * DEG, w, h, 42.0f / 36 * (float)w), wide = widened(&v, 2.2);
    if ((err = write_pose_pair(dir, "camera.txt", "frames", &v, "gt_wide", &wide))) return err;
    tone look = { .wb = { 1.02f, 1, 0.97f }, .contrast = 0.2f, .saturation = 1.1f, .shoulder = 0.6f,
        .filter = { { 1, 0, 0 }, { 0, 1, 0 }, { 0, 0, 1 } } };
    text clip, table;
    if ((err = text_open(&clip))) return err;
    if ((err = text_open(&table))) { fclose(clip.f), free(clip.bytes); return err; }
    fprintf(clip.f, "YUV4MPEG2 W%d H%d F10:1 Ip A1:1 C420jpeg XCOLORRANGE=FULL\n", w, h);
    fprintf(table.f, "frame\tsun_x\tsun_y\tsun_z\tirradiance_r\tirradiance_g\tirradiance_b\twide\n");
    for (int i = 0; i < o->frames && !err; i++) {
        float part = o->frames > 1 ? (float)i / (float)(o->frames - 1) : 0;
        light l = { .azimuth = mixf(-150, -66, part) * DEG, .elevation = mixf(24, 42, part) * DEG, .cover = 0.35f, .drift = 11 };
        light_set(&l);
        set people = { 0 };
        const set nobody = { 0 };
        for (int k = 0; k < 11; k++) {
            rng r = rng_make(o->seed, 9000 + (uint64_t)k);
            float speed = uniform(&r, 0.9f, 1.6f) * (k & 1 ? 1 : -1), x = uniform(&r, -12, 9) + speed * 0.1f * (float)i,
                y = uniform(&r, -24, -10.5f);
            person(&people, &r, x, y, speed > 0 ? 0 : PI, uniform(&r, 0, 6) + fabsf(speed) * 0.42f * (float)i);
        }
        set_build(&people);
        picture p = { 0 };
        orl_image im = { 0 };
        bool truth = i == 0 || i == o->frames / 2 || i == o->frames - 1;
        double sun[3];
        to_model(&m, (double[3]){ l.sun[0], l.sun[1], l.sun[2] }, 1, sun);
        fprintf(table.f, "%d\t%.6f\t%.6f\t%.6f\t%.5g\t%.5g\t%.5g\t%d\n", i, sun[0], sun[1], sun[2], l.sun_e[0], l.sun_e[1], l.sun_e[2],
            truth);
        if (!(err = render(&v, &l, place, &people, o->seed + 7, o->threads, &p))) {
            if (i == 0) look.exposure = 1.1f * meter(&p);
            if (!(err = develop(&p, &look, o->seed * 100 + (uint64_t)i + 1, &im))) put_i420(clip.f, &im);
        }
        orl_image_free(&im), picture_free(&p);
        if (truth && !err && !(err = render(&wide, &l, place, &nobody, o->seed + 8, o->threads, &p)) && !(err = develop(&p, &look, 0, &im))) {
            snprintf(name, sizeof name, "%04d.png", i);
            err = write_image(wide_dir, name, &im);
        }
        orl_image_free(&im), picture_free(&p), set_free(&people);
    }
    err = text_close(&table, err, dir, "frames.tsv");
    return text_close(&clip, err, dir, "kiosk.y4m");
}
/* The wide truth of the first test photo, in the photo's own light and tone. */
static orl_err make_wide(const options *o, const shot *s, const set *place, const char *gt)
{
    const set nobody = { 0 };
    view wide = widened(&s->view, 1.8);
    picture p = { 0 };
    orl_image im = { 0 };
    orl_err err = write_pose_pair(gt, "wide_test_000.txt", s->name, &s->view, "wide_test_000", &wide);
    if (!err && !(err = render(&wide, &s->light, place, &nobody, s->seed, o->threads, &p)) &&
        !(err = develop(&p, &s->tone, 0, &im))) err = write_image(gt, "wide_test_000.png", &im);
    orl_image_free(&im), picture_free(&p);
    return err;
}
static orl_err attraction_make(const options *o)
{
    const int n = o->photos + o->tests;
    set place = { 0 };
    shot *shots = aligned_alloc(16, (size_t)n * sizeof *shots);
    orl_image *photos = calloc((size_t)n, sizeof *photos), mask = { 0 };
    char photo_dir[1024], gt[1024], mask_dir[1024], sparse[1024];
    int made = 0;
    orl_err err = shots && photos ? ORL_OK : orl_fail(ORL_E_MEMORY, "attraction: no memory for %d photos", n);
    if (err || (err = folder(o->dir, "", gt)) || (err = folder(o->dir, "photos", photo_dir)) || (err = folder(o->dir, "gt", gt))) goto done;
    if (o->masks && (err = folder(gt, "masks", mask_dir))) goto done;
    build_place(&place);
    for (; made < n && !err; made++) {
        shot *s = &shots[made];
        picture p = { 0 };
        bool test = made >= o->photos;
        *s = shot_make(o->seed, test ? made - o->photos : made, test, o->width, &place);
        if ((err = render(&s->view, &s->light, &place, &s->people, s->seed, o->threads, &p))) continue;
        s->tone.exposure *= meter(&p);
        if (!(err = develop(&p, &s->tone, s->seed, &photos[made])) && !(err = write_image(photo_dir, s->name, &photos[made])) &&
            test) err = write_truth(s, &place, &p, gt);
        if (!err && o->masks && !(err = orl_image_alloc(&mask, p.w, p.h, 1))) {
            char name[40];
            memcpy(mask.px, p.label, (size_t)p.w * (size_t)p.h);
            snprintf(name, sizeof name, "%.*s.png", (int)strcspn(s->name, "."), s->name);
            err = write_image(mask_dir, name, &mask);
            orl_image_free(&mask);
        }
        picture_free(&p);
        if (!err && (made + 1) % 10 == 0) printf("  photo %d of %d\n", made + 1, n);
    }
    if (err || (err = folder(o->dir, "sparse", sparse)) || (err = folder(o->dir, "sparse/0", sparse))) goto done;
    if ((err = write_model(o, sparse, shots, photos, o->photos, &place, true))) goto done;
    if (o->tests && ((err = folder(o->dir, "sparse_test", sparse)) || (err = folder(o->dir, "sparse_test/0", sparse)))) goto done;
    if (o->tests && (err = write_model(o, sparse, shots + o->photos, photos + o->photos, o->tests, &place, false))) goto done;
    if ((err = write_tables(o, shots, n, gt)) || (o->tests && (err = make_wide(o, &shots[o->photos], &place, gt)))) goto done;
    if (o->frames) err = make_kiosk(o, &place);
done:
    for (int i = 0; i < made; i++) set_free(&shots[i].people), orl_image_free(&photos[i]);
    free(shots), free(photos), set_free(&place);
    return err;
}

int main(int argc, char **argv)
{
    options o = { .photos = 24, .tests = 6, .width = 320, .frames = 20, .points = 3000, .seed = 1 };
    static const struct option names[] = {
        { "photos", 1, 0, 'p' }, { "tests", 1, 0, 't' }, { "width", 1, 0, 'w' }, { "frames", 1, 0, 'f' }, { "points", 1, 0, 'n' },
        { "seed", 1, 0, 's' }, { "threads", 1, 0, 'j' }, { "masks", 0, 0, 'm' }, { "help", 0, 0, 'h' }, { 0 } };
    static const char usage[] =
        "usage: attraction [OPTION]... OUT_DIR\n"
        "Makes a small procedural attraction: a SCENE folder with ground truth and a kiosk clip.\n\n"
        "  --photos=N   training photos (24)\n"
        "  --tests=N    test photos (6)\n"
        "  --width=N    long side in pixels, a multiple of 8 (320)\n"
        "  --frames=N   frames of the kiosk clip, 0 for none (20)\n"
        "  --points=N   SfM points wanted (3000)\n"
        "  --seed=N     another set of photos of the same place (1)\n"
        "  --threads=N  0 for one per core (0)\n"
        "  --masks      also write gt/masks: 0 scene, 128 sky, 255 people\n  --help       this text\n";
    for (int c; (c = getopt_long(argc, argv, "", names, NULL)) != -1;) {
        char *end = "";
        long value = optarg ? strtol(optarg, &end, 10) : 0;
        if (c == 'h') { fputs(usage, stdout); return 0; }
        if (c == '?') { fputs(usage, stderr); return 2; }
        const long most = c == 'w' ? 4096 : c == 's' ? 1000000 : c == 'n' ? 100000 : c == 'j' ? 64 : 400, least = c == 'w' ? 32 : c == 'p'
            ? 2 : c == 'n' ? 1 : 0;
        if (c != 'm' && (!*optarg || *end || value < least || value > most || (c == 'w' && value % 8))) {
            fprintf(stderr, "attraction: '%s' is out of range (%ld to %ld%s)\n", optarg, least, most, c == 'w' ? ", a multiple of 8" : "");
            return 2;
        }
        int v = (int)value;
        switch (c) {
        case 'p': o.photos = v; break;
        case 't': o.tests = v; break;
        case 'w': o.width = v; break;
        case 'f': o.frames = v; break;
        case 'n': o.points = v; break;
        case 's': o.seed = (uint64_t)v; break;
        case 'j': o.threads = v; break;
        default: o.masks = true;
        }
    }
    if (optind != argc - 1) { fputs(usage, stderr); return 2; }
    o.dir = argv[optind];
    if (attraction_make(&o)) { fprintf(stderr, "attraction: %s\n", orl_error_text()); return 1; }
    return 0;
}
