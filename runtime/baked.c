/* Baked views in the scene file's container: SCENE.md 4.16 in code. */
#include "runtime/baked.h"
#include <stdlib.h>
#include <string.h>
#include "runtime/arena.h"
#include "runtime/commands.h"

typedef struct {
    int32_t model, w, h, photo_w, photo_h;
    uint8_t reserved[4];
    double lens[8], photo_lens[8], R[9], t[3], turn[9], eye[3];     /* fx, fy, cx, cy, k1, k2, p1, p2; turn: camera -> grid frame */
    float phi_scale[ORL_SHADOW_DIM];
    uint8_t rest[8];
} head_bytes;
_Static_assert(sizeof(head_bytes) == 384, "size of SCENE.md 4.16");

enum { SIDE_MAX = 16384 };
static const char *const TAG[ORL_VIEWS] = { "VPHO", "VWID" };

/* The planes in their order: calls each(user, plane, bytes) for all of v's. */
typedef void each_plane(void *user, const void **plane, size_t bytes);
static void planes(orl_view *v, each_plane *each, void *user)
{
    size_t n = (size_t)v->stride * (size_t)v->h;
#define PLANE(p, size) do { const void *at = v->p; each(user, &at, n * (size)); v->p = (void *)at; } while (0)
    for (int c = 0; c < 3; c++) PLANE(normal[c], 1);
    for (int c = 0; c < 3; c++) PLANE(albedo[c], 1);
    PLANE(open, 1);
    PLANE(cov, 1);
    PLANE(horizon, ORL_HORIZON);
    for (int g = 0; g < 2; g++) PLANE(phi[g], ORL_SHADOW_DIM / 2);
    PLANE(depth, sizeof *v->depth);
    PLANE(ceiling, ORL_HORIZON);
#undef PLANE
}

typedef struct { uint8_t *base; size_t used; } cursor;

static void count_plane(void *user, const void **plane, size_t bytes) { (void)plane; ((cursor *)user)->used += orl_align64(bytes); }

static void store_plane(void *user, const void **plane, size_t bytes)
{
    cursor *c = user;
    memcpy(c->base + c->used, *plane, bytes);
    memset(c->base + c->used + bytes, 0, orl_align64(bytes) - bytes);
    c->used += orl_align64(bytes);
}

static void find_plane(void *user, const void **plane, size_t bytes)
{
    cursor *c = user;
    *plane = c->base + c->used;
    c->used += orl_align64(bytes);
}

static size_t section_bytes(int w, int h)
{
    orl_view v = { .stride = orl_view_stride(w), .h = h };
    cursor c = { NULL, sizeof(head_bytes) };
    planes(&v, count_plane, &c);
    return c.used;
}

/* ---- writing */

static void lens_of(const orl_camera *c, double out[8]) { memcpy(out, (const double[]){ c->fx, c->fy, c->cx, c->cy, c->k1, c->k2, c->p1, c->p2 }, 8 * sizeof *out); }

static void store(const orl_view *v, const orl_camera *photo, uint8_t *out)
{
    head_bytes h = { .model = (int32_t)v->cam.model, .w = v->w, .h = v->h, .photo_w = photo->w, .photo_h = photo->h };
    lens_of(&v->cam, h.lens);
    lens_of(photo, h.photo_lens);
    memcpy(h.R, v->pose.R, sizeof h.R);
    memcpy(h.t, v->pose.t, sizeof h.t);
    memcpy(h.turn, v->grid_from_cam, sizeof h.turn);
    memcpy(h.eye, v->eye, sizeof h.eye);
    memcpy(h.phi_scale, v->phi_scale, sizeof h.phi_scale);
    memcpy(out, &h, sizeof h);
    orl_view copy = *v;
    planes(&copy, store_plane, &(cursor){ out, sizeof h });
}

orl_err orl_baked_write(const char *path, const orl_scene *s, const orl_camera *photo, const orl_view view[ORL_VIEWS], size_t *bytes_out)
{
    orl_scene file = { .light = s->light, .ncodes = s->ncodes, .codes = s->codes };
    uint8_t *part[ORL_VIEWS] = { NULL };
    orl_err e = ORL_OK;
    memcpy(file.title, s->title, sizeof file.title);
    for (int k = 0; k < ORL_VIEWS; k++) {
        file.view_bytes[k] = section_bytes(view[k].w, view[k].h);
        if (!(part[k] = malloc((size_t)file.view_bytes[k]))) e = orl_fail(ORL_E_MEMORY, "%s: no memory for a view of %d x %d", path, view[k].w, view[k].h);
        else store(&view[k], k ? &view[k].cam : photo, part[k]);
        file.view[k] = part[k];
    }
    if (!e) e = orl_scene_write(path, &file, bytes_out);
    for (int k = 0; k < ORL_VIEWS; k++) free(part[k]);
    return e;
}

/* ---- reading */

static int within(const double *v, int n, double limit) { for (int i = 0; i < n; i++) if (!(v[i] >= -limit && v[i] <= limit)) return 0; return 1; }

static orl_err camera_of(const head_bytes *h, const double lens[8], int w, int height, const char *name, const char *tag, const char *field, orl_camera *out)
{
    if (w < 1 || height < 1 || w > SIDE_MAX || height > SIDE_MAX) return orl_fail(ORL_E_RANGE, "%s: section %s: %s of %d x %d pixels", name, tag, field, w, height);
    if (h->model < 0 || h->model > ORL_CAM_OPENCV || !within(lens, 8, 1e9) || !(lens[0] > 0) || !(lens[1] > 0)) return orl_fail(ORL_E_RANGE, "%s: section %s: lens of the %s", name, tag, field);
    *out = (orl_camera){ (orl_cam_model)h->model, w, height, lens[0], lens[1], lens[2], lens[3], lens[4], lens[5], lens[6], lens[7] };
    return ORL_OK;
}

