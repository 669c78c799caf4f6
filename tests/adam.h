/* Adaptation's objective written down a second time, and its minimum by Adam: what orl_adapt is measured against. Slow; not for the runtime. */
#ifndef TESTS_ADAM_H
#define TESTS_ADAM_H
#include <math.h>
#include <string.h>
#include "oriel/adapt.h"

enum { ADAM_STEPS = 2000, ADAM_STARTS = 8, ADAM_INDEPENDENT = 400 };

/* Robust data term, prior and belief in the sky, as orl_adapt_result.cost counts them; g: its gradient. Samples must be finite, weights 0 or positive. */
static inline double adam_cost(const orl_light_model *m, const orl_sample *s, size_t n, const float *code, const orl_adapt_options *o, double g[ORL_CODE])
{
    static _Thread_local orl_light light;
    static _Thread_local orl_light_jac jac;
    double weight = 0, data = 0, prior = 0, t2 = 3.46 * 3.46 * (double)o->sigma * (double)o->sigma;
    float rgb[3], J[3][ORL_CODE];
    orl_light_decode(m, code, &light);
    orl_light_jac_decode(m, &light, &jac);
    memset(g, 0, ORL_CODE * sizeof *g);
    for (size_t i = 0; i < n; i++) {
        double r[3], e2 = 0;
        if (!(s[i].weight > 0)) continue;
        orl_light_shade_jac(&light, &jac, &s[i], rgb, J);
        for (int c = 0; c < 3; c++) {
            r[c] = rgb[c] > s[i].rgb[c] && s[i].rgb[c] >= 250.0f / 255 ? 0 : (double)(rgb[c] - s[i].rgb[c]);
            e2 += r[c] * r[c];
        }
        double share = t2 / (e2 + t2), w = (double)s[i].weight;
        weight += w;
        data += 0.5 * w * e2 * share;
        for (int c = 0; c < 3; c++) for (int k = 0; k < ORL_CODE; k++) g[k] += w * share * share * r[c] * (double)J[c][k];
    }
    double scale = (weight > ADAM_INDEPENDENT ? ADAM_INDEPENDENT / weight : 1) / ((double)o->sigma * (double)o->sigma);
    for (int i = 0; i < ORL_CODE; i++) {
        double pd = 0, d = 0;
        for (int k = 0; k < ORL_CODE; k++) {
            d = (double)(code[k] - m->prior_mean[k]);
            pd += (double)(o->prior_weight * m->prior_prec[i][k]) * (k == ORL_C_SUN_AZ ? remainder(d, 2 * M_PI) : d);
        }
        d = (double)(code[i] - m->prior_mean[i]);
        prior += 0.5 * pd * (i == ORL_C_SUN_AZ ? remainder(d, 2 * M_PI) : d);
        g[i] = scale * g[i] + pd;
    }
    static const float UP[4] = { 0.1f, 0.35f, 0.7f, 0.95f };
    for (int k = 0; k < 4; k++) {
        orl_sample q = { .dir = { sqrtf(1 - UP[k] * UP[k]), 0, UP[k] } };
        orl_light_shade_jac(&light, &jac, &q, rgb, J);
        for (int c = 0; c < 3; c++) {
            if (!(m->sky_std[c] > 0)) continue;
            double a = 0.25 * (double)o->prior_weight / ((double)m->sky_std[c] * (double)m->sky_std[c]), r = (double)(rgb[c] - m->sky_mean[c]);
            prior += 0.5 * a * r * r;
            for (int i = 0; i < ORL_CODE; i++) g[i] += a * r * (double)J[c][i];
        }
    }
    double per = weight > ADAM_INDEPENDENT ? ADAM_INDEPENDENT : weight > 0 ? weight : 1;
    for (int k = 0; k < ORL_CODE; k++) g[k] /= per;
    return (scale * data + prior) / per;
}

/* From 8 sun azimuths around the prior's mean; the least cost met, its code in best. Steps of 0.02 that fall to a hundredth by a half cosine. */
static inline double adam(const orl_light_model *m, const orl_sample *s, size_t n, const orl_adapt_options *o, float best[ORL_CODE])
{
    double least = INFINITY;
    for (int start = 0; start < ADAM_STARTS; start++) {
        float code[ORL_CODE];
        double g[ORL_CODE], mean[ORL_CODE] = { 0 }, square[ORL_CODE] = { 0 }, b1 = 1, b2 = 1;
        memcpy(code, m->prior_mean, sizeof code);
        code[ORL_C_SUN_AZ] = (float)remainder(start * 2 * M_PI / ADAM_STARTS, 2 * M_PI);
        code[ORL_C_SUN_EL] = start & 1 ? 1.0f : 0.45f;
        for (int step = 0; step <= ADAM_STEPS; step++) {
            double cost = adam_cost(m, s, n, code, o, g), rate = 0.02 * (0.505 + 0.495 * cos(M_PI * step / ADAM_STEPS));
            if (cost < least) {
                least = cost;
                memcpy(best, code, sizeof code);
            }
            b1 *= 0.9;
            b2 *= 0.999;
            for (int k = 0; k < ORL_CODE; k++) {
                mean[k] = 0.9 * mean[k] + 0.1 * g[k];
                square[k] = 0.999 * square[k] + 0.001 * g[k] * g[k];
                code[k] -= (float)(rate * (mean[k] / (1 - b1)) / (sqrt(square[k] / (1 - b2)) + 1e-9));
            }
            code[ORL_C_SUN_AZ] = (float)remainder((double)code[ORL_C_SUN_AZ], 2 * M_PI);
            code[ORL_C_SUN_EL] = fminf(fmaxf(code[ORL_C_SUN_EL], -0.1f), 1.5f);
        }
    }
    return least;
}
#endif
