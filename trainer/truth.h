/* Figures of a scene against ground truth, for `eval` and the report. */
#ifndef TRAINER_TRUTH_H
#define TRAINER_TRUTH_H
#include "oriel/dataset.h"
#include "oriel/scene.h"

enum { TRUTH_FIGURES = 20 };
typedef struct { double v; const char *key; int digits; } figure;
typedef struct {
    const char *checkpoint;         /* of the run that made the scene; NULL: no figure on transients */
    int long_side, full_adapt, threads;     /* pixels; light from the whole photo instead of its left half */
} truth_options;

/* Each appends its figures to out[*count...], where the SCENE has what they take. */

/* depth_median_rel, normal_mean_deg (true depth under 80 m), the same with _all, scene_missed, sky_covered: against gt/, or else sky_covered alone by masks; sfm_heldout_median_rel, sfm_heldout_points:
 * SfM points held out from training; transient_iou: against SCENE/masks. */
orl_err truth_geometry(const orl_dataset *d, const orl_scene *s, const truth_options *o, figure out[TRUTH_FIGURES], int *count);
/* albedo_psnr: base colour, linear, one scale per channel for all test photos, pixels with depth. sun_median_deg: sun of the left half against the true one, over test photos that have one; sun_nearest_deg: the
 * nearest training photo's true sun instead. relit_psnr: test views under skies that no photo has; relit_noshadow_psnr: true base colour times true irradiance without shadow instead. */
orl_err truth_factors(const orl_dataset *d, const orl_scene *s, const truth_options *o, figure out[TRUTH_FIGURES], int *count);
/* outside_psnr: the recorded clip, light from each frame that has a wide truth, outside the frame. kiosk_sun_median_deg: the sun in those frames. */
orl_err truth_kiosk(const orl_dataset *d, const orl_scene *s, const truth_options *o, figure out[TRUTH_FIGURES], int *count);
#endif
