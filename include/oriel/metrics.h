/* How close a picture comes to the truth: PSNR, SSIM, LDR-FLIP. Images are float, 3 channels, sRGB in [0,1] (values outside are
 * clamped), same size. Scores are taken on columns [x0, x1) as if the picture were cut there: nothing outside the range takes part.
 * Single-threaded, fixed order. */
#ifndef ORIEL_METRICS_H
#define ORIEL_METRICS_H
#include "oriel/image.h"

#define ORL_PSNR_MAX 99.0       /* dB; stands for infinity (identical pictures) */
#define ORL_FLIP_PPD 67.0206    /* pixels per degree: 0.7 m before a 0.7 m wide screen of 3840 pixels */

typedef struct { double psnr, ssim, flip; } orl_score;

/* All return ORL_E_RANGE if the pictures differ in shape, are not RGB, or the range does not lie inside; ORL_E_MEMORY. */
orl_err orl_metrics_psnr(const orl_imagef *truth, const orl_imagef *test, int x0, int x1, double *db);
/* Wang et al. 2004: 11-tap Gaussian, sigma 1.5, windows wholly inside (so at least 11 x 11 pixels), K1 0.01, K2 0.03, mean over RGB. */
orl_err orl_metrics_ssim(const orl_imagef *truth, const orl_imagef *test, int x0, int x1, double *ssim);
/* The same over the windows that lie wholly on pixels with where != 0 (w * h, rows tight); ORL_E_RANGE if there are none. */
orl_err orl_metrics_ssim_where(const orl_imagef *truth, const orl_imagef *test, const uint8_t *where, double *ssim);
/* Andersson et al., "FLIP: A Difference Evaluator for Alternating Images", 2020; mean over pixels, 0 (same) .. 1. */
orl_err orl_metrics_flip(const orl_imagef *truth, const orl_imagef *test, int x0, int x1, double *flip);
orl_err orl_metrics_score(const orl_imagef *truth, const orl_imagef *test, int x0, int x1, orl_score *out);
#endif
