// Features in bytes, channels last. The specification is ops/to_bytes.py. A pixel has C channels; HALF is 1 for bfloat16 features,
// 0 for float32.
#include "common.h"

#if HALF
typedef uint16_t number;
static inline float loaded(number x) { return from_bits((uint32_t)x << 16); }
static inline float stored(float x) {  // rounded to bfloat16, ties to even
    uint32_t bits = bits_of(x);
    return from_bits((bits + 0x7fff + (bits >> 16 & 1)) & 0xffff0000);
}
#else
typedef float number;
static inline float loaded(number x) { return x; }
static inline float stored(float x) { return x; }
#endif

// x and out [pixels, C]; scale [C]
void to_bytes(const number *x, const float *scale, uint8_t *out, float half, int64_t pixels, int threads) {
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int64_t i = 0; i < pixels; i++)
#pragma omp simd
        for (int c = 0; c < C; c++) out[i * C + c] = (uint8_t)(int)MIN(stored(half + loaded(x[i * C + c]) * scale[c]), 255.0f);
}
