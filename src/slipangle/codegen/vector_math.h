/* Elementary functions on the vectors of vectors.h, of doubles, for generated model code.

   Errors are a few units in the last place. NaN stays NaN; what would overflow ends near 1e308; sine, cosine and tangent
   of angles from 2^36 (7e10) are NaN. Functions that vehicle models use rarely go through the C library lane by lane. */

#ifdef __ASSOCIATIVE_MATH__
#error "This code rounds by adding a large number: leave out -fassociative-math and -funsafe-math-optimizations."
#endif
#if defined __clang__ && __clang_major__ >= 11 /* which does not say so */
#pragma clang fp reassociate(off)
#endif

#define NATIVE(width)                                                                                       \
    INLINE V v_sqrt(V a) { return (V)_mm##width##_sqrt_pd((__m##width##d)a); }                            \
    INLINE V v_fmin(V a, V b) { return (V)_mm##width##_min_pd((__m##width##d)a, (__m##width##d)b); }      \
    INLINE V v_fmax(V a, V b) { return (V)_mm##width##_max_pd((__m##width##d)a, (__m##width##d)b); }
#if defined(__AVX512F__) && LANES == 8
#include <immintrin.h>
NATIVE(512)
#elif defined(__AVX__) && LANES == 4
#include <immintrin.h>
NATIVE(256)
#else
ONE_BY_ONE
#endif
INLINE V v_nearest(V a) { return (a + 0x1.8p52) - 0x1.8p52; }

/* What the polynomials need of the bits: of whole numbers n and t = n + 1.5 * 2^52, whose low bits are those of n. */
#if LANES == 1
INLINE uint64_t v_bits(V a)
{
    uint64_t bits;
    memcpy(&bits, &a, sizeof bits);
    return bits;
}
INLINE V v_of_bits(uint64_t bits)
{
    V a;
    memcpy(&a, &bits, sizeof a);
    return a;
}
INLINE I v_odd(V n) { return (I)(v_bits(n + 0x1.8p52) & 1); }
INLINE V v_flip(V a, V n) { return v_bits(n + 0x1.8p52) & 2 ? -a : a; } /* -a where n is 2 or 3 modulo 4 */
INLINE I v_below(V a) { return (I)(v_bits(a) >> 63); }                   /* -0 too */
INLINE V v_power(V t) { return v_of_bits((v_bits(t) << 52) + v_bits(1.0)); } /* 2^n */
INLINE V v_split(V a, V *m) /* a = 2^n m with m between sqrt(1/2) and sqrt(2); t */
{
    uint64_t k = (uint64_t)((I)(v_bits(a) - v_bits(0.7071067811865476)) >> 52);
    *m = v_of_bits(v_bits(a) - (k << 52));
    return v_of_bits(k + v_bits(0x1.8p52));
}
#else
INLINE I v_odd(V n) { return -((I)(n + 0x1.8p52) & 1); }
INLINE V v_flip(V a, V n) { return (V)((I)a ^ (((I)(n + 0x1.8p52) & 2) << 62)); }
INLINE I v_below(V a) { return (I)a < 0; }
INLINE V v_power(V t) { return (V)(((I)t << 52) + (I)v_all(1.0)); }
INLINE V v_split(V a, V *m)
{
    I k = ((I)a - (I)v_all(0.7071067811865476)) >> 52;
    *m = (V)((I)a - (k << 52));
    return (V)(k + (I)v_all(0x1.8p52));
}
#endif

/* Polynomials are summed in pairs, as a chain of terms would wait for each of them. */

/* Sine and cosine: x = k pi/2 + r with pi/2 in three parts, Taylor series on |r| <= pi/4; a branch
   for larger x would hold up everything around it. */
INLINE V v_quarter(V x, V *k)
{
    V n = v_nearest(x * 0x1.45f306dc9c883p-1);
    *k = n;
#if defined __FMA__ || defined __ARM_FEATURE_FMA
    V r = x - n * 0x1.921fb54400000p+0;
#else /* products with the upper and the lower bits of n are exact */
    V upper = v_nearest(n * 0x1p-20) * 0x1p20;
    V r = (x - upper * 0x1.921fb54400000p+0) - (n - upper) * 0x1.921fb54400000p+0;
#endif
    r = r - n * 0x1.0b4611a600000p-34;
    r = r - n * 0x1.3198a2e037073p-69;
    return v_pick(v_fabs(x) < 0x1p36, r, v_all(NAN));
}
INLINE V v_sin_series(V r)
{
    V z = r * r, y = z * z;
    V low = (z * (1.0 / 120.0) - 1.0 / 6.0) + y * (z * (1.0 / 362880.0) - 1.0 / 5040.0);
    V high = (z * (1.0 / 6227020800.0) - 1.0 / 39916800.0) + y * (-1.0 / 1307674368000.0);
    return r + r * z * (low + y * y * high);
}
INLINE V v_cos_series(V r)
{
    V z = r * r, y = z * z;
    V low = (z * (-1.0 / 720.0) + 1.0 / 24.0) + y * (z * (-1.0 / 3628800.0) + 1.0 / 40320.0);
    V high = (z * (-1.0 / 87178291200.0) + 1.0 / 479001600.0) + y * (1.0 / 20922789888000.0);
    return (1.0 - 0.5 * z) + y * (low + y * y * high);
}
INLINE V v_turn(V r, V n)
{
    /* sine of r + n pi/2, n whole */
    return v_flip(v_pick(v_odd(n), v_cos_series(r), v_sin_series(r)), n);
}
INLINE V v_sin(V x)
{
    V n, r = v_quarter(x, &n);
    return v_turn(r, n);
}
INLINE V v_cos(V x)
{
    V n, r = v_quarter(x, &n);
    return v_turn(r, n + 1.0);
}
INLINE V v_tan(V x)
{
    V n, r = v_quarter(x, &n), s = v_sin_series(r), c = v_cos_series(r);
    I odd = v_odd(n);
    return v_pick(odd, -c, s) / v_pick(odd, s, c);
}

/* Arc tangent of y / x for x > 0 through the octant nearest to 0, pi/4 or pi/2; one division. */
INLINE V v_octant(V y, V x)
{
    V a = v_fabs(y);
    I steep = a > 2.414213562373095 * x, middle = a > 0.4142135623730951 * x;
    V top = v_pick(steep, -x, v_pick(middle, a - x, a));
    V bottom = v_pick(steep, a, v_pick(middle, a + x, x));
    V base = v_pick(steep, v_all(1.5707963267948966), v_pick(middle, v_all(0.7853981633974483), v_all(0.0)));
    V t = top / bottom, z = t * t;
    V z2 = z * z, z4 = z2 * z2;
    V low = (z * 0.19999999999997015 - 0.33333333333333326) + z2 * (z * 0.11111111085322109 - 0.1428571428532971);
    V next = (z * 0.07692281099937581 - 0.09090908059031183) + z2 * (z * 0.058768340045912165 - 0.06666205259974159);
    V high = (z * 0.044995007283918385 - 0.052173125739150616) + z2 * (z * 0.01511376508271356 - 0.03338782448748951);
    V p = low + z4 * (next + z4 * high);
    return v_copysign(base + (t + t * z * p), y);
}
INLINE V v_atan(V x) { return v_octant(x, v_all(1.0)); }
INLINE V v_atan2(V y, V x)
{
    V a = v_octant(y, v_fabs(x));
    a = v_pick((v_fabs(x) == 0.0) & (y == 0.0), v_copysign(v_all(0.0), y), a);
    return v_pick(v_below(x), v_copysign(v_all(3.141592653589793), y) - a, a);
}

INLINE V v_asin(V x) { return v_octant(x, v_sqrt((1.0 - x) * (1.0 + x))); }
INLINE V v_acos(V x) { return v_atan2(v_sqrt((1.0 - x) * (1.0 + x)), x); }

/* Exponential: x = k ln 2 + r, e^x = s + s p with s = 2^k and p = e^r - 1, interpolated at Chebyshev's points on
   |r| <= ln(2)/2 and evaluated in pairs. */
INLINE V v_exp_parts(V x, V *s)
{
    V t = x * 1.4426950408889634 + 0x1.8p52, n = t - 0x1.8p52;
    V r = x - n * 0x1.62e42fefa0000p-1;
    r = r - n * 0x1.cf79abc9e3b3ap-40;
    V z = r * r, y = z * z;
    V low = (0.5000000000000001 + r * 0.16666666666666669) + z * (0.04166666666662399 + r * 0.008333333333330051);
    V high = (0.0013888888917281794 + r * 0.00019841269863105968) +
             z * (2.480152119021773e-05 + r * 2.7557268378684192e-06) +
             y * (2.7620138719733994e-07 + r * 2.5100424157005067e-08);
    *s = v_power(t);
    return r + z * (low + y * high);
}
/* NaN stays NaN: the smaller and the larger of two are the second where they do not compare. */
INLINE V v_within(V x, double low, double high) { return v_fmin(v_all(high), v_fmax(v_all(low), x)); }
INLINE V v_exp(V x)
{
    V s, p = v_exp_parts(v_within(x, -708.0, 709.0), &s);
    return s + s * p;
}
INLINE V v_expm1(V x)
{
    V s, p = v_exp_parts(v_within(x, -708.0, 709.0), &s);
    return s * p + (s - 1.0);
}
INLINE V v_tanh(V x)
{
    V a = v_fabs(x), s, p = v_exp_parts(v_fmin(v_all(40.0), a + a), &s);
    V e = s * p + (s - 1.0);
    return v_copysign(e / (e + 2.0), x);
}
INLINE V v_sinh(V x)
{
    V e = v_expm1(v_fabs(x));
    return v_copysign(0.5 * (e + e / (e + 1.0)), x);
}
INLINE V v_cosh(V x)
{
    V e = v_exp(v_fabs(x));
    return 0.5 * e + 0.5 / e;
}

/* Logarithm: x = 2^k m with m between sqrt(1/2) and sqrt(2), log m = 2 atanh(s) as its series, s = (m - 1)/(m + 1). */
INLINE V v_log(V x)
{
    I tiny = x < 0x1p-1022;
    V up = v_pick(tiny, x * 0x1p54, x);
    V m, n = v_split(up, &m) - v_pick(tiny, v_all(0x1.8p52 + 54.0), v_all(0x1.8p52));
    V f = m - 1.0, s = f / (m + 1.0), z = s * s, y = z * z;
    V low = (0.3333333333333333 + z * 0.2) + y * (0.14285714285714285 + z * 0.1111111111111111);
    V high = (0.09090909090909091 + z * 0.07692307692307693) + y * (0.06666666666666667 + z * 0.058823529411764705) +
             y * y * (0.05263157894736842 + z * 0.047619047619047616);
    /* 2 s = f - s f, so that what is rounded is small beside f */
    V tail = s * (2.0 * z * (low + y * y * high) - f) + n * 0x1.ef35793c76730p-45;
    V value = n * 0x1.62e42fefa3800p-1 + (f + tail);
    V end = v_pick(x == 0.0, v_all(-INFINITY), v_pick(x < 0.0, v_all(NAN), x));
    return v_pick((x > 0.0) & (x < INFINITY), value, end);
}
INLINE V v_hypot(V a, V b) { return v_sqrt(a * a + b * b); }
#undef NATIVE
#undef ONE_BY_ONE
#undef LANE_BY_LANE
#undef LANE_BY_LANE_2
