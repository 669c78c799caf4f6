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
/* The recorded clip through the loop that `oriel run` runs, its wide truths and the recording itself beside it (trainer/kiosk.c):
 * outside_psnr, outside_ssim: blended pictures against the wide truths, outside the frame, mean over these. kiosk_sun_median_deg: the sun there.
 * temporal_ratio: inside the frame, people left out, the unblended render's mean absolute change from frame to frame over the recording's; mean over all pairs. jump_frames: pictures after the exposure's jump
 * until the render's mean level there is within a tenth of the jump of the recording's. */
orl_err truth_kiosk(const orl_dataset *d, const orl_scene *s, const truth_options *o, figure out[TRUTH_FIGURES], int *count);

/* Parts that these share. Rotation world -> scene frame out of the scene's similarity; the sun's direction that a JSON text gives after `key`, 0 if it gives none; degrees between the sun of a code (scene frame)
 * and a true one (world). */
void truth_rotation(const orl_scene *s, double R[9]);
int truth_sun_after(const char *json, const char *key, double dir[3]);
double truth_sun_error(const double R[9], const float *code, const double world[3]);
#endif
