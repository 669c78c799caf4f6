/* The light model: codes -> environment -> colour of a sample, its derivatives for adaptation and its reverse mode for training. Equations in the header; everything is per sample
 * and without state but one constant table. Display-referred output, not clamped. */
#include "oriel/light.h"
#include <math.h>
#include <pthread.h>
#include <string.h>
#include "oriel/math.h"

#define PI 3.14159265f
typedef float v4 __attribute__((vector_size(16)));
typedef int32_t i4 __attribute__((vector_size(16)));

static float clampf(float x, float lo, float hi) { return x > lo ? x < hi ? x : hi : lo; }     /* NaN -> lo */

/* ---- octahedral map ---- */

void orl_oct_dir(float u, float v, float dir[3])
{
    float x = u, y = v, z = 1 - fabsf(u) - fabsf(v);
    if (z < 0) {
        x = (1 - fabsf(v)) * (u < 0 ? -1.0f : 1.0f);
        y = (1 - fabsf(u)) * (v < 0 ? -1.0f : 1.0f);
    }
    float r = 1 / sqrtf(x * x + y * y + z * z);
    dir[0] = x * r; dir[1] = y * r; dir[2] = z * r;
}

void orl_oct_uv(const float dir[3], float uv[2])
{
    float sum = fabsf(dir[0]) + fabsf(dir[1]) + fabsf(dir[2]);
    if (!(sum > 1e-20f)) { uv[0] = uv[1] = 0; return; }                 /* no direction: up */
    float r = 1 / sum, u = dir[0] * r, v = dir[1] * r;
    uv[0] = u; uv[1] = v;
    if (dir[2] < 0) {
        uv[0] = (1 - fabsf(v)) * (u < 0 ? -1.0f : 1.0f);
        uv[1] = (1 - fabsf(u)) * (v < 0 ? -1.0f : 1.0f);
    }
}

/* ---- irradiance of a normal ---- */

/* max(0, n.w) = n.w / 2 + |n.w| / 2. The first half of E is linear in n: rows 0..2 of a table. The second is even and of degree one: |n_a| G_a(n_b / n_a, n_c / n_a) on the face that n's
 * greatest component a chooses of the cube (b, c follow a in a circle; opposite faces are one), G_a a quadratic B-spline of SIDE^2 coefficients: smooth but for the cube's edges, where faces meet
 * within some thousandths of the peak. The face z is the finest: a sky ends at the horizon, and normals near the poles see that edge all around. */
static const int SIDE[3] = { ORL_IRR_XY, ORL_IRR_XY, ORL_IRR_Z }, FACE[3] = { 3, 3 + ORL_IRR_XY * ORL_IRR_XY, 3 + 2 * ORL_IRR_XY * ORL_IRR_XY };

/* At x in [-1, 1] of a face; t: from the first of three knots to the next. Knots stand closer in the middle, where a step of x is the greater angle. */
typedef struct { float x, t; int at; } spline;

static spline spline_at(float x, int side)
{
    float k = (x * (1.15f - 0.15f * x * x) + 1) * (0.5f * (float)(side - 2));
    int i = (int)k < side - 3 ? (int)k : side - 3;
    return (spline){ x, k - (float)i, i };
}

static void spline_weights(const spline *s, float w[3])
{
    float t = s->t, g = 1 - t;
    w[0] = 0.5f * g * g; w[2] = 0.5f * t * t; w[1] = 1 - w[0] - w[2];
}

static void spline_slopes(const spline *s, int side, float d[3])     /* by x */
{
    float t = s->t, k = 0.5f * (float)(side - 2) * (1.15f - 0.45f * s->x * s->x);
    d[0] = (t - 1) * k; d[2] = t * k; d[1] = -d[0] - d[2];
}

typedef struct { float n[3], size, sign; spline u, v; int a, b, c, side, at; float wu[3], wv[3]; } footprint;

