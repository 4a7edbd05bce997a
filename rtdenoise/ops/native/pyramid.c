// Between the scales. The specification is ops/pyramid.py; POOL is 0 for the mean, 1 for the maximum.
#include "common.h"

// One row of D: pixels (2y..2y+1, 2x..2x+1) of `image`, at an odd border what there is of them.
static inline void pool_row(const float *image, float *out, int y, int H, int W) {
    const float *top = image + 2 * (int64_t)y * W, *bottom = 2 * y + 1 < H ? top + W : top;
#pragma omp simd
    for (int x = 0; x < W / 2; x++) {
        float a = top[2 * x], b = top[2 * x + 1], c = bottom[2 * x], d = bottom[2 * x + 1];
        out[x] = POOL ? MAX(MAX(a, b), MAX(c, d)) : (a + b + c + d) * 0.25f;
    }
    if (W % 2) out[W / 2] = POOL ? MAX(top[W - 1], bottom[W - 1]) : (top[W - 1] + bottom[W - 1]) * 0.5f;
}

// image [N, H, W] -> out [N, ⌈H/2⌉, ⌈W/2⌉], contiguous.
void downsample(const float *image, float *out, int N, int H, int W, int threads) {
    int h = (H + 1) / 2, w = (W + 1) / 2;
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int64_t row = 0; row < (int64_t)N * h; row++)
        pool_row(image + row / h * H * W, out + row * w, row % h, H, W);
}

// fine, out [B, C, H, W], coarse, change [B, C, h, w], alpha [B, 1, h, w], contiguous. `change` is left holding
// alpha · (coarse - D fine).
void compose(const float *fine, const float *coarse, const float *alpha, float *change, float *out, int B, int C, int H,
             int W, int threads) {
    int h = (H + 1) / 2, w = (W + 1) / 2;
#pragma omp parallel num_threads(threads)
    {
#pragma omp for schedule(static)
        for (int64_t row = 0; row < (int64_t)B * C * h; row++) {
            const float *a = alpha + (row / h / C * h + row % h) * w, *i = coarse + row * w;
            float *d = change + row * w;
            pool_row(fine + row / h * H * W, d, row % h, H, W);
#pragma omp simd
            for (int x = 0; x < w; x++) d[x] = a[x] * (i[x] - d[x]);
        }
#pragma omp for schedule(static)
        for (int64_t row = 0; row < (int64_t)B * C * H; row++) {
            int y = row % H, near = y / 2, far = MIN(MAX(y % 2 ? near + 1 : near - 1, 0), h - 1);
            const float *n = change + (row / H * h + near) * w, *f = change + (row / H * h + far) * w;
            const float *from = fine + row * W;
            float *to = out + row * W;
#define MIXED(x) (0.75f * n[x] + 0.25f * f[x])
            to[0] = from[0] + MIXED(0);
#pragma omp simd
            for (int x = 0; x < w - 1; x++) {  // fine pixels 2x + 1 and 2x + 2 lie between x and x + 1
                float left = MIXED(x), right = MIXED(x + 1);
                to[2 * x + 1] = from[2 * x + 1] + 0.75f * left + 0.25f * right;
                to[2 * x + 2] = from[2 * x + 2] + 0.25f * left + 0.75f * right;
            }
            if (W % 2 == 0) to[W - 1] = from[W - 1] + MIXED(w - 1);
#undef MIXED
        }
    }
}
