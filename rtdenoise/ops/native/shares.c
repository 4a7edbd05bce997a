// Blend weights from logits by cells. The specification is ops/shares.py. N is the number of weights a pixel; LOGIT as in
// logits.h.
#include "common.h"

#include "logits.h"

static inline float sigmoid(float x) {
    float e = exp_negative(-fabsf(x)), large = 1 / (1 + e);
    return x < 0 ? e * large : large;
}

// out [B, N, H, W], contiguous.
void shares(const logit *logits, float *out, int B, int H, int W, const Layout *layout, int threads) {
    Layout at = *layout;
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int64_t row = 0; row < (int64_t)B * H; row++) {
        int64_t b = row / H, y = row % H, plane = (int64_t)H * W;
        const logit *l = logits + OFFSET(at, b, y, 0);
        for (int from = 0; from < W; from += BLOCK) {
            int pixels = MIN(BLOCK, W - from);
            float values[READ * BLOCK], *o = out + b * N * plane + y * W + from;
            read_logits(l, at, from, pixels, values);
            for (int k = 0; k < N; k++)
                _Pragma("omp simd") for (int x = 0; x < pixels; x++) o[k * plane + x] = sigmoid(values[k * BLOCK + x]);
        }
    }
}
