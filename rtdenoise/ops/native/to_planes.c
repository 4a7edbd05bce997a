// A 3×3 convolution of features, channels last, to O planes of float32. The specification is ops/to_planes.py. C is the
// number of channels, a multiple of LANES; HALF is 1 for bfloat16 features, 0 for float32.
#include "common.h"

#define LANES 16
typedef float vector __attribute__((vector_size(LANES * 4)));
typedef uint32_t bits __attribute__((vector_size(LANES * 4)));
typedef uint16_t halves __attribute__((vector_size(LANES * 2)));

#if HALF
typedef uint16_t number;
static inline vector loaded(const number *x) {  // a bfloat16 is the upper half of a float32
    halves h;
    memcpy(&h, x, sizeof h);
    bits b = __builtin_convertvector(h, bits) << 16;
    vector v;
    memcpy(&v, &b, sizeof v);
    return v;
}
#else
typedef float number;
static inline vector loaded(const number *x) {
    vector v;
    memcpy(&v, x, sizeof v);
    return v;
}
#endif

static inline float total(vector v) {
    typedef float half __attribute__((vector_size(LANES * 2)));
    typedef float quarter __attribute__((vector_size(LANES)));
    half h[2];
    quarter q[2];
    memcpy(h, &v, sizeof v);
    h[0] += h[1];
    memcpy(q, h, sizeof *h);
    q[0] += q[1];
    return q[0][0] + q[0][2] + (q[0][1] + q[0][3]);
}

// Pixel (i, j) from rows v0 … v1 - 1 and columns u0 … u1 - 1 of the taps; the others lie beyond the image, where zeros are.
static inline __attribute__((always_inline)) void
pixel(const number *x, const float *taps, const float *bias, float *out, int H, int W, int i, int j, int v0, int v1, int u0,
      int u1) {
    vector sums[O] = {0};
    for (int v = v0; v < v1; v++)
        for (int u = u0; u < u1; u++)
            for (int c = 0; c < C; c += LANES) {
                vector weight, value = loaded(x + ((int64_t)(i + v - 1) * W + j + u - 1) * C + c);
                for (int o = 0; o < O; o++) {
                    memcpy(&weight, taps + ((v * 3 + u) * O + o) * C + c, sizeof weight);
                    sums[o] += value * weight;
                }
            }
    for (int o = 0; o < O; o++) out[((int64_t)o * H + i) * W + j] = bias[o] + total(sums[o]);
}

// x [H, W, C]; taps [3, 3, O, C]; out [O, H, W]
void to_planes(const number *x, const float *taps, const float *bias, float *out, int H, int W, int threads) {
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int i = 0; i < H; i++)
        for (int j = 0; j < W; j++)
            if (i > 0 && i < H - 1 && j > 0 && j < W - 1)
                pixel(x, taps, bias, out, H, W, i, j, 0, 3, 0, 3);  // all constant: unrolled
            else
                pixel(x, taps, bias, out, H, W, i, j, i == 0, 3 - (i == H - 1), j == 0, 3 - (j == W - 1));
}
