/* int8 networks: dispatch, packing, and the choice of a multiplier. Not the arithmetic: mlp.h, mlp_ref.c. */
#include "runtime/arena.h"
#include "runtime/kernels/mlp.h"

const orl_mlp_kernel *orl_mlp_kernel_of(unsigned cpu)
{
#if defined(__x86_64__)
    if (cpu & ORL_CPU_AVX512) return &orl_mlp_avx512;
    if (cpu & ORL_CPU_AVX2) return &orl_mlp_avx2;
#elif defined(__aarch64__)
    if (cpu & ORL_CPU_DOTPROD) return &orl_mlp_dotprod;
    if (cpu & ORL_CPU_NEON) return &orl_mlp_neon;
#else
    (void)cpu;
#endif
    return &orl_mlp_ref;
}

static int width_ok(int n) { return n >= 16 && n <= ORL_MLP_WIDTH && n % 16 == 0; }

static orl_err check_shape(const orl_mlp_layer *l, int layers)
{
    if (layers < 1 || layers > ORL_MLP_LAYERS) return orl_fail(ORL_E_RANGE, "network: %d layers, not 1 to %d", layers, ORL_MLP_LAYERS);
    for (int k = 0; k < layers; k++) {
        if (!width_ok(l[k].in) || !width_ok(l[k].out)) return orl_fail(ORL_E_RANGE, "network, layer %d: %d to %d, not multiples of 16 up to %d", k, l[k].in, l[k].out, ORL_MLP_WIDTH);
        if (k && l[k].in != l[k - 1].out) return orl_fail(ORL_E_RANGE, "network, layer %d: takes %d of the %d before it", k, l[k].in, l[k - 1].out);
    }
    return ORL_OK;
}

static orl_err check_values(const orl_mlp_layer *l, int k)
{
    for (int i = 0; i < l->out * l->in; i++) if (l->w[i] == -128) return orl_fail(ORL_E_RANGE, "network, layer %d: weight %d is -128", k, i);
    for (int o = 0; o < l->out; o++) {
        if (l->bias[o] < -ORL_MLP_BIAS || l->bias[o] > ORL_MLP_BIAS) return orl_fail(ORL_E_RANGE, "network, layer %d: bias %d is %d", k, o, l->bias[o]);
        if (l->mul[o] < 0) return orl_fail(ORL_E_RANGE, "network, layer %d: multiplier %d is %d", k, o, l->mul[o]);
        if (l->shift[o] > ORL_MLP_SHIFT) return orl_fail(ORL_E_RANGE, "network, layer %d: shift %d is %d", k, o, l->shift[o]);
    }
    return ORL_OK;
}

size_t orl_mlp_need(const orl_mlp_layer *l, int layers)
{
    size_t need = orl_align64(sizeof(orl_mlp));
    if (check_shape(l, layers)) return 0;
    for (int k = 0; k < layers; k++) need += 2 * (size_t)l[k].in * (size_t)l[k].out + 3 * orl_align64(4 * (size_t)l[k].out);
    return need;
}

orl_err orl_mlp_pack(const orl_mlp_layer *l, int layers, unsigned cpu, void *at, size_t size, const orl_mlp **out)
{
    const orl_mlp_kernel *kernel = orl_mlp_kernel_of(cpu);
    orl_err e = check_shape(l, layers);
    for (int k = 0; !e && k < layers; k++) e = check_values(l + k, k);
    if (e) return e;
    if (!at || (uintptr_t)at % 64 || size < orl_mlp_need(l, layers)) return orl_fail(ORL_E_MEMORY, "network: %zu bytes at 64-byte steps are wanted", orl_mlp_need(l, layers));
    orl_arena a = { at, 0 };
    orl_mlp *m = orl_arena_take(&a, sizeof *m);
    m->kernel = kernel;
    m->layers = layers;
    for (int k = 0; k < layers; k++) {
        const int in = l[k].in, group = kernel->group, block = kernel->block < l[k].out ? kernel->block : l[k].out, move = k ? kernel->hidden : kernel->first;
        int8_t *bytes = orl_arena_take(&a, (size_t)kernel->bytes * (size_t)in * (size_t)l[k].out);
        int16_t *words = (int16_t *)bytes;
        int32_t *bias = orl_arena_take(&a, 4 * (size_t)l[k].out), *shift = orl_arena_take(&a, 4 * (size_t)l[k].out), *mul = orl_arena_take(&a, 4 * (size_t)l[k].out);
        for (int o = 0; o < l[k].out; o++) {
            int sum = 0;
            for (int i = 0; i < in; i++) {
                int w = l[k].w[o * in + i], to = o / block * block * in + (i / group * block + o % block) * group + i % group;
                sum += w;
                if (kernel->bytes == 1) bytes[to] = (int8_t)w;
                else words[to] = (int16_t)w;
            }
            shift[o] = l[k].shift[o];
            mul[o] = l[k].mul[o];
            bias[o] = l[k].bias[o] - move * sum + (shift[o] ? 1 << (shift[o] - 1) : 0);
        }
        m->layer[k].in = in;
        m->layer[k].out = l[k].out;
        m->layer[k].w = bytes;
        m->layer[k].bias = bias;
        m->layer[k].shift = shift;
        m->layer[k].mul = mul;
    }
    *out = m;
    return ORL_OK;
}

void orl_mlp_scale(double scale, int16_t *mul, uint8_t *shift)
{
    int s = 0;
    while (scale < 1.0 / 16 && s < ORL_MLP_SHIFT) { scale *= 2; s++; }
    int m = (int)(scale * 32768 + 0.5);
    if (s && m == 4096) { m = 2048; s--; }
    *mul = (int16_t)(m > 32767 ? 32767 : m);
    *shift = (uint8_t)s;
}
