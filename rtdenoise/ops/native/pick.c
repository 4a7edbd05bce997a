// Every fine pixel picks from the K×K coarse ones around it. The specification is ops/pick.py. K, C and LOGIT as in
// apply_kernel.c.
#include "common.h"

#define R (K / 2)
#define N (K * K)
#include "logits.h"
#include "taps.h"

#define WIDTH (BLOCK + 4 * R)  // of a row of coarse pixels under a block of fine ones, every pixel twice

// Copy the coarse pixels, [C, h, w] of one image, under fine pixels [from, from + pixels) of row y: tap (dy, dx) of pixel
// from + x is patch[(c * K + dy) * WIDTH + 2 * dx + x]. Taps outside the image repeat its border and get logits of -Inf.
// `from` is even.
static inline void place(const float *coarse, float *patch, float *values, int y, int from, int pixels, int h, int w) {
    int cells = (pixels + 1) / 2 + 2 * R, first = from / 2 - R;
    for (int dy = 0; dy < K; dy++) {
        int row = y / 2 + dy - R;
        const float *line = coarse + (int64_t)MIN(MAX(row, 0), h - 1) * w;
        for (int c = 0; c < C; c++) {
            const float *source = line + c * (int64_t)h * w;
            float *to = patch + (c * K + dy) * WIDTH;
            for (int i = 0; i < cells; i++) to[2 * i] = to[2 * i + 1] = source[MIN(MAX(first + i, 0), w - 1)];
        }
        for (int dx = 0; dx < K; dx++) {
            int inside = row >= 0 && row < h;
            int left = inside ? MIN(MAX(2 * (R - dx) - from, 0), pixels) : pixels;
            int right = inside ? MIN(MAX(2 * (w + R - dx) - from, left), pixels) : pixels;
            float *v = values + (dy * K + dx) * BLOCK;
            for (int x = 0; x < left; x++) v[x] = -INFINITY;
            for (int x = right; x < pixels; x++) v[x] = -INFINITY;
        }
    }
}

// fine, out [B, C, H, W], coarse [B, C, ⌈H/2⌉, ⌈W/2⌉], share [B, 1, H, W], contiguous; logits as `read_logits` wants them.
void pick(const float *fine, const float *coarse, const float *share, const logit *logits, float *out, int B, int H, int W,
          const Layout *layout, int threads) {
    Layout at = *layout;
    int h = (H + 1) / 2, w = (W + 1) / 2;
    int64_t plane = (int64_t)H * W;
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int64_t row = 0; row < (int64_t)B * H; row++) {
        int b = row / H, y = row % H;
        const logit *l = logits + OFFSET(at, b, y, 0);
        for (int from = 0; from < W; from += BLOCK) {
            int pixels = MIN(BLOCK, W - from);
            float values[READ * BLOCK], patch[C * K * WIDTH], most[BLOCK];
            read_logits(l, at, from, pixels, values);
            place(coarse + b * C * (int64_t)h * w, patch, values, y, from, pixels, h, w);
            greatest(values, pixels, most);
            int64_t here = b * C * plane + y * (int64_t)W + from;
            const float *f = fine + here, *s = share + b * plane + y * (int64_t)W + from;
            float *o = out + here;
            _Pragma("omp simd") for (int x = 0; x < pixels; x++) {
                float sum = 0, colour[C] = {0};
                FOR_TAPS(ALL) {
                    float e = exp_negative(values[(dy * K + dx) * BLOCK + x] - most[x]);
                    sum += e;
                    FOR_CHANNELS colour[c] = fmaf(e, patch[(c * K + dy) * WIDTH + 2 * dx + x], colour[c]);
                }
                FOR_CHANNELS o[c * plane + x] = lerp(f[c * plane + x], colour[c] / sum, s[x]);
            }
        }
    }
}