/* A normal without a direction (zero, infinite, not a number) receives nothing. */
static inline void footprint_of(const float n[3], footprint *f)
{
    float x = n[0], y = n[1], z = n[2], ax = fabsf(x), ay = fabsf(y), az = fabsf(z), sum = ax + ay + az, m, u, v;
    if (!(sum > 1e-20f && sum < 1e20f)) x = y = z = ax = ay = az = 0;
    if (az > ax && az > ay) { f->a = 2; f->b = 0; f->c = 1; m = z; u = x; v = y; }
    else if (ay > ax) { f->a = 1; f->b = 2; f->c = 0; m = y; u = z; v = x; }
    else { f->a = 0; f->b = 1; f->c = 2; m = x; u = y; v = z; }
    float r = 1 / (m == 0 ? 1 : m);
    f->n[0] = x; f->n[1] = y; f->n[2] = z;
    f->size = fabsf(m);
    f->sign = m < 0 ? -1.0f : 1.0f;
    f->side = SIDE[f->a];
    f->u = spline_at(u * r, f->side);
    f->v = spline_at(v * r, f->side);
    f->at = FACE[f->a] + f->u.at * f->side + f->v.at;
    spline_weights(&f->u, f->wu);
    spline_weights(&f->v, f->wv);
}

static v4 load(const float *p) { v4 r; memcpy(&r, p, sizeof r); return r; }
static v4 keep(v4 x, i4 mask) { return (v4)((i4)x & mask); }

/* Sky irradiance, three channels; open: where it is not clamped to 0 (splines overshoot by some thousandths of the peak where no sky is seen, and NaN is nothing too). */
static inline v4 fetch(const float *t, const footprint *f, i4 *open)
{
    v4 e = { 0 }, even = { 0 };
    for (int r = 0; r < 3; r++) e += f->n[r] * load(t + 4 * r);
    for (int r = 0; r < 3; r++) {
        const float *row = t + 4 * (f->at + r * f->side);
        even += f->wu[r] * (f->wv[0] * load(row) + f->wv[1] * load(row + 4) + f->wv[2] * load(row + 8));
    }
    e += f->size * even;
    *open = e > 0;
    return keep(e, *open);
}

/* Its derivative where n moves by d, not clamped. */
static inline v4 fetch_along(const float *t, const footprint *f, const float d[3])
{
    v4 e = { 0 };
    float size = f->sign * d[f->a], u = f->sign * (d[f->b] - f->u.x * d[f->a]), v = f->sign * (d[f->c] - f->v.x * d[f->a]), du[3], dv[3];
    spline_slopes(&f->u, f->side, du);
    spline_slopes(&f->v, f->side, dv);
    for (int r = 0; r < 3; r++) { du[r] = size * f->wu[r] + u * du[r]; dv[r] *= v; }
    for (int r = 0; r < 3; r++) e += d[r] * load(t + 4 * r);
    for (int r = 0; r < 3; r++) {
        const float *row = t + 4 * (f->at + r * f->side);
        for (int c = 0; c < 3; c++) e += (du[r] * f->wv[c] + f->wu[r] * dv[c]) * load(row + 4 * c);
    }
    return e;
}

/* Derivatives by z: the same sums over rows of DZ vectors. */
enum { LANES = 4, ROW_Z = 3 * ORL_ENV_DIM, DZ = ROW_Z / LANES };

static inline void fetch_z(const float *t, const footprint *f, v4 dz[DZ])
{
    for (int k = 0; k < DZ; k++) dz[k] = f->n[0] * load(t + LANES * k) + f->n[1] * load(t + ROW_Z + LANES * k) + f->n[2] * load(t + 2 * ROW_Z + LANES * k);
    for (int r = 0; r < 3; r++)
        for (int c = 0; c < 3; c++) {
            const float w = f->size * f->wu[r] * f->wv[c], *row = t + ROW_Z * (f->at + r * f->side + c);
            for (int k = 0; k < DZ; k++) dz[k] += w * load(row + LANES * k);
        }
}

static const float UP[3] = { 0, 0, 1 };

/* ---- environment -> irradiance ---- */

/* Sky, splines and cube are alike under y -> -y and x -> -x. The sums and differences of four mirrored directions (lanes: even, odd in y, in x, in both) meet only their like in
 * four mirrored coefficients: a quarter of the products. transfer[block][w]: block 0 the linear part, then a quarter of each face; w a quarter of the sky. Made once. */
enum { HALF_XY = ORL_IRR_XY / 2, HALF_Z = ORL_IRR_Z / 2, BLOCKS = 1 + 2 * HALF_XY * HALF_XY + HALF_Z * HALF_Z, QUARTER = ORL_ENV / 4, NODES = 48 };
static v4 transfer[BLOCKS][QUARTER];
static uint16_t row_of[BLOCKS][4];      /* table rows of a block: itself, mirrored in y, in x, in both */
static pthread_once_t transfer_once = PTHREAD_ONCE_INIT;

