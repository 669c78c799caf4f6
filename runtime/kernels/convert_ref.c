/* Conversion to RGB in plain C: the specification of convert.h that every other variant must meet bit for bit. */
#include <string.h>
#include "runtime/kernels/convert.h"

static uint8_t clamp8(int v) { return (uint8_t)(v < 0 ? 0 : v > 255 ? 255 : v); }

static void pixel(const orl_yuv_tab *t, int y, int a, int b, uint8_t *rgb)
{
    for (int c = 0; c < 3; c++) rgb[c] = clamp8((t->y * y + (t->c[c][0] * a + t->c[c][1] * b) * (c == 2 ? 2 : 1) + t->add[c]) >> 14);
}

void orl_convert_half_ref(const uint8_t *const p[3], const orl_yuv_tab *t, int n, uint8_t *rgb) { for (int i = 0; i < n; i++) pixel(t, p[0][i], p[1][i / 2], p[2][i / 2], rgb + 3 * i); }
void orl_convert_full_ref(const uint8_t *const p[3], const orl_yuv_tab *t, int n, uint8_t *rgb) { for (int i = 0; i < n; i++) pixel(t, p[0][i], p[1][i], p[2][i], rgb + 3 * i); }
void orl_convert_semi_ref(const uint8_t *const p[3], const orl_yuv_tab *t, int n, uint8_t *rgb) { for (int i = 0; i < n; i++) pixel(t, p[0][i], p[1][i & ~1], p[1][i | 1], rgb + 3 * i); }

void orl_convert_yuyv_ref(const uint8_t *const p[3], const orl_yuv_tab *t, int n, uint8_t *rgb)
{
    for (int i = 0; i < n; i++) pixel(t, p[0][2 * i], p[0][2 * (i & ~1) + 1], p[0][2 * (i | 1) + 1], rgb + 3 * i);
}

void orl_convert_uyvy_ref(const uint8_t *const p[3], const orl_yuv_tab *t, int n, uint8_t *rgb)
{
    for (int i = 0; i < n; i++) pixel(t, p[0][2 * i + 1], p[0][2 * (i & ~1)], p[0][2 * (i | 1)], rgb + 3 * i);
}

void orl_convert_swap_ref(const uint8_t *const p[3], const orl_yuv_tab *t, int n, uint8_t *rgb)
{
    (void)t;
    for (int i = 0; i < 3 * n; i += 3) { rgb[i] = p[0][i + 2]; rgb[i + 1] = p[0][i + 1]; rgb[i + 2] = p[0][i]; }
}

void orl_convert_copy_ref(const uint8_t *const p[3], const orl_yuv_tab *t, int n, uint8_t *rgb)
{
    (void)t;
    memcpy(rgb, p[0], 3 * (size_t)n);
}
