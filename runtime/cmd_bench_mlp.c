/* `oriel bench --mlp`: the int8 network of three layers 32-64-64-16 on a batch of samples, one thread: every variant of this machine beside the peak of its own dot product, taken in the same run, and beside
 * XNNPACK's signed 8-bit fully connected layers where the build has them. Weights at random with one scale a layer, which is all that those know; both get the same network and the same inputs. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include "runtime/commands.h"
#include "runtime/kernels/mlp.h"
#include "runtime/kernels/shade.h"
#ifdef ORL_HAVE_XNN
#include <xnnpack.h>
#endif

enum { BATCH = 4096, LAYERS = 3, WIDE = ORL_MLP_WIDTH, ROUNDS = 30, PEAK_ROUNDS = 1 << 16 };
static const int WIDTH[LAYERS + 1] = { 32, 64, 64, 16 };
static const double SCALE[LAYERS] = { 1.0 / 256, 1.0 / 512, 1.0 / 512 };
static const char *const VARIANT[] = {
#define NAME(n) #n,
    ORL_KERNEL_VARIANTS(NAME)
#undef NAME
};
enum { VARIANTS = sizeof VARIANT / sizeof *VARIANT };

typedef struct {
    int8_t w[LAYERS][WIDE * WIDE], x[BATCH * WIDE], y[BATCH * WIDE], xnn_y[BATCH * WIDE], hidden[2][BATCH * WIDE];
    int32_t bias[LAYERS][WIDE];
    int16_t mul[LAYERS][WIDE];
    uint8_t shift[LAYERS][WIDE];
} data;

#ifdef ORL_HAVE_XNN
/* Hidden values 0 .. 255 are XNNPACK's -128 .. 127 around a zero of -128. */
static orl_err xnn_open(data *d, xnn_operator_t op[LAYERS])
{
    int ok = xnn_initialize(NULL) == xnn_status_success;
    for (int k = 0; ok && k < LAYERS; k++) {
        size_t in = (size_t)WIDTH[k], out = (size_t)WIDTH[k + 1];
        int8_t in_zero = k ? -128 : 0, out_zero = k + 1 < LAYERS ? -128 : 0;
        ok = xnn_create_fully_connected_nc_qs8(in, out, in, out, in_zero, 1, (float)SCALE[k], d->w[k], d->bias[k], out_zero, 1, -128, 127, 0, &op[k]) == xnn_status_success &&
             xnn_setup_fully_connected_nc_qs8(op[k], BATCH, k ? d->hidden[k - 1] : d->x, k + 1 < LAYERS ? d->hidden[k] : d->xnn_y, NULL) == xnn_status_success;
    }
    return ok ? ORL_OK : orl_fail(ORL_E_UNSUPPORTED, "XNNPACK does not take the network");
}

static double xnn_run(xnn_operator_t op[LAYERS])
{
    double t = orl_seconds();
    for (int k = 0; k < LAYERS; k++) xnn_run_operator(op[k], NULL);
    return orl_seconds() - t;
}
#endif

static uint32_t next(uint64_t *r) { *r = *r * 6364136223846793005u + 1442695040888963407u; return (uint32_t)(*r >> 33); }

/* The layers; multiply-adds of a batch. */
static double fill(data *d, orl_mlp_layer layer[LAYERS])
{
    uint64_t r = 1;
    double macs = 0;
    for (int k = 0; k < LAYERS; k++) {
        for (int i = 0; i < WIDTH[k] * WIDTH[k + 1]; i++) d->w[k][i] = (int8_t)((int)(next(&r) % 255) - 127);
        for (int o = 0; o < WIDTH[k + 1]; o++) {
            d->bias[k][o] = (int32_t)(next(&r) % 20001) - 10000;
            orl_mlp_scale(SCALE[k], &d->mul[k][o], &d->shift[k][o]);
        }
        layer[k] = (orl_mlp_layer){ WIDTH[k], WIDTH[k + 1], d->w[k], d->bias[k], d->mul[k], d->shift[k] };
        macs += (double)BATCH * WIDTH[k] * WIDTH[k + 1];
    }
    for (int i = 0; i < BATCH * WIDTH[0]; i++) d->x[i] = (int8_t)((int)(next(&r) % 256) - 128);
    return macs;
}

