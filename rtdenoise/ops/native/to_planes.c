// A 3×3 convolution of features, channels last, to O planes of float32. The specification is ops/to_planes.py. C is the
// number of channels, a multiple of SUMS; HALF is 1 for bfloat16 features, 0 for float32; HALF_TAPS is 1 for bfloat16 weights,
// which go with bfloat16 features only.
#include "common.h"

#define SUMS 16  // parts of a sum
#ifdef __AVX512F__
#define MANY 4  // pixels at once, which read each weight together: their sums stay in registers
#else
#define MANY 1
#endif
typedef float vector __attribute__((vector_size(SUMS * 4)));

#if HALF
typedef uint16_t number;
#else
typedef float number;
#endif
#if HALF_TAPS
typedef uint16_t tap;
#else
typedef float tap;
#endif

#if HALF_TAPS && defined __AVX512BF16__ && C % 32 == 0  // sums of two products of bfloat16: one instruction
#include <immintrin.h>
#define LANES 32
typedef __m512bh values;
static inline values loaded(const number *x) { return (values)_mm512_loadu_si512(x); }
static inline values loaded_taps(const tap *x) { return loaded(x); }
static inline vector plus_products(vector sum, values x, values w) { return _mm512_dpbf16_ps(sum, x, w); }
#else
#define LANES SUMS
typedef vector values;
static inline values from_halves(const uint16_t *x) {  // a bfloat16 is the upper half of a float32
    typedef uint16_t halves __attribute__((vector_size(LANES * 2)));
    typedef uint32_t bits __attribute__((vector_size(LANES * 4)));
    halves h;
    memcpy(&h, x, sizeof h);
    bits b = __builtin_convertvector(h, bits) << 16;
    values v;
    memcpy(&v, &b, sizeof v);
    return v;
}
static inline values from_floats(const float *x) {
    values v;
    memcpy(&v, x, sizeof v);
    return v;
}
#define FROM(x) _Generic((x), const uint16_t *: from_halves, const float *: from_floats)(x)
static inline values loaded(const number *x) { return FROM(x); }
static inline values loaded_taps(const tap *x) { return FROM(x); }
static inline vector plus_products(vector sum, values x, values w) { return sum + x * w; }
#endif

static inline float total(vector v) {
    typedef float half __attribute__((vector_size(SUMS * 2)));
    typedef float quarter __attribute__((vector_size(SUMS)));
    half h[2];
    quarter q[2];
    memcpy(h, &v, sizeof v);
    h[0] += h[1];
    memcpy(q, h, sizeof *h);
    q[0] += q[1];
    return q[0][0] + q[0][2] + (q[0][1] + q[0][3]);
}

// `many` pixels from (i, j) on, from rows v0 … v1 - 1 and columns u0 … u1 - 1 of the taps; the others lie beyond the image,
// where zeros are.
static inline __attribute__((always_inline)) void
pixels(const number *x, const tap *taps, const float *bias, float *out, int H, int W, int i, int j, int many, int v0, int v1,
       int u0, int u1) {
    vector sums[MANY][O] = {0};
    for (int v = v0; v < v1; v++)
        for (int u = u0; u < u1; u++)
            for (int c = 0; c < C; c += LANES) {
                const number *from = x + ((int64_t)(i + v - 1) * W + j + u - 1) * C + c;
                values w[O];
                for (int o = 0; o < O; o++) w[o] = loaded_taps(taps + ((v * 3 + u) * O + o) * C + c);
                for (int p = 0; p < many; p++)
                    for (int o = 0; o < O; o++) sums[p][o] = plus_products(sums[p][o], loaded(from + p * C), w[o]);
            }
    for (int p = 0; p < many; p++)
        for (int o = 0; o < O; o++) out[((int64_t)o * H + i) * W + j + p] = bias[o] + total(sums[p][o]);
}

// x [H, W, C]; taps [3, 3, O, C]; out [O, H, W]
void to_planes(const number *x, const tap *taps, const float *bias, float *out, int H, int W, int threads) {
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int i = 0; i < H; i++)
        for (int j = 0; j < W;)
            if (i > 0 && i < H - 1 && j > 0 && j + MANY < W) {
                pixels(x, taps, bias, out, H, W, i, j, MANY, 0, 3, 0, 3);  // all constant: unrolled
                j += MANY;
            } else {
                pixels(x, taps, bias, out, H, W, i, j, 1, i == 0, 3 - (i == H - 1), j == 0, 3 - (j == W - 1));
                j++;
            }
}
