// A 3×3 convolution of features, channels last, to O planes of float32. The specification is ops/to_planes.py. C is the
// number of channels, a multiple of SUMS; HALF is 1 for bfloat16 features, 0 for float32; HALF_TAPS is 1 for bfloat16 weights,
// which go with bfloat16 features only. EMULATED may be given, for code of CPUs that have tiles.
#include <stdlib.h>
#include "common.h"
#if HALF_TAPS && C % 32 == 0 && (EMULATED || defined __AMX_BF16__ && defined __linux__)
#define TILES 1
#include "tiles.h"
#endif

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

#if TILES
#define ACROSS (3 * C / 32)  // tiles of a row of taps

// The taps as tiles, those of a row after each other, with zeros for outputs that are not there; NULL where there is no memory.
static tap *in_tiles(const tap *taps) {
    tap *all = TILE_ROOM(3 * ACROSS * TILE * DEEP);
    if (!all) return NULL;
    memset(all, 0, 3 * ACROSS * TILE * DEEP);
    for (int k = 0; k < 9; k++)
        for (int o = 0; o < O; o++)
            for (int c = 0; c < C; c++) all[(k * C + c) / 2 * DEEP / 2 + o * 2 + c % 2] = taps[(k * O + o) * C + c];
    return all;
}

// TILE pixels from (i, j) on, of which none is beside the image; rows v0 … v1 - 1 of the taps, which are tiles.
static inline void by_tiles(const number *x, const tap *tiles, const float *bias, float *out, int H, int W, int i, int j, int v0,
                            int v1) {
    float sums[TILE][TILE];
    TILE_ZERO(0);
    for (int v = v0; v < v1; v++)
        for (int k = 0; k < ACROSS; k++) {
            TILE_LOAD(1, x + ((int64_t)(i + v - 1) * W + j - 1) * C + k * (DEEP / 2), C * sizeof *x);
            TILE_LOAD(2, tiles + (v * ACROSS + k) * TILE * (DEEP / 2), DEEP);
            TILE_HALF_PRODUCTS(0, 1, 2);
        }
    TILE_STORE(0, sums, DEEP);
    for (int o = 0; o < O; o++)
        for (int p = 0; p < TILE; p++) out[((int64_t)o * H + i) * W + j + p] = bias[o] + sums[p][o];
}
#endif

// x [H, W, C]; taps [3, 3, O, C]; out [O, H, W]
void to_planes(const number *x, const tap *taps, const float *bias, float *out, int H, int W, int threads) {
#if TILES
    tap *tiles = tiles_allowed() ? in_tiles(taps) : NULL;
#endif
#pragma omp parallel num_threads(threads)
    {
#if TILES
        if (tiles) tiles_begin();
#endif
#pragma omp for schedule(static)
        for (int i = 0; i < H; i++)
            for (int j = 0; j < W;) {
                int v0 = i == 0, v1 = 3 - (i == H - 1);
#if TILES
                if (tiles && j > 0 && j + TILE < W) {
                    by_tiles(x, tiles, bias, out, H, W, i, j, v0, v1);
                    j += TILE;
                    continue;
                }
#endif
                if (v0 == 0 && v1 == 3 && j > 0 && j + MANY < W) {
                    pixels(x, taps, bias, out, H, W, i, j, MANY, 0, 3, 0, 3);  // all constant: unrolled
                    j += MANY;
                } else {
                    pixels(x, taps, bias, out, H, W, i, j, 1, v0, v1, j == 0, 3 - (j == W - 1));
                    j++;
                }
            }
#if TILES
        if (tiles) tiles_end();
#endif
    }
#if TILES
    free(tiles);
#endif
}
