/* Elementary functions that give the same bits on every IEEE machine (libm's differ in the last place). Single precision, a few ulp.
 * Total: NaN in -> 0 out; arguments are clamped to where the result is finite. */
#ifndef ORIEL_MATH_H
#define ORIEL_MATH_H
float orl_expf(float x);            /* clamped to [-87, 88] */
float orl_logf(float x);            /* x <= 1e-37 -> ln 1e-37 */
float orl_powf(float x, float y);   /* x <= 0 -> 0 */
float orl_sinf(float x);            /* |x| <= 1e4, else reduced by fmod first */
float orl_cosf(float x);
float orl_atan2f(float y, float x); /* atan2(0, 0) = 0 */
float orl_asinf(float x);           /* clamped to [-1, 1] */
#endif
