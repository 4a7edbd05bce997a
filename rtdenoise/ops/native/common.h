// Arithmetic that all kernels share. Planes have < 2³¹ pixels.
#include <math.h>
#include <stdint.h>
#include <string.h>

#define MIN(a, b) ((a) < (b) ? (a) : (b))
#define MAX(a, b) ((a) > (b) ? (a) : (b))

static inline float from_bits(uint32_t bits) {
    float x;
    memcpy(&x, &bits, sizeof x);
    return x;
}

static inline uint32_t bits_of(float x) {
    uint32_t bits;
    memcpy(&bits, &x, sizeof bits);
    return bits;
}

// exp(x) for x ≤ 0, as 2ⁿ · 2ʳ with |r| ≤ ½ (minimax polynomial of degree 5); within 2 ulp near 1. It is 0 below -87.3,
// where float32 has no normal numbers left, and for NaN. Branch-free, so that the loop around it is vectorised. A sum with
// ROUND is rounded to a whole number n, which its lowest bits hold.
#define ROUND 12582912.0f  // 1.5 · 2²³
static inline float exp_negative(float x) {
    float t = x * 1.44269504f, whole = t + ROUND, r = t - (whole - ROUND), p = 1.3269555e-3f;
    p = fmaf(p, r, 9.6712932e-3f);
    p = fmaf(p, r, 5.5507109e-2f);
    p = fmaf(p, r, 2.4022247e-1f);
    p = fmaf(p, r, 6.9314700e-1f);
    p = fmaf(p, r, 1.0f);
    return t >= -126 ? from_bits(bits_of(p) + (bits_of(whole) << 23)) : 0;
}

// As torch.lerp: exactly `from` or `to` where the weight is 0 or 1, however far apart they are.
static inline float lerp(float from, float to, float weight) {
    float d = to - from;
    return weight < 0.5f ? fmaf(weight, d, from) : fmaf(weight - 1, d, to);
}
