// How much brighter light has become in cells, and light that is multiplied by it. The specification is ops/relit.py; CELL,
// ROUNDING, DARKER, FROM, WHOLE and MOST are those of constants.py. Of squares of cells there are two sizes: 4 × 4 and 2 × 2.
#include "common.h"
#include "cells.h"

#define SUMS 6  // of three channels, before and now
#define COUNT(n, side) (((n) + (side) - 1) / (side))

// The sums of a row of cells, [SUMS, columns]; `space` has SUMS · W values.
static inline void sum_row(const float *before, const float *now, const uint8_t *found, float *cells, float *space, int row,
                           int H, int W, int columns) {
    int64_t plane = (int64_t)H * W;
    memset(space, 0, SUMS * (size_t)W * sizeof *space);
    for (int y = row * CELL; y < MIN((row + 1) * CELL, H); y++) {
        const uint8_t *has = found + (int64_t)y * W;
        for (int c = 0; c < 3; c++) {
            const float *then = before + c * plane + (int64_t)y * W, *light = now + c * plane + (int64_t)y * W;
            float *b = space + c * W, *n = b + 3 * W;
#pragma omp simd
            for (int x = 0; x < W; x++) {
                b[x] += has[x] ? then[x] : 0;
                n[x] += has[x] ? light[x] : 0;
            }
        }
    }
    total_cells(space, cells, SUMS, W, columns);
}

// The sums of a row of squares of 2 × 2 cells, [SUMS, columns of squares]; cells [rows, SUMS, columns].
static inline void join(const float *cells, float *out, int row, int rows, int columns) {
    for (int i = 0; i < SUMS; i++)
        for (int x = 0; x < COUNT(columns, 2); x++) {
            float total = 0;
            for (int y = 2 * row; y < MIN(2 * row + 2, rows); y++)
                for (int k = 2 * x; k < MIN(2 * x + 2, columns); k++) total += cells[((int64_t)y * SUMS + i) * columns + k];
            out[i * COUNT(columns, 2) + x] = total;
        }
}

// g of square (row, column), [3], from the sums of quarters of squares, [rows, SUMS, columns].
static inline void brighter(const float *quarters, float *g, int row, int column, int rows, int columns) {
    int top = MAX(2 * row - 2, 0), bottom = MIN(2 * row + 4, rows), left = MAX(2 * column - 2, 0);
    int right = MIN(2 * column + 4, columns);
    float sum[SUMS] = {0}, total = 0, square = 0;
    for (int y = top; y < bottom; y++)
        for (int i = 0; i < SUMS; i++)
            for (int x = left; x < right; x++) sum[i] += quarters[((int64_t)y * SUMS + i) * columns + x];
    for (int i = 0; i < SUMS; i++) total += sum[i];
    float share = 1 / MAX(total, 1e-30f);  // squares of light itself may be infinite
    for (int c = 0; c < 3; c++) g[c] = 0;
    for (int y = top; y < bottom; y++)
        for (int c = 0; c < 3; c++) {
            const float *then = quarters + ((int64_t)y * SUMS + c) * columns, *light = then + (int64_t)3 * columns;
            for (int x = left; x < right; x++) square += share * (then[x] - light[x]) * (share * (then[x] - light[x]));
        }
    float apart = 0;
    for (int c = 0; c < 3; c++) {
        float d = share * (sum[c] - sum[3 + c]), least = (float)ROUNDING * share * sum[c];
        apart += d * d;
        square += least * least;
    }
    float q = apart / MAX(square, 1e-30f);
    if (sum[3] + sum[4] + sum[5] < sum[0] + sum[1] + sum[2]) q /= (float)DARKER;
    float sure = MIN(MAX((q - (float)FROM) / ((float)WHOLE - (float)FROM), 0), 1);
    if (sure == 0) return;
    for (int c = 0; c < 3; c++) {
        float times = sum[c] > 0 ? MIN(MAX(sum[3 + c] / sum[c], 1 / (float)MOST), (float)MOST) : 1;
        g[c] = sure * logf(times);
    }
}

// Where cell x lies between the middles of squares of `side` cells: the one before it, the one after, and its weight.
static inline float between(int x, int side, int n, int *low, int *high) {
    float at = MAX((x + 0.5f) / side - 0.5f, 0);
    *low = MIN((int)at, n - 1);
    *high = MIN(*low + 1, n - 1);
    return at - *low;
}

