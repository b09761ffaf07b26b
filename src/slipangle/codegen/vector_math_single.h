/* Elementary functions on the vectors of vectors.h in single precision: those of the C library, lane by lane. */

ONE_BY_ONE
LANE_BY_LANE(v_sin, sin)
LANE_BY_LANE(v_cos, cos)
LANE_BY_LANE(v_tan, tan)
LANE_BY_LANE(v_asin, asin)
LANE_BY_LANE(v_acos, acos)
LANE_BY_LANE(v_atan, atan)
LANE_BY_LANE(v_sinh, sinh)
LANE_BY_LANE(v_cosh, cosh)
LANE_BY_LANE(v_tanh, tanh)
LANE_BY_LANE(v_exp, exp)
LANE_BY_LANE(v_expm1, expm1)
LANE_BY_LANE(v_log, log)
LANE_BY_LANE_2(v_atan2, atan2)
INLINE V v_hypot(V a, V b) { return v_sqrt(a * a + b * b); }
#undef ONE_BY_ONE
#undef LANE_BY_LANE
#undef LANE_BY_LANE_2
