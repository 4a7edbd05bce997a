// Bilinear reprojection that tests every tap, in one pass. The specification is ops/reproject.py. C is the number of
// channels; MIN_HISTORY_WEIGHT and FAR_AWAY are those of constants.py.
#include "common.h"
#include "alike.h"
#include "kept.h"

#define BLOCK 32  // pixels

// Stored images and the geometry of the previous frame are whole planes; all other pointers lead to a row of the current frame.
typedef struct {
    const float *stored[C], *depth, *normal, *depth_before, *normal_before;
    float *out;
    uint8_t *valid;
    float depth_tolerance, normal_tolerance;
    int64_t plane;
    int H, W;
} Row;

// One of the four pixels around a target: its index in a plane and its weight.
typedef struct {
    int at;
    float weight;
} Tap;

// Tap 0 to 3 of pixel x, whose target lies between columns left, left + 1 and rows top, top + 1, with weights f and g of the
// latter. The weight is 0 on another surface or off the screen. `together`: the tap is on the screen and `shift` away.
static inline Tap look_at(int tap, Row r, int x, int left, int top, float f, float g, int together, int shift) {
    int j = left + tap % 2, i = top + tap / 2;
    int inside = together || ((i >= 0) & (i < r.H) & (j >= 0) & (j < r.W));
    int apart = MIN(MAX(i, 0), r.H - 1) * r.W + MIN(MAX(j, 0), r.W - 1);
    int at = together ? shift + tap / 2 * r.W + tap % 2 + x : apart;
    Surface here = surface_at(r.depth, r.normal, r.plane, x);
    Surface before = surface_at(r.depth_before, r.normal_before, r.plane, at);
    int same = inside & alike(here, before, r.depth_tolerance, r.normal_tolerance);
    return (Tap){at, same ? (tap % 2 ? f : 1 - f) * (tap / 2 ? g : 1 - g) : 0};
}

// Pixels [from, to) of a row, with targets as in `look_at`. `together`: all taps are on the screen and `shift` away, so that
// they are loaded in a row instead of gathered.
static inline void look(Row r, const int *left, const int *top, const float *f, const float *g, int from, int to,
                        int together, int shift) {
    int64_t plane = r.plane;
#pragma omp simd
    for (int x = from; x < to; x++) {
        float total = 0, sum[C] = {0};
#pragma GCC unroll 4
        for (int tap = 0; tap < 4; tap++) {
            Tap t = look_at(tap, r, x, left[x - from], top[x - from], f[x - from], g[x - from], together, shift);
            total += t.weight;
#pragma GCC unroll 8
            for (int c = 0; c < C; c++) sum[c] = fmaf(t.weight, r.stored[c][t.at], sum[c]);
        }
        r.valid[x] = total >= MIN_HISTORY_WEIGHT;
        float scale = total >= MIN_HISTORY_WEIGHT ? 1 / total : 0;
#pragma GCC unroll 8
        for (int c = 0; c < C; c++) r.out[c * plane + x] = sum[c] * scale;
    }
}

// Whether `look` has made NaN, as of 0 · NaN or 0 · ∞.
static inline int has_nan(Row r, int from, int to) {
    int found = 0;
    for (int c = 0; c < C; c++)
        for (int x = from; x < to; x++) found |= r.out[c * r.plane + x] != r.out[c * r.plane + x];
    return found;
}

// The same pixels again, without reading taps that have no weight.
static __attribute__((noinline)) void look_again(Row r, const int *left, const int *top, const float *f, const float *g,
                                                 int from, int to) {
    for (int x = from; x < to; x++) {
        float total = 0, sum[C] = {0};
        for (int tap = 0; tap < 4; tap++) {
            Tap t = look_at(tap, r, x, left[x - from], top[x - from], f[x - from], g[x - from], 0, 0);
            total += t.weight;
            for (int c = 0; c < C && t.weight > 0; c++) sum[c] = fmaf(t.weight, r.stored[c][t.at], sum[c]);
        }
        for (int c = 0; c < C; c++) r.out[c * r.plane + x] = total >= MIN_HISTORY_WEIGHT ? sum[c] * (1 / total) : 0;
    }
}