static int quarter(int w) { return w / (ORL_ENV_COLS / 4) * ORL_ENV_COLS + w % (ORL_ENV_COLS / 4); }

static int mirrored(int w, int how)     /* how: 1 in y, 2 in x */
{
    int col = w % ORL_ENV_COLS;
    if (how & 1) col = ORL_ENV_COLS - 1 - col;
    if (how & 2) col = (ORL_ENV_COLS / 2 - 1 - col) & (ORL_ENV_COLS - 1);
    return w - w % ORL_ENV_COLS + col;
}

static v4 hadamard(v4 a)
{
    v4 s = { a[0] + a[1], a[0] - a[1], a[2] + a[3], a[2] - a[3] };
    return (v4){ s[0] + s[2], s[1] + s[3], s[0] - s[2], s[1] - s[3] };
}

/* Least squares: coefficients of a spline's lower half from values at nodes that crowd at the ends, so that faces meet. */
static void spline_fit(int side, const double *node, const double *weight, double fit[][NODES])
{
    double a[ORL_IRR_Z][ORL_IRR_Z] = { { 0 } }, b[ORL_IRR_Z][NODES] = { { 0 } };
    for (int q = 0; q < NODES; q++) {
        spline s = spline_at((float)node[q], side);
        float w[3];
        spline_weights(&s, w);
        for (int r = 0; r < 3; r++) {
            for (int c = 0; c < 3; c++) a[s.at + r][s.at + c] += weight[q] * (double)w[r] * (double)w[c];
            b[s.at + r][q] = weight[q] * (double)w[r];
        }
    }
    for (int k = 0; k < side; k++)                                      /* Gauss-Jordan; positive definite, no pivots */
        for (int r = 0; r < side; r++) {
            double f = r == k ? 0 : a[r][k] / a[k][k];
            if (f == 0) continue;
            for (int c = k; c < side; c++) a[r][c] -= f * a[k][c];
            for (int q = 0; q < NODES; q++) b[r][q] -= f * b[k][q];
        }
    for (int r = 0; r < side / 2; r++) for (int q = 0; q < NODES; q++) fit[r][q] = b[r][q] / a[r][r];
}

/* Coefficients of |n.w| / 2 on a face, lower quarter, by rows. */
static void kernel_fit(int face, const float w[3], const double *node, double fit[][NODES], float *out)
{
    int half = SIDE[face] / 2;
    double a = w[face], b = w[(face + 1) % 3], c = w[(face + 2) % 3], line[NODES], mid[ORL_IRR_Z / 2][NODES] = { { 0 } };
    for (int i = 0; i < NODES; i++) {
        for (int j = 0; j < NODES; j++) {
            double x = a + node[i] * b + node[j] * c;
            line[j] = 0.5 * (x < 0 ? -x : x);
        }
        for (int r = 0; r < half; r++) for (int j = 0; j < NODES; j++) mid[r][j] += fit[r][i] * line[j];
    }
    for (int r = 0; r < half; r++)
        for (int s = 0; s < half; s++) {
            double sum = 0;
            for (int j = 0; j < NODES; j++) sum += mid[r][j] * fit[s][j];
            out[r * half + s] = (float)sum;
        }
}

static void sky_direction(int w, float dir[3], float *area)
{
    const float step = PI / 16;
    int row = w / ORL_ENV_COLS, col = w % ORL_ENV_COLS;
    float el = PI / 2 - ((float)row + 0.5f) * step, az = -PI + ((float)col + 0.5f) * (2 * PI / ORL_ENV_COLS), ce = orl_cosf(el);
    dir[0] = ce * orl_cosf(az); dir[1] = ce * orl_sinf(az); dir[2] = orl_sinf(el);
    *area = (2 * PI / ORL_ENV_COLS) * (orl_sinf(PI / 2 - (float)row * step) - orl_sinf(PI / 2 - (float)(row + 1) * step));
}

static void rows_make(void)
{
    for (int g = 0; g < 3; g++) row_of[0][g] = (uint16_t)(2 - g);
    static const uint8_t flip[3][4] = { { 0, 1, 3, 2 }, { 0, 3, 2, 1 }, { 0, 2, 1, 3 } };       /* of face and mirror; 1: u changes its sign, 2: v */
    for (int face = 0, b = 1; face < 3; face++)
        for (int i = 0; i < SIDE[face] * SIDE[face] / 4; i++, b++)
            for (int g = 0; g < 4; g++) {
                int side = SIDE[face], r = i / (side / 2), s = i % (side / 2);
                row_of[b][g] = (uint16_t)(FACE[face] + (flip[face][g] & 1 ? side - 1 - r : r) * side + (flip[face][g] & 2 ? side - 1 - s : s));
            }
}

