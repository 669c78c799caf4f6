/* Rays for AVX2, eight at a time (rays_lanes.h). */
#include <immintrin.h>

#define INLINE static inline __attribute__((always_inline))
typedef __m256 F;
typedef int32_t I __attribute__((vector_size(32)));
typedef __m256 M;
#include "runtime/kernels/rays.h"

INLINE F splat(float v) { return _mm256_set1_ps(v); }
INLINE I splat_i(int32_t v) { return (I)_mm256_set1_epi32(v); }
INLINE F load(const float *p) { return _mm256_loadu_ps(p); }
INLINE I load_i(const int32_t *p) { return (I)_mm256_loadu_si256((const __m256i *)p); }
INLINE void store(float *p, F v) { _mm256_storeu_ps(p, v); }
INLINE void store_i(int32_t *p, I v) { _mm256_storeu_si256((__m256i *)p, (__m256i)v); }
INLINE M less(F a, F b) { return _mm256_cmp_ps(a, b, _CMP_LT_OQ); }
INLINE M truths(I a) { return _mm256_castsi256_ps((__m256i)a); }
INLINE I signs(M m) { return (I)_mm256_castps_si256(m); }
INLINE M negative(I a) { return _mm256_castsi256_ps(_mm256_srai_epi32((__m256i)a, 31)); }
INLINE M both(M a, M b) { return _mm256_and_ps(a, b); }
INLINE M but(M a, M b) { return _mm256_andnot_ps(b, a); }
INLINE M either(M a, M b) { return _mm256_or_ps(a, b); }
INLINE int any(M m) { return _mm256_movemask_ps(m) != 0; }
INLINE F pick(M m, F a, F b) { return _mm256_blendv_ps(b, a, m); }
INLINE I pick_i(M m, I a, I b) { return (I)_mm256_castps_si256(_mm256_blendv_ps(_mm256_castsi256_ps((__m256i)b), _mm256_castsi256_ps((__m256i)a), m)); }
INLINE F real(I a) { return _mm256_cvtepi32_ps((__m256i)a); }
INLINE I whole(F a) { return (I)_mm256_cvttps_epi32(a); }
INLINE I look(const int32_t *t, I at) { return (I)_mm256_i32gather_epi32((const int *)t, (__m256i)at, 4); }
INLINE I look_bytes(const int8_t *t, I at) { return (I)_mm256_i32gather_epi32((const int *)(const void *)t, (__m256i)at, 1); }
#include "runtime/kernels/rays_lanes.h"

void orl_rays_march_avx2(const orl_scene *s, int n, int refine, orl_rays *r)
{
    for (int k = 0; k < n; k += 8) march(s, refine, r, k);
}
