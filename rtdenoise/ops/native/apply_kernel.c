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

// Logits of a block of pixels, turned from channels last into planes that stay in the nearest cache. They move 32 bits at
// a time: a word holds one float32, or two neighbouring 16-bit logits.
#define PER (sizeof(uint32_t) / sizeof(logit))
#define WORDS ((K * K + PER - 1) / PER)

static inline float of_word(uint32_t word, int k) {
    if (sizeof(logit) == 4) return from_bits(word);
    return value(k % 2 ? word >> 16 : word & 0xffff);
}

// `from`: the logits of one pixel. The last word may have one logit only, with nothing behind it.
static inline void pack(const logit *from, uint32_t *words) {
    _Pragma("GCC unroll 49") for (int i = 0; i < (int)WORDS; i++) {
        uint32_t word = 0;
        int whole = (i + 1) * (int)PER <= K * K;
        memcpy(&word, from + i * PER, whole ? sizeof word : sizeof *from);
        words[i * BLOCK] = word;
    }
}

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

// Pointers are at the row's first pixel. Logit k of pixel x is in `words`, where there are some, at `column` of a block;
// else in `logits`, with planes `stride` apart. `image` and `out` have planes `plane` apart.
static inline void forward_pixel(const float *image, const logit *logits, const uint32_t *words, float *out,
                                 float *stats, int64_t plane, int64_t stride, int column, int W, int x, Taps t) {
#define LOGIT_AT(k) (words ? of_word(words[(k) / PER * BLOCK + column], k) : value(logits[(k) * stride + column]))
    float most = -INFINITY, sum = 0, colour[C] = {0};
    FOR_TAPS(t) {
        float v = LOGIT_AT(dy * K + dx);
        most = v > most ? v : most;
    }
    FOR_TAPS(t) {
        float w = exp_negative(LOGIT_AT(dy * K + dx) - most);
        sum += w;
        FOR_CHANNELS colour[c] = fmaf(w, image[c * plane + (dy - R) * (int64_t)W + dx - R + x], colour[c]);
    }
    float scale = 1 / sum;
    FOR_CHANNELS out[c * plane + x] = colour[c] * scale;
    if (stats) stats[x] = most, stats[plane + x] = scale;
#undef LOGIT_AT
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

// Where logits lie, in values from the first: image b, tap k, and pixel (y, x), which may be one of a cell of 2×2.
typedef struct { int64_t batch, tap, cell_row, row, cell, pixel; } Layout;
#define OFFSET(l, b, y, x) \
    ((b) * (l).batch + (y) / 2 * (l).cell_row + (y) % 2 * (l).row + (x) / 2 * (l).cell + (x) % 2 * (l).pixel)

// image, out [B, C, H, W], stats [B, 2, H, W] (maximum and 1/sum; may be null) contiguous. Logits of a row are
// neighbours along x (planes) or along k (a convolution's output, channels last).
void forward(const float *image, const logit *logits, float *out, float *stats, int B, int H, int W,
             const Layout *layout, int threads) {
    Layout at = *layout;
    int planes = at.pixel == 1 && at.cell == 2;
    EACH_ROW {
        int b = row / H, y = row % H;
        int64_t pixel = (int64_t)y * W, first = b * C * plane + pixel;
        float *s = stats ? stats + b * 2 * plane + pixel : 0;
        const logit *l = logits + OFFSET(at, b, y, 0);
#define PIXEL(x, taps) forward_pixel(image + first, l, 0, out + first, s, plane, at.tap, x, W, x, taps)
        if (planes) SPAN(PIXEL, 0, W);
#undef PIXEL
        for (int from = 0; !planes && from < W; from += BLOCK) {
            int to = MIN(from + BLOCK, W);
            uint32_t words[WORDS * BLOCK];
            for (int x = from; x < to; x++) pack(l + OFFSET(at, 0, 0, x), words + x - from);
#define PIXEL(x, taps) forward_pixel(image + first, 0, words, out + first, s, plane, 0, x - from, W, x, taps)
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