static void transfer_make(void)
{
    double node[NODES], weight[NODES], fit[3][ORL_IRR_Z / 2][NODES];
    for (int q = 0; q < NODES; q++) {
        float angle = PI * ((float)q + 0.5f) / NODES;
        node[q] = (double)-orl_cosf(angle);
        weight[q] = 0.5 + 0.5 * (double)orl_sinf(angle);
    }
    for (int face = 0; face < 3; face++) spline_fit(SIDE[face], node, weight, fit[face]);
    for (int w = 0; w < QUARTER; w++) {
        float area, dir[3], k[4][BLOCKS];
        for (int g = 0; g < 4; g++) {
            sky_direction(mirrored(quarter(w), g), dir, &area);
            for (int face = 0, b = 1; face < 3; b += SIDE[face] * SIDE[face] / 4, face++) kernel_fit(face, dir, node, fit[face], k[g] + b);
            if (g == 0) transfer[0][w] = 0.5f * area * (v4){ dir[2], dir[1], dir[0], 0 };
        }
        for (int b = 1; b < BLOCKS; b++) transfer[b][w] = 0.25f * area * hadamard((v4){ k[0][b], k[1][b], k[2][b], k[3][b] });
    }
    rows_make();
}

/* Rows of the table stand stride floats apart. */
static void irradiance(const float (*env)[3], float *out, size_t stride)
{
    v4 sky[QUARTER][3];
    pthread_once(&transfer_once, transfer_make);
    for (int w = 0; w < QUARTER; w++) {
        int at = quarter(w);
        for (int c = 0; c < 3; c++) sky[w][c] = hadamard((v4){ env[at][c], env[mirrored(at, 1)][c], env[mirrored(at, 2)][c], env[mirrored(at, 3)][c] });
    }
    for (int b = 0; b < BLOCKS; b++) {
        v4 e[3] = { { 0 } };
        for (int w = 0; w < QUARTER; w++) for (int c = 0; c < 3; c++) e[c] += transfer[b][w] * sky[w][c];
        for (int c = 0; c < 3; c++) {
            if (b) e[c] = hadamard(e[c]);                               /* the linear part's lanes are its rows 2, 1, 0 and nothing */
            for (int g = b ? 3 : 2; g >= 0; g--) out[row_of[b][g] * stride + (size_t)c] = e[c][g];
        }
    }
}

/* Of a horizontal surface under sky and sun. */
static void up_irradiance(const orl_light *l, float up[3])
{
    footprint f;
    footprint_of(UP, &f);
    i4 open;
    v4 e = fetch(l->esky[0], &f, &open);
    for (int c = 0; c < 3; c++) up[c] = e[c] + l->sun_rgb[c] * clampf(l->sun_dir[2], 0, 1);
}

/* Sky generator coordinates q of the codes. */
static void sky_q(const float *code, float q[ORL_SKY_Q])
{
    q[0] = 1;
    q[1] = code[ORL_C_SUN_EL];
    memcpy(q + 2, code + ORL_C_ENV, (ORL_ENV_DIM + ORL_SKY_DIM) * sizeof *q);
}

/* All that follows from codes and env. */
static void finish(const orl_light_model *m, const float code[ORL_CODE], orl_light *l)
{
    for (int k = 0; k < ORL_CODE; k++) l->code[k] = code[k] == code[k] ? clampf(code[k], -1e3f, 1e3f) : 0;
    float az = l->code[ORL_C_SUN_AZ], el = l->code[ORL_C_SUN_EL], ce = orl_cosf(el), q[ORL_SKY_Q];
    l->sin_az = orl_sinf(az);
    l->cos_az = orl_cosf(az);
    l->sun_dir[0] = ce * l->cos_az; l->sun_dir[1] = ce * l->sin_az; l->sun_dir[2] = orl_sinf(el);
    memset(l->esky, 0, sizeof l->esky);
    irradiance((const float (*)[3])l->env, l->esky[0], 4);
    for (int c = 0; c < 3; c++) l->sun_rgb[c] = orl_expf(clampf(l->code[ORL_C_SUN_RGB + c], -12, 12));
    up_irradiance(l, l->up);
    sky_q(l->code, q);
    memset(l->sky_m, 0, sizeof l->sky_m);
    for (int c = 0; c < 3; c++) {
        l->eground[c] = m->ground[c] * l->up[c];
        for (int j = 0; j < ORL_SKY_Q; j++) for (int y = 0; y < ORL_SKY_Y; y++) l->sky_m[c][y] += q[j] * m->sky_gen[j][c][y];
        for (int k = 0; k < 3; k++) l->tone_a[c][k] = l->code[ORL_C_TONE + 3 * c + k] + (c == k ? 1.0f : 0.0f);
        l->tone_b[c] = l->code[ORL_C_TONE + 9 + c];
    }
}

