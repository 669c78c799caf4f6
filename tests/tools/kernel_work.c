/* kernel_work VARIANT PLACE: the re-lighting and conversion kernels on so many pixels of one kind that their instructions can be counted (tests/boards.sh). PLACE: surface (all of it, its sun by horizons and ceilings,
 * shadow features, the photo at 2.2 times the wide view's scale, no photo where it is mixed), sky (no surface), border (half covered, half photo). Prints a line a kernel: name, pixels, pixels after which what it
 * does repeats, bytes read and written a pixel. 77: the machine does not have the variant. */
#include <stdio.h>
#include <stdlib.h>
#include "runtime/kernels/convert.h"
#include "tests/kernel_data.h"

enum { TURNS = 64, ZOOM = 563 };        /* ZOOM: 2.2 in Q8 */

static kernel_data d;
static uint8_t rgb[KD_N * 3];
static int16_t vis[KD_N], s[KD_N];

static void fill(int cov)
{
    kd_fill(&d, 3, KD_RANDOM);
    memset(d.cov, cov, sizeof d.cov);
    d.ceilings = 1;
    d.traced = 0;
    d.shadows = 1;
    d.all = 0;
    d.tab.gain_shift = 0;               /* lights as they are, none that dazzles */
    for (int a = 0; a < 2; a++) d.box[a] = ZOOM;
    memset(d.column, 0, sizeof d.column);
    memset(d.row, 0, sizeof d.row);
    kd_warp(&d);
    for (int i = 0; i < KD_N; i++) {
        unsigned u = (unsigned)i * 7919 % (KD_SIDE * 256 - 4 * 256), v = (unsigned)i * 104729 % (KD_SIDE * 256 - 4 * 256);
        d.at[i] = (orl_warp_at){ 3 * (KD_SIDE * (v >> 8) + (u >> 8)), (uint8_t)u, (uint8_t)v, 0 };
    }
    memset(vis, 0, sizeof vis);
    memset(s, 0, sizeof s);
}

static void convert(unsigned cpu, orl_pixels pixels)
{
    orl_source_info info = { .w = KD_N, .h = 1, .pixels = pixels };
    orl_convert_kernels k;
    orl_yuv_tab t;
    orl_convert_kernels_init(&k, cpu);
    orl_yuv_table(&info, &t);
    k.row[pixels]((const uint8_t *const[]){ d.photo, d.photo, d.photo }, &t, KD_N, rgb);
}

int main(int argc, char **argv)
{
    unsigned cpu;
    if (argc != 3 || (strcmp(argv[2], "surface") && strcmp(argv[2], "sky") && strcmp(argv[2], "border"))) {
        fprintf(stderr, "usage: kernel_work VARIANT surface|sky|border\n");
        return 2;
    }
    if (orl_cpu_from_name(argv[1], &cpu)) return 77;
    const int border = argv[2][0] == 'b', cov = argv[2][1] == 'u' ? 255 : border ? 128 : 0;
    orl_kernels k;
    orl_kernels_init(&k, cpu);
    fill(cov);
    orl_vis_in sun = kd_vis_struct(&d, 0);
    orl_shade_in in = kd_in_struct(&d, 0);
    orl_warp_in warp = kd_warp_struct(&d, 0);
    orl_mix_in mix = kd_mix_struct(&d, 0);
    uint8_t weight[KD_N];
    memset(weight, border ? 128 : 0, sizeof weight);
    mix.weight = weight;
    in.vis = vis;
    in.s = s;
    for (int i = 0; i < TURNS; i++) {
        k.vis(&sun, &d.vis_tab, KD_N, vis);
        k.shadow((const int8_t *const[]){ d.phi[0], d.phi[1] }, d.cov, &d.tab, KD_N, s);
        k.shade(&in, &d.tab, KD_N, rgb);
        k.mix(&mix, KD_N, d.render);
        k.warp(&warp, KD_N, rgb);
        convert(cpu, ORL_PIX_YUYV);
        convert(cpu, ORL_PIX_NV12);
        convert(cpu, ORL_PIX_420);
    }
    const int n = TURNS * KD_N, run = ORL_KERNEL_STEP;
    const double photo = 3.0 * ZOOM * ZOOM / 65536;
    printf("vis %d %d %g\nshadow %d %d %g\nshade %d %d %g\nmix %d %d %g\nwarp %d %d %g\n", n, run, cov ? 4 + 1 + 2. : 1 + 2., n, run, cov ? 8 + 1 + 2. : 1 + 2., n, run, cov ? 3 + 3 + 1 + 1 + 2 + 2 + 3. : 1 + 3., n, run,
           border ? 3 + 3 + 2 + 3. : 3 + 3 + 2., n, 1, sizeof(orl_warp_at) + photo + 3);
    printf("convert_yuyv %d %d %g\nconvert_semi %d %d %g\nconvert_half %d %d %g\n", n, ORL_CONVERT_STEP, 2 + 3., n, ORL_CONVERT_STEP, 1.5 + 3, n, ORL_CONVERT_STEP, 1.5 + 3);
    return 0;
}
