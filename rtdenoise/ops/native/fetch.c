// Nearest reprojection. The specification is ops/fetch.py; C is the number of channels.
#include "common.h"
#include "targets.h"

// image, out [B, C, H, W], motion [B, 2, H, W], contiguous.
void fetch(const float *image, const float *motion, float *out, int B, int H, int W, int threads) {
    int64_t plane = (int64_t)H * W;
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int64_t row = 0; row < (int64_t)B * H; row++) {
        int b = row / H, y = row % H;
        const float *from = image + b * C * plane, *mx = motion + b * 2 * plane + (int64_t)y * W, *my = mx + plane;
        float *to = out + b * C * plane + (int64_t)y * W;
#pragma omp simd
        for (int x = 0; x < W; x++) {
            int at = (int)(clamped_target(my[x], y, H) + 0.5f) * W + (int)(clamped_target(mx[x], x, W) + 0.5f);
#pragma GCC unroll 8
            for (int c = 0; c < C; c++) to[c * plane + x] = from[c * plane + at];
        }
    }
}
