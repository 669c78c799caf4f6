/* PSNR, SSIM and LDR-FLIP on a range of columns. Both filters of SSIM and all of FLIP's are separable, so one small convolution serves
 * everything. */
#include "oriel/metrics.h"
#include <math.h>
#include <stdlib.h>

#define PI 3.14159265358979323846

enum { SSIM_RADIUS = 5, TAPS_MAX = 64 };

static float clamp01(float x) { return x > 0 ? (x < 1 ? x : 1) : 0; }   /* NaN -> 0 */

static orl_err check(const orl_imagef *a, const orl_imagef *b, int x0, int x1, int side)
{
    if (a->c != 3 || b->c != 3 || a->w != b->w || a->h != b->h)
        return orl_fail(ORL_E_RANGE, "metrics: pictures of %d x %d x %d and %d x %d x %d", a->w, a->h, a->c, b->w, b->h, b->c);
    if (x0 < 0 || x1 > a->w || x1 - x0 < side || a->h < side)
        return orl_fail(ORL_E_RANGE, "metrics: columns %d to %d of a %d x %d picture (at least %d wanted)", x0, x1, a->w, a->h, side);
    return ORL_OK;
}

/* One channel of the range as a plane of its own. */
static void plane(const orl_imagef *im, int x0, int x1, int ch, float *out)
{
    for (int y = 0; y < im->h; y++)
        for (int x = x0; x < x1; x++) *out++ = clamp01(im->px[((size_t)y * (size_t)im->w + (size_t)x) * 3 + (size_t)ch]);
}

/* Correlates rows with kx, then columns with ky (2 r + 1 taps each), border pixels repeated. in may be out. */
static void filter(const float *in, int w, int h, const float *kx, const float *ky, int r, float *tmp, float *out)
{
    for (int y = 0; y < h; y++) {
        const float *row = in + (size_t)y * (size_t)w;
        for (int x = 0; x < w; x++) {
            float s = 0;
            for (int k = -r; k <= r; k++) {
                int i = x + k;
                s += kx[k + r] * row[i < 0 ? 0 : i >= w ? w - 1 : i];
            }
            tmp[(size_t)y * (size_t)w + (size_t)x] = s;
        }
    }
    for (int y = 0; y < h; y++) {
        float *o = out + (size_t)y * (size_t)w;
        for (int x = 0; x < w; x++) o[x] = 0;
        for (int k = -r; k <= r; k++) {
            int i = y + k;
            const float *row = tmp + (size_t)(i < 0 ? 0 : i >= h ? h - 1 : i) * (size_t)w;
            float f = ky[k + r];
            for (int x = 0; x < w; x++) o[x] += f * row[x];
        }
    }
}

/* ---- PSNR ---- */

orl_err orl_metrics_psnr(const orl_imagef *truth, const orl_imagef *test, int x0, int x1, double *db)
{
    orl_err e = check(truth, test, x0, x1, 1);
    if (e) return e;
    double sum = 0;
    for (int y = 0; y < truth->h; y++)
        for (int i = 3 * x0; i < 3 * x1; i++) {
            size_t at = (size_t)y * (size_t)truth->w * 3 + (size_t)i;
            double d = (double)clamp01(truth->px[at]) - clamp01(test->px[at]);
            sum += d * d;
        }
    double mse = sum / (3.0 * (x1 - x0) * truth->h), v = mse > 0 ? -10 * log10(mse) : ORL_PSNR_MAX;
    *db = v < ORL_PSNR_MAX ? v : ORL_PSNR_MAX;
    return ORL_OK;
}

/* ---- SSIM ---- */

/* Does a window lie wholly in where? NULL: all of the picture. */
static int window_in(const uint8_t *where, int w, int x, int y)
{
    for (int v = y - SSIM_RADIUS; where && v <= y + SSIM_RADIUS; v++)
        for (int u = x - SSIM_RADIUS; u <= x + SSIM_RADIUS; u++) if (!where[(size_t)v * (size_t)w + (size_t)u]) return 0;
    return 1;
}

