/* A kiosk's file, made by `oriel bake`: a fixed camera's two views with horizons and ceilings of their own, and the light model, so that a board neither needs the scene nor marches
 * (formats/SCENE.md 4.16). Private to the runtime. */
#ifndef RUNTIME_BAKED_H
#define RUNTIME_BAKED_H
#include "oriel/view.h"

typedef struct {
    orl_scene scene;                    /* light model and codes, no surface; owns the mapped file, in which the views' planes lie */
    orl_view view[ORL_VIEWS];           /* the photo's, small, and the wide one; for orl_view_attach */
    orl_camera photo;                   /* as recorded */
} orl_baked;

/* Atomic. view: built and baked, ceiling and all. ORL_E_IO, ORL_E_MEMORY. */
orl_err orl_baked_write(const char *path, const orl_scene *s, const orl_camera *photo, const orl_view view[ORL_VIEWS], size_t *bytes_out);
/* ORL_E_FORMAT and ORL_E_RANGE name file, section and field; a scene file is ORL_E_FORMAT. */
orl_err orl_baked_open(const char *path, orl_baked *out);
/* The views of a scene struct that is open already; name stands in messages. */
orl_err orl_baked_views(const orl_scene *s, const char *name, orl_view view[ORL_VIEWS], orl_camera *photo);
void orl_baked_close(orl_baked *b);
/* As orl_views_find: the cameras, the photo's at the size of the pictures that come from `name` (w 0: as recorded). */
orl_err orl_baked_cameras(const orl_baked *b, const char *name, int w, int h, orl_view_pose *photo, orl_view_pose *wide);
#endif
