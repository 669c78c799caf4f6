/* Panoramas to relight by (oriel/panorama.h): file -> sun, sunless map, what is seen in a direction. All measuring is done on a copy of 1024 x 512 pixels, whatever the file's size. */
#include "oriel/panorama.h"
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include "oriel/math.h"

#define PI 3.14159265f
#define DEG (PI / 180)
#define LOBE (8 * DEG)                  /* the sun's energy lies within this of the brightest pixel */
#define RING (20 * DEG)                 /* the sky around it, from 1.5 lobes to here */
enum { W = ORL_PANORAMA_BINS, H = W / 2, BAND = H / 2 / ORL_ENV_ROWS };

static float dot3(const float *a, const float *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
float orl_luminance(const float rgb[3]) { return 0.2126f * rgb[0] + 0.7152f * rgb[1] + 0.0722f * rgb[2]; }

static void direction(float az, float el, float d[3])
{
    float c = orl_cosf(el);
    d[0] = c * orl_cosf(az);
    d[1] = c * orl_sinf(az);
    d[2] = orl_sinf(el);
}

/* Centre of pixel (x, y) of a panorama, in its own frame. */
static void pixel_dir(const orl_imagef *m, int x, int y, float d[3]) { direction((0.5f - ((float)x + 0.5f) / (float)m->w) * 2 * PI, (0.5f - ((float)y + 0.5f) / (float)m->h) * PI, d); }

/* Solid angle of a pixel of row y. */
static float pixel_area(const orl_imagef *m, int y) { return 2 * PI / (float)m->w * PI / (float)m->h * orl_cosf((0.5f - ((float)y + 0.5f) / (float)m->h) * PI); }

static int by_value(const void *a, const void *b)
{
    float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

float orl_percentile(float *v, size_t n, size_t percent)
{
    if (!n) return 0;
    qsort(v, n, sizeof *v, by_value);
    return v[n * percent / 100];
}

static int in_lobe(const orl_panorama *p, const float d[3], const float *px) { return dot3(d, p->peak) > orl_cosf(LOBE) && orl_luminance(px) > 4 * orl_luminance(p->rest); }

/* Median of the sky around the brightest pixel. */
static orl_err find_rest(const orl_imagef *m, orl_panorama *p)
{
    size_t n = (size_t)W * H / 2, count = 0;
    float *ring = malloc(n * 3 * sizeof *ring), d[3];
    if (!ring) return orl_fail(ORL_E_MEMORY, "relight: no memory for the sky");
    for (size_t i = 0; i < n; i++) {
        pixel_dir(m, (int)(i % W), (int)(i / W), d);
        float c = dot3(d, p->peak);
        if (c > orl_cosf(1.5f * LOBE) || c < orl_cosf(RING)) continue;
        for (int k = 0; k < 3; k++) ring[(size_t)k * n + count] = m->px[3 * i + (size_t)k];
        count++;
    }
    for (int k = 0; k < 3 && count; k++) p->rest[k] = orl_percentile(ring + (size_t)k * n, count, 50);
    free(ring);
    return ORL_OK;
}

/* The brightest pixel above the horizon, and what stands out of the sky around it. It is a sun if that lights a face turned to it more than a twentieth of what the sky does. */
static orl_err find_sun(const orl_imagef *m, orl_panorama *p)
{
    size_t n = (size_t)W * H / 2, best = 0;
    float d[3], sum[3] = { 0 }, whole = 0;
    for (size_t i = 0; i < n; i++) {
        int y = (int)(i / W);
        if (orl_luminance(m->px + 3 * i) > orl_luminance(m->px + 3 * best)) best = i;
        whole += orl_luminance(m->px + 3 * i) * pixel_area(m, y) * orl_sinf((0.5f - ((float)y + 0.5f) / H) * PI);
    }
    pixel_dir(m, (int)(best % W), (int)(best / W), p->peak);
    orl_err e = find_rest(m, p);
    for (size_t i = 0; !e && i < n; i++) {
        const float *px = m->px + 3 * i, area = pixel_area(m, (int)(i / W));
        pixel_dir(m, (int)(i % W), (int)(i / W), d);
        if (!in_lobe(p, d, px)) continue;
        for (int k = 0; k < 3; k++) {
            p->rgb[k] += (px[k] > p->rest[k] ? px[k] - p->rest[k] : 0) * area;
            sum[k] += orl_luminance(px) * area * d[k];
        }
    }
    float len = sqrtf(dot3(sum, sum));
    p->has_sun = orl_luminance(p->rgb) > 0.05f * whole && len > 0;
    if (!p->has_sun) {
        memset(p->rgb, 0, sizeof p->rgb);
        memcpy(sum, p->peak, sizeof sum);
        len = 1;
    }
    p->az = orl_atan2f(sum[1], sum[0]);
    p->el = orl_asinf(sum[2] / len);
    return e;
}

static void sum_rings(const orl_imagef *m, orl_panorama *p)
{
    for (int r = 0; r < ORL_ENV_ROWS; r++) {
        float whole = 0;
        for (int y = r * BAND; y < (r + 1) * BAND; y++) {
            float area = pixel_area(m, y), d[3];
            whole += area;
            for (int x = 0; x < W; x++) {
                const float *px = m->px + ((size_t)y * W + (size_t)x) * 3;
                pixel_dir(m, x, y, d);
                if (p->has_sun && in_lobe(p, d, px)) px = p->rest;
                for (int k = 0; k < 3; k++) p->ring[r][x][k] += area * px[k];
            }
        }
        for (int x = 0; x < W; x++) for (int k = 0; k < 3; k++) p->ring[r][x][k] /= whole;
    }
}

orl_err orl_panorama_open(const char *path, orl_panorama *out)
{
    orl_imagef m = { 0 };
    orl_panorama *p = out;
    memset(p, 0, sizeof *p);
    orl_err e = orl_imagef_read(path, &p->map);
    if (!e && (p->map.w < 8 || p->map.h < 4)) e = orl_fail(ORL_E_RANGE, "%s: %d x %d pixels are no environment map", path, p->map.w, p->map.h);
    for (size_t i = 0, n = (size_t)p->map.w * (size_t)p->map.h * 3; i < n; i++) {       /* no light is negative, and sums of it stay finite */
        float v = p->map.px[i];
        p->map.px[i] = v > 0 ? v < 1e9f ? v : 1e9f : 0;
    }
    if (!e) e = orl_imagef_resize_area(&p->map, W, H, &m);
    if (!e) e = find_sun(&m, p);
    if (!e) sum_rings(&m, p);
    orl_imagef_free(&m);
    if (e) orl_panorama_close(p);
    return e;
}

void orl_panorama_close(orl_panorama *p) { orl_imagef_free(&p->map); }

orl_sun orl_panorama_sun(const orl_panorama *p) { return (orl_sun){ p->turn + p->az, p->el, { p->rgb[0], p->rgb[1], p->rgb[2] }, 1, 0 }; }

void orl_panorama_env(const orl_panorama *p, const orl_sun *sun, float env[ORL_ENV][3])
{
    enum { PER = W / ORL_ENV_COLS };
    float u = 0.5f - (sun->az - p->turn - PI) / (2 * PI);       /* where the map's first column, opposite the sun, begins; columns of the panorama run the other way */
    int first = (int)((u - floorf(u)) * W + 0.5f);
    for (int i = 0; i < ORL_ENV; i++)
        for (int k = 0; k < 3; k++) {
            float s = 0;
            for (int b = 0; b < PER; b++) s += p->ring[i / ORL_ENV_COLS][(first - 1 - i % ORL_ENV_COLS * PER - b + 2 * W) % W][k];
            env[i][k] = s / PER * sun->sky;
        }
}

typedef enum { WHOLE, CUT, EXCESS } part;       /* the panorama, without its sun, the sun alone */

/* Share of what stands out of the sky that goes along with the sun, to the eye: fades out towards the lobe's end, so that its glow has no edge in the old place or the new. */
static float shine(const orl_panorama *p, const float d[3])
{
    float end = orl_cosf(LOBE), t = (dot3(d, p->peak) - end) / (orl_cosf(LOBE / 2) - end);
    t = t > 0 ? t < 1 ? t : 1 : 0;
    return t * t * (3 - 2 * t);
}

/* Bilinear, direction in the panorama's own frame. */
static void sample(const orl_panorama *p, const float q[3], part what, float rgb[3])
{
    const orl_imagef *m = &p->map;
    float u = 0.5f - orl_atan2f(q[1], q[0]) / (2 * PI), v = 0.5f - orl_asinf(q[2]) / PI, d[3];
    float x = (u - floorf(u)) * (float)m->w - 0.5f, y = v * (float)m->h - 0.5f;
    int ix = (int)floorf(x), iy = (int)floorf(y);
    float fx = x - (float)ix, fy = y - (float)iy;
    rgb[0] = rgb[1] = rgb[2] = 0;
    for (int k = 0; k < 4; k++) {
        int px = (ix + (k & 1) + m->w) % m->w, py = iy + (k >> 1);
        py = py < 0 ? 0 : py >= m->h ? m->h - 1 : py;
        float w = (k & 1 ? fx : 1 - fx) * (k >> 1 ? fy : 1 - fy);
        const float *c = m->px + ((size_t)py * (size_t)m->w + (size_t)px) * 3;
        float f = 0;
        if (what != WHOLE) {
            pixel_dir(m, px, py, d);
            f = shine(p, d);
        }
        for (int a = 0; a < 3; a++) {
            float over = c[a] > p->rest[a] ? f * (c[a] - p->rest[a]) : 0;
            rgb[a] += w * (what == EXCESS ? over : c[a] - over);
        }
    }
}

/* A direction seen from one sun, as it is seen from another: across, up, and towards it stay what they are. */
static void carry(const float d[3], float az, float el, float to_az, float to_el, float q[3])
{
    float ca = orl_cosf(az), sa = orl_sinf(az), ce = orl_cosf(el), se = orl_sinf(el);
    float across = d[1] * ca - d[0] * sa, out = d[0] * ca + d[1] * sa, towards = out * ce + d[2] * se, up = d[2] * ce - out * se;
    ca = orl_cosf(to_az), sa = orl_sinf(to_az), ce = orl_cosf(to_el), se = orl_sinf(to_el);
    out = towards * ce - up * se;
    q[0] = out * ca - across * sa;
    q[1] = out * sa + across * ca;
    q[2] = towards * se + up * ce;
}

void orl_panorama_look(const orl_panorama *p, const orl_sun *sun, const float dir[3], float rgb[3])
{
    float c = orl_cosf(p->turn), s = orl_sinf(p->turn), q[3] = { c * dir[0] + s * dir[1], c * dir[1] - s * dir[0], dir[2] }, near = orl_cosf(2 * LOBE), own[3], to[3], disc[3];
    int moved = sun->moved && p->has_sun;
    sample(p, q, moved && dot3(q, p->peak) > near ? CUT : WHOLE, rgb);
    for (int k = 0; k < 3; k++) rgb[k] *= sun->sky;
    direction(sun->az, sun->el, to);
    if (!moved || dot3(dir, to) < near) return;
    carry(dir, sun->az, sun->el, p->az, p->el, own);
    sample(p, own, EXCESS, disc);
    for (int k = 0; k < 3; k++) rgb[k] += p->rgb[k] > 0 ? disc[k] * sun->rgb[k] / p->rgb[k] : 0;
}
