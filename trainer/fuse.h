/* Many noisy oriented points to one surface, by moving least squares. */
#ifndef TRAINER_FUSE_H
#define TRAINER_FUSE_H
#include "trainer/grid.h"
#include "trainer/stereo.h"

typedef struct {
    const stereo_point *points;     /* not owned */
    uint32_t *begin, *index;        /* points of bin b: index[begin[b]] .. index[begin[b + 1]] */
    int n[3];                       /* bins of 2 fine cells */
} fuse;

/* hull: a first signed distance, fine cells; points that lie in what it calls free take no part. st must outlive the fusion, its points keep their places. ORL_E_MEMORY. */
orl_err fuse_init(fuse *f, const stereo *st, const grid *hull, const int dims[3]);
void fuse_free(fuse *f);
/* Signed distance at x by the points near it whose normals are within 90 degrees of `side`, positive in free space, fine cells; *sure: 0 (no point near) .. 1. */
float fuse_distance(const fuse *f, const float x[3], const float side[3], float *sure);
#endif
