// Keep a sky without noise. The specification is ops/even_sky.py. BLOCK and TOLERANCE are constants.SKY_BLOCK and SKY_TOLERANCE.
#include "common.h"

// radiance [B, 3, H, W], depth [B, 1, H, W], open [B, H, W], lowest, highest [B, 3, ⌈H/BLOCK⌉, ⌈W/BLOCK⌉], contiguous.
// Which pixels show the sky (bit 0) and are open (bit 1), and the extremes of the open ones' radiance in every block.
void sky_blocks(const float *radiance, const float *depth, uint8_t *open, float *lowest, float *highest, int B, int H, int W,
                int threads) {
    int64_t plane = (int64_t)H * W, rows = (H + BLOCK - 1) / BLOCK, columns = (W + BLOCK - 1) / BLOCK;
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int64_t i = 0; i < B * rows; i++) {
        int64_t b = i / rows, row = i % rows, bottom = MIN((row + 1) * BLOCK, H);
        uint8_t hit[W + 2];  // whether this pixel, the one above or the one below hit something; a border on either side
        hit[0] = hit[W + 1] = 0;
        for (int64_t y = row * BLOCK; y < bottom; y++) {
            const float *here = depth + b * plane + y * W, *above = here - (y > 0) * W, *below = here + (y < H - 1) * W;
            uint8_t *o = open + b * plane + y * W;
#pragma omp simd
            for (int x = 0; x < W; x++) hit[x + 1] = (here[x] > 0) | (above[x] > 0) | (below[x] > 0);
#pragma omp simd
            for (int x = 0; x < W; x++) o[x] = hit[x] | hit[x + 1] | hit[x + 2] ? 0 : 3;
            for (int x = 0; x < W; x++) {  // closed by a corner alone
                uint8_t side = hit[x + 1] | (x > 0 && here[x - 1] > 0) | (x < W - 1 && here[x + 1] > 0);
                o[x] |= !side;
            }
        }
        for (int c = 0; c < 3; c++) {
            float low[W], high[W];
            for (int64_t y = row * BLOCK; y < bottom; y++) {
                const float *r = radiance + (3 * b + c) * plane + y * W;
                const uint8_t *o = open + b * plane + y * W;
                int first = y == row * BLOCK;
#pragma omp simd
                for (int x = 0; x < W; x++) {
                    float least = first ? INFINITY : low[x], most = first ? -INFINITY : high[x];
                    low[x] = MIN(least, o[x] & 2 ? r[x] : INFINITY);
                    high[x] = MAX(most, o[x] & 2 ? r[x] : -INFINITY);
                }
            }
            for (int64_t column = 0; column < columns; column++) {
                float least = INFINITY, most = -INFINITY;
                for (int x = column * BLOCK; x < MIN((column + 1) * BLOCK, W); x++) {
                    least = MIN(least, low[x]);
                    most = MAX(most, high[x]);
                }
                int64_t block = ((3 * b + c) * rows + row) * columns + column;
                lowest[block] = least;
                highest[block] = most;
            }
        }
    }
}

// out [B, 3, H, W] = radiance where a pixel shows the sky and is even, image elsewhere; out may not be image.
void even_sky(const float *image, const float *radiance, const uint8_t *open, const float *lowest, const float *highest,
              float *out, int B, int H, int W, int threads) {
    int64_t plane = (int64_t)H * W, rows = (H + BLOCK - 1) / BLOCK, columns = (W + BLOCK - 1) / BLOCK;
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int64_t i = 0; i < B * rows * columns; i++) {
        int64_t b = i / (rows * columns), row = i / columns % rows, column = i % columns;
        float low[3], high[3];  // of this block and those around it
        for (int c = 0; c < 3; c++) {
            low[c] = INFINITY, high[c] = -INFINITY;
            for (int64_t v = MAX(row - 1, 0); v <= MIN(row + 1, rows - 1); v++)
                for (int64_t u = MAX(column - 1, 0); u <= MIN(column + 1, columns - 1); u++) {
                    int64_t block = ((3 * b + c) * rows + v) * columns + u;
                    low[c] = MIN(low[c], lowest[block]);
                    high[c] = MAX(high[c], highest[block]);
                }
        }
        for (int64_t y = row * BLOCK; y < MIN((row + 1) * BLOCK, H); y++)
            for (int64_t x = column * BLOCK; x < MIN((column + 1) * BLOCK, W); x++) {
                int64_t at = 3 * b * plane + y * W + x;
                int even = open[b * plane + y * W + x] & (low[0] <= high[0]);
                for (int c = 0; c < 3; c++) {
                    float light = radiance[at + c * plane], margin = TOLERANCE * light;
                    even &= (high[c] - light <= margin) & (light - low[c] <= margin);
                }
                for (int c = 0; c < 3; c++) out[at + c * plane] = even ? radiance[at + c * plane] : image[at + c * plane];
            }
    }
}
