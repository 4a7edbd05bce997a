// Bilinear reprojection whose taps are tested one by one, in one pass. The specification is ops/reproject.py; C is the
// number of channels. A plane has < 2³¹ pixels.
#include "common.h"

static inline float target(float motion) {  // far away is as good as off the screen
    return isnan(motion) ? 1e6f : MIN(MAX(motion, -1e6f), 1e6f);
}

#define BLOCK 32  // pixels

// What is looked up, of the whole previous frame; the rest where a row of the current one begins.
typedef struct {
    const float *stored[C], *depth, *normal, *depth_before, *normal_before;
    float *out;
    uint8_t *valid;
    float depth_tolerance, normal_tolerance, least;
    int64_t plane;
    int H, W;
} Row;

// One of the four pixels that a pixel looks between: where in a plane, and how much it counts.
typedef struct {
    int at;
    float weight;
} Tap;

// Pixel x of a row, which looks between left, left + 1 and top, top + 1, with weights f and g of the second: a tap has
// the bilinear one, or 0 where it is on another surface or off the screen. `together`: it is `shift` away and on the screen.
static inline Tap look_at(int tap, Row r, int x, int left, int top, float f, float g, int together, int shift) {
    int64_t plane = r.plane;
    float d = r.depth[x], nx = r.normal[x], ny = r.normal[plane + x], nz = r.normal[2 * plane + x];
    int j = left + tap % 2, i = top + tap / 2;
    int inside = together || ((i >= 0) & (i < r.H) & (j >= 0) & (j < r.W));
    int apart = MIN(MAX(i, 0), r.H - 1) * r.W + MIN(MAX(j, 0), r.W - 1);
    int at = together ? shift + tap / 2 * r.W + tap % 2 + x : apart;
    const float *n = r.normal_before + at;
    float wd = r.depth_before[at], wx = n[0], wy = n[plane], wz = n[2 * plane];
    float length = sqrtf((nx * nx + ny * ny + nz * nz) * (wx * wx + wy * wy + wz * wz));
    int near = fabsf(d - wd) <= r.depth_tolerance * MAX(d, wd);
    int aligned = nx * wx + ny * wy + nz * wz >= r.normal_tolerance * length;
    int hit = d > 0, was_hit = wd > 0;
    int same = inside & ((hit & was_hit & near & aligned) | (!hit & !was_hit));
    return (Tap){at, same ? (tap % 2 ? f : 1 - f) * (tap / 2 ? g : 1 - g) : 0};
}

// Pixels [from, to) of a row, which look between the pixels left, left + 1 and top, top + 1, with weights f and g of the
// second. `together`: all of them are `shift` pixels away and on the screen, which makes a load of what else is a gather.
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
        r.valid[x] = total >= r.least;
        float scale = total >= r.least ? 1 / total : 0;
#pragma GCC unroll 8
        for (int c = 0; c < C; c++) r.out[c * plane + x] = sum[c] * scale;
    }
}

// stored: B × C planes; out [B, C, H, W], motion [B, 2, H, W], depths [B, 1, H, W], normals [B, 3, H, W], valid [B, 1, H, W] bool,
// all contiguous.
void reproject(const float *const *stored, const float *motion, const float *depth, const float *normal,
               const float *depth_before, const float *normal_before, float *out, uint8_t *valid, int B, int H, int W,
               float depth_tolerance, float normal_tolerance, float least, int threads) {
    int64_t plane = (int64_t)H * W;
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int64_t row = 0; row < (int64_t)B * H; row++) {
        int64_t b = row / H, y = row % H, pixel = y * W;
        const float *mx = motion + b * 2 * plane + pixel, *my = mx + plane;
        Row r = {{0}, depth + b * plane + pixel, normal + b * 3 * plane + pixel,
                 depth_before + b * plane, normal_before + b * 3 * plane, out + b * C * plane + pixel,
                 valid + b * plane + pixel, depth_tolerance, normal_tolerance, least, plane, H, W};
        for (int c = 0; c < C; c++) r.stored[c] = stored[b * C + c];
        for (int from = 0; from < W; from += BLOCK) {
            int n = MIN(BLOCK, W - from), left[BLOCK], top[BLOCK], apart = 0;
            float f[BLOCK], g[BLOCK];
#pragma omp simd
            for (int x = 0; x < n; x++) {
                float u = target(mx[from + x]) + (from + x), v = target(my[from + x]) + y;
                left[x] = (int)floorf(u), top[x] = (int)floorf(v);
                f[x] = u - floorf(u), g[x] = v - floorf(v);
            }
            for (int x = 0; x < n; x++) apart |= (left[x] - x != left[0]) | (top[x] != top[0]);
            int on_screen = left[0] >= 0 && left[0] + n < W && top[0] >= 0 && top[0] + 1 < H;
            if (apart || !on_screen) look(r, left, top, f, g, from, from + n, 0, 0);
            else look(r, left, top, f, g, from, from + n, 1, top[0] * W + left[0] - from);
        }
    }
}

// The way back: grad is added to grad_stored, both [B, C, H, W], where each tap came from. The rest as above.
void reproject_backward(float *grad_stored, const float *motion, const float *depth, const float *normal,
                        const float *depth_before, const float *normal_before, const float *grad, int B, int H, int W,
                        float depth_tolerance, float normal_tolerance, float least, int threads) {
    int64_t plane = (int64_t)H * W;
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int b = 0; b < B; b++) {  // two rows may add to the same pixel
        const float *mx = motion + b * 2 * plane, *my = mx + plane, *from = grad + b * C * plane;
        float *to = grad_stored + b * C * plane;
        Row r = {{0}, depth + b * plane, normal + b * 3 * plane, depth_before + b * plane,
                 normal_before + b * 3 * plane, 0, 0, depth_tolerance, normal_tolerance, least, plane, H, W};
        for (int64_t at = 0; at < plane; at++) {  // the picture as one long row: x and y are in left and top
            float u = target(mx[at]) + at % W, v = target(my[at]) + at / W, left = floorf(u), top = floorf(v), total = 0;
            Tap taps[4];
            for (int k = 0; k < 4; k++) {
                taps[k] = look_at(k, r, at, (int)left, (int)top, u - left, v - top, 0, 0);
                total += taps[k].weight;
            }
            if (total < least) continue;
            for (int k = 0; k < 4; k++)
                for (int c = 0; c < C; c++)
                    to[c * plane + taps[k].at] += taps[k].weight / total * from[c * plane + at];
        }
    }
}