/* ln radiance before the clamp, kept apart because its derivative is zero where it is clamped. */
static float log_radiance(const orl_light_model *m, const float *z, int w, int c)
{
    float v = m->env_mean[w][c];
    for (int k = 0; k < ORL_ENV_DIM; k++) v += z[k] * m->env_basis[k][w][c];
    return v;
}

void orl_light_decode(const orl_light_model *m, const float code[ORL_CODE], orl_light *out)
{
    float z[ORL_ENV_DIM];
    for (int k = 0; k < ORL_ENV_DIM; k++) z[k] = code[ORL_C_ENV + k] == code[ORL_C_ENV + k] ? clampf(code[ORL_C_ENV + k], -1e3f, 1e3f) : 0;
    for (int w = 0; w < ORL_ENV; w++) for (int c = 0; c < 3; c++) out->env[w][c] = orl_expf(clampf(log_radiance(m, z, w, c), -12, 12));
    finish(m, code, out);
}

void orl_light_from_env(const orl_light_model *m, const float env[ORL_ENV][3], const float code[ORL_CODE], orl_light *out)
{
    for (int w = 0; w < ORL_ENV; w++) for (int c = 0; c < 3; c++) out->env[w][c] = clampf(env[w][c], 0, 1e6f);
    finish(m, code, out);
}

void orl_light_jac_decode(const orl_light_model *m, const orl_light *l, orl_light_jac *out)
{
    out->model = m;
    float live[ORL_ENV][3], d[ORL_ENV][3];
    for (int w = 0; w < ORL_ENV; w++)
        for (int c = 0; c < 3; c++) live[w][c] = fabsf(log_radiance(m, l->code + ORL_C_ENV, w, c)) < 12 ? l->env[w][c] : 0;
    for (int k = 0; k < ORL_ENV_DIM; k++) {
        for (int w = 0; w < ORL_ENV; w++) for (int c = 0; c < 3; c++) d[w][c] = live[w][c] * m->env_basis[k][w][c];
        irradiance((const float (*)[3])d, out->desky[0][k], ROW_Z);
    }
    footprint f;
    footprint_of(UP, &f);
    v4 up[DZ];
    fetch_z(out->desky[0][0], &f, up);
    memcpy(out->dground, up, sizeof up);
    for (int k = 0; k < ORL_ENV_DIM; k++) for (int c = 0; c < 3; c++) out->dground[k][c] *= m->ground[c];
}

/* ---- pieces of a sample ---- */

/* sRGB transfer; above 1 its power law goes on. slope: d encoded / d linear, zero where the clamp holds. Three channels at once: orl_logf's and orl_expf's own
 * arithmetic (oriel/math.h) on the range where neither needs its clamps. */
static void encode(const float linear[3], float e[3], float slope[3])
{
    const float toe = 0.0031308f;
    v4 x = { clampf(linear[0], toe, ORL_LINEAR_MAX), clampf(linear[1], toe, ORL_LINEAR_MAX), clampf(linear[2], toe, ORL_LINEAR_MAX), 1 };
    i4 u = (i4)x, k = (u - 0x3f3504f3) >> 23;     /* a product stands for << : k may be negative */
    v4 f = (v4)(u - k * 0x800000) - 1.0f, s = f / (2.0f + f), z = s * s, h = 0.5f * f * f, fe = __builtin_convertvector(k, v4);
    v4 p = ((2.0f / 9 * z + 2.0f / 7) * z + 2.0f / 5) * z + 2.0f / 3;
    v4 t = (fe * 0.693359375f + (f - (h - (s * (h + z * p) - fe * 2.12194440e-4f)))) * (1 / 2.4f);
    v4 n = (t * 1.44269504f + 12582912.0f) - 12582912.0f, r = (t - n * 0.693359375f) + n * 2.12194440e-4f;
    p = ((((1.0f / 5040 * r + 1.0f / 720) * r + 1.0f / 120) * r + 1.0f / 24) * r + 1.0f / 6) * r + 0.5f;
    v4 y = 1.055f * (((p * r) * r + r) + 1.0f) * (v4)((__builtin_convertvector(n, i4) + 127) * 0x800000), d = y / (2.4f * x);
    for (int c = 0; c < 3; c++) {
        int low = !(linear[c] > toe), nothing = !(linear[c] >= 0);
        e[c] = nothing ? 0 : low ? 12.92f * linear[c] : y[c] - 0.055f;
        slope[c] = nothing || linear[c] >= ORL_LINEAR_MAX ? 0 : low ? 12.92f : d[c];
    }
}

