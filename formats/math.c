/* Elementary functions with the same bits on every IEEE machine: argument reduction, then a polynomial in a fixed order. exp and log are single precision throughout (they sit in inner
 * loops); the others compute in double and round once. No tables, no state, no libm beyond fmod and sqrt, which IEEE defines exactly. */
#include "oriel/math.h"
#include <float.h>
#include <math.h>
#include <stdint.h>
#include <string.h>

static float from_bits(uint32_t u) { float f; memcpy(&f, &u, 4); return f; }
static uint32_t to_bits(float f) { uint32_t u; memcpy(&u, &f, 4); return u; }

/* x = n ln 2 + r, |r| <= ln 2 / 2; 2^n is built in the exponent field (n = -126..127 after the clamp). */
float orl_expf(float x)
{
    if (!(x == x)) return 0;
    x = x < -87.0f ? -87.0f : x > 88.0f ? 88.0f : x;
    float n = (x * 1.44269504f + 12582912.0f) - 12582912.0f;           /* 1.5 * 2^23: rounds to nearest */
    float r = (x - n * 0.693359375f) + n * 2.12194440e-4f;             /* ln 2 = 0.693359375 - 2.1219444e-4, the first exact in 10 bits */
    float p = 1.0f / 5040;
    p = p * r + 1.0f / 720;
    p = p * r + 1.0f / 120;
    p = p * r + 1.0f / 24;
    p = p * r + 1.0f / 6;
    p = p * r + 0.5f;
    p = (p * r) * r + r;
    return (p + 1.0f) * from_bits((uint32_t)((int)n + 127) << 23);
}

/* x = 2^e m, m in [sqrt 1/2, sqrt 2); ln m = 2 atanh(s), s = (m - 1) / (m + 1). */
float orl_logf(float x)
{
    if (!(x == x)) return 0;
    x = x < 1e-37f ? 1e-37f : x > FLT_MAX ? FLT_MAX : x;
    uint32_t u = to_bits(x), k = u - 0x3f3504f3u;
    int e = (int32_t)k >> 23;
    float m = from_bits(u - ((uint32_t)e << 23)), f = m - 1.0f, s = f / (2.0f + f), z = s * s;
    float p = 2.0f / 9;
    p = p * z + 2.0f / 7;
    p = p * z + 2.0f / 5;
    p = p * z + 2.0f / 3;
    float h = 0.5f * f * f, fe = (float)e;                              /* ln m = f - h + s (h + z p): exact where f is small */
    return fe * 0.693359375f + (f - (h - (s * (h + z * p) - fe * 2.12194440e-4f)));
}

float orl_powf(float x, float y)
{
    if (!(x > 0) || !(y == y)) return 0;
    if (x > FLT_MAX) x = FLT_MAX;
    int e = 0;
    double m = x;                                                       /* scaled first, so that subnormals are exact too */
    if (x < FLT_MIN) { x *= 16777216.0f; m = x; e = -24; }
    uint32_t u = to_bits(x);
    int q = (int32_t)(u - 0x3f3504f3u) >> 23;
    m = from_bits(u - ((uint32_t)q << 23));
    e += q;
    double s = (m - 1) / (m + 1), z = s * s, p = 0;
    for (int k = 15; k >= 1; k -= 2) p = p * z + 2.0 / k;
    double t = (double)y * (e * 0.693147180559945309 + p * s);
    t = t < -87 ? -87 : t > 88 ? 88 : t;
    double n = (t * 1.44269504088896341 + 6755399441055744.0) - 6755399441055744.0, r = t - n * 0.693147180559945309;
    double v = 1;
    for (int k = 9; k >= 1; k--) v = v * r / k + 1;
    return (float)(v * from_bits((uint32_t)((int)n + 127) << 23));
}

/* Quadrant and remainder in [-pi/4, pi/4]; pi/2 in two parts, the first with 33 bits, so that n times it is exact for n < 2^20. */
static double reduce(float x, unsigned *quadrant)
{
    double d = x;
    if (!(d >= -1e4 && d <= 1e4)) d = d >= -FLT_MAX && d <= FLT_MAX ? fmod(d, 6.28318530717958648) : 0;
    double n = (d * 0.636619772367581343 + 6755399441055744.0) - 6755399441055744.0;
    *quadrant = (unsigned)(int)n & 3;
    return (d - n * 1.57079632673412561417) - n * 6.07710050650619224932e-11;
}

static float sine(double r, unsigned quadrant)
{
    double z = r * r, v;
    if (quadrant & 1) v = 1 + z * (-1.0 / 2 + z * (1.0 / 24 + z * (-1.0 / 720 + z * (1.0 / 40320 - z * (1.0 / 3628800)))));
    else v = r * (1 + z * (-1.0 / 6 + z * (1.0 / 120 + z * (-1.0 / 5040 + z * (1.0 / 362880 - z * (1.0 / 39916800))))));
    return (float)(quadrant & 2 ? -v : v);
}

float orl_sinf(float x)
{
    unsigned q;
    double r = reduce(x, &q);
    return sine(r, q);
}

float orl_cosf(float x)
{
    if (!(x == x)) return 0;
    unsigned q;
    double r = reduce(x, &q);
    return sine(r, (q + 1) & 3);
}

/* atan of y / x for 0 <= y <= x, x > 0. Above tan(pi/8) through pi/4 + atan((t - 1) / (t + 1)). */
static double atan_ratio(double y, double x)
{
    int high = y > 0.414213562373095049 * x;
    double t = high ? (y - x) / (y + x) : y / x, z = t * t, p = 0;
    for (int k = 23; k >= 1; k -= 2) p = 1.0 / k - p * z;
    return (high ? 0.785398163397448310 : 0) + t * p;
}

static double arctan2(double y, double x)
{
    double ax = x < 0 ? -x : x, ay = y < 0 ? -y : y, a = 0;
    if (ax > 0 || ay > 0) a = ay <= ax ? atan_ratio(ay, ax) : 1.57079632679489662 - atan_ratio(ax, ay);
    if (x < 0) a = 3.14159265358979324 - a;
    return y < 0 ? -a : a;
}

static double bounded(float x) { return x > FLT_MAX ? FLT_MAX : x < -FLT_MAX ? -FLT_MAX : x; }

float orl_atan2f(float y, float x)
{
    if (!(x == x) || !(y == y)) return 0;
    return (float)arctan2(bounded(y), bounded(x));
}

float orl_asinf(float x)
{
    if (!(x == x)) return 0;
    double d = x > 1 ? 1 : x < -1 ? -1 : x;
    return (float)arctan2(d, sqrt((1 - d) * (1 + d)));
}
