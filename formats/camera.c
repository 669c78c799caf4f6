/* Camera models and poses in COLMAP's conventions (include/oriel/camera.h). */
#include "oriel/camera.h"
#include <math.h>
#include <stdio.h>
#include <string.h>

static const struct { const char *name; int nparams; } MODELS[] = {
    { "SIMPLE_PINHOLE", 3 }, { "PINHOLE", 4 }, { "SIMPLE_RADIAL", 4 }, { "RADIAL", 5 }, { "OPENCV", 8 },
};
enum { NMODELS = sizeof MODELS / sizeof *MODELS };

int orl_camera_model_from_name(const char *name)
{
    for (int i = 0; i < NMODELS; i++) if (!strcmp(name, MODELS[i].name)) return i;
    return -1;
}

const char *orl_camera_model_name(orl_cam_model m) { return (int)m >= 0 && (int)m < NMODELS ? MODELS[m].name : "?"; }
int orl_camera_param_count(int model) { return model >= 0 && model < NMODELS ? MODELS[model].nparams : -1; }

orl_err orl_camera_from_params(orl_camera *out, int model, int w, int h, const double *p, int n)
{
    if (model < 0 || model >= NMODELS) return orl_fail(ORL_E_UNSUPPORTED, "camera model %d is not supported", model);
    if (n != MODELS[model].nparams) return orl_fail(ORL_E_FORMAT, "%s camera: %d parameters, expected %d", MODELS[model].name, n, MODELS[model].nparams);
    if (w < 1 || h < 1 || w > 65535 || h > 65535) return orl_fail(ORL_E_RANGE, "%s camera: image size %d x %d", MODELS[model].name, w, h);
    for (int i = 0; i < n; i++) if (!isfinite(p[i])) return orl_fail(ORL_E_RANGE, "%s camera: parameter %d is not finite", MODELS[model].name, i);
    orl_camera c = { .model = (orl_cam_model)model, .w = w, .h = h };
    int two = model == ORL_CAM_PINHOLE || model == ORL_CAM_OPENCV;
    c.fx = p[0];
    c.fy = two ? p[1] : p[0];
    c.cx = p[two ? 2 : 1];
    c.cy = p[two ? 3 : 2];
    if (model == ORL_CAM_SIMPLE_RADIAL || model == ORL_CAM_RADIAL) c.k1 = p[3];
    if (model == ORL_CAM_RADIAL) c.k2 = p[4];
    if (model == ORL_CAM_OPENCV) { c.k1 = p[4]; c.k2 = p[5]; c.p1 = p[6]; c.p2 = p[7]; }
    double side = w > h ? w : h;
    if (c.fx < 0.05 * side || c.fy < 0.05 * side || c.fx > 100 * side || c.fy > 100 * side)
        return orl_fail(ORL_E_RANGE, "%s camera: focal length %g of a %d x %d image is absurd", MODELS[model].name, c.fx, w, h);
    if (fabs(c.cx) > 10 * side || fabs(c.cy) > 10 * side) return orl_fail(ORL_E_RANGE, "%s camera: principal point %g, %g is far outside", MODELS[model].name, c.cx, c.cy);
    *out = c;
    return ORL_OK;
}

orl_camera orl_camera_resized(const orl_camera *c, int w, int h)
{
    orl_camera o = *c;
    double sx = (double)w / c->w, sy = (double)h / c->h;
    o.w = w; o.h = h;
    o.fx *= sx; o.cx *= sx;
    o.fy *= sy; o.cy *= sy;
    return o;
}

orl_camera orl_camera_widened(const orl_camera *c, double factor, int w, int h)
{
    orl_camera o = { .model = ORL_CAM_PINHOLE, .w = w, .h = h };
    double s = (double)w / c->w, t = (double)h / c->h;
    if (t < s) s = t;                           /* the photo's own aspect fits inside whatever size is asked */
    o.fx = c->fx * s / factor;
    o.fy = c->fy * s / factor;
    o.cx = 0.5 * w + (c->cx - 0.5 * c->w) * s / factor;
    o.cy = 0.5 * h + (c->cy - 0.5 * c->h) * s / factor;
    return o;
}

