// How far textures have moved over their surfaces. The specification is ops/retextured.py; CELL and the bounds are those of
// constants.py.
#include "common.h"
#include "cells.h"

#define SUMS 4  // how far albedo before lies beyond this frame's, farther away than two neighbours', and the pixels with both
#define ROWS 8  // of `space`: SUMS, the least and the greatest of three pixels above each other, and two more

// The sums of a row of cells, [SUMS, columns]; `space` has ROWS · W values.
static inline void compare(const float *albedo, const float *before, const uint8_t *found, float *cells, float *space, int row,
                           int H, int W, int columns) {
    int64_t plane = (int64_t)H * W;
    float *beyond = space, *across = beyond + W, *down = across + W, *count = down + W;
    float *low = count + W, *high = low + W, *least = high + W, *greatest = least + W;
    memset(space, 0, SUMS * (size_t)W * sizeof *space);
    for (int y = row * CELL; y < MIN((row + 1) * CELL, H); y++) {
        const uint8_t *has = found + (int64_t)y * W;
        for (int c = 0; c < 3; c++) {
            const float *now = albedo + c * plane + (int64_t)y * W, *then = before + c * plane + (int64_t)y * W;
            const float *above = y > 0 ? now - W : now, *below = y + 1 < H ? now + W : now;
#pragma omp simd
            for (int x = 0; x < W; x++) {
                low[x] = MIN(MIN(above[x], now[x]), below[x]);
                high[x] = MAX(MAX(above[x], now[x]), below[x]);
            }
            least[0] = MIN(low[0], low[MIN(1, W - 1)]);
            greatest[0] = MAX(high[0], high[MIN(1, W - 1)]);
            least[W - 1] = MIN(low[W - 1], low[MAX(W - 2, 0)]);
            greatest[W - 1] = MAX(high[W - 1], high[MAX(W - 2, 0)]);
#pragma omp simd
            for (int x = 1; x < W - 1; x++) {
                least[x] = MIN(MIN(low[x - 1], low[x]), low[x + 1]);
                greatest[x] = MAX(MAX(high[x - 1], high[x]), high[x + 1]);
            }
#pragma omp simd
            for (int x = 0; x < W; x++) {
                float d = has[x] ? now[x] - then[x] : 0, under = has[x] ? below[x] - now[x] : 0;
                across[x] += d * d;
                down[x] += d * d - under * under;
                beyond[x] += has[x] ? MAX(then[x] - greatest[x], 0) + MAX(least[x] - then[x], 0) : 0;
            }
#pragma omp simd
            for (int x = 0; x < W - 1; x++) {
                float right = has[x] ? now[x + 1] - now[x] : 0;
                across[x] -= right * right;
            }
        }
#pragma omp simd
        for (int x = 0; x < W; x++) count[x] += has[x];
    }
    total_cells(space, cells, SUMS, W, columns);
}

// The share of each cell of a row, from its sums and those of the eight around it; `cells` [rows, SUMS, columns].
static inline void shares(const float *cells, float *share, int row, int rows, int columns) {
    for (int column = 0; column < columns; column++) {
        float sum[SUMS];
        sum_around(cells, sum, SUMS, row, column, rows, columns);
        float beyond = sum[0] / MAX(sum[3], 1), apart = MIN(sum[1], sum[2]) / MAX(sum[3], 1);
        float texture = (beyond - (float)LEAST) / ((float)MOST - (float)LEAST);
        float moved = (apart - (float)MOVED_LEAST) / ((float)MOVED_MOST - (float)MOVED_LEAST);
        share[column] = MIN(MAX(MAX(texture, moved), 0), 1);
    }
}

// albedo and before [B, 3, H, W], found [B, 1, H, W], out [B, 1, H, W]; cells [B, rows, SUMS, columns]; space has ROWS · W
// values for each of `threads` threads.
void retextured(const float *albedo, const float *before, const uint8_t *found, float *out, float *cells, float *space, int B,
                int H, int W, int threads) {
    int rows = (H + CELL - 1) / CELL, columns = (W + CELL - 1) / CELL;
    int64_t plane = (int64_t)H * W, row_of_cells = (int64_t)SUMS * columns, count = (int64_t)B * rows;
#pragma omp parallel num_threads(threads)
    {
#pragma omp for schedule(static)
        for (int t = 0; t < threads; t++)
            for (int64_t i = count * t / threads; i < count * (t + 1) / threads; i++)
                compare(albedo + i / rows * 3 * plane, before + i / rows * 3 * plane, found + i / rows * plane,
                        cells + i * row_of_cells, space + (int64_t)t * ROWS * W, i % rows, H, W, columns);
        spread_values(shares, cells, out, space, (int64_t)ROWS * W, SUMS, B, H, W, threads);
    }
}
