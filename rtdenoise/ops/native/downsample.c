// D of eq. 4. The specification is ops/downsample.py.
#include "common.h"
#include "pool.h"

// image [N, H, W] -> out [N, ⌈H/2⌉, ⌈W/2⌉], contiguous.
void downsample(const float *image, float *out, int N, int H, int W, int threads) {
    int h = (H + 1) / 2, w = (W + 1) / 2;
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int64_t row = 0; row < (int64_t)N * h; row++)
        pool_row(image + row / h * H * W, out + row * w, row % h, H, W);
}