static void distort(const orl_camera *c, double x, double y, double *dx, double *dy)
{
    double r2 = x * x + y * y, radial = c->k1 * r2 + c->k2 * r2 * r2;
    *dx = x * radial + 2 * c->p1 * x * y + c->p2 * (r2 + 2 * x * x);
    *dy = y * radial + 2 * c->p2 * x * y + c->p1 * (r2 + 2 * y * y);
}

/* Newton on distorted(x, y) = (x0, y0); the Jacobian of the radial and tangential terms is symmetric. */
void orl_camera_unproject(const orl_camera *c, double u, double v, double dir[3])
{
    double x0 = (u - c->cx) / c->fx, y0 = (v - c->cy) / c->fy, x = x0, y = y0;
    if (c->k1 != 0 || c->k2 != 0 || c->p1 != 0 || c->p2 != 0)
        for (int i = 0; i < 20; i++) {
            double dx, dy, r2 = x * x + y * y, radial = c->k1 * r2 + c->k2 * r2 * r2, slope = 2 * (c->k1 + 2 * c->k2 * r2);
            distort(c, x, y, &dx, &dy);
            double a = 1 + radial + slope * x * x + 2 * c->p1 * y + 6 * c->p2 * x, b = slope * x * y + 2 * c->p1 * x + 2 * c->p2 * y;
            double d = 1 + radial + slope * y * y + 6 * c->p1 * y + 2 * c->p2 * x, det = a * d - b * b;
            if (!(det > 0.05)) break;           /* where the model folds over: keep the last sane value */
            double ex = x + dx - x0, ey = y + dy - y0, sx = (d * ex - b * ey) / det, sy = (a * ey - b * ex) / det, step = fabs(sx) + fabs(sy);
            if (!(step < 10)) break;
            x -= sx;
            y -= sy;
            if (step < 1e-12) break;
        }
    dir[0] = x;
    dir[1] = y;
    dir[2] = 1;
}

int orl_camera_project(const orl_camera *c, const double p[3], double uv[2])
{
    if (!(p[2] > 1e-9)) return 0;
    double x = p[0] / p[2], y = p[1] / p[2], dx, dy;
    distort(c, x, y, &dx, &dy);
    uv[0] = c->fx * (x + dx) + c->cx;
    uv[1] = c->fy * (y + dy) + c->cy;
    return 1;
}

orl_err orl_pose_from_quat(orl_pose *out, const double q[4], const double t[3])
{
    double n = q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3];
    if (!isfinite(n) || n < 1e-12) return orl_fail(ORL_E_DEGENERATE, "pose: quaternion %g %g %g %g is singular", q[0], q[1], q[2], q[3]);
    for (int i = 0; i < 3; i++) if (!isfinite(t[i])) return orl_fail(ORL_E_DEGENERATE, "pose: translation is not finite");
    n = 1 / sqrt(n);
    double w = q[0] * n, x = q[1] * n, y = q[2] * n, z = q[3] * n;
    double R[9] = { 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y), 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
                    2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y) };
    memcpy(out->R, R, sizeof R);
    memcpy(out->t, t, 3 * sizeof *t);
    return ORL_OK;
}

void orl_pose_to_quat(const orl_pose *p, double q[4])
{
    const double *R = p->R;
    double tr = R[0] + R[4] + R[8];
    if (tr > 0) {
        double s = sqrt(tr + 1) * 2;
        q[0] = s / 4; q[1] = (R[7] - R[5]) / s; q[2] = (R[2] - R[6]) / s; q[3] = (R[3] - R[1]) / s;
    } else {
        int i = R[4] > R[0] ? 1 : 0;
        if (R[8] > R[4 * i]) i = 2;
        int j = (i + 1) % 3, k = (i + 2) % 3;
        double s = sqrt(R[4 * i] - R[4 * j] - R[4 * k] + 1) * 2;
        q[0] = (R[3 * k + j] - R[3 * j + k]) / s;
        q[1 + i] = s / 4;
        q[1 + j] = (R[3 * j + i] + R[3 * i + j]) / s;
        q[1 + k] = (R[3 * k + i] + R[3 * i + k]) / s;
    }
}

