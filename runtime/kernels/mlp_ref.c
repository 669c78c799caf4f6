/* int8 networks in plain C: the specification of mlp.h. */
#include "runtime/kernels/mlp.h"

static int clamp(int v, int lo, int hi) { return v < lo ? lo : v > hi ? hi : v; }

static void run_ref(const orl_mlp *m, const int8_t *x, int n, int8_t *y)
{
    for (int s = 0; s < n; s++, x += m->layer[0].in) {
        int a[2][ORL_MLP_WIDTH];
        for (int i = 0; i < m->layer[0].in; i++) a[0][i] = x[i];
        for (int k = 0; k < m->layers; k++) {
            const int8_t *w = m->layer[k].w;
            for (int o = 0; o < m->layer[k].out; o++, w += m->layer[k].in) {
                int acc = m->layer[k].bias[o];                          /* with the half of the rounding shift in it */
                for (int i = 0; i < m->layer[k].in; i++) acc += w[i] * a[k & 1][i];
                int u = (clamp(acc >> m->layer[k].shift[o], -32768, 32767) * m->layer[k].mul[o] + (1 << 14)) >> 15;
                if (k + 1 < m->layers) a[~k & 1][o] = clamp(u, 0, 255);
                else *y++ = (int8_t)clamp(u, -128, 127);
            }
        }
    }
}

const orl_mlp_kernel orl_mlp_ref = { 1, 16, 1, 0, 0, run_ref, NULL };
