/* Rays for AVX-512, sixteen at a time (rays_lanes.h). */
#include <immintrin.h>

#define INLINE static inline __attribute__((always_inline))
typedef __m512 F;
typedef int32_t I __attribute__((vector_size(64)));
typedef __mmask16 M;
#include "runtime/kernels/rays.h"

INLINE F splat(float v) { return _mm512_set1_ps(v); }
INLINE I splat_i(int32_t v) { return (I)_mm512_set1_epi32(v); }
INLINE F load(const float *p) { return _mm512_loadu_ps(p); }
INLINE I load_i(const int32_t *p) { return (I)_mm512_loadu_si512(p); }
INLINE void store(float *p, F v) { _mm512_storeu_ps(p, v); }
INLINE void store_i(int32_t *p, I v) { _mm512_storeu_si512(p, (__m512i)v); }
INLINE M less(F a, F b) { return _mm512_cmp_ps_mask(a, b, _CMP_LT_OQ); }
INLINE M truths(I a) { return _mm512_movepi32_mask((__m512i)a); }
INLINE I signs(M m) { return (I)_mm512_movm_epi32(m); }
INLINE M negative(I a) { return _mm512_movepi32_mask((__m512i)a); }
INLINE M both(M a, M b) { return _kand_mask16(a, b); }
INLINE M but(M a, M b) { return _kandn_mask16(b, a); }
INLINE M either(M a, M b) { return _kor_mask16(a, b); }
INLINE int any(M m) { return m != 0; }
INLINE F pick(M m, F a, F b) { return _mm512_mask_blend_ps(m, b, a); }
INLINE I pick_i(M m, I a, I b) { return (I)_mm512_mask_blend_epi32(m, (__m512i)b, (__m512i)a); }
INLINE F real(I a) { return _mm512_cvtepi32_ps((__m512i)a); }
INLINE I whole(F a) { return (I)_mm512_cvttps_epi32(a); }
INLINE I look(const int32_t *t, I at) { return (I)_mm512_i32gather_epi32((__m512i)at, t, 4); }
INLINE I look_bytes(const int8_t *t, I at) { return (I)_mm512_i32gather_epi32((__m512i)at, t, 1); }
#include "runtime/kernels/rays_lanes.h"

void orl_rays_march_avx512(const orl_scene *s, int n, int refine, orl_rays *r)
{
    for (int k = 0; k < n; k += 16) march(s, refine, r, k);
}
