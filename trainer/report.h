/* The parts of the report's page. Each appends HTML to page.body. */
#ifndef TRAINER_REPORT_H
#define TRAINER_REPORT_H
#include "oriel/view.h"
#include "trainer/ablation.h"
#include "trainer/checkpoint.h"
#include "trainer/eval.h"
#include "oriel/plot.h"
#include "trainer/truth.h"

enum { REPORT_SCORED = 512, REPORT_LARGE = 400, REPORT_SMALL = 270 };    /* long sides: of photos that are scored, of pictures in the page */

enum { REPORT_SKIES = 12 };
typedef struct { const char *dir, *scene, *checkpoint, *ablation, *output, *sky[REPORT_SKIES]; int nskies, limit, train, threads; } report_options;
typedef struct {
    const report_options *o;
    const orl_dataset *d;
    const orl_scene *s;
    orl_model *model;               /* these two NULL: no checkpoint */
    checkpoint_header *head;
    ablation *parts;                /* NULL: no table */
    orl_text body;
    eval_row *test, *train;         /* scores of the photos shown */
    int ntest, ntrain;
} page;

/* A heading with an anchor of its own. */
void report_section(page *p, const char *id, const char *title);

/* report_pictures.c. of: what the picture shows; with the caption it is the picture's alternative text. */
typedef enum { LAYER_BASE, LAYER_NORMALS, LAYER_SHADING, LAYER_SUN, LAYER_SHADOW, LAYER_DEPTH, LAYER_CLAY } report_layer;
orl_err report_picture(page *p, const orl_image *im, int side, const char *of, const char *caption);
/* A layer of a view; light: for shading, sun and shadow. */
orl_err report_add_layer(page *p, const orl_view *v, report_layer what, const orl_light *light, int side, const char *of, const char *caption);
orl_err report_add_difference(page *p, const orl_image *a, const orl_image *b, const char *of);
/* The sky found, on a plan whose top is where `heading` (azimuth, radians) points. */
orl_err report_add_sky(page *p, const orl_light *l, double heading, const char *of);
orl_err report_add_outside(page *p);

/* report_photo.c: a photo beside its render, and what that is made of. half: the light is found on the left half, else on the whole photo. row receives the scores; shown is 0 where the photo cannot be
 * read, which is said on standard error. */
orl_err report_add_photo(page *p, const orl_photo *photo, const eval_setup *setup, int half, eval_row *row, int *shown);

/* report_skies.c: the first test photo's view under the skies asked for. */
orl_err report_add_skies(page *p);

/* report_tables.c */
void report_add_facts(page *p, int train, int test, const figure *f, int n);
void report_add_scores(page *p);
void report_add_curves(page *p);
void report_add_ablation(page *p);
#endif
