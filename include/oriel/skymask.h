/* Sky segmentation for photos that come without a mask: classical, no network, nothing learned beforehand. */
#ifndef ORIEL_SKYMASK_H
#define ORIEL_SKYMASK_H
#include "oriel/dataset.h"

enum { ORL_SKY_SURE = 200, ORL_SKY_SCENE = 55 };        /* > 200 counts as sky, < 55 as scene, the rest as unknown */

/* photo: sRGB, 3 channels, any size. cam: of the photo, at any size. up: world up, NULL = up in the picture and no horizon (pose is not read then). points: pixels of photo where
 * SfM points were observed or fall (surely not sky; those outside the picture or not finite are left out); may be NULL with npoints 0.
 * prob: 1 channel, size of photo, allocated here: 255 surely sky .. 0 surely not. Carving the building is the worst error, so doubt ends in the middle and a photo without a sky gives none.
 * Single-threaded, deterministic, about 0.2 s a photo. ORL_E_RANGE if photo is not RGB or up is no direction; ORL_E_MEMORY. */
orl_err orl_skymask(const orl_image *photo, const orl_camera *cam, const orl_pose *pose, const double up[3],
                    const float (*points)[2], size_t npoints, orl_image *prob);

/* The same for photo number `index` of a dataset: besides its own observations, all well-measured SfM points are projected into it (seen or hidden, the sky is not there), which
 * is several times the evidence and all there is on a test photo. photo and cam as orl_photo_load gives them. skip (NULL: none): of each of the dataset's points, 1 if it is not to be asked. */
orl_err orl_skymask_photo(const orl_dataset *d, uint32_t index, const orl_image *photo, const orl_camera *cam, const double up[3], const uint8_t *skip, orl_image *prob);

/* World up of a dataset: the direction most orthogonal to the training cameras' x axes, leaning a little on their mean y axis where they all look one way. ORL_E_DEGENERATE without cameras. */
orl_err orl_skymask_up(const orl_dataset *d, double up[3]);
#endif
