/* The float model of a checkpoint (include/oriel/model.h): surface and stage 2, rendered pixel by pixel without quantisation. */
#include "oriel/model.h"
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "oriel/parallel.h"
#include "trainer/checkpoint.h"
#include "trainer/exact.h"

struct orl_model { surface surf; stage2 s2; };

orl_err orl_model_load(const char *path, orl_model **out)
{
    checkpoint_header h;
    FILE *f;
    orl_err e = checkpoint_peek(path, &h, &f);
    if (e) return e;
    orl_model *m = calloc(1, sizeof *m);
    if (!m) e = orl_fail(ORL_E_MEMORY, "%s: no memory", path);
    if (!e && h.phase != 3) e = orl_fail(ORL_E_FORMAT, "%s: training has not finished (go on with fit --resume)", path);
    if (!e) e = surface_load(&m->surf, f, path);
    if (!e) e = stage2_init(&m->s2, NULL, &m->surf, NULL, NULL, &(stage2_options){ .without = h.without });
    if (!e) e = stage2_load(&m->s2, f, 0, path);
    fclose(f);
    if (e) { orl_model_free(m); return e; }
    *out = m;
    return ORL_OK;
}

void orl_model_free(orl_model *m)
{
    if (!m) return;
    stage2_free(&m->s2);
    surface_free(&m->surf);
    free(m);
}

const orl_light_model *orl_model_light(const orl_model *m) { return &m->s2.light; }
void orl_model_up(const orl_model *m, double R[9]) { memcpy(R, m->surf.f.R, sizeof m->surf.f.R); }

/* pixel: indices of those wanted; NULL: all of them. */
typedef struct { const orl_model *m; world_photo cam; const orl_light *light; const int *pixel; orl_sample *out; float *depth; } gbuffer_job;

/* Four rays: attributes averaged, coverage counted. Returns the mean depth, 0 without surface. */
static float pixel_sample(const gbuffer_job *j, int x, int y, orl_sample *s)
{
    const orl_model *m = j->m;
    const float o[3] = { (float)j->cam.centre[0], (float)j->cam.centre[1], (float)j->cam.centre[2] };
    const float fwd[3] = { (float)j->cam.axes[2], (float)j->cam.axes[5], (float)j->cam.axes[8] };
    int trace = j->light && stage2_traces(&m->s2, j->light);
    float hits = 0, depth = 0, lit = 0;
    memset(s, 0, sizeof *s);
    world_ray(&j->cam, x + 0.5, y + 0.5, s->dir);
    for (int k = 0; k < 4; k++) {
        float d[3];
        surface_hit h;
        world_ray(&j->cam, x + 0.25 + 0.5 * (k & 1), y + 0.25 + 0.5 * (k >> 1), d);
        orl_sample q;
        int met = surface_meet(&m->surf, o, d, (float)(2 * k + 1) * (255.0f / 8), &h);
        if (met == MET_SURFACE) stage2_surface_sample(&m->s2, &h, &q);
        else if (met == MET_GROUND) stage2_ground_sample(&m->s2, h.x, &q);
        else if (met == MET_BACKDROP) stage2_backdrop_sample(&m->s2, h.x, h.n, &q);
        else continue;
        for (int a = 0; a < 3; a++) { s->albedo[a] += q.albedo[a]; s->normal[a] += q.normal[a]; }
        for (int a = 0; a < ORL_HORIZON; a++) s->horizon[a] += q.horizon[a];
        for (int a = 0; a < ORL_SHADOW_DIM; a++) s->phi[a] += q.phi[a];
        if (trace) lit += (float)surface_sunlit(&m->surf, h.x, h.n, j->light->sun_dir);
        s->open += q.open;
        depth += h.t * (d[0] * fwd[0] + d[1] * fwd[1] + d[2] * fwd[2]);
        hits++;
    }
    if (hits == 0) return 0;
    float inv = 1 / hits, n = 0;
    for (int a = 0; a < 3; a++) { s->albedo[a] *= inv; n += s->normal[a] * s->normal[a]; }
    n = n > 1e-12f ? 1 / sqrtf(n) : 0;
    for (int a = 0; a < 3; a++) s->normal[a] *= n;
    for (int a = 0; a < ORL_HORIZON; a++) s->horizon[a] *= inv;
    for (int a = 0; a < ORL_SHADOW_DIM; a++) s->phi[a] *= inv;
    if (trace) s->fix = lit * inv - orl_light_sun_visibility(j->light, s);
    s->open *= inv;
    s->cov = hits / 4;
    return depth * (inv / (float)m->surf.f.scale);
}

static void gbuffer_pixels(void *user, int begin, int end)
{
    const gbuffer_job *j = user;
    for (int i = begin; i < end; i++) {
        int at = j->pixel ? j->pixel[i] : i;
        float depth = pixel_sample(j, at % j->cam.w, at / j->cam.w, &j->out[i]);
        if (j->depth) j->depth[i] = depth;
    }
}

void orl_model_gbuffer(const orl_model *m, const orl_camera *cam, const orl_pose *pose, const orl_light *light, int threads, orl_sample *out, float *depth)
{
    gbuffer_job j = { .m = m, .light = light, .out = out, .depth = depth };
    frame_view(&m->surf.f, cam, pose, &j.cam);
    orl_parallel(threads, cam->w * cam->h, 1024, gbuffer_pixels, &j);
}

void orl_model_samples(const orl_model *m, const orl_camera *cam, const orl_pose *pose, const orl_light *light, const int *pixel, int n, int threads, orl_sample *out)
{
    gbuffer_job j = { .m = m, .light = light, .pixel = pixel, .out = out };
    frame_view(&m->surf.f, cam, pose, &j.cam);
    orl_parallel(threads, n, 64, gbuffer_pixels, &j);
}

typedef struct { const orl_model *m; world_photo cam; const orl_light *light; int side; float sigma, *rgb; } exact_job;

static void exact_pixels(void *user, int begin, int end)
{
    const exact_job *j = user;
    const float o[3] = { (float)j->cam.centre[0], (float)j->cam.centre[1], (float)j->cam.centre[2] };
    const int rays = j->side * j->side;
    for (int i = begin; i < end; i++) {
        float *sum = j->rgb + 3 * (size_t)i;
        memset(sum, 0, 3 * sizeof *sum);
        for (int k = 0; k < rays; k++) {
            float d[3], c[3];
            world_ray(&j->cam, i % j->cam.w + (k % j->side + 0.5) / j->side, i / j->cam.w + (k / j->side + 0.5) / j->side, d);
            exact_ray(&j->m->s2, j->light, o, d, (float)(2 * k + 1) * (255.0f / (float)(2 * rays)), j->sigma, c);
            for (int a = 0; a < 3; a++) sum[a] += c[a] / (float)rays;
        }
    }
}

void orl_model_exact(const orl_model *m, const orl_camera *cam, const orl_pose *pose, const orl_light *light, int side, float sigma, int threads, float *rgb)
{
    exact_job j = { .m = m, .light = light, .side = side, .sigma = sigma, .rgb = rgb };
    frame_view(&m->surf.f, cam, pose, &j.cam);
    orl_parallel(threads, cam->w * cam->h, 256, exact_pixels, &j);
}