void orl_pose_apply(const orl_pose *p, const double x[3], double c[3])
{
    for (int i = 0; i < 3; i++) c[i] = p->R[3 * i] * x[0] + p->R[3 * i + 1] * x[1] + p->R[3 * i + 2] * x[2] + p->t[i];
}

void orl_pose_centre(const orl_pose *p, double c[3])
{
    for (int i = 0; i < 3; i++) c[i] = -(p->R[i] * p->t[0] + p->R[3 + i] * p->t[1] + p->R[6 + i] * p->t[2]);
}

void orl_pose_ray(const orl_pose *p, const double d[3], double w[3])
{
    double n = 0;
    for (int i = 0; i < 3; i++) {
        w[i] = p->R[i] * d[0] + p->R[3 + i] * d[1] + p->R[6 + i] * d[2];
        n += w[i] * w[i];
    }
    n = n > 0 ? 1 / sqrt(n) : 0;
    for (int i = 0; i < 3; i++) w[i] *= n;
}

orl_err orl_posefile_read(const char *path, orl_view_pose *out, int cap, int *count)
{
    FILE *f = fopen(path, "r");
    if (!f) return orl_fail(ORL_E_IO, "%s: cannot be opened", path);
    char line[2048];
    int n = 0, row = 0;
    orl_err e = ORL_OK;
    while (!e && n < cap && fgets(line, sizeof line, f)) {
        row++;
        char name[128], model[32];
        int used, cut = !strchr(line, '\n') && !feof(f);
        long long w, h;
        for (int ch = 0; cut && ch != EOF && ch != '\n';) ch = getc(f);
        if (line[strspn(line, " \t\r\n")] == 0 || line[strspn(line, " \t")] == '#') continue;
        if (cut) { e = orl_fail(ORL_E_FORMAT, "%s:%d: line is too long", path, row); break; }
        if (strcspn(line + strspn(line, " \t"), " \t\r\n") >= sizeof name) { e = orl_fail(ORL_E_FORMAT, "%s:%d: name is too long", path, row); break; }
        if (sscanf(line, "%127s %31s %lld %lld%n", name, model, &w, &h, &used) != 4) { e = orl_fail(ORL_E_FORMAT, "%s:%d: expected NAME MODEL WIDTH HEIGHT", path, row); break; }
        int m = orl_camera_model_from_name(model), np = orl_camera_param_count(m);
        if (m < 0) { e = orl_fail(ORL_E_UNSUPPORTED, "%s:%d: camera model %s is not supported", path, row, model); break; }
        double v[15];
        const char *p = line + used;
        for (int i = 0; i < np + 7; i++) {
            int k;
            if (sscanf(p, "%lf%n", &v[i], &k) != 1) { e = orl_fail(ORL_E_FORMAT, "%s:%d: value %d of %d is missing", path, row, i + 1, np + 7); break; }
            p += k;
        }
        orl_view_pose o;
        memset(&o, 0, sizeof o);
        memcpy(o.name, name, sizeof o.name);
        p += strspn(p, " \t\r\n");
        if (!e && *p && *p != '#') e = orl_fail(ORL_E_FORMAT, "%s:%d: more than %d values", path, row, np + 7);
        if (e) break;
        /* a side that is no int becomes 0, which no camera accepts */
        e = orl_camera_from_params(&o.cam, m, w == (int)w ? (int)w : 0, h == (int)h ? (int)h : 0, v, np);
        if (!e) e = orl_pose_from_quat(&o.pose, v + np, v + np + 4);
        if (e) { char why[256]; snprintf(why, sizeof why, "%s", orl_error_text()); orl_fail(e, "%s:%d: %s", path, row, why); }
        else out[n++] = o;
    }
    fclose(f);
    if (!e && n == 0) e = orl_fail(ORL_E_FORMAT, "%s: no pose in it", path);
    if (!e) *count = n;
    return e;
}
