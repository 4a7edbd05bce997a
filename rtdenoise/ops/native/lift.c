// The curve of networks that write pixels. The specification is ops/lift.py; PU_A ... are those of constants.py. Powers are taken
// of what a value is beyond the least one, so that logarithm and exponential are of numbers ≥ 0.
#include "common.h"
#include "log1p.h"
#include "expm1.h"

#define BLOCK 256

static inline float power(float ratio, float exponent) {  // of ratios ≥ 1
    return 1 + expm1_positive(exponent * log1p_positive(MAX(ratio - 1, 0)));
}

static inline float lifted(float light, float least, float slope) {
    float dark = MIN(light, (float)PU_Y1);
    float value = dark <= (float)PU_Y0 ? (float)PU_A * dark
                                       : least * power(dark / (float)PU_Y0, (float)PU_C) + (float)PU_D;
    float low = expm1_positive(value / (float)PU_E);
    return light <= (float)PU_Y1 ? low : fmaf(slope, light, slope * (float)PU_F - 1);
}

static inline float lowered(float x, float least, float slope) {
    float value = (float)PU_E * log1p_positive(x), dark = MIN(value, (float)PU_X1);
    float low = dark <= (float)PU_X0 ? dark / (float)PU_A
                                     : (float)PU_Y0 * power((dark - (float)PU_D) / least, 1 / (float)PU_C);
    return value <= (float)PU_X1 ? low : x / slope + (1 / slope - (float)PU_F);
}

#define EACH(name, of)                                                                      \
    void name(const float *in, float *out, int64_t count, int threads) {                    \
        float least = (float)(PU_B * pow(PU_Y0, PU_C)), slope = (float)exp(PU_G / PU_E);     \
        _Pragma("omp parallel for num_threads(threads) schedule(static)")                   \
        for (int64_t from = 0; from < count; from += BLOCK) {                               \
            int n = (int)MIN(BLOCK, count - from);                                          \
            _Pragma("omp simd")                                                             \
            for (int i = 0; i < n; i++) out[from + i] = of(in[from + i], least, slope);     \
        }                                                                                   \
    }

EACH(lift, lifted)
EACH(lower, lowered)
