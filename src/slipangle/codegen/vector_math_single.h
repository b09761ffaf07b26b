/* The functions of vector_math.h on LANES numbers of single precision, with the same names, for what is exported so.
   Arithmetic is that of vectors; elementary functions go through the C library lane by lane. */

#include <math.h>
#include <stdint.h>
#include <string.h>

typedef float V __attribute__((vector_size(4 * LANES), aligned(4 * LANES)));
typedef int32_t I __attribute__((vector_size(4 * LANES), aligned(4 * LANES)));

#undef INLINE
#define INLINE static inline __attribute__((always_inline, unused))

INLINE V v_all(float a)
{
    V z = {0};
    return z + a;
}
#if LANES == 1 /* masks would go through the registers of whole numbers */
INLINE V v_pick(I mask, V a, V b)
{
    V z = {mask[0] ? a[0] : b[0]};
    return z;
}
INLINE V v_fabs(V a)
{
    V z = {__builtin_fabsf(a[0])};
    return z;
}
INLINE V v_copysign(V a, V b)
{
    V z = {__builtin_copysignf(a[0], b[0])};
    return z;
}
#else
INLINE V v_pick(I mask, V a, V b) { return (V)((mask & (I)a) | (~mask & (I)b)); }
INLINE V v_fabs(V a) { return (V)((I)a & INT32_MAX); }
INLINE V v_copysign(V a, V b) { return (V)(((I)a & INT32_MAX) | ((I)b & INT32_MIN)); }
#endif
INLINE V v_true(I mask) { return (V)(mask & (I)v_all(1.0f)); }
INLINE V v_and(V a, V b) { return v_true((a != 0.0f) & (b != 0.0f)); }
INLINE V v_or(V a, V b) { return v_true((a != 0.0f) | (b != 0.0f)); }
INLINE V v_not(V a) { return v_true(a == 0.0f); }
INLINE V v_if(V condition, V a) { return (V)((condition != 0.0f) & (I)a); }
INLINE V v_sign(V a) { return v_true(a > 0.0f) - v_true(a < 0.0f); }
INLINE V v_fmin(V a, V b) { return v_pick(a < b, a, b); }
INLINE V v_fmax(V a, V b) { return v_pick(a > b, a, b); }

#define LANE_BY_LANE(name)                                   \
    static __attribute__((noinline, unused)) V v_##name(V a) \
    {                                                        \
        for (int i = 0; i < LANES; i++)                      \
            a[i] = name##f(a[i]);                            \
        return a;                                            \
    }
#define LANE_BY_LANE_2(name)                                      \
    static __attribute__((noinline, unused)) V v_##name(V a, V b) \
    {                                                             \
        for (int i = 0; i < LANES; i++)                           \
            a[i] = name##f(a[i], b[i]);                           \
        return a;                                                 \
    }
LANE_BY_LANE(sin)
LANE_BY_LANE(cos)
LANE_BY_LANE(tan)
LANE_BY_LANE(asin)
LANE_BY_LANE(acos)
LANE_BY_LANE(atan)
LANE_BY_LANE(sinh)
LANE_BY_LANE(cosh)
LANE_BY_LANE(tanh)
LANE_BY_LANE(exp)
LANE_BY_LANE(expm1)
LANE_BY_LANE(log)
LANE_BY_LANE(log1p)
LANE_BY_LANE(asinh)
LANE_BY_LANE(acosh)
LANE_BY_LANE(atanh)
LANE_BY_LANE(erf)
LANE_BY_LANE(floor)
LANE_BY_LANE(ceil)
LANE_BY_LANE_2(atan2)
LANE_BY_LANE_2(pow)
LANE_BY_LANE_2(fmod)
LANE_BY_LANE_2(remainder)

INLINE V v_sqrt(V a)
{
    for (int i = 0; i < LANES; i++)
        a[i] = __builtin_sqrtf(a[i]);
    return a;
}
INLINE V v_hypot(V a, V b) { return v_sqrt(a * a + b * b); }

INLINE int v_any(I mask)
{
    int32_t any = 0;
    for (int i = 0; i < LANES; i++)
        any |= mask[i];
    return any != 0;
}
#undef LANE_BY_LANE
#undef LANE_BY_LANE_2
