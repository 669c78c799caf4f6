/* Every fixed-point format of the runtime, its range, and what happens at its end. Where a number is made stands what it means; here, that it fits. Q n: an integer of 2^-n.
 *
 *   number                               format      range                      at its end                                          where
 *   distance in a scene file             i8 Q5       -4 .. 3.97 cells           cut; free space beyond takes steps of its own       formats/SCENE.md 5
 *   place of a hit                       i32 Q12     0 .. 4096 cells            the box: 512 bricks of 8                            runtime/march.h
 *   way of a ray                         i64 Q16     0 .. 1e5 cells             nothing is met                                      runtime/march.h
 *   slope of the SDF over 4 cells        i32 Q16     -8 .. 8 cells              cannot be                                           runtime/march.h
 *   base colour of a hit                 u32 Q16     0 .. 65535                 cut                                                 runtime/march.h
 *   light and shadow bytes of a hit      u16, i16 Q8 a byte and 8 bits more     cannot be                                           runtime/march.h
 *   a view's normal                      i8 x 127    -1 .. 1                    -128 is refused in files                            include/oriel/view.h
 *   a view's base colour                 u8 x 255    0 .. 1 of colour^(5/12)    cut                                                 include/oriel/view.h
 *   openness, coverage, traced sun       u8, i8      0 .. 255; -127 .. 127      cut                                                 include/oriel/view.h
 *   horizons, ceilings                   u8          0 .. 90 degrees            cut                                                 include/oriel/view.h
 *   depth                                u16 Q4      0 .. 4095.9 cells          stays there; 65535: none                            include/oriel/view.h
 *   sun visibility, shadow               i16 Q15     0 .. 1                     saturating sums                                     runtime/kernels/shade.h
 *   irradiance / pi                      i16 Q k     0 .. 2047 x white          k = 4 .. 20 by light; above, all of it is scaled    runtime/kernels/shade.h
 *   its power, encoded colour            i16 Q15 Q13 0 .. 1; -0.5 .. 3.49       min before the sum, toe by max                      runtime/kernels/shade.h
 *   tone                                 i16 Q10+s   |row| sum 15.9, b 16       s = 0 .. 4 so that no sum of real pixels wraps      runtime/kernels/shade.h
 *   photo's box and its shares           Q8; Q8, Q15 1 .. 64 pixels a side      shares sum to one                                   runtime/kernels/shade.h
 *   correction of the seam               i32 Q4, i16 Q5  -255 .. 255 levels     a mean of differences: cannot be                    runtime/blend.c
 *   YUV coefficients                     i16 Q14     2 at most                  sums exact in 32 bits                               runtime/kernels/convert.h
 *   int8 networks                        i8, i32     sums below 2^31            saturated to 16 bits, then clamped to 8             runtime/kernels/mlp.h
 *
 * What is float: poses, lenses, rays (runtime/kernels/rays.h), light codes and their adaptation. Their arithmetic is + - * / and sqrt in a fixed order, or oriel/math.h's, and what leaves them for one of
 * the formats above is clamped, NaN to the lower end. tests/test_extremes.c walks the ends. */
#ifndef RUNTIME_NUMBERS_H
#define RUNTIME_NUMBERS_H
#include "oriel/scene.h"
#include "runtime/kernels/shade.h"

#define ORL_I16_MAX 32767

/* visibility: 8 times a difference, and the smoothstep's argument */
_Static_assert(8 * ORL_VIS_SPAN <= ORL_I16_MAX && (8 * ORL_VIS_SPAN * 20182 + 0x4000) / 0x8000 * 2 <= ORL_I16_MAX, "the soft sun leaves 16 bits");
/* a horizon between two azimuths, Q8, unsigned */
_Static_assert(255 * 256 <= 65535, "a horizon leaves 16 bits");
/* the traced sun: what is added to Q15 */
_Static_assert(127 * 258 <= ORL_I16_MAX, "a traced sun leaves 16 bits");
/* shadow features: eight products of 8 and 15 bits, rounded */
_Static_assert(8LL * 128 * ORL_PHI_W_MAX + (1 << 14) < 1LL << 31 && (ORL_PHI_W_MAX + 64) / 128 <= 127, "shadow sums leave 32 bits, or weights two bytes");
/* the power's polynomial, largest at t = 0 */
_Static_assert(ORL_POW_0 <= ORL_I16_MAX && ORL_POW_1 - ORL_POW_2 + ORL_POW_3 <= ORL_I16_MAX, "the power leaves 16 bits");
/* the encoding: its lower end's argument, and the brightest colour minus the darkest sky */
_Static_assert(32 * ORL_TOE <= ORL_I16_MAX && ORL_TOE_2 + ORL_TOE_3 <= ORL_I16_MAX, "the toe leaves 16 bits");
_Static_assert(ORL_U_MAX - ORL_TOE_LINE + 4096 <= ORL_I16_MAX, "a colour between surface and sky leaves 16 bits");
/* tone: 3.49 in Q13 times a row of 1.99, in 1/16 levels, and what is left for b: 268 levels */
_Static_assert(28590LL * 32604 / 32768 + 268 * 16 <= ORL_I16_MAX, "a toned pixel leaves 16 bits");
/* the photo: rows summed in 16 unsigned bits, columns in 15, each rounded by a half at most */
_Static_assert(255 * 256 <= 65535 && 255 * 128 + 64 + (ORL_WARP_ROWS + 1) / 2 <= ORL_I16_MAX, "a box's mean leaves 16 bits");
/* the seam: Q5 between two cells */
_Static_assert(2 * 255 * 32 + 16 <= ORL_I16_MAX, "a correction leaves 16 bits");
#endif
