// A network's input, channels last, in one pass over the planes of a frame. The specification is ops/features.py. C is the
// number of features, of which the first LIGHT are compressed and then multiplied by UNIT; HALF is 1 for bfloat16, 0 for
// float32.
#include "common.h"
#include "log1p.h"

#define BLOCK 64  // pixels

// A word of 64 bits holds neighbouring features of the output: four bfloat16 or two float32.
#if HALF
#define PER 4
// The upper 16 bits hold x as bfloat16, rounded to nearest, ties to even; the lower ones are noise. x is finite.
static inline uint32_t rounded(float x) {
    uint32_t bits = bits_of(x);
    return bits + 0x7fff + (bits >> 16 & 1);
}
static inline float stored(float x) { return from_bits(rounded(x) & 0xffff0000); }
static inline uint64_t word(const float *x) {
    uint32_t low = rounded(x[0]) >> 16 | (rounded(x[BLOCK]) & 0xffff0000);
    uint32_t high = rounded(x[2 * BLOCK]) >> 16 | (rounded(x[3 * BLOCK]) & 0xffff0000);
    return low | (uint64_t)high << 32;
}
#else
#define PER 2
static inline float stored(float x) { return x; }
static inline uint64_t word(const float *x) { return bits_of(x[0]) | (uint64_t)bits_of(x[BLOCK]) << 32; }
#endif
#define SIZE (8 / PER)  // bytes of a feature
#define WORDS ((C + PER - 1) / PER)

static inline float in_unit(float x) { return UNIT == 1 ? x : stored(x) * (float)UNIT; }

// planes: C pointers to `pixels` float32 each; out [pixels, C]. A block of pixels is packed into words, in vector code, and
// only words are transposed: moving single values is slow. Planes are prefetched because processors follow few streams.
void features(const float *const *planes, float scale, uint8_t *out, int64_t pixels, int threads) {
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int64_t from = 0; from < pixels; from += BLOCK) {
        int n = (int)MIN(BLOCK, pixels - from);
        float values[WORDS * PER * BLOCK];
        uint64_t words[WORDS * BLOCK];
        memset(values + C * BLOCK, 0, sizeof values - C * BLOCK * sizeof *values);  // the unused part of the last word
        for (int c = 0; c < C; c++) {
            const float *plane = planes[c] + from;
            for (int x = 0; x < n; x += 16) __builtin_prefetch(plane + 2 * BLOCK + x);
#pragma omp simd
            for (int x = 0; x < n; x++)
                values[c * BLOCK + x] = c < LIGHT ? in_unit(log1p_positive(plane[x] * scale)) : plane[x];
        }
        for (int w = 0; w < WORDS; w++)
#pragma omp simd
            for (int x = 0; x < BLOCK; x++) words[w * BLOCK + x] = word(values + w * PER * BLOCK + x);
        uint8_t *to = out + from * C * SIZE;
        for (int x = 0; x < n; x++, to += C * SIZE)
            _Pragma("GCC unroll 64") for (int w = 0; w < WORDS; w++)
                memcpy(to + w * 8, words + w * BLOCK + x, MIN(8, (C - w * PER) * SIZE));
    }
}