float orl_light_encode(float linear)
{
    float in[3] = { linear, 0, 0 }, e[3], slope[3];
    encode(in, e, slope);
    return e[0];
}

float orl_light_decode_srgb(float e)
{
    if (!(e > 0)) return 0;
    if (e <= 0.04045f) return e * (1 / 12.92f);
    float c = orl_expf(2.4f * orl_logf((e + 0.055f) * (1 / 1.055f)));
    return c < ORL_LINEAR_MAX ? c : ORL_LINEAR_MAX;
}

static void turn(const orl_light *l, const float v[3], float rel[3])      /* scene frame -> sun-relative */
{
    rel[0] = l->cos_az * v[0] + l->sin_az * v[1];
    rel[1] = l->cos_az * v[1] - l->sin_az * v[0];
    rel[2] = v[2];
}

void orl_light_esky(const orl_light *l, const float n[3], float e[3])
{
    float rel[3];
    turn(l, n, rel);
    footprint f;
    footprint_of(rel, &f);
    i4 open;
    v4 sky = fetch(l->esky[0], &f, &open);
    for (int c = 0; c < 3; c++) e[c] = sky[c];
}

/* V and its derivatives by sun azimuth and elevation. */
static float visibility(const orl_light *l, const orl_sample *s, float *d_az, float *d_el)
{
    const float per = ORL_HORIZON / (2 * PI);
    float a = l->code[ORL_C_SUN_AZ] * per;
    int i = (int)a - (a < (float)(int)a);                               /* floor */
    float f = a - (float)i, h0 = s->horizon[i & (ORL_HORIZON - 1)], h1 = s->horizon[(i + 1) & (ORL_HORIZON - 1)];
    float t = clampf((l->code[ORL_C_SUN_EL] - (h0 + f * (h1 - h0))) * (1 / ORL_SUN_SOFT) + 0.5f, 0, 1);
    *d_el = 6 * t * (1 - t) * (1 / ORL_SUN_SOFT);
    *d_az = -*d_el * (h1 - h0) * per;
    float v = t * t * (3 - 2 * t) + s->fix, clamped = clampf(v, 0, 1);
    if (v != clamped) *d_el = *d_az = 0;
    return clamped;
}

float orl_light_sun_visibility(const orl_light *l, const orl_sample *s)
{
    float a, b;
    return visibility(l, s, &a, &b);
}

float orl_light_shadow(const orl_light *l, const orl_sample *s)
{
    float x = ORL_SHADOW_BIAS;
    for (int k = 0; k < ORL_SHADOW_DIM; k++) x += l->code[ORL_C_SHADOW + k] * s->phi[k];
    return 1 / (1 + orl_expf(-x));
}

/* The surface's part of a sample with all that its derivatives need. */
typedef struct {
    float rel[3], vis, vis_az, vis_el, s, below;    /* below: share of the lower hemisphere, (1 - n_z) / 2 */
    float cosine;                                   /* n . sun, >= 0 */
    float irr[3], e[3], slope[3];                   /* irradiance; encoded colour; d e / d linear */
    footprint f;
    i4 open;                                        /* where sky irradiance is not clamped */
} surface;

static void shade_surface(const orl_light *l, const orl_sample *o, surface *r)
{
    turn(l, o->normal, r->rel);
    footprint_of(r->rel, &r->f);
    float linear[3];
    v4 sky = fetch(l->esky[0], &r->f, &r->open);
    r->s = orl_light_shadow(l, o);
    r->vis = visibility(l, o, &r->vis_az, &r->vis_el);
    float d = o->normal[0] * l->sun_dir[0] + o->normal[1] * l->sun_dir[1] + o->normal[2] * l->sun_dir[2];
    r->cosine = d > 0 ? d : 0;
    r->below = 0.5f * (1 - o->normal[2]);
    for (int c = 0; c < 3; c++) {
        r->irr[c] = r->s * (r->vis * l->sun_rgb[c] * r->cosine + o->open * sky[c] + r->below * l->eground[c]);
        linear[c] = o->albedo[c] * (1 / PI) * r->irr[c];
    }
    encode(linear, r->e, r->slope);
}

