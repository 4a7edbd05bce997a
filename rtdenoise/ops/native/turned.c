// How far surfaces have turned. The specification is ops/turned.py; CELL, NOISE and ANGLE are those of constants.py.
#include "common.h"
#include "cells.h"

#define SUMS 5  // of the differences of normals, of their squares, and the pixels that have both

static inline float squared(float x, float y, float z) { return x * x + y * y + z * z; }

// The sums of a row of cells, [SUMS, columns]; `space` has SUMS · W values.
static inline void compare(const float *normal, const float *before, float *cells, float *space, int row, int H, int W,
                           int columns) {
    int64_t plane = (int64_t)H * W;
    float *u = space, *v = u + W, *w = v + W, *square = w + W, *count = square + W;
    memset(space, 0, SUMS * (size_t)W * sizeof *space);
    for (int y = row * CELL; y < MIN((row + 1) * CELL, H); y++) {
        const float *now = normal + (int64_t)y * W, *then = before + (int64_t)y * W;
#pragma omp simd
        for (int x = 0; x < W; x++) {
            float now_x = now[x], now_y = now[plane + x], now_z = now[2 * plane + x];
            float then_x = then[x], then_y = then[plane + x], then_z = then[2 * plane + x];
            float has = squared(now_x, now_y, now_z), had = squared(then_x, then_y, then_z);
            float both = has > 0 && had > 0, a = both / sqrtf(MAX(has, 1e-12f)), b = both / sqrtf(MAX(had, 1e-12f));
            float dx = a * now_x - b * then_x, dy = a * now_y - b * then_y, dz = a * now_z - b * then_z;
            u[x] += dx;
            v[x] += dy;
            w[x] += dz;
            square[x] += squared(dx, dy, dz);
            count[x] += both;
        }
    }
    total_cells(space, cells, SUMS, W, columns);
}

// The share of each cell of a row, from its sums and those of the eight around it; `cells` [rows, SUMS, columns].
static inline void shares(const float *cells, float *share, int row, int rows, int columns) {
    for (int column = 0; column < columns; column++) {
        float sum[SUMS];
        sum_around(cells, sum, SUMS, row, column, rows, columns);
        float square = sum[0] * sum[0] + sum[1] * sum[1] + sum[2] * sum[2];
        float sure = MAX(1 - (float)NOISE * sum[3] / MAX(square, 1e-30f), 0);
        share[column] = 1 - exp_negative(-(sure * sqrtf(square) / MAX(sum[4], 1)) / (float)ANGLE);
    }
}

// normal and before [B, 3, H, W], out [B, 1, H, W]; cells [B, rows, SUMS, columns]; space has SUMS · W values for each of
// `threads` threads.
void turned(const float *normal, const float *before, float *out, float *cells, float *space, int B, int H, int W,
            int threads) {
    int rows = (H + CELL - 1) / CELL, columns = (W + CELL - 1) / CELL;
    int64_t plane = (int64_t)H * W, row_of_cells = (int64_t)SUMS * columns, count = (int64_t)B * rows;
#pragma omp parallel num_threads(threads)
    {
#pragma omp for schedule(static)
        for (int t = 0; t < threads; t++)
            for (int64_t i = count * t / threads; i < count * (t + 1) / threads; i++)
                compare(normal + i / rows * 3 * plane, before + i / rows * 3 * plane, cells + i * row_of_cells,
                        space + (int64_t)t * SUMS * W, i % rows, H, W, columns);
        spread_values(shares, cells, out, space, (int64_t)SUMS * W, SUMS, B, H, W, threads);
    }
}
