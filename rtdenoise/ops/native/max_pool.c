// The greatest of 2 × 2 pixels, channels last. The specification is ops/max_pool.py. A pixel has C channels, of BITS each: bytes,
// or floating-point numbers of which INFINITE is the greatest.
#include "common.h"

#if BITS == 8
typedef uint8_t number;
typedef uint8_t order;
static inline order ordered(number x) { return x; }
static inline number again(order x) { return x; }
#else
#if BITS == 16
typedef uint16_t number;
typedef int16_t order;
#define MOST INT16_MAX
#else
typedef uint32_t number;
typedef int32_t order;
#define MOST INT32_MAX
#endif
// Integers in the order of numbers, and back; NaN of either sign is greater than all.
static inline order turned(number x) { return (order)x < 0 ? (order)(x ^ MOST) : (order)x; }
static inline order ordered(number x) { return (x & MOST) > INFINITE ? MOST : turned(x); }
static inline number again(order x) { return (number)turned((number)x); }
#endif

// x [B, 2H, 2W, C]; out [B, H, W, C]: `rows` of B · H
void max_pool(const number *x, number *out, int64_t rows, int W, int threads) {
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int64_t i = 0; i < rows; i++)
        for (int j = 0; j < W; j++) {
            const number *top = x + (4 * i * W + 2 * j) * C, *bottom = top + 2 * (int64_t)W * C;
            number *to = out + (i * W + j) * C;
#pragma omp simd
            for (int c = 0; c < C; c++) {
                order a = ordered(top[c]), b = ordered(top[C + c]), d = ordered(bottom[c]), e = ordered(bottom[C + c]);
                to[c] = again(MAX(MAX(a, b), MAX(d, e)));
            }
        }
}