/* NAN: the row has none. xnn: seconds of XNNPACK. */
static void say(int json, const char *name, const char *variant, double seconds, double macs, double peak, double xnn)
{
    double rate = macs / seconds * 1e-9;
    if (json) {
        printf("{\"name\": \"%s %s\", \"seconds\": %.6g, \"gmac_s\": %.4g", name, variant, seconds, rate);
        if (isfinite(peak)) printf(", \"ratio\": %.3g, \"against\": \"peak\"", rate / peak);
        if (isfinite(xnn)) printf(", \"xnnpack_ratio\": %.3g", xnn / seconds);
        printf("}\n");
    } else {
        printf("%-28s %-8s %10.3f ms  %7.1f GMAC/s", name, variant, 1e3 * seconds, rate);
        if (isfinite(peak)) printf("  %5.2f of the peak, %.1f", rate / peak, peak);
        if (isfinite(xnn)) printf("  %5.2f x XNNPACK", xnn / seconds);
        printf("\n");
    }
}

orl_err orl_bench_mlp(int json)
{
    data *d = calloc(1, sizeof *d);
    orl_mlp_layer layer[LAYERS];
    const orl_mlp *m[VARIANTS] = { NULL };
    void *block[VARIANTS] = { NULL };
    double seconds[VARIANTS], peak[VARIANTS], macs = 0, xnn = NAN;
    orl_err e = d ? ORL_OK : orl_fail(ORL_E_MEMORY, "no memory");
    if (!e) macs = fill(d, layer);
    for (int v = 0; !e && v < VARIANTS; v++) {
        unsigned cpu;
        size_t need = orl_mlp_need(layer, LAYERS);
        seconds[v] = INFINITY;
        peak[v] = NAN;
        if (orl_cpu_from_name(VARIANT[v], &cpu)) continue;
        block[v] = aligned_alloc(64, need);
        e = orl_mlp_pack(layer, LAYERS, cpu, block[v], need, &m[v]);
    }
#ifdef ORL_HAVE_XNN
    xnn_operator_t op[LAYERS] = { NULL };
    if (!e) e = xnn_open(d, op);
#endif
    for (int i = 0; !e && i < ROUNDS; i++) {                    /* all of them by turns: what else the machine does is shared */
        for (int v = 0; v < VARIANTS; v++) {
            if (!m[v]) continue;
            if (m[v]->kernel->peak) {
                double t = orl_seconds(), done = (double)m[v]->kernel->peak(PEAK_ROUNDS);
                peak[v] = fmax(peak[v], done / (orl_seconds() - t) * 1e-9);
            }
            double t = orl_seconds();
            orl_mlp_run(m[v], d->x, BATCH, d->y);
            seconds[v] = fmin(seconds[v], orl_seconds() - t);
        }
#ifdef ORL_HAVE_XNN
        xnn = fmin(xnn, xnn_run(op));
#endif
    }
    for (int v = 0; !e && v < VARIANTS; v++) if (m[v]) say(json, "int8 32-64-64-16, batch 4096", VARIANT[v], seconds[v], macs, peak[v], xnn);
#ifdef ORL_HAVE_XNN
    if (!e) {
        int most = 0;
        for (int i = 0; i < BATCH * WIDTH[LAYERS]; i++) most = abs(d->y[i] - d->xnn_y[i]) > most ? abs(d->y[i] - d->xnn_y[i]) : most;
        say(json, "int8 32-64-64-16, batch 4096", "XNNPACK", xnn, macs, NAN, NAN);
        if (json) printf("{\"name\": \"int8 outputs off XNNPACK's\", \"levels\": %d}\n", most);
        else printf("outputs off XNNPACK's by %d of 255 levels at the most\n", most);
    }
    for (int k = 0; k < LAYERS; k++) if (op[k]) xnn_delete_operator(op[k]);
#endif
    for (int v = 0; v < VARIANTS; v++) free(block[v]);
    free(d);
    return e;
}
