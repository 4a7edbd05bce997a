// How far a frame agrees with a running mean. The specification is ops/agrees.py; CELL, PATIENCE, ALIKE and so on are those
// of constants.py.
#include "common.h"
#include "cells.h"

#define SUMS 4  // of the differences of three channels, and of their squares with what is added
#define WIDE 2  // side of a wide cell in cells

static inline float squared(float x, float y, float z) { return x * x + y * y + z * z; }

// The sums of a row of cells, [SUMS, columns]; `space` has SUMS · W values.
static inline void compare(const float *light, const float *mean, const uint8_t *found, float *cells, float *space, int row,
                           int H, int W, int columns) {
    int64_t plane = (int64_t)H * W;
    float *u = space, *v = u + W, *w = v + W, *square = w + W;
    memset(space, 0, SUMS * (size_t)W * sizeof *space);
    for (int y = row * CELL; y < MIN((row + 1) * CELL, H); y++) {
        const float *now = light + (int64_t)y * W, *then = mean + (int64_t)y * W;
        const uint8_t *has = found + (int64_t)y * W;
#pragma omp simd
        for (int x = 0; x < W; x++) {
            float there = has[x], dx = there * (then[x] - now[x]), dy = there * (then[plane + x] - now[plane + x]);
            float dz = there * (then[2 * plane + x] - now[2 * plane + x]);
            u[x] += dx;
            v[x] += dy;
            w[x] += dz;
            float least = squared(now[x], now[plane + x], now[2 * plane + x]);
            square[x] += squared(dx, dy, dz) + there * (float)ROUNDING * least;
        }
    }
    total_cells(space, cells, SUMS, W, columns);
}

// The factor of `side` × `side` cells, of which (row, column) is one, and as many on each side of them; `cells` [rows, SUMS,
// columns].
static inline float unchanged(const float *cells, int row, int column, int side, float alike, float changed, int rows,
                              int columns) {
    float sum[SUMS] = {0};
    int top = row / side * side - side, left = column / side * side - side;
    for (int y = MAX(top, 0); y < MIN(top + 3 * side, rows); y++)
        for (int i = 0; i < SUMS; i++)
            for (int x = MAX(left, 0); x < MIN(left + 3 * side, columns); x++)
                sum[i] += cells[((int64_t)y * SUMS + i) * columns + x];
    float q = squared(sum[0], sum[1], sum[2]) / MAX((float)PATIENCE * sum[3], 1e-30f);
    return MIN(MAX((changed - q) / (changed - alike), 0), 1);
}

// The factor of each cell of a row; `cells` [rows, SUMS, columns].
static inline void factors(const float *cells, float *factor, int row, int rows, int columns) {
    float wide = 0;
    for (int column = 0; column < columns; column++) {
        if (column % WIDE == 0) wide = unchanged(cells, row, column, WIDE, WIDE_ALIKE, WIDE_CHANGED, rows, columns);
        factor[column] = wide * unchanged(cells, row, column, 1, ALIKE, CHANGED, rows, columns);
    }
}

// light and mean [B, 3, H, W], found and out [B, 1, H, W]; cells [B, rows, SUMS, columns]; space has SUMS · W values for each
// of `threads` threads.
void agrees(const float *light, const float *mean, const uint8_t *found, float *out, float *cells, float *space, int B, int H,
            int W, int threads) {
    int rows = (H + CELL - 1) / CELL, columns = (W + CELL - 1) / CELL;
    int64_t plane = (int64_t)H * W, row_of_cells = (int64_t)SUMS * columns, count = (int64_t)B * rows;
#pragma omp parallel num_threads(threads)
    {
#pragma omp for schedule(static)
        for (int t = 0; t < threads; t++)
            for (int64_t i = count * t / threads; i < count * (t + 1) / threads; i++) {
                int64_t b = i / rows;
                compare(light + b * 3 * plane, mean + b * 3 * plane, found + b * plane, cells + i * row_of_cells,
                        space + (int64_t)t * SUMS * W, i % rows, H, W, columns);
            }
        spread_values(factors, cells, out, space, (int64_t)SUMS * W, SUMS, B, H, W, threads);
    }
}
