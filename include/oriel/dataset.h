/* A SCENE folder as the trainer sees it: photos with cameras, split, masks, SfM points. */
#ifndef ORIEL_DATASET_H
#define ORIEL_DATASET_H
#include "oriel/colmap.h"
#include "oriel/image.h"

typedef struct {
    char name[256];                 /* file name */
    char path[1024];                /* of the photo */
    char mask[1024];                /* of the mask, "" if none given: 0 scene, 128 sky, 255 transient */
    int  test;                      /* trains nothing: neither pixels nor observations */
    orl_camera cam;                 /* at the photo's full size */
    orl_pose pose;
    uint32_t obs_begin, obs_count;  /* into obs; 0 for test photos */
} orl_photo;

typedef struct {
    char dir[1024], name[128];
    orl_photo *photos; uint32_t nphotos;            /* sorted by name; train and test */
    orl_colmap_obs *obs; uint32_t nobs;
    orl_colmap_point *points; uint32_t npoints;     /* only points seen by >= 2 training photos; track_length counts training photos */
} orl_dataset;

/* Layouts: photos/ or images/, sparse/0 or sparse (binary or text), masks/NAME.png, split.tsv, sparse_test/0; and IMC-PT Phototourism
 * (dense/images, dense/sparse, *.tsv of NeRF-W beside or above). Photos without camera, cameras without photo: named through warn, skipped. No split: all train. */
orl_err orl_dataset_open(const char *dir, void (*warn)(void *user, const char *line), void *user, orl_dataset *out);
void orl_dataset_free(orl_dataset *d);
/* Photo through OpenImageIO, EXIF orientation honoured, 3 channels sRGB 8 bit, area-averaged to the long side given (0 = full). cam (may be NULL) receives the camera at that size. A photo whose
 * size is not the camera's (or its transpose where EXIF turns it) is ORL_E_FORMAT. */
orl_err orl_photo_load(const orl_photo *p, int long_side, orl_image *out, orl_camera *cam);
/* Mask labels at size w x h (nearest); ORL_E_IO if none is given. */
orl_err orl_photo_load_mask(const orl_photo *p, int w, int h, orl_image *out);
/* Any image OpenImageIO can read (HDR panorama, EXR, …), linear float, 3 channels. */
orl_err orl_oiio_read_float(const char *path, orl_imagef *out);
#endif
