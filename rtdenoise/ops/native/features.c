// Planes of pixels to one vector of features a pixel, in one pass. The specification is ops/features.py; C is the number
// of features, LIGHT how many of them, the first, are compressed, and HALF 1 for bfloat16, 0 for float32.
#include "common.h"

#define BLOCK 64  // pixels

#if HALF
typedef uint16_t feature;
static inline feature stored(float x) {  // rounded to nearest, ties to even; x is finite
    uint32_t bits;
    memcpy(&bits, &x, sizeof bits);
    return (bits + 0x7fff + (bits >> 16 & 1)) >> 16;
}
#else
typedef float feature;
static inline feature stored(float x) { return x; }
#endif

// log(1 + x) for x ≥ 0 to some units in the last place; branch-free. log(u) = e · ln 2 + log(m) with √½ ≤ m < √2
// (coefficients of Cephes' logf), and what the sum u = 1 + x has lost of x is given back.
static inline float log1p_positive(float x) {
    float u = 1 + x, m, p = 7.0376836292e-2f;
    uint32_t bits;
    memcpy(&bits, &u, sizeof bits);
    int32_t e = (int32_t)(bits - 0x3f3504f3) >> 23;
    bits -= (uint32_t)e << 23;
    memcpy(&m, &bits, sizeof m);
    float f = m - 1, square = f * f, n = (float)e;
    p = fmaf(p, f, -1.1514610310e-1f);
    p = fmaf(p, f, 1.1676998740e-1f);
    p = fmaf(p, f, -1.2420140846e-1f);
    p = fmaf(p, f, 1.4249322787e-1f);
    p = fmaf(p, f, -1.6668057665e-1f);
    p = fmaf(p, f, 2.0000714765e-1f);
    p = fmaf(p, f, -2.4999993993e-1f);
    p = fmaf(p, f, 3.3333331174e-1f);
    float rest = fmaf(p * f, square, fmaf(n, -2.12194440e-4f, -0.5f * square)) + (x - (u - 1)) / u;
    return fmaf(n, 0.693359375f, f + rest);
}

// planes: C pointers to `pixels` float32 each; out [pixels, C].
void features(const float *const *planes, float scale, feature *out, int64_t pixels, int threads) {
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int64_t from = 0; from < pixels; from += BLOCK) {
        int n = (int)MIN(BLOCK, pixels - from);
        feature block[C * BLOCK], *to = out + from * C;
        for (int c = 0; c < C; c++) {
            const float *plane = planes[c] + from;
#pragma omp simd
            for (int x = 0; x < n; x++)
                block[c * BLOCK + x] = stored(c < LIGHT ? log1p_positive(plane[x] * scale) : plane[x]);
        }
        for (int x = 0; x < n; x++)
            _Pragma("GCC unroll 64") for (int c = 0; c < C; c++) to[x * C + c] = block[c * BLOCK + x];
    }
}
