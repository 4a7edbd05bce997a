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

// exp(x) for x ≤ 0, as 2ⁿ · 2ʳ with |r| ≤ ½ (Taylor's series), to 2 units in the last place where it is near 1; 0 below
// -87, where float32 has no normal numbers left. Branch-free, so that the loop around it becomes vector code.
static inline float exp_negative(float x) {
    float t = MAX(x * 1.44269504f, -126.0f), n = rintf(t), r = t - n, p = 1.5403530e-4f;
    p = fmaf(p, r, 1.3333558e-3f);
    p = fmaf(p, r, 9.6181291e-3f);
    p = fmaf(p, r, 5.5504109e-2f);
    p = fmaf(p, r, 2.4022651e-1f);
    p = fmaf(p, r, 6.9314718e-1f);
    p = fmaf(p, r, 1.0f);
    int32_t bits;
    memcpy(&bits, &p, sizeof bits);
    bits += (int32_t)n * (1 << 23);
    memcpy(&p, &bits, sizeof p);
    return x < -87.0f ? 0.0f : p;
}
