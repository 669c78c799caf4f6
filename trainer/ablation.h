/* The table that tests/ablation.sh writes: what a scene scores when stage 2 does without one of its parts. */
#ifndef TRAINER_ABLATION_H
#define TRAINER_ABLATION_H
#include "oriel/error.h"

enum { ABLATION_PSNR, ABLATION_SSIM, ABLATION_FLIP, ABLATION_FULL, ABLATION_ALBEDO, ABLATION_SUN, ABLATION_RELIT, ABLATION_FIGURES };
enum { ABLATION_ROWS = 64 };
typedef struct { char variant[64]; double v[ABLATION_FIGURES]; } ablation_row;     /* NAN: not measured */
typedef struct { ablation_row row[ABLATION_ROWS]; int n, full; } ablation;         /* full: the row of what is compared with */

/* Tab-separated, untrusted. The heading is `variant psnr ssim flip psnr_full albedo_psnr sun_median_deg relit_psnr`; a line a variant follows, no two alike, one of them `full`; `-` stands for a figure
 * that was not measured (never psnr). Names are printable ASCII. ORL_E_FORMAT and ORL_E_RANGE name file and line; out stays untouched. */
orl_err ablation_read(const char *path, ablation *out);
#endif
