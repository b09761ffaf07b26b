/* LANES numbers side by side: V, and masks of them, I. `expression.preamble` puts this text into a source once for each
   width, with V, I, LANES and the prefix v_ renamed: v4, v4_fabs and so on; `export.precision` the same with float for
   double. A vector of one is a plain number, whose mask is any number but 0: GCC would take it through memory. */

#include <math.h>
#include <stdint.h>
#include <string.h>

#undef INLINE
#define INLINE static inline __attribute__((always_inline, unused))

#if LANES == 1
typedef double V;
typedef int64_t I;
#define v_lane(v, i) (v)
#define v_unless(mask) ((mask) == 0)
INLINE V v_all(double a) { return a; }
INLINE V v_pick(I mask, V a, V b) { return mask ? a : b; }
INLINE V v_fabs(V a) { return fabs(a); }
INLINE V v_copysign(V a, V b) { return copysign(a, b); }
INLINE V v_true(I mask) { return mask ? 1.0 : 0.0; }
INLINE V v_where(I mask, V a) { return mask ? a : 0.0; }
INLINE V v_if(V condition, V a) { return condition != 0.0 ? a : 0.0; }
INLINE int v_any(I mask) { return mask != 0; }
#else
typedef double V __attribute__((vector_size(sizeof(double) * LANES), aligned(sizeof(double) * LANES)));
typedef int64_t I __attribute__((vector_size(sizeof(double) * LANES), aligned(sizeof(double) * LANES)));
#define v_lane(v, i) (v)[i]
#define v_unless(mask) (~(mask))
INLINE V v_all(double a)
{
    V z = {0};
    return z + a;
}
INLINE V v_pick(I mask, V a, V b) { return (V)((mask & (I)a) | (~mask & (I)b)); }
INLINE V v_fabs(V a) { return (V)((I)a & INT64_MAX); }
INLINE V v_copysign(V a, V b) { return (V)(((I)a & INT64_MAX) | ((I)b & INT64_MIN)); }
INLINE V v_true(I mask) { return (V)(mask & (I)v_all(1.0)); }
INLINE V v_where(I mask, V a) { return (V)(mask & (I)a); }
INLINE V v_if(V condition, V a) { return (V)((condition != 0.0) & (I)a); }
INLINE int v_any(I mask)
{
    int64_t any = 0;
    for (int i = 0; i < LANES; i++)
        any |= mask[i];
    return any != 0;
}
#endif
INLINE V v_and(V a, V b) { return v_true((a != 0.0) & (b != 0.0)); }
INLINE V v_or(V a, V b) { return v_true((a != 0.0) | (b != 0.0)); }
INLINE V v_not(V a) { return v_true(a == 0.0); }
INLINE V v_sign(V a) { return v_true(a > 0.0) - v_true(a < 0.0); }

#define LANE_BY_LANE(name, function)                         \
    static __attribute__((noinline, unused)) V name(V a)     \
    {                                                        \
        for (int i = 0; i < LANES; i++)                      \
            v_lane(a, i) = function(v_lane(a, i));           \
        return a;                                            \
    }
#define LANE_BY_LANE_2(name, function)                           \
    static __attribute__((noinline, unused)) V name(V a, V b)    \
    {                                                            \
        for (int i = 0; i < LANES; i++)                          \
            v_lane(a, i) = function(v_lane(a, i), v_lane(b, i)); \
        return a;                                                \
    }
LANE_BY_LANE(v_asinh, asinh)
LANE_BY_LANE(v_acosh, acosh)
LANE_BY_LANE(v_atanh, atanh)
LANE_BY_LANE(v_log1p, log1p)
LANE_BY_LANE(v_erf, erf)
LANE_BY_LANE(v_floor, floor)
LANE_BY_LANE(v_ceil, ceil)
LANE_BY_LANE_2(v_pow, pow)
LANE_BY_LANE_2(v_fmod, fmod)
LANE_BY_LANE_2(v_remainder, remainder)


#define ONE_BY_ONE                                         \
    INLINE V v_sqrt(V a)                                   \
    {                                                      \
        for (int i = 0; i < LANES; i++)                    \
            v_lane(a, i) = sqrt(v_lane(a, i));             \
        return a;                                          \
    }                                                      \
    INLINE V v_fmin(V a, V b) { return v_pick(a < b, a, b); } \
    INLINE V v_fmax(V a, V b) { return v_pick(a > b, a, b); }
