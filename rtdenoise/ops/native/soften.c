// The finest detail of a scale taken out of a composed image. The specification is ops/soften.py.
#include "common.h"
#include "pool.h"

// composed, fine, out [B, C, H, W], share [B, 1, H, W], coarse [B, C, h, w], contiguous. `coarse` is scratch memory: it
// holds D fine, and out = composed - (1 - share) · (fine - U[coarse]).
void soften(const float *composed, const float *fine, const float *share, float *coarse, float *out, int B, int C,
            int H, int W, int threads) {
    int h = (H + 1) / 2, w = (W + 1) / 2;
#pragma omp parallel num_threads(threads)
    {
#pragma omp for schedule(static)
        for (int64_t row = 0; row < (int64_t)B * C * h; row++)
            pool_row(fine + row / h * H * W, coarse + row * w, row % h, H, W);
#pragma omp for schedule(static)
        for (int64_t row = 0; row < (int64_t)B * C * H; row++) {
            int y = row % H, near = y / 2, far = MIN(MAX(y % 2 ? near + 1 : near - 1, 0), h - 1);
            const float *n = coarse + (row / H * h + near) * w, *f = coarse + (row / H * h + far) * w;
            const float *from = composed + row * W, *i = fine + row * W, *s = share + (row / H / C * H + y) * W;
            float *to = out + row * W;
#define BETWEEN_ROWS(x) (0.75f * n[x] + 0.25f * f[x])
#define SOFTENED(x, low) (from[x] - (1 - s[x]) * (i[x] - (low)))
            to[0] = SOFTENED(0, BETWEEN_ROWS(0));
#pragma omp simd
            for (int x = 0; x < w - 1; x++) {  // fine pixels 2x + 1 and 2x + 2 lie between x and x + 1
                float left = BETWEEN_ROWS(x), right = BETWEEN_ROWS(x + 1);
                to[2 * x + 1] = SOFTENED(2 * x + 1, 0.75f * left + 0.25f * right);
                to[2 * x + 2] = SOFTENED(2 * x + 2, 0.25f * left + 0.75f * right);
            }
            if (W % 2 == 0) to[W - 1] = SOFTENED(W - 1, BETWEEN_ROWS(w - 1));
#undef SOFTENED
#undef BETWEEN_ROWS
        }
    }
}
