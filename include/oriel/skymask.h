/* Sky segmentation for photos that come without a mask: classical, no network, nothing learned beforehand. */
#ifndef ORIEL_SKYMASK_H
#define ORIEL_SKYMASK_H
#include "oriel/camera.h"
#include "oriel/image.h"

/* photo: sRGB, 3 channels, any size. cam: at the photo's size (resized here if not). up: world up, NULL = up in the image. points: pixels of photo where
 * SfM points were observed (surely not sky; those outside the picture or not finite are left out); may be NULL with npoints 0.
 * prob: 1 channel, allocated here, size of photo: 255 surely sky .. 0 surely not; > ORL_SKY_SURE counts as sky, < ORL_SKY_SCENE as scene, the rest as unknown.
 * Carving the building is the worst error, so doubt ends in the middle and a photo without a sky gives none. Single-threaded, deterministic, about 0.2 s a photo.
 * ORL_E_RANGE if photo is not RGB; ORL_E_MEMORY. */
orl_err orl_skymask(const orl_image *photo, const orl_camera *cam, const orl_pose *pose, const double up[3],
                    const float (*points)[2], size_t npoints, orl_image *prob);

enum { ORL_SKY_SURE = 200, ORL_SKY_SCENE = 55 };
#endif
