// Sums of least squares over cells, in one pass. The specification is shift/displacement.py.
#include "common.h"
#include "targets.h"

#define TERMS 7
#define AT_ONCE 512

// Along one axis of n pixels: those beside a target and around them, and the weight of the second.
typedef struct {
    int before, first, second, after;
    float weight;
} Axis;

static inline Axis axis(float u, int n) {
    int i = (int)u, j = MIN(i + 1, n - 1);
    return (Axis){MAX(i - 1, 0), i, j, MIN(j + 1, n - 1), u - i};
}

static inline float mix(float a, float b, float weight) { return (1 - weight) * a + weight * b; }

// The middle of cells around pixel x: as torch's interpolate, which repeats the border.
static inline Axis cells_at(int x, int cell, int n) { return axis(MIN(MAX((x + 0.5f) / cell - 0.5f, 0), n - 1), n); }

static inline float look_up(const float *plane, Axis x, Axis y, int W) {
    return mix(mix(plane[y.first * W + x.first], plane[y.first * W + x.second], x.weight),
               mix(plane[y.second * W + x.first], plane[y.second * W + x.second], x.weight), y.weight);
}

// Twice the central difference along x, between four pixels.
static inline float slope_x(const float *plane, Axis x, Axis y, int W) {
    const float *up = plane + y.first * W, *down = plane + y.second * W;
    int left = MAX(x.second - 1, 0);  // x.first, but in the last column
    return mix(mix(up[MIN(x.first + 1, W - 1)] - up[x.before], up[x.after] - up[left], x.weight),
               mix(down[MIN(x.first + 1, W - 1)] - down[x.before], down[x.after] - down[left], x.weight), y.weight);
}

static inline float slope_y(const float *plane, Axis x, Axis y, int W, int H) {
    int below = MIN(y.first + 1, H - 1), above = MAX(y.second - 1, 0);
#define DIFFERENCE(column) \
    mix(plane[below * W + column] - plane[y.before * W + column], plane[y.after * W + column] - plane[above * W + column], \
        y.weight)
    return mix(DIFFERENCE(x.first), DIFFERENCE(x.second), x.weight);
}

// now, before, here, depth, was [B, 1, H, W], motion [B, 2, H, W], shift [B, 2, h, w], sums [B, TERMS, h, w],
// contiguous; h = ⌈H/cell⌉, w = ⌈W/cell⌉; `cell` is a multiple of `stride`, and at most AT_ONCE times that. The terms of
// many pixels are computed first, because that vectorises, then summed up by cells.
void displacement_sums(const float *now, const float *before, const float *motion, const float *shift, const float *here,
                       const float *depth, const float *was, float *sums, int B, int H, int W, int cell, int stride,
                       float tolerance, int threads) {
    int h = (H + cell - 1) / cell, w = (W + cell - 1) / cell, each = cell / stride, cells_at_once = AT_ONCE / each;
    int64_t plane = (int64_t)H * W, cells = (int64_t)h * w;
#pragma omp parallel for num_threads(threads) schedule(dynamic)
    for (int row = 0; row < B * h; row++) {
        int64_t b = row / h, j = row % h, base = b * plane;
        const float *mx = motion + 2 * base, *my = mx + plane, *sx = shift + 2 * b * cells, *sy = sx + cells;
        const float *light = before + base, *far = was + base;
        float *out = sums + b * TERMS * cells + j * w;
        for (int k = 0; k < TERMS; k++) memset(out + k * cells, 0, w * sizeof(float));
        for (int y = j * cell; y < MIN((j + 1) * cell, H); y += stride) {
            Axis down = cells_at(y, cell, h);
            for (int first = 0; first < w; first += cells_at_once) {
                int from = first * cell, count = (MIN(W - from, cells_at_once * cell) + stride - 1) / stride;
                int64_t line = base + (int64_t)y * W + from;
                const float *light_here = now + line, *counts_here = here + line, *depth_here = depth + line;
                const float *x_here = mx + line - base, *y_here = my + line - base;
                float terms[TERMS][AT_ONCE], any = 0;
#pragma omp simd reduction(+ : any)
                for (int n = 0; n < count; n++) any += counts_here[n * stride];
                if (any == 0) continue;
#pragma omp simd
                for (int n = 0; n < count; n++) {
                    int p = n * stride, x = from + p;
                    Axis across = cells_at(x, cell, w);
                    float u = x_here[p] + look_up(sx, across, down, w), v = y_here[p] + look_up(sy, across, down, w);
                    int seen = on_screen(x + u, y + v, H, W);
                    Axis ax = axis(clamped_target(u, x, W), W), ay = axis(clamped_target(v, y, H), H);
                    float d = depth_here[p], e = look_up(far, ax, ay, W), counted = counts_here[p];
                    int same = fabsf(d - e) <= tolerance * MAX(d, e);
                    float weight = seen & same ? counted : 0, apart = light_here[p] - look_up(light, ax, ay, W);
                    float gx = slope_x(light, ax, ay, W) / 2, gy = slope_y(light, ax, ay, W, H) / 2;
                    terms[0][n] = weight;
                    terms[1][n] = weight * gx * gx, terms[2][n] = weight * gx * gy, terms[3][n] = weight * gy * gy;
                    terms[4][n] = weight * gx * apart, terms[5][n] = weight * gy * apart;
                    terms[6][n] = weight * apart * apart;
                }
                for (int k = 0; k < TERMS; k++)
                    for (int n = 0, i = first; n < count; i++)
                        for (int end = MIN(n + each, count); n < end; n++) out[k * cells + i] += terms[k][n];
            }
        }
    }
}
