/* Dispatch of the conversion kernels, and their coefficients. */
#include "runtime/kernels/convert.h"

#define SET(isa) { orl_convert_half_##isa, orl_convert_half_##isa, orl_convert_half_##isa, orl_convert_full_##isa, orl_convert_copy_ref, orl_convert_swap_##isa, \
                   orl_convert_semi_##isa, orl_convert_semi_##isa, orl_convert_yuyv_##isa, orl_convert_uyvy_##isa }       /* in orl_pixels' order */

void orl_convert_kernels_init(orl_convert_kernels *k, unsigned cpu)
{
    *k = (orl_convert_kernels){ SET(ref) };
#if defined(__x86_64__)
    if (cpu & ORL_CPU_AVX2) *k = (orl_convert_kernels){ SET(avx2) };
    if (cpu & ORL_CPU_AVX512) *k = (orl_convert_kernels){ SET(avx512) };
#elif defined(__aarch64__)
    if (cpu & ORL_CPU_NEON) *k = (orl_convert_kernels){ SET(neon) };
#else
    (void)cpu;
#endif
}

/* Q14, U to B Q13: to nearest of the inverse of Y = kr R + (1 - kr - kb) G + kb B, U = (B - Y) / (2 - 2 kb), V = (R - Y) / (2 - 2 kr), the range's scale included.
 * ITU-R BT.601: kr 0.299, kb 0.114; BT.709: kr 0.2126, kb 0.0722. Limited: Y 16..235, U and V 16..240. */
typedef struct { int y, rv, gu, gv, bu; } matrix;
static const matrix MATRIX[2][2] = { { { 19077, 26149, -6419, -13320, 16525 }, { 16384, 22970, -5638, -11700, 14516 } },
                                     { { 19077, 29372, -3494, -8731, 17305 }, { 16384, 25802, -3069, -7670, 15201 } } };

void orl_yuv_table(const orl_source_info *info, orl_yuv_tab *t)
{
    matrix m = MATRIX[info->matrix == ORL_MATRIX_709][info->full_range != 0];
    if (info->pixels == ORL_PIX_MONO) m = (matrix) { m.y, 0, 0, 0, 0 };
    int u = info->pixels == ORL_PIX_NV21, v = !u, base = (1 << 13) - (info->full_range ? 0 : 16 * m.y);
    *t = (orl_yuv_tab) { .y = (int16_t)m.y };
    t->c[0][v] = (int16_t)m.rv;
    t->c[1][u] = (int16_t)m.gu;
    t->c[1][v] = (int16_t)m.gv;
    t->c[2][u] = (int16_t)m.bu;
    t->add[0] = base - 128 * m.rv;
    t->add[1] = base - 128 * (m.gu + m.gv);
    t->add[2] = base - 256 * m.bu;
}
