/* kernel_hash: one FNV-1a hash over the outputs of the re-lighting kernels, of int8 networks and of a small marched view, one line per variant this machine has. All lines, on all machines, must carry the same hash. */
#include <stdio.h>
#include <stdlib.h>
#include "oriel/view.h"
#include "tests/kernel_data.h"
#include "tests/mlp_data.h"
#include "tests/synth_scene.h"

static const char *const variants[] = {
#define NAME(n) #n,
    ORL_KERNEL_VARIANTS(NAME)
#undef NAME
};

static uint64_t fnv(uint64_t h, const void *p, size_t n)
{
    for (size_t i = 0; i < n; i++) h = (h ^ ((const uint8_t *)p)[i]) * 1099511628211u;
    return h;
}

static kernel_data d;
static uint8_t rgb[KD_N * 3];
static int16_t vis[KD_N], s[KD_N];

static uint64_t hash_kernels(unsigned cpu)
{
    uint64_t h = 14695981039346656037u;
    orl_kernels k;
    orl_kernels_init(&k, cpu);
    for (int i = 0; i < 12; i++) {
        kd_fill(&d, 1000 + (uint64_t)i, i < KD_MODES ? (kd_mode)i : KD_RANDOM);
        orl_vis_in sun = kd_vis_struct(&d, 0);
        orl_shade_in in = kd_in_struct(&d, 0);
        k.vis(&sun, &d.vis_tab, KD_N, vis);
        k.shadow((const int8_t *const[]){ d.phi[0], d.phi[1] }, d.cov, &d.tab, KD_N, s);
        k.shade(&in, &d.tab, KD_N, rgb);
        h = fnv(fnv(fnv(h, vis, sizeof vis), s, sizeof s), rgb, sizeof rgb);
        orl_mix_in mix = kd_mix_struct(&d, 0);
        k.mix(&mix, KD_N, d.render);
        h = fnv(h, d.render, sizeof d.render);
        orl_warp_in warp = kd_warp_struct(&d, 0);
        k.warp(&warp, KD_N, rgb);
        h = fnv(h, rgb, sizeof rgb);
    }
    return h;
}

static int hash_mlp(unsigned cpu, uint64_t *h)
{
    static mlp_data m;
    static int8_t y[MLP_ROWS * ORL_MLP_WIDTH];
    int bad = 0;
    for (int i = 0; !bad && i < 4 * MLP_MODES; i++) {
        const int width[] = { 16 + 16 * (i % 4), 16 + 16 * (i / 2 % 4), 64, 16 + 16 * (i / 4 % 4) };
        const orl_mlp *net = NULL;
        mlp_data_fill(&m, 2000 + (uint64_t)i, 3, width, (mlp_mode)(i % MLP_MODES), MLP_ROWS);
        size_t need = orl_mlp_need(m.layer, m.layers);
        void *block = aligned_alloc(64, need);
        bad = !block || orl_mlp_pack(m.layer, m.layers, cpu, block, need, &net);
        if (!bad) {
            orl_mlp_run(net, m.x, MLP_ROWS, y);
            *h = fnv(*h, y, (size_t)(MLP_ROWS * width[3]));
        }
        free(block);
    }
    return bad;
}

static int hash_view(unsigned cpu, uint64_t *h)
{
    orl_scene sc;
    orl_view v;
    orl_light light;
    uint8_t out[96 * 64 * 3];
    synth_scene_make(&sc, 8, 8, 6);
    const double eye[3] = { -30, -50, 60 }, target[3] = { 32, 32, 18 };
    orl_camera cam = synth_camera(96, 64, 50);
    cam.model = ORL_CAM_OPENCV;
    cam.k1 = -0.1; cam.k2 = 0.02; cam.p1 = 0.001;
    orl_pose pose = synth_look(&sc, eye, target);
    size_t need = orl_view_need(cam.w, cam.h);
    void *block = aligned_alloc(64, need), *lb = aligned_alloc(64, orl_view_light_need());
    int bad = !block || !lb || orl_view_build(&sc, &cam, &pose, 2, 1, block, need, &v);
    if (!bad) {
        orl_light_decode(&sc.light, sc.light.prior_mean, &light);
        orl_view_light *l = orl_view_light_make(&v, &light, lb, orl_view_light_need());
        orl_view_shade(&v, l, cpu, 0, v.h, out, (size_t)v.w * 3);
        size_t planes = (size_t)((uint8_t *)v.sky - (uint8_t *)block);
        *h = fnv(fnv(*h, block, planes), out, sizeof out);
    }
    free(block);
    free(lb);
    synth_scene_free(&sc);
    return bad;
}

int main(void)
{
    for (size_t i = 0; i < sizeof variants / sizeof *variants; i++) {
        unsigned cpu;
        if (orl_cpu_from_name(variants[i], &cpu)) continue;
        uint64_t h = hash_kernels(cpu);
        if (hash_mlp(cpu, &h) || hash_view(cpu, &h)) { fprintf(stderr, "kernel_hash: %s\n", orl_error_text()); return 1; }
        printf("%016llx %s\n", (unsigned long long)h, variants[i]);
    }
    return 0;
}
