// softmax over the K² taps of every pixel, and their weighted sum, in one reading of the logits. The specification is
// ops/apply_kernel.py. Specialised by K (side of the kernel), C (channels) and LOGIT (0: float32, 1: bfloat16,
// 2: float16).
//
// The inner loops run over the taps of one pixel and are unrolled; the loop over x becomes vector code, so that sums and
// maximum stay in registers. Pixels whose taps leave the image go through the same functions with fewer taps.
#include "common.h"

#define R (K / 2)
#define BLOCK 64  // pixels

static inline float from_bits(uint32_t bits) {
    float x;
    memcpy(&x, &bits, sizeof x);
    return x;
}

#if LOGIT == 0
typedef float logit;
static inline float value(logit v) { return v; }
#elif LOGIT == 1
typedef uint16_t logit;
static inline float value(logit v) { return from_bits((uint32_t)v << 16); }
#else
// In integers, which every compiler makes vector code of: the exponent moves from bias 15 to 127 by a product that is
// exact for subnormal numbers too; Inf and NaN have an exponent of their own.
typedef uint16_t logit;
static inline float value(logit v) {
    uint32_t size = (uint32_t)(v & 0x7fff) << 13, sign = (uint32_t)(v & 0x8000) << 16;
    float x = from_bits(size) * 0x1p112f;
    uint32_t bits;
    memcpy(&bits, &x, sizeof bits);
    return from_bits(bits | sign | (size >= 0x0f800000 ? 0x7f800000 : 0));
}
#endif

typedef struct { int y0, y1, x0, x1; } Taps;  // dy in [y0, y1), dx in [x0, x1)

#define FOR_TAPS(t) \
    _Pragma("GCC unroll 16") for (int dy = (t).y0; dy < (t).y1; dy++) \
    _Pragma("GCC unroll 16") for (int dx = (t).x0; dx < (t).x1; dx++)
#define FOR_CHANNELS _Pragma("GCC unroll 8") for (int c = 0; c < C; c++)

static const Taps ALL = {0, K, 0, K};

// Taps of pixel (y, x) that lie inside the image.
static inline Taps inside(int y, int x, int H, int W) {
    return (Taps){MAX(0, R - y), MIN(K, H + R - y), MAX(0, R - x), MIN(K, W + R - x)};
}

// Calls PIXEL(x, taps) for x in [from, to) of a row: vector code where all taps are inside.
#define SPAN(PIXEL, from, to) do { \
    int whole = y >= R && y < H - R && W > 2 * R; \
    int left = whole ? MAX(from, MIN(to, R)) : (to), right = whole ? MAX(left, MIN(to, W - R)) : (to); \
    for (int x = (from); x < left; x++) PIXEL(x, inside(y, x, H, W)); \
    _Pragma("omp simd") for (int x = left; x < right; x++) PIXEL(x, ALL); \
    for (int x = right; x < (to); x++) PIXEL(x, inside(y, x, H, W)); \
} while (0)

// Pointers are at the row's first pixel; `logits` where its pixel x is at `column`, with planes `stride` apart. `image`
// and `out` have planes `plane` apart.
static inline void forward_pixel(const float *image, const logit *logits, float *out, float *stats, int64_t plane,
                                 int64_t stride, int column, int W, int x, Taps t) {
    float most = -INFINITY, sum = 0, colour[C] = {0};
    FOR_TAPS(t) {
        float v = value(logits[(dy * K + dx) * stride + column]);
        most = v > most ? v : most;
    }
    FOR_TAPS(t) {
        float w = exp_negative(value(logits[(dy * K + dx) * stride + column]) - most);
        sum += w;
        FOR_CHANNELS colour[c] = fmaf(w, image[c * plane + (dy - R) * (int64_t)W + dx - R + x], colour[c]);
    }
    float scale = 1 / sum;
    FOR_CHANNELS out[c * plane + x] = colour[c] * scale;
    if (stats) stats[x] = most, stats[plane + x] = scale;
}

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

// grad_image[p] = Σ_k w[k, q] · grad[q] over the pixels q = p - (tap k) that read p: a gather, so threads never collide.
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

// image, out [B, C, H, W], stats [B, 2, H, W] (maximum and 1/sum; may be null) contiguous; logits [B, K², H, W] with
// images `batch`, planes `stride` and pixels `step` values apart, rows step · W. Where step is not 1 (a convolution's
// output, channels last) some pixels at a time are turned into planes that stay in the nearest cache.
void forward(const float *image, const logit *logits, float *out, float *stats, int B, int H, int W, int64_t batch,
             int64_t stride, int64_t step, int threads) {
    EACH_ROW {
        int b = row / H, y = row % H;
        int64_t pixel = (int64_t)y * W, first = b * C * plane + pixel;
        const logit *l = logits + b * batch + pixel * step;
        float *s = stats ? stats + b * 2 * plane + pixel : 0;
#define PIXEL(x, taps) forward_pixel(image + first, l, out + first, s, plane, stride, x, W, x, taps)
        if (step == 1) SPAN(PIXEL, 0, W);
#undef PIXEL
        for (int from = 0; step != 1 && from < W; from += BLOCK) {
            int to = MIN(from + BLOCK, W);
            logit planes[K * K * BLOCK];
            for (int x = from; x < to; x++)
                _Pragma("GCC unroll 49") for (int k = 0; k < K * K; k++)
                    planes[k * BLOCK + x - from] = l[x * step + k * stride];
#define PIXEL(x, taps) forward_pixel(image + first, planes, out + first, s, plane, BLOCK, x - from, W, x, taps)
            SPAN(PIXEL, from, to);
#undef PIXEL
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
