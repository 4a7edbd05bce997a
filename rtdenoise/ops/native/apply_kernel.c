// Softmax over the K² taps of every pixel and their weighted sum; logits are read once. The specification is
// ops/apply_kernel.py. K is the side of the kernel, C the number of channels, LOGIT the type of the logits (logits.h).
//
// The inner loops, over the taps of one pixel, are unrolled and the loop over x is vectorised, so that sums and maximum stay
// in registers. Taps outside the image get no weight in `forward`; the backward passes visit fewer taps there.
#include "common.h"

#define R (K / 2)
#define N (K * K)
#include "logits.h"
#include "taps.h"

// Taps of pixel (y, x) that lie inside the image.
static inline Taps inside(int y, int x, int H, int W) {
    return (Taps){MAX(0, R - y), MIN(K, H + R - y), MAX(0, R - x), MIN(K, W + R - x)};
}

// PIXEL(x, taps) for x in [from, to) of a row, vectorised where all taps are inside.
#define SPAN(PIXEL, from, to) do { \
    int whole = y >= R && y < H - R && W > 2 * R; \
    int left = whole ? MAX(from, MIN(to, R)) : (to), right = whole ? MAX(left, MIN(to, W - R)) : (to); \
    for (int x = (from); x < left; x++) PIXEL(x, inside(y, x, H, W)); \
    _Pragma("omp simd") for (int x = left; x < right; x++) PIXEL(x, ALL); \
    for (int x = right; x < (to); x++) PIXEL(x, inside(y, x, H, W)); \
} while (0)

// grad_logits[k] = w[k] · (grad · image[tap k] - grad · out)
static inline void backward_logits_pixel(const float *image, const logit *logits, const float *out, const float *stats,
                                         const float *grad, float *grad_logits, int64_t plane, int64_t stride, int W,
                                         int x, Taps t) {
    float most = stats[x], scale = stats[plane + x], mean = 0;
    FOR_CHANNELS mean = fmaf(grad[c * plane + x], out[c * plane + x], mean);
    FOR_TAPS(t) {
        float w = exp_negative(value(logits[(dy * K + dx) * stride + x]) - most) * scale, dot = -mean;
        FOR_CHANNELS dot = fmaf(grad[c * plane + x], image[c * plane + (dy - R) * (int64_t)W + dx - R + x], dot);
        grad_logits[(dy * K + dx) * plane + x] = w * dot;
    }
}

// grad_image[p] = Σ_k w[k, q] · grad[q] over the pixels q = p - (tap k) that read p. A gather: threads never collide.
static inline void backward_image_pixel(const logit *logits, const float *stats, const float *grad, float *grad_image,
                                        int64_t plane, int64_t stride, int W, int x, Taps t) {
    float colour[C] = {0};
    FOR_TAPS(t) {  // q = p + (dy - R, dx - R) reads p with its opposite tap
        int64_t q = (dy - R) * (int64_t)W + dx - R + x;
        float w = exp_negative(value(logits[((K - 1 - dy) * K + K - 1 - dx) * stride + q]) - stats[q]);
        w *= stats[plane + q];
        FOR_CHANNELS colour[c] = fmaf(w, grad[c * plane + q], colour[c]);
    }
    FOR_CHANNELS grad_image[c * plane + x] = colour[c];
}

#define EACH_ROW \
    int64_t plane = (int64_t)H * W; \
    _Pragma("omp parallel for num_threads(threads) schedule(static)") \
    for (int64_t row = 0; row < (int64_t)B * H; row++)
#define HERE \
    int b = row / H, y = row % H; \
    int64_t pixel = (int64_t)y * W, first = b * C * plane + pixel, firstStats = b * 2 * plane + pixel; \
    const logit *l = logits + b * batch + pixel;

// A block of a row, as the loop over its pixels reads it. Tap (dy, dx) of pixel x has the logit
// values[(dy * K + dx) * BLOCK + x] and, in channel c, the value row[dy][c * plane + dx + x].
typedef struct {
    float values[READ * BLOCK], patch[C * K * (BLOCK + 2 * R)];
    const float *row[K];
    int64_t plane;
} Block;

// Pixels that are not `seen` take the values of `otherwise`. If `seen` is null, all pixels are seen.
typedef struct { const uint8_t *seen; const float *otherwise; } Gaps;