static orl_err ssim_of(const orl_imagef *truth, const orl_imagef *test, int x0, int x1, const uint8_t *where, double *ssim)
{
    enum { A, B, AA, BB, AB, PLANES };
    orl_err e = check(truth, test, x0, x1, 2 * SSIM_RADIUS + 1);
    if (e) return e;
    int w = x1 - x0, h = truth->h, r = SSIM_RADIUS;
    size_t n = (size_t)w * (size_t)h;
    float *mem = malloc((PLANES + 1) * n * sizeof *mem), *p[PLANES], g[2 * SSIM_RADIUS + 1], norm = 0;
    if (!mem) return orl_fail(ORL_E_MEMORY, "ssim: no memory for %zu pixels", n);
    for (int k = 0; k < PLANES; k++) p[k] = mem + (size_t)k * n;
    for (int k = -r; k <= r; k++) norm += g[k + r] = expf(-(float)(k * k) / (2 * 1.5f * 1.5f));
    for (int k = 0; k <= 2 * r; k++) g[k] /= norm;

    double sum = 0;
    size_t windows = 0;
    for (int ch = 0; ch < 3; ch++) {
        plane(truth, x0, x1, ch, p[A]);
        plane(test, x0, x1, ch, p[B]);
        for (size_t i = 0; i < n; i++) {
            float a = p[A][i] -= 0.5f, b = p[B][i] -= 0.5f;     /* centred: variances keep their digits */
            p[AA][i] = a * a; p[BB][i] = b * b; p[AB][i] = a * b;
        }
        for (int k = 0; k < PLANES; k++) filter(p[k], w, h, g, g, r, mem + PLANES * n, p[k]);
        for (int y = r; y < h - r; y++)
            for (int x = r; x < w - r; x++) {
                if (!window_in(where, w, x, y)) continue;
                size_t i = (size_t)y * (size_t)w + (size_t)x;
                windows++;
                double a = p[A][i], b = p[B][i], va = p[AA][i] - a * a, vb = p[BB][i] - b * b, vab = p[AB][i] - a * b;
                a += 0.5; b += 0.5;
                sum += (2 * a * b + 1e-4) * (2 * vab + 9e-4) / ((a * a + b * b + 1e-4) * (va + vb + 9e-4));
            }
    }
    free(mem);
    if (!windows) return orl_fail(ORL_E_RANGE, "ssim: no window of %d x %d pixels lies within what is to be scored", 2 * r + 1, 2 * r + 1);
    *ssim = sum / (double)windows;
    return ORL_OK;
}

orl_err orl_metrics_ssim(const orl_imagef *truth, const orl_imagef *test, int x0, int x1, double *ssim) { return ssim_of(truth, test, x0, x1, NULL, ssim); }
orl_err orl_metrics_ssim_where(const orl_imagef *truth, const orl_imagef *test, const uint8_t *where, double *ssim) { return ssim_of(truth, test, 0, truth->w, where, ssim); }

/* ---- FLIP ---- */

/* XYZ of linear sRGB, divided by the white point, and its inverse: white is (1, 1, 1) on both sides. */
static const double XYZ[3][3] = {
    { 0.4123907993, 0.3575843394, 0.1804807884 }, { 0.2126390059, 0.7151686788, 0.0721923154 }, { 0.0193308187, 0.1191947798, 0.9505321522 },
};
static const double RGB[3][3] = {
    { 3.2409699419, -1.5373831776, -0.4986107603 }, { -0.9692436363, 1.8759675015, 0.0415550574 }, { 0.0556300797, -0.2039769589, 1.0569715142 },
};

static void xyz_from_rgb(const double rgb[3], double xyz[3])
{
    for (int i = 0; i < 3; i++)
        xyz[i] = (XYZ[i][0] * rgb[0] + XYZ[i][1] * rgb[1] + XYZ[i][2] * rgb[2]) / (XYZ[i][0] + XYZ[i][1] + XYZ[i][2]);
}

static void rgb_from_xyz(const double xyz[3], double rgb[3])
{
    double v[3];
    for (int i = 0; i < 3; i++) v[i] = xyz[i] * (XYZ[i][0] + XYZ[i][1] + XYZ[i][2]);
    for (int i = 0; i < 3; i++) rgb[i] = RGB[i][0] * v[0] + RGB[i][1] * v[1] + RGB[i][2] * v[2];
}

