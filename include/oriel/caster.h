/* What no photo shows and yet hides the sun from what they show: buildings behind the cameras, as upright boxes on the ground. Grid frame, cells. */
#ifndef ORIEL_CASTER_H
#define ORIEL_CASTER_H

enum { ORL_CASTERS = 16 };

/* Points x with |axis . (x - centre)| < half_0, |axis' . (x - centre)| < half_1 and x_z < top, axis' = axis turned by 90 degrees. It has no underside. */
typedef struct { float centre[2], axis[2], half[2], top; } orl_caster;         /* axis: unit */
typedef struct { int n; orl_caster box[ORL_CASTERS]; } orl_casters;             /* n = 0: none is known */

#define ORL_CASTER_FAR 1e9       /* as good as endless */

/* Does one of them stand in the way from o to o + far d (upwards: d_z >= 0)? Plain double arithmetic: the same answer everywhere. NaN: 0. */
int orl_casters_hide(const orl_casters *c, const double o[3], const double d[3], double far);
#endif