// Sets the rows of `image` (one of the batch) under pixels [from, to) of row y. Outside the image its border is repeated, by
// the pointers to rows and by a copy under the first and the last block; taps there get logits of -Inf. Rows with gaps are
// copied too, and filled.
static inline void place(Block *o, const float *image, Gaps gaps, int y, int from, int to, int H, int W) {
    int pixels = to - from, beside = from < R || to > W - R, above = y < R || y >= H - R, filled = 0;
    int n = pixels + 2 * R, left = MAX(R - from, 0), right = MIN(n, W + R - from);
    int64_t first[K], plane = (int64_t)H * W;
    o->plane = plane;
    for (int dy = 0; dy < K; dy++) {
        first[dy] = (int64_t)MIN(MAX(y + dy - R, 0), H - 1) * W + from - R;
        o->row[dy] = image + first[dy];
        filled |= gaps.seen && memchr(gaps.seen + first[dy] + left, 0, right - left);
    }
    if (beside || filled) {
        for (int dy = 0; dy < K; dy++) {
            for (int c = 0; c < C; c++) {
                float *copy = o->patch + (c * K + dy) * (BLOCK + 2 * R);
                int64_t at = c * plane + first[dy];
                memcpy(copy + left, image + at + left, (right - left) * sizeof *copy);
                for (int x = left; filled && x < right; x++)
                    if (!gaps.seen[first[dy] + x]) copy[x] = gaps.otherwise[at + x];
                for (int x = 0; x < left; x++) copy[x] = copy[left];
                for (int x = right; x < n; x++) copy[x] = copy[right - 1];
            }
            o->row[dy] = o->patch + dy * (BLOCK + 2 * R);
        }
        o->plane = K * (BLOCK + 2 * R);
    }
    for (int k = 0; k < K * K && (beside || above); k++) {
        int dy = k / K, dx = k % K, inside = y + dy >= R && y + dy < H + R;
        int first = inside ? MAX(R - dx - from, 0) : pixels, last = inside ? MIN(W + R - dx - from, pixels) : pixels;
        for (int x = 0; x < first; x++) o->values[k * BLOCK + x] = -INFINITY;
        for (int x = MAX(first, last); x < pixels; x++) o->values[k * BLOCK + x] = -INFINITY;
    }
}

// image, out, spatial [B, C, H, W], stats [B, 2, H, W] (maximum and 1/sum), seen [B, 1, H, W] bool, alpha [B, 1, H, W],
// contiguous; logits as `read_logits` wants them. `stats` may be null, and so may the last three together. With them this is
// ops/blend_history.py: the image is `spatial` where not `seen`, and the result is blended with `spatial`.
void forward(const float *image, const logit *logits, float *out, float *stats, const uint8_t *seen,
             const float *spatial, const float *alpha, int B, int H, int W, const Layout *layout, int threads) {
    Layout at = *layout;
    EACH_ROW {
        int b = row / H, y = row % H;
        const logit *l = logits + OFFSET(at, b, y, 0);
        for (int from = 0; from < W; from += BLOCK) {
            int to = MIN(from + BLOCK, W), pixels = to - from;
            Block block;
            read_logits(l, at, from, pixels, block.values);
            int64_t before = b * C * plane, here = before + y * (int64_t)W + from;
            Gaps gaps = {seen ? seen + b * plane : 0, seen ? spatial + before : 0};
            place(&block, image + before, gaps, y, from, to, H, W);
            float most[BLOCK], scale[BLOCK], *o = out + here;
            greatest(block.values, pixels, most);
            _Pragma("omp simd") for (int x = 0; x < pixels; x++) {
                float sum = 0, colour[C] = {0};
                FOR_TAPS(ALL) {
                    float w = exp_negative(block.values[(dy * K + dx) * BLOCK + x] - most[x]);
                    sum += w;
                    FOR_CHANNELS colour[c] = fmaf(w, block.row[dy][c * block.plane + dx + x], colour[c]);
                }
                scale[x] = 1 / sum;
                FOR_CHANNELS o[c * plane + x] = colour[c] * scale[x];
            }
            for (int c = 0; alpha && c < C; c++) {
                const float *a = alpha + b * plane + y * (int64_t)W + from, *s = spatial + here + c * plane;
                _Pragma("omp simd") for (int x = 0; x < pixels; x++)
                    o[c * plane + x] = lerp(o[c * plane + x], s[x], a[x]);
            }
            if (stats) {
                float *s = stats + (b * 2 * (int64_t)H + y) * W + from;
                memcpy(s, most, pixels * sizeof *s), memcpy(s + plane, scale, pixels * sizeof *s);
            }
        }
    }
}

// grad_logits [B, K², H, W] contiguous, zero where a tap is outside.
void backward_logits(const float *image, const logit *logits, const float *out, const float *stats, const float *grad,
                     float *grad_logits, int B, int H, int W, int64_t batch, int64_t stride, int threads) {
    EACH_ROW {
        HERE
        float *g = grad_logits + b * K * K * plane + pixel;
#define PIXEL(x, taps) \
    backward_logits_pixel(image + first, l, out + first, stats + firstStats, grad + first, g, plane, stride, W, x, taps)
        SPAN(PIXEL, 0, W);
#undef PIXEL
    }
}

void backward_image(const logit *logits, const float *stats, const float *grad, float *grad_image, int B, int H, int W,
                    int64_t batch, int64_t stride, int threads) {
    EACH_ROW {
        HERE
#define PIXEL(x, taps) \
    backward_image_pixel(l, stats + firstStats, grad + first, grad_image + first, plane, stride, W, x, taps)
        SPAN(PIXEL, 0, W);
#undef PIXEL
    }
}
