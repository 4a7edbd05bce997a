// Reprojection in one pass. The specification is ops/warp.py; C is the number of channels. A plane has < 2³¹ pixels.
#include "common.h"

// image, otherwise, out [B, C, H, W], motion [B, 2, H, W], seen [B, 1, H, W] bool, contiguous; `seen` and `otherwise` may
// be null.
void warp(const float *image, const float *motion, const uint8_t *seen, const float *otherwise, float *out, int B,
          int H, int W, int threads) {
    int64_t plane = (int64_t)H * W;
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int64_t row = 0; row < (int64_t)B * H; row++) {
        int b = row / H, y = row % H;
        const float *from = image + b * C * plane, *mx = motion + b * 2 * plane + (int64_t)y * W, *my = mx + plane;
        float *to = out + b * C * plane + (int64_t)y * W;
#pragma omp simd
        for (int x = 0; x < W; x++) {
            float u = clamped(mx[x], x, W), v = clamped(my[x], y, H);
            int x0 = (int)u, y0 = (int)v, x1 = MIN(x0 + 1, W - 1), y1 = MIN(y0 + 1, H - 1);
            float f = u - x0, g = v - y0;
#pragma GCC unroll 8
            for (int c = 0; c < C; c++) {
                const float *i = from + c * plane;
                float top = i[y0 * W + x0] * (1 - f) + i[y0 * W + x1] * f;
                float bottom = i[y1 * W + x0] * (1 - f) + i[y1 * W + x1] * f;
                to[c * plane + x] = top * (1 - g) + bottom * g;
            }
        }
        const uint8_t *wanted = seen ? seen + row * W : 0;
        if (!wanted || !memchr(wanted, 0, W)) continue;  // most rows: nothing else is read
        for (int c = 0; c < C; c++) {
            const float *other = otherwise + (b * C + c) * plane + (int64_t)y * W;
#pragma omp simd
            for (int x = 0; x < W; x++) to[c * plane + x] = wanted[x] ? to[c * plane + x] : other[x];
        }
    }
}

void fetch(const float *image, const float *motion, float *out, int B, int H, int W, int threads) {
    int64_t plane = (int64_t)H * W;
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int64_t row = 0; row < (int64_t)B * H; row++) {
        int b = row / H, y = row % H;
        const float *from = image + b * C * plane, *mx = motion + b * 2 * plane + (int64_t)y * W, *my = mx + plane;
        float *to = out + b * C * plane + (int64_t)y * W;
#pragma omp simd
        for (int x = 0; x < W; x++) {
            int at = (int)(clamped(my[x], y, H) + 0.5f) * W + (int)(clamped(mx[x], x, W) + 0.5f);
#pragma GCC unroll 8
            for (int c = 0; c < C; c++) to[c * plane + x] = from[c * plane + at];
        }
    }
}
