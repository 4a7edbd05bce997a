// Luminance of blocks of pixels in one pass. The specification is ops/block_luminance.py. RED, GREEN and BLUE are
// constants.LUMINANCE_WEIGHTS; a block is at most MAX_BLOCK wide, and as many columns are reduced at a time.
#include "common.h"

// radiance [B, 3, H, W], means, maxima [B, ⌈H/side⌉, ⌈W/side⌉], contiguous; side ≤ MAX_BLOCK. Columns are reduced first,
// because that vectorises, then blocks.
void block_luminance(const float *radiance, float *means, float *maxima, int B, int H, int W, int side, int threads) {
    int64_t plane = (int64_t)H * W, rows = (H + side - 1) / side, columns = (W + side - 1) / side;
    int at_once = MAX_BLOCK / side * side;
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int64_t i = 0; i < B * rows; i++) {
        int64_t top = i % rows * side, bottom = MIN(top + side, H);
        for (int from = 0; from < W; from += at_once) {
            int to = MIN(from + at_once, W);
            float sum[MAX_BLOCK], most[MAX_BLOCK];
            for (int64_t y = top; y < bottom; y++) {
                const float *r = radiance + i / rows * 3 * plane + y * W, *g = r + plane, *b = g + plane;
#pragma omp simd
                for (int x = from; x < to; x++) {
                    float light = RED * r[x] + GREEN * g[x] + BLUE * b[x];
                    sum[x - from] = y == top ? light : sum[x - from] + light;
                    most[x - from] = y == top ? light : MAX(most[x - from], light);
                }
            }
            for (int left = 0; left < to - from; left += side) {
                int right = MIN(left + side, to - from);
                float total = 0, greatest = most[left];
                for (int x = left; x < right; x++) total += sum[x], greatest = MAX(greatest, most[x]);
                int64_t block = i * columns + (from + left) / side;
                means[block] = total / ((bottom - top) * (right - left));
                maxima[block] = greatest;
            }
        }
    }
}
