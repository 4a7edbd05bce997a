// What is around a pixel. The specification is ops/around.py; CELL is that of constants.py.
#include "common.h"
#include "expm1.h"

// The least and the greatest values of two planes in a row of cells; `space` has 2 · W values.
static inline void extremes(const float *first, const float *other, float *least, float *most, float *space, int row, int H,
                            int W) {
    float *low = space, *high = space + W;
    for (int x = 0; x < W; x++) low[x] = INFINITY, high[x] = -INFINITY;
    for (int y = row * CELL; y < MIN((row + 1) * CELL, H); y++) {
        const float *a = first + (int64_t)y * W, *b = other + (int64_t)y * W;
#pragma omp simd
        for (int x = 0; x < W; x++) {
            low[x] = MIN(low[x], MIN(a[x], b[x]));
            high[x] = MAX(high[x], MAX(a[x], b[x]));
        }
    }
    for (int from = 0; from < W; from += CELL) {
        float l = INFINITY, h = -INFINITY;
        for (int x = from; x < MIN(from + CELL, W); x++) l = MIN(l, low[x]), h = MAX(h, high[x]);
        least[from / CELL] = l, most[from / CELL] = h;
    }
}

// A row of pixels, of cells whose values and those around lie in `least` and `most`.
static inline void expanded(const float *in, float *out, const float *least, const float *most, int row, int rows, int columns,
                            int W) {
    for (int from = 0; from < W; from += CELL) {
        int column = from / CELL, n = MIN(CELL, W - from);
        float l = INFINITY, h = -INFINITY;
        for (int i = MAX(row - 1, 0); i <= MIN(row + 1, rows - 1); i++)
            for (int k = MAX(column - 1, 0); k <= MIN(column + 1, columns - 1); k++)
                l = MIN(l, least[i * columns + k]), h = MAX(h, most[i * columns + k]);
        if (n == CELL)  // a constant, for the vector code
#pragma omp simd
            for (int x = from; x < from + CELL; x++) out[x] = MIN(MAX(expm1_positive(in[x]), l), h);
        else
            for (int x = from; x < from + n; x++) out[x] = MIN(MAX(expm1_positive(in[x]), l), h);
    }
}

// compressed, first, other, out [planes, H, W]; least and most [planes, rows, columns]; `space` has 2 · W values for each of
// `threads` threads.
void expand_within(const float *compressed, const float *first, const float *other, float *least, float *most, float *space,
                   float *out, int planes, int H, int W, int threads) {
    int rows = (H + CELL - 1) / CELL, columns = (W + CELL - 1) / CELL;
    int64_t plane = (int64_t)H * W, cells = (int64_t)rows * columns;
#pragma omp parallel num_threads(threads)
    {
#pragma omp for schedule(static)
        for (int t = 0; t < threads; t++)
            for (int64_t i = (int64_t)planes * rows * t / threads; i < (int64_t)planes * rows * (t + 1) / threads; i++)
                extremes(first + i / rows * plane, other + i / rows * plane, least + i * columns, most + i * columns,
                         space + (int64_t)t * 2 * W, i % rows, H, W);
#pragma omp for schedule(static)
        for (int64_t i = 0; i < (int64_t)planes * H; i++) {
            int64_t p = i / H;
            expanded(compressed + i * W, out + i * W, least + p * cells, most + p * cells, i % H / CELL, rows, columns, W);
        }
    }
}