static int rotation(const double R[9])
{
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++) {
            double dot = 0;
            for (int a = 0; a < 3; a++) dot += R[3 * i + a] * R[3 * k + a];
            if (!(dot > (i == k) - 1e-3 && dot < (i == k) + 1e-3)) return 0;
        }
    return R[0] * (R[4] * R[8] - R[5] * R[7]) - R[1] * (R[3] * R[8] - R[5] * R[6]) + R[2] * (R[3] * R[7] - R[4] * R[6]) > 0;
}

static orl_err find_view(const orl_scene *s, int k, const char *name, orl_view *out, orl_camera *photo)
{
    const char *tag = TAG[k];
    if (s->view_bytes[k] < sizeof(head_bytes)) return orl_fail(ORL_E_FORMAT, "%s: section %s: %llu bytes", name, tag, (unsigned long long)s->view_bytes[k]);
    const head_bytes *h = (const head_bytes *)s->view[k];
    orl_view v = { 0 };
    orl_err e = camera_of(h, h->lens, h->w, h->h, name, tag, "view", &v.cam);
    if (!e) e = camera_of(h, h->photo_lens, h->photo_w, h->photo_h, name, tag, "photo", photo);
    if (e) return e;
    if (s->view_bytes[k] != section_bytes(h->w, h->h)) return orl_fail(ORL_E_FORMAT, "%s: section %s: %llu bytes for %d x %d pixels", name, tag, (unsigned long long)s->view_bytes[k], h->w, h->h);
    if (!rotation(h->R) || !within(h->t, 3, 1e9)) return orl_fail(ORL_E_RANGE, "%s: section %s: pose", name, tag);
    if (!within(h->turn, 9, 1.001) || !within(h->eye, 3, 1e9)) return orl_fail(ORL_E_RANGE, "%s: section %s: place in the grid", name, tag);
    for (int i = 0; i < ORL_SHADOW_DIM; i++) if (!(h->phi_scale[i] >= 0 && h->phi_scale[i] <= 32768)) return orl_fail(ORL_E_RANGE, "%s: section %s: phi_scale[%d]", name, tag, i);
    for (size_t i = 0; i < sizeof h->reserved; i++) if (h->reserved[i]) return orl_fail(ORL_E_FORMAT, "%s: section %s: reserved bytes are not 0", name, tag);
    v.w = h->w;
    v.h = h->h;
    v.stride = orl_view_stride(h->w);
    memcpy(v.pose.R, h->R, sizeof h->R);
    memcpy(v.pose.t, h->t, sizeof h->t);
    memcpy(v.grid_from_cam, h->turn, sizeof h->turn);
    memcpy(v.eye, h->eye, sizeof h->eye);
    memcpy(v.phi_scale, h->phi_scale, sizeof h->phi_scale);
    planes(&v, find_plane, &(cursor){ (uint8_t *)s->view[k], sizeof *h });          /* mapped for reading; nobody writes to a baked plane */
    size_t n = (size_t)v.stride * (size_t)v.h;
    for (int a = 0; a < 3; a++)         /* the one value whose square leaves 16 bits */
        for (size_t i = 0; i < n; i++) if (v.normal[a][i] == -128) return orl_fail(ORL_E_RANGE, "%s: section %s: normal of pixel %zu, %zu", name, tag, i % (size_t)v.stride, i / (size_t)v.stride);
    *out = v;
    return ORL_OK;
}

orl_err orl_baked_views(const orl_scene *s, const char *name, orl_view view[ORL_VIEWS], orl_camera *photo)
{
    orl_view v[ORL_VIEWS];
    orl_camera own, recorded;
    if (!s->view[0]) return orl_fail(ORL_E_FORMAT, "%s: it holds no baked view (`oriel bake` makes one)", name);
    for (int k = 0; k < ORL_VIEWS; k++) {
        orl_err e = find_view(s, k, name, &v[k], k ? &own : &recorded);
        if (e) return e;
    }
    memcpy(view, v, sizeof v);
    *photo = recorded;
    return ORL_OK;
}

orl_err orl_baked_open(const char *path, orl_baked *out)
{
    orl_baked b = { 0 };
    orl_err e = orl_scene_open(path, &b.scene);
    if (e) return e;
    if ((e = orl_baked_views(&b.scene, path, b.view, &b.photo))) { orl_scene_close(&b.scene); return e; }
    *out = b;
    return ORL_OK;
}

orl_err orl_baked_cameras(const orl_baked *b, const char *name, int w, int h, orl_view_pose *photo, orl_view_pose *wide)
{
    orl_view_pose from = { .cam = b->photo, .pose = b->view[0].pose };
    orl_err e = w ? orl_camera_fit(&from.cam, name, w, h) : ORL_OK;
    if (e) return e;
    *photo = from;
    *wide = (orl_view_pose){ .cam = b->view[1].cam, .pose = b->view[1].pose };
    return ORL_OK;
}

void orl_baked_close(orl_baked *b)
{
    orl_scene_close(&b->scene);
    memset(b, 0, sizeof *b);
}