/* CIELAB of linear RGB, its chroma scaled by lightness (Hunt effect). */
static void hunt_lab(const double rgb[3], double lab[3])
{
    double f[3];
    xyz_from_rgb(rgb, f);
    for (int i = 0; i < 3; i++) f[i] = f[i] > 216.0 / 24389 ? cbrt(f[i]) : f[i] * 841 / 108 + 4.0 / 29;
    lab[0] = 116 * f[1] - 16;
    lab[1] = 0.01 * lab[0] * 500 * (f[0] - f[1]);
    lab[2] = 0.01 * lab[0] * 200 * (f[1] - f[2]);
}

static double hyab(const double a[3], const double b[3]) { return fabs(a[0] - b[0]) + hypot(a[1] - b[1], a[2] - b[2]); }

typedef struct { int r; float k[TAPS_MAX]; } taps;

static taps gauss_csf(double b, int r)     /* Gaussian of the contrast sensitivity, b in square degrees; sums to 1 */
{
    taps t = { .r = r };
    double sum = 0;
    for (int pass = 0; pass < 2; pass++)
        for (int i = -r; i <= r; i++) {
            double d = i / ORL_FLIP_PPD, g = exp(-PI * PI * d * d / b);
            if (pass) t.k[i + r] = (float)(g / sum);
            else sum += g;
        }
    return t;
}

/* Kernels of the feature detectors: a Gaussian, its first and its second derivative; the latter two with their positive and their
 * negative weights summing to 1 each. */
static void feature_taps(taps *smooth, taps *edge, taps *point)
{
    double sd = 0.5 * 0.082 * ORL_FLIP_PPD, sum = 0, pos[2] = { 0 }, neg[2] = { 0 }, v[2][TAPS_MAX];
    int r = (int)ceil(3 * sd);
    smooth->r = edge->r = point->r = r;
    for (int i = -r; i <= r; i++) {
        double g = exp(-i * i / (2 * sd * sd));
        smooth->k[i + r] = (float)g;
        sum += g;
        v[0][i + r] = -i * g;
        v[1][i + r] = (i * i / (sd * sd) - 1) * g;
        for (int k = 0; k < 2; k++) *(v[k][i + r] > 0 ? &pos[k] : &neg[k]) += fabs(v[k][i + r]);
    }
    for (int i = 0; i <= 2 * r; i++) {
        smooth->k[i] = (float)(smooth->k[i] / sum);
        edge->k[i] = (float)(v[0][i] / (v[0][i] > 0 ? pos[0] : neg[0]));
        point->k[i] = (float)(v[1][i] / (v[1][i] > 0 ? pos[1] : neg[1]));
    }
}

