// Bilinear or cubic reprojection in one pass. The specification is ops/warp.py. C is the number of channels; TAPS along
// either axis is 2 (bilinear) or 4 (cubic).
#include "common.h"
#include "targets.h"

// The taps along one axis: indices and weights.
typedef struct {
    int at[TAPS];
    float weight[TAPS];
} Axis;

static inline Axis axis(float u, int n) {
    int i = (int)u;
    float f = u - i;
#if TAPS == 4
    return (Axis){{MAX(i - 1, 0), i, MIN(i + 1, n - 1), MIN(i + 2, n - 1)},
                  {f * (f * (1 - 0.5f * f) - 0.5f), 1 + f * f * (1.5f * f - 2.5f), f * (0.5f + f * (2 - 1.5f * f)),
                   f * f * (0.5f * f - 0.5f)}};
#else
    return (Axis){{i, MIN(i + 1, n - 1)}, {1 - f, f}};
#endif
}

static inline float look_up(const float *plane, Axis x, Axis y, int W) {
    float sum = 0;
#pragma GCC unroll 4
    for (int j = 0; j < TAPS; j++) {
        float line = 0;
#pragma GCC unroll 4
        for (int i = 0; i < TAPS; i++) line += plane[y.at[j] * W + x.at[i]] * x.weight[i];
        sum += line * y.weight[j];
    }
    return sum;
}

// The 2×2 pixels around a target and their range, to which a cubic lookup is clamped.
typedef struct {
    int at[4];
    float least, greatest;
} Around;

static inline Around around(const float *plane, Axis x, Axis y, int W) {
    const int n = TAPS / 2;
    int p = y.at[n - 1] * W + x.at[n - 1], q = y.at[n - 1] * W + x.at[n], r = y.at[n] * W + x.at[n - 1],
        s = y.at[n] * W + x.at[n];
    float least = MIN(MIN(plane[p], plane[q]), MIN(plane[r], plane[s]));
    float greatest = MAX(MAX(plane[p], plane[q]), MAX(plane[r], plane[s]));
    return (Around){{p, q, r, s}, least, greatest};
}

// image, otherwise, out [B, C, H, W], motion [B, 2, H, W], seen [B, 1, H, W] bool, contiguous. `seen` and `otherwise` may
// both be null.
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
            Axis across = axis(clamped_target(mx[x], x, W), W), down = axis(clamped_target(my[x], y, H), H);
#pragma GCC unroll 8
            for (int c = 0; c < C; c++) {
                float found = look_up(from + c * plane, across, down, W);
#if TAPS == 4
                Around a = around(from + c * plane, across, down, W);
                found = found < a.least ? a.least : found > a.greatest ? a.greatest : found;  // NaN stays
#endif
                to[c * plane + x] = found;
            }
        }
        const uint8_t *s = seen ? seen + row * W : 0;
        if (!s || !memchr(s, 0, W)) continue;  // most rows: `otherwise` is not read
        for (int c = 0; c < C; c++) {
            const float *other = otherwise + (b * C + c) * plane + (int64_t)y * W;
#pragma omp simd
            for (int x = 0; x < W; x++) to[c * plane + x] = s[x] ? to[c * plane + x] : other[x];
        }
    }
}

// Backward: scatters grad to the taps of each lookup, and adds. The gradient of a clamped lookup goes to the pixels that it
// was clamped to, in equal parts.
void warp_backward(float *grad_image, const float *image, const float *motion, const float *grad, int B, int H, int W,
                   int threads) {
    int64_t plane = (int64_t)H * W;
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int n = 0; n < B * C; n++) {  // two rows may add to the same pixel
        const float *from = image + n * plane, *mx = motion + n / C * 2 * plane, *my = mx + plane, *g = grad + n * plane;
        float *to = grad_image + n * plane;
        for (int64_t p = 0; p < plane; p++) {
            Axis x = axis(clamped_target(mx[p], p % W, W), W), y = axis(clamped_target(my[p], p / W, H), H);
#if TAPS == 4
            float found = look_up(from, x, y, W);
            Around a = around(from, x, y, W);
            if (found < a.least || found > a.greatest) {
                float limit = found < a.least ? a.least : a.greatest;
                int equal = 0;
                for (int k = 0; k < 4; k++) equal += from[a.at[k]] == limit;
                for (int k = 0; k < 4; k++) to[a.at[k]] += from[a.at[k]] == limit ? g[p] / equal : 0;
                continue;
            }
#endif
            for (int j = 0; j < TAPS; j++)
                for (int i = 0; i < TAPS; i++) to[y.at[j] * W + x.at[i]] += y.weight[j] * x.weight[i] * g[p];
        }
    }
}