void orl_light_irradiance(const orl_light *l, const orl_sample *s, float e[3])
{
    surface r;
    shade_surface(l, s, &r);
    memcpy(e, r.irr, sizeof r.irr);
}

static void sky_y(const float rel[3], float y[ORL_SKY_Y])
{
    float a = rel[0], b = rel[1], c = rel[2];
    y[0] = 1; y[1] = a; y[2] = b; y[3] = c; y[4] = a * b; y[5] = b * c; y[6] = c * a; y[7] = a * a - b * b; y[8] = 3 * c * c - 1;
}

static float dot_y(const float m[ORL_SKY_Y], const float y[ORL_SKY_Y])
{
    float s = 0;
    for (int k = 0; k < ORL_SKY_Y; k++) s += m[k] * y[k];
    return s;
}

/* Untoned colour p; sf and y are filled where cov lets them through. */
static void shade_parts(const orl_light *l, const orl_sample *o, surface *sf, float rel[3], float y[ORL_SKY_Y], float p[3])
{
    p[0] = p[1] = p[2] = 0;
    if (o->cov > 0) {
        shade_surface(l, o, sf);
        for (int c = 0; c < 3; c++) p[c] = o->cov * sf->e[c];
    }
    if (o->cov < 1) {
        turn(l, o->dir, rel);
        sky_y(rel, y);
        for (int c = 0; c < 3; c++) p[c] += (1 - o->cov) * dot_y(l->sky_m[c], y);
    }
}

static void tone(const orl_light *l, const float p[3], float rgb[3])
{
    for (int c = 0; c < 3; c++) rgb[c] = l->tone_a[c][0] * p[0] + l->tone_a[c][1] * p[1] + l->tone_a[c][2] * p[2] + l->tone_b[c];
}

void orl_light_shade(const orl_light *l, const orl_sample *s, float rgb[3])
{
    surface sf;
    float rel[3], y[ORL_SKY_Y], p[3];
    shade_parts(l, s, &sf, rel, y, p);
    tone(l, p, rgb);
}

/* ---- derivatives ---- */

/* d p / d code of the surface part: by irradiance, then scaled by cov and slope. */
static void surface_jac(const orl_light *l, const orl_light_jac *jl, const orl_sample *o, const surface *r, float P[3][ORL_CODE])
{
    const float *ground = jl->model->ground, *sun = l->sun_dir;
    float ce = sqrtf(sun[0] * sun[0] + sun[1] * sun[1]);
    float sign = l->cos_az * sun[0] + l->sin_az * sun[1] < 0 ? -1.0f : 1.0f;    /* elevation beyond the zenith */
    float cos_az = r->cosine > 0 ? o->normal[1] * sun[0] - o->normal[0] * sun[1] : 0;
    float cos_el = r->cosine > 0 ? sign * ce * o->normal[2] - sun[2] * (l->cos_az * o->normal[0] + l->sin_az * o->normal[1]) : 0;
    float up = clampf(sun[2], 0, 1), up_el = sun[2] > 0 ? sign * ce : 0;
    v4 az = keep(fetch_along(l->esky[0], &r->f, (const float[3]){ r->rel[1], -r->rel[0], 0 }), r->open), by_z[DZ];
    float dz[ORL_ENV_DIM][3];
    fetch_z(jl->desky[0][0], &r->f, by_z);
    memcpy(dz, by_z, sizeof dz);
    float lobe = r->vis * r->cosine;
    for (int c = 0; c < 3; c++) {
        float g = o->cov * r->slope[c] * o->albedo[c] * (1 / PI) * r->s, E = l->sun_rgb[c], open = r->open[c] ? o->open : 0;
        P[c][ORL_C_SUN_AZ] = g * (E * (r->vis_az * r->cosine + r->vis * cos_az) + o->open * az[c]);
        P[c][ORL_C_SUN_EL] = g * (E * (r->vis_el * r->cosine + r->vis * cos_el) + r->below * ground[c] * E * up_el);
        float lit = l->code[ORL_C_SUN_RGB + c];
        if (lit > -12 && lit < 12) P[c][ORL_C_SUN_RGB + c] = g * E * (lobe + r->below * ground[c] * up);
        for (int k = 0; k < ORL_ENV_DIM; k++) P[c][ORL_C_ENV + k] = g * (open * dz[k][c] + r->below * jl->dground[k][c]);
        for (int k = 0; k < ORL_SHADOW_DIM; k++) P[c][ORL_C_SHADOW + k] = o->cov * r->slope[c] * o->albedo[c] * (1 / PI) * (1 - r->s) * r->irr[c] * o->phi[k];
    }
}