/* One picture's perceived colours (lab: 3 planes) and feature strengths (feat: edges, points). tmp: 4 planes. */
static void perceive(const orl_imagef *im, int x0, int x1, float *lab, float *feat, float *tmp)
{
    int w = x1 - x0, h = im->h, radius = (int)ceil(3 * sqrt(0.04 / (2 * PI * PI)) * ORL_FLIP_PPD);
    size_t n = (size_t)w * (size_t)h, at = 0;
    for (int y = 0; y < h; y++)                     /* opponent space: achromatic, red-green, blue-yellow */
        for (int x = x0; x < x1; x++, at++) {
            double rgb[3], xyz[3];
            for (int i = 0; i < 3; i++) {
                double v = clamp01(im->px[((size_t)y * (size_t)im->w + (size_t)x) * 3 + (size_t)i]);
                rgb[i] = v <= 0.04045 ? v / 12.92 : pow((v + 0.055) / 1.055, 2.4);
            }
            xyz_from_rgb(rgb, xyz);
            lab[at] = (float)(116 * xyz[1] - 16);
            lab[n + at] = (float)(500 * (xyz[0] - xyz[1]));
            lab[2 * n + at] = (float)(200 * (xyz[1] - xyz[2]));
        }

    taps smooth, edge, point;
    feature_taps(&smooth, &edge, &point);
    float *lum = tmp, *fx = tmp + n, *fy = tmp + 2 * n, *work = tmp + 3 * n;
    for (size_t i = 0; i < n; i++) lum[i] = (lab[i] + 16) / 116;
    for (int f = 0; f < 2; f++) {
        const taps *t = f ? &point : &edge;
        filter(lum, w, h, t->k, smooth.k, t->r, work, fx);
        filter(lum, w, h, smooth.k, t->k, t->r, work, fy);
        for (size_t i = 0; i < n; i++) feat[(size_t)f * n + i] = hypotf(fx[i], fy[i]);
    }

    taps a = gauss_csf(0.0047, radius), rg = gauss_csf(0.0053, radius), by1 = gauss_csf(0.04, radius), by2 = gauss_csf(0.025, radius);
    filter(lab, w, h, a.k, a.k, radius, work, lab);
    filter(lab + n, w, h, rg.k, rg.k, radius, work, lab + n);
    /* Blue-yellow: two Gaussians, weighted by their share of the whole kernel (a centre tap is 1 / sum). */
    filter(lab + 2 * n, w, h, by1.k, by1.k, radius, work, fx);
    filter(lab + 2 * n, w, h, by2.k, by2.k, radius, work, fy);
    double s1 = 34.1 * sqrt(PI / 0.04) / ((double)by1.k[radius] * by1.k[radius]);
    double s2 = 13.5 * sqrt(PI / 0.025) / ((double)by2.k[radius] * by2.k[radius]);
    float share = (float)(s1 / (s1 + s2));
    for (size_t i = 0; i < n; i++) {
        double yxz[3] = { lab[i], lab[n + i], share * fx[i] + (1 - share) * fy[i] }, xyz[3], rgb[3], out[3];
        xyz[1] = (yxz[0] + 16) / 116;
        xyz[0] = xyz[1] + yxz[1] / 500;
        xyz[2] = xyz[1] - yxz[2] / 200;
        rgb_from_xyz(xyz, rgb);
        for (int k = 0; k < 3; k++) rgb[k] = rgb[k] > 0 ? (rgb[k] < 1 ? rgb[k] : 1) : 0;
        hunt_lab(rgb, out);
        for (int k = 0; k < 3; k++) lab[(size_t)k * n + i] = (float)out[k];
    }
}

orl_err orl_metrics_flip(const orl_imagef *truth, const orl_imagef *test, int x0, int x1, double *flip)
{
    orl_err e = check(truth, test, x0, x1, 1);
    if (e) return e;
    size_t n = (size_t)(x1 - x0) * (size_t)truth->h;
    float *mem = malloc(14 * n * sizeof *mem), *lab[2] = { mem, mem + 3 * n }, *feat[2] = { mem + 6 * n, mem + 8 * n };
    if (!mem) return orl_fail(ORL_E_MEMORY, "flip: no memory for %zu pixels", n);
    perceive(truth, x0, x1, lab[0], feat[0], mem + 10 * n);
    perceive(test, x0, x1, lab[1], feat[1], mem + 10 * n);

    const double qc = 0.7, pc = 0.4, pt = 0.95, qf = 0.5;
    double green[3], blue[3], sum = 0;
    hunt_lab((double[]){ 0, 1, 0 }, green);
    hunt_lab((double[]){ 0, 0, 1 }, blue);
    double most = pow(hyab(green, blue), qc), knee = pc * most;
    for (size_t i = 0; i < n; i++) {
        double a[3] = { lab[0][i], lab[0][n + i], lab[0][2 * n + i] }, b[3] = { lab[1][i], lab[1][n + i], lab[1][2 * n + i] };
        double c = pow(hyab(a, b), qc);
        c = c < knee ? pt * c / knee : pt + (1 - pt) * (c - knee) / (most - knee);
        double f = fmax(fabs((double)feat[0][i] - feat[1][i]), fabs((double)feat[0][n + i] - feat[1][n + i]));
        f = pow(fmin(f / sqrt(2), 1), qf);
        sum += pow(fmin(c, 1), 1 - f);
    }
    *flip = sum / (double)n;
    free(mem);
    return ORL_OK;
}

orl_err orl_metrics_score(const orl_imagef *truth, const orl_imagef *test, int x0, int x1, orl_score *out)
{
    orl_score s;
    orl_err e = orl_metrics_psnr(truth, test, x0, x1, &s.psnr);
    if (!e) e = orl_metrics_ssim(truth, test, x0, x1, &s.ssim);
    if (!e) e = orl_metrics_flip(truth, test, x0, x1, &s.flip);
    if (!e) *out = s;
    return e;
}