// stored: B × C planes; out [B, C, H, W], motion [B, 2, H, W], depths [B, 1, H, W], normals [B, 3, H, W], valid [B, 1, H, W]
// bool, all contiguous.
void reproject(const float *const *stored, const float *motion, const float *depth, const float *normal,
               const float *depth_before, const float *normal_before, float *out, uint8_t *valid, int B, int H, int W,
               float depth_tolerance, float normal_tolerance, int threads) {
    int64_t plane = (int64_t)H * W;
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int64_t row = 0; row < (int64_t)B * H; row++) {
        int64_t b = row / H, y = row % H, pixel = y * W;
        const float *mx = motion + b * 2 * plane + pixel, *my = mx + plane;
        Row r = {{0}, depth + b * plane + pixel, normal + b * 3 * plane + pixel,
                 depth_before + b * plane, normal_before + b * 3 * plane, out + b * C * plane + pixel,
                 valid + b * plane + pixel, depth_tolerance, normal_tolerance, plane, H, W};
        for (int c = 0; c < C; c++) r.stored[c] = stored[b * C + c];
        for (int from = 0; from < W; from += BLOCK) {
            int n = MIN(BLOCK, W - from), left[BLOCK], top[BLOCK], apart = 0;
            float f[BLOCK], g[BLOCK];
#pragma omp simd
            for (int x = 0; x < n; x++) {
                float u = bounded(mx[from + x]) + (from + x), v = bounded(my[from + x]) + y;
                left[x] = (int)floorf(u), top[x] = (int)floorf(v);
                f[x] = u - floorf(u), g[x] = v - floorf(v);
            }
            for (int x = 0; x < n; x++) apart |= (left[x] - x != left[0]) | (top[x] != top[0]);
            int on_screen = left[0] >= 0 && left[0] + n < W && top[0] >= 0 && top[0] + 1 < H;
            if (apart || !on_screen) look(r, left, top, f, g, from, from + n, 0, 0);
            else look(r, left, top, f, g, from, from + n, 1, top[0] * W + left[0] - from);
            if (has_nan(r, from, from + n)) look_again(r, left, top, f, g, from, from + n);
        }
    }
}

// Backward: scatters grad to the taps of each lookup, and adds; both are [B, C, H, W]. All else as above.
void reproject_backward(float *grad_stored, const float *motion, const float *depth, const float *normal,
                        const float *depth_before, const float *normal_before, const float *grad, int B, int H, int W,
                        float depth_tolerance, float normal_tolerance, int threads) {
    int64_t plane = (int64_t)H * W;
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int b = 0; b < B; b++) {  // two rows may add to the same pixel
        const float *mx = motion + b * 2 * plane, *my = mx + plane, *from = grad + b * C * plane;
        float *to = grad_stored + b * C * plane;
        Row r = {{0}, depth + b * plane, normal + b * 3 * plane, depth_before + b * plane,
                 normal_before + b * 3 * plane, 0, 0, depth_tolerance, normal_tolerance, plane, H, W};
        for (int64_t at = 0; at < plane; at++) {  // the image as one long row
            float u = bounded(mx[at]) + at % W, v = bounded(my[at]) + at / W, left = floorf(u), top = floorf(v), total = 0;
            Tap taps[4];
            for (int k = 0; k < 4; k++) {
                taps[k] = look_at(k, r, at, (int)left, (int)top, u - left, v - top, 0, 0);
                total += taps[k].weight;
            }
            if (total < MIN_HISTORY_WEIGHT) continue;
            for (int k = 0; k < 4; k++)
                for (int c = 0; c < C; c++)
                    to[c * plane + taps[k].at] += taps[k].weight / total * from[c * plane + at];
        }
    }
}
