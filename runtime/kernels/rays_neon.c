/* Rays for NEON, four at a time (rays_lanes.h). */
#include <arm_neon.h>

#define INLINE static inline __attribute__((always_inline))
typedef float32x4_t F;
typedef int32x4_t I;
typedef uint32x4_t M;
#include "runtime/kernels/rays.h"

INLINE F splat(float v) { return vdupq_n_f32(v); }
INLINE I splat_i(int32_t v) { return vdupq_n_s32(v); }
INLINE F load(const float *p) { return vld1q_f32(p); }
INLINE I load_i(const int32_t *p) { return vld1q_s32(p); }
INLINE void store(float *p, F v) { vst1q_f32(p, v); }
INLINE void store_i(int32_t *p, I v) { vst1q_s32(p, v); }
INLINE M less(F a, F b) { return vcltq_f32(a, b); }
INLINE M truths(I a) { return vreinterpretq_u32_s32(a); }
INLINE I signs(M m) { return vreinterpretq_s32_u32(m); }
INLINE M negative(I a) { return vcltzq_s32(a); }
INLINE M both(M a, M b) { return vandq_u32(a, b); }
INLINE M but(M a, M b) { return vbicq_u32(a, b); }
INLINE M either(M a, M b) { return vorrq_u32(a, b); }
INLINE int any(M m) { return vmaxvq_u32(m) != 0; }
INLINE F pick(M m, F a, F b) { return vbslq_f32(m, a, b); }
INLINE I pick_i(M m, I a, I b) { return vbslq_s32(m, a, b); }
INLINE F real(I a) { return vcvtq_f32_s32(a); }
INLINE I whole(F a) { return vcvtq_s32_f32(a); }
INLINE I look(const int32_t *t, I at) { return (I){ t[at[0]], t[at[1]], t[at[2]], t[at[3]] }; }
INLINE int32_t two_bytes(const int8_t *p) { int16_t v; __builtin_memcpy(&v, p, 2); return v; }
INLINE I look_bytes(const int8_t *t, I at) { return (I){ two_bytes(t + at[0]), two_bytes(t + at[1]), two_bytes(t + at[2]), two_bytes(t + at[3]) }; }
#include "runtime/kernels/rays_lanes.h"

void orl_rays_march_neon(const orl_scene *s, int n, int refine, orl_rays *r)
{
    for (int k = 0; k < n; k += 4) march(s, refine, r, k);
}
