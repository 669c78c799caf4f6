/* Panoramas as skies. */
#ifndef TRAINER_SKY_H
#define TRAINER_SKY_H
#include "oriel/sky.h"
/* Reads an equirectangular HDR panorama (any format OpenImageIO knows, width = 2 height, at least 64 rows), cuts the sun out, turns it to the column centre; exposed to 1, no warmth.
 * A sky without a sun gets its brightest spot as direction and next to no irradiance. azimuth (may be NULL): the sun's in the panorama, whose centre column is 0, counter-clockwise seen from above.
 * ORL_E_DEGENERATE on a black sky. */
orl_err sky_from_panorama(const char *path, orl_sky *out, double *azimuth);
/* Mirror image about the sun's azimuth. */
void sky_mirror(orl_sky *s);
enum { SKY_TRAIN = 0, SKY_TEST = 1, SKY_BASILICA = 2 };
/* What split.tsv beside the panorama says of it; SKY_TRAIN where it says nothing. Test wins over basilica. */
int sky_split(const char *path);
#endif
