/* Adaptation: finds the codes (l_e, l_s, l_t) of a photo from samples of it, by damped Gauss-Newton (Levenberg-Marquardt) with robust weights and a Gaussian prior.
 * Plain float in a fixed order, no allocation, same result on every machine. */
#ifndef ORIEL_ADAPT_H
#define ORIEL_ADAPT_H
#include "oriel/light.h"

typedef enum { ORL_ADAPT_CONVERGED = 0, ORL_ADAPT_ITERATIONS, ORL_ADAPT_DEGENERATE } orl_adapt_status;
typedef struct {
    int max_iterations;     /* per start; default 12 */
    int azimuths;           /* sun azimuths tried as starts when init is NULL; default 8, each at two elevations */
    float prior_weight;     /* times the prior's quadratic form; default 1 */
    float sigma;            /* noise of a residual at rgb scale; default 0.05 */
    int threads;            /* that share the samples; default 1, <= 0: one per core. The same bits for any number */
    float enough;           /* a step that gains less, as a share of the cost, is the last; default 1e-4 */
    unsigned frozen;        /* bit 0: l_e fixed, bit 1: l_s fixed, bit 2: l_t fixed, bit 3: sun direction fixed */
} orl_adapt_options;
typedef struct {
    float code[ORL_CODE];
    float cost;             /* robust data term + prior, per sample */
    float rms;              /* weighted residual rms, rgb scale */
    float inliers;          /* share of weight kept by the robust weights, 0..1 */
    float std[ORL_CODE];    /* posterior standard deviation of each code entry */
    int iterations;
    orl_adapt_status status;/* DEGENERATE: no usable sample or singular equations; code is then the prior mean (or init) */
} orl_adapt_result;

/* Is a colour (sRGB, 0..1) neither black nor burnt out? A photo with fewer than one in 200 such pixels is DEGENERATE. */
int orl_adapt_telling(const float rgb[3]);
orl_adapt_options orl_adapt_defaults(void);
size_t orl_adapt_need(void);                            /* bytes of work memory, 64-byte aligned */
/* samples with weight 0 are skipped. Robust weight: Geman-McClure on the residual's RGB norm. A channel observed >= 250/255 with a brighter model counts as fitting (saturated). init: NULL = several starts from the prior mean.
 * Of a black-and-white photo (98 % of the weight within 2.5 levels of grey) the tone is the same for all channels. */
orl_err orl_adapt(const orl_light_model *m, const orl_sample *s, size_t n, const float *init,
                  const orl_adapt_options *opt, void *work, size_t work_bytes, orl_adapt_result *out);
/* orl_adapt_result.cost of any code on any samples. */
orl_err orl_adapt_cost(const orl_light_model *m, const orl_sample *s, size_t n, const float code[ORL_CODE], const orl_adapt_options *opt, void *work, size_t work_bytes, float *cost);
#endif
