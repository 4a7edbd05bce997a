// Eq. 4. The specification is ops/compose.py.
#include "common.h"
#include "pool.h"

// fine, out [B, C, H, W], coarse, change [B, C, h, w], alpha [B, 1, h, w], contiguous. `change` is scratch memory: it holds
// alpha · (coarse - D fine), and out = fine + U[change].
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
#define BETWEEN_ROWS(x) (0.75f * n[x] + 0.25f * f[x])
            to[0] = from[0] + BETWEEN_ROWS(0);
#pragma omp simd
            for (int x = 0; x < w - 1; x++) {  // fine pixels 2x + 1 and 2x + 2 lie between x and x + 1
                float left = BETWEEN_ROWS(x), right = BETWEEN_ROWS(x + 1);
                to[2 * x + 1] = from[2 * x + 1] + 0.75f * left + 0.25f * right;
                to[2 * x + 2] = from[2 * x + 2] + 0.25f * left + 0.75f * right;
            }
            if (W % 2 == 0) to[W - 1] = from[W - 1] + BETWEEN_ROWS(w - 1);
#undef BETWEEN_ROWS
        }
    }
}
