#ifndef CAR_LANES
#if defined __AVX512F__@WHERE@
#define CAR_LANES 8
#elif defined __AVX__
#define CAR_LANES 4
#elif defined __SSE2__ || defined __aarch64__ || defined __wasm_simd128__
#define CAR_LANES 2
#else
#define CAR_LANES 1
#endif
#endif
@BYTES@
#else
#error "CAR_LANES must be 1, 2, 4 or 8"
#endif
