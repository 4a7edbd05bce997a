// The curve of networks that write pixels. The specification is ops/lift.py; PU_A ... are those of constants.py, GREY its
// PIXELS_GREY. Powers are taken of what a value is beyond the least one, so that logarithm and exponential are of numbers ≥ 0.
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

typedef struct {
    float r, g, b;
} Colour;

static inline Colour lift_colour(Colour x, float least, float slope) {
    float grey = (float)GREY * ((x.r + x.g + x.b) / 3), keep = 1 - (float)GREY;
    return (Colour){lifted(keep * x.r + grey, least, slope), lifted(keep * x.g + grey, least, slope),
                    lifted(keep * x.b + grey, least, slope)};
}

static inline Colour lower_colour(Colour x, float least, float slope) {
    float r = lowered(x.r, least, slope), g = lowered(x.g, least, slope), b = lowered(x.b, least, slope);
    float grey = (float)GREY * ((r + g + b) / 3), scale = 1 / (1 - (float)GREY);
    return (Colour){MAX(r - grey, 0) * scale, MAX(g - grey, 0) * scale, MAX(b - grey, 0) * scale};
}

// in and out [B, 3, plane].
#define EACH(name, of)                                                                                        \
    void name(const float *in, float *out, int B, int64_t plane, int threads) {                               \
        float least = (float)(PU_B * pow(PU_Y0, PU_C)), slope = (float)exp(PU_G / PU_E);                       \
        int64_t blocks = (plane + BLOCK - 1) / BLOCK;                                                         \
        _Pragma("omp parallel for num_threads(threads) schedule(static)")                                     \
        for (int64_t block = 0; block < B * blocks; block++) {                                                \
            int64_t from = block % blocks * BLOCK, at = block / blocks * 3 * plane + from;                    \
            int n = (int)MIN(BLOCK, plane - from);                                                            \
            const float *r = in + at, *g = r + plane, *b = g + plane;                                         \
            float *out_r = out + at, *out_g = out_r + plane, *out_b = out_g + plane;                          \
            _Pragma("omp simd")                                                                               \
            for (int i = 0; i < n; i++) {                                                                     \
                Colour x = of((Colour){r[i], g[i], b[i]}, least, slope);                                      \
                out_r[i] = x.r, out_g[i] = x.g, out_b[i] = x.b;                                               \
            }                                                                                                 \
        }                                                                                                     \
    }

EACH(lift, lift_colour)
EACH(lower, lower_colour)