static void sky_jac(const orl_light *l, const orl_light_jac *jl, const orl_sample *o, const float rel[3], const float y[ORL_SKY_Y], float P[3][ORL_CODE])
{
    float a = rel[0], b = rel[1], z = rel[2], share = 1 - o->cov;
    const float y_az[ORL_SKY_Y] = { 0, b, -a, 0, b * b - a * a, -a * z, z * b, 4 * a * b, 0 };
    for (int c = 0; c < 3; c++) {
        P[c][ORL_C_SUN_AZ] += share * dot_y(l->sky_m[c], y_az);
        P[c][ORL_C_SUN_EL] += share * dot_y(jl->model->sky_gen[1][c], y);
        for (int k = 0; k < ORL_ENV_DIM + ORL_SKY_DIM; k++) P[c][ORL_C_ENV + k] += share * dot_y(jl->model->sky_gen[2 + k][c], y);
    }
}

void orl_light_shade_jac(const orl_light *l, const orl_light_jac *jl, const orl_sample *s, float rgb[3], float J[3][ORL_CODE])
{
    surface sf;
    float rel[3], y[ORL_SKY_Y], p[3], P[3][ORL_CODE] = { { 0 } };
    shade_parts(l, s, &sf, rel, y, p);
    tone(l, p, rgb);
    if (s->cov > 0) surface_jac(l, jl, s, &sf, P);
    if (s->cov < 1) sky_jac(l, jl, s, rel, y, P);
    for (int c = 0; c < 3; c++) {
        for (int k = 0; k < ORL_C_TONE; k++) J[c][k] = l->tone_a[c][0] * P[0][k] + l->tone_a[c][1] * P[1][k] + l->tone_a[c][2] * P[2][k];
        for (int k = 0; k < ORL_TONE_DIM; k++) J[c][ORL_C_TONE + k] = 0;
        for (int k = 0; k < 3; k++) J[c][ORL_C_TONE + 3 * c + k] = p[k];
        J[c][ORL_C_TONE + 9 + c] = 1;
    }
}

void orl_light_shade_back(const orl_light_model *m, const orl_light *l, const orl_sample *s, const float d_rgb[3],
                          float d_albedo[3], float d_phi[ORL_SHADOW_DIM], float d_ground[3], float d_sky_m[3][ORL_SKY_Y])
{
    (void)m;                                                            /* the ground's colour enters linearly */
    float d_p[3];
    for (int c = 0; c < 3; c++) d_p[c] = l->tone_a[0][c] * d_rgb[0] + l->tone_a[1][c] * d_rgb[1] + l->tone_a[2][c] * d_rgb[2];
    if (s->cov > 0 && (d_albedo || d_phi || d_ground)) {
        surface r;
        shade_surface(l, s, &r);
        float lobe = 0;
        for (int c = 0; c < 3; c++) {
            float d_linear = s->cov * d_p[c] * r.slope[c] * (1 / PI), d_irr = d_linear * s->albedo[c];
            if (d_albedo) d_albedo[c] += d_linear * r.irr[c];
            if (d_ground) d_ground[c] += d_irr * r.s * r.below * l->up[c];
            lobe += d_irr * r.irr[c];
        }
        lobe *= 1 - r.s;
        if (d_phi) for (int k = 0; k < ORL_SHADOW_DIM; k++) d_phi[k] += lobe * l->code[ORL_C_SHADOW + k];
    }
    if (s->cov < 1 && d_sky_m) {
        float rel[3], y[ORL_SKY_Y];
        turn(l, s->dir, rel);
        sky_y(rel, y);
        for (int c = 0; c < 3; c++) for (int k = 0; k < ORL_SKY_Y; k++) d_sky_m[c][k] += (1 - s->cov) * d_p[c] * y[k];
    }
}