// Add to `out` g of channel c in a row of cells, linear between the middles of squares of `side` cells, [rows of squares, columns
// of squares, 3]; `line` has a value for each column of squares.
static inline void spread_row(const float *g, float *line, float *out, int c, int row, int side, int rows, int columns) {
    int top, bottom, n = COUNT(columns, side), any = 0;
    float v = between(row, side, COUNT(rows, side), &top, &bottom);
    for (int x = 0; x < n; x++) {
        line[x] = (1 - v) * g[((int64_t)top * n + x) * 3 + c] + v * g[((int64_t)bottom * n + x) * 3 + c];
        any |= line[x] != 0;
    }
    for (int x = 0; any && x < columns; x++) {
        int left, right;
        float u = between(x, side, n, &left, &right);
        out[x] += (1 - u) * line[left] + u * line[right];
    }
}

// before and now [B, 3, H, W], found [B, 1, H, W], out [B, 3, rows, columns]; cells [B, rows, SUMS, columns], quarters as many
// of squares of 2 × 2 cells, first [B, squares of 4 × 4, 3] and second [B, squares of 2 × 2, 3]; space has SUMS · W values for
// each of `threads` threads.
void gain(const float *before, const float *now, const uint8_t *found, float *out, float *cells, float *quarters, float *first,
          float *second, float *space, int B, int H, int W, int threads) {
    int rows = COUNT(H, CELL), columns = COUNT(W, CELL), h = COUNT(rows, 2), w = COUNT(columns, 2);
    int m = COUNT(h, 2), n = COUNT(w, 2);
    int64_t plane = (int64_t)H * W, of_cells = (int64_t)rows * SUMS * columns, of_quarters = (int64_t)h * SUMS * w;
    int64_t of_first = (int64_t)m * n * 3, of_second = (int64_t)h * w * 3, count = (int64_t)B * rows;
#pragma omp parallel num_threads(threads)
    {
#pragma omp for schedule(static)
        for (int t = 0; t < threads; t++)
            for (int64_t i = count * t / threads; i < count * (t + 1) / threads; i++) {
                int64_t b = i / rows;
                sum_row(before + b * 3 * plane, now + b * 3 * plane, found + b * plane, cells + i * SUMS * columns,
                        space + (int64_t)t * SUMS * W, i % rows, H, W, columns);
            }
#pragma omp for schedule(static)
        for (int64_t i = 0; i < (int64_t)B * h; i++)
            join(cells + i / h * of_cells, quarters + i * SUMS * w, i % h, rows, columns);
#pragma omp for schedule(static)
        for (int64_t i = 0; i < (int64_t)B * m; i++)
            for (int x = 0; x < n; x++)
                brighter(quarters + i / m * of_quarters, first + (i * n + x) * 3, i % m, x, h, w);
#pragma omp for schedule(static)
        for (int t = 0; t < threads; t++)
            for (int64_t k = count * t / threads * 3; k < count * (t + 1) / threads * 3; k++) {
                int64_t i = k / 3, c = k % 3;
                float *g = out + ((i / rows * 3 + c) * rows + i % rows) * columns, *before = cells + (i * SUMS + c) * columns;
                memset(g, 0, columns * sizeof *g);
                spread_row(first + i / rows * of_first, space + (int64_t)t * SUMS * W, g, c, i % rows, 4, rows, columns);
                for (int x = 0; x < columns; x++)
                    if (g[x]) before[x] *= expf(g[x]);
            }
#pragma omp for schedule(static)
        for (int64_t i = 0; i < (int64_t)B * h; i++)
            for (int x = 0; x < w; x++)
                brighter(cells + i / h * of_cells, second + (i * w + x) * 3, i % h, x, rows, columns);
#pragma omp for schedule(static)
        for (int t = 0; t < threads; t++)
            for (int64_t k = count * t / threads * 3; k < count * (t + 1) / threads * 3; k++) {
                int64_t i = k / 3, c = k % 3;
                float *g = out + ((i / rows * 3 + c) * rows + i % rows) * columns;
                spread_row(second + i / rows * of_second, space + (int64_t)t * SUMS * W, g, c, i % rows, 2, rows, columns);
                for (int x = 0; x < columns; x++) g[x] = g[x] ? expf(g[x]) : 1;
            }
    }
}

// Multiply the first three channels of an image [B, C, H, W] by `gain`, [B, 3, rows, columns].
void relit(float *image, const float *gain, int B, int C, int H, int W, int threads) {
    int rows = COUNT(H, CELL), columns = COUNT(W, CELL);
    int64_t plane = (int64_t)H * W;
#pragma omp parallel for schedule(static) num_threads(threads)
    for (int64_t i = 0; i < (int64_t)B * 3 * rows; i++) {
        int64_t b = i / (3 * rows), c = i / rows % 3, row = i % rows;
        const float *times = gain + i * columns;
        for (int column = 0; column < columns; column++)
            if (times[column] != 1)
                for (int y = row * CELL; y < MIN((row + 1) * CELL, H); y++)
                    for (int x = column * CELL; x < MIN((column + 1) * CELL, W); x++)
                        image[(b * C + c) * plane + (int64_t)y * W + x] *= times[column];
    }
}
