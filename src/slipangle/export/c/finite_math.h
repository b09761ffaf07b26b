#if defined __FAST_MATH__ || defined _M_FP_FAST || (defined __FINITE_MATH_ONLY__ && __FINITE_MATH_ONLY__ > 0)
#error "This code tells what is missing by NaN: leave out -ffast-math, -Ofast, -ffinite-math-only and /fp:fast."
#endif
