// What the kernels share. Compiled on the user's machine by ops/native.py, with whatever vector unit it has.
#include <math.h>
#include <stdint.h>
#include <string.h>

#define MIN(a, b) ((a) < (b) ? (a) : (b))
#define MAX(a, b) ((a) > (b) ? (a) : (b))

// Where a motion leads from pixel x of a row of n: clamped to the row, a motion that is not finite counting as none.
static inline float clamped(float motion, int x, int n) {
    float u = (fabsf(motion) <= 3.4028235e38f ? motion : 0) + x;
    return MIN(MAX(u, 0), n - 1);
}

// exp(x) for x ≤ 0, to 1 unit in the last place; 0 below -87, where float32 has no normal numbers left. Branch-free, so
// that the loop around it becomes vector code: 2ⁿ · exp(r) with |r| ≤ ln 2 / 2 (coefficients of Cephes' expf).
static inline float exp_negative(float x) {
    float n = rintf(x * 1.44269504f);
    float r = fmaf(n, 2.12194440e-4f, fmaf(n, -0.693359375f, x));
    float p = 1.9875691500e-4f;
    p = fmaf(p, r, 1.3981999507e-3f);
    p = fmaf(p, r, 8.3334519073e-3f);
    p = fmaf(p, r, 4.1665795894e-2f);
    p = fmaf(p, r, 1.6666665459e-1f);
    p = fmaf(p, r, 5.0000001201e-1f);
    p = fmaf(p, r * r, r) + 1.0f;
    int32_t bits = (int32_t)((uint32_t)(MAX((int32_t)n, -126) + 127) << 23);
    float power;
    memcpy(&power, &bits, sizeof power);
    return x < -87.0f ? 0.0f : p * power;
}
