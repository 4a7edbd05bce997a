// Bilinear reprojection whose taps are tested one by one, in one pass. The specification is ops/reproject.py; C is the
// number of channels. A plane has < 2³¹ pixels.
#include "common.h"

static inline float target(float motion) {  // far away is as good as off the screen
    return isnan(motion) ? 1e6f : MIN(MAX(motion, -1e6f), 1e6f);
}

// stored, out [B, C, H, W], motion [B, 2, H, W], depths [B, 1, H, W], normals [B, 3, H, W], valid [B, 1, H, W] bool,
// all contiguous.
void reproject(const float *stored, const float *motion, const float *depth, const float *normal,
               const float *depth_before, const float *normal_before, float *out, uint8_t *valid, int B, int H, int W,
               float depth_tolerance, float normal_tolerance, float least, int threads) {
    int64_t plane = (int64_t)H * W;
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int64_t row = 0; row < (int64_t)B * H; row++) {
        int64_t b = row / H, y = row % H, pixel = y * W;
        const float *from = stored + b * C * plane, *mx = motion + b * 2 * plane + pixel, *my = mx + plane;
        const float *d = depth + b * plane + pixel, *n = normal + b * 3 * plane + pixel;
        const float *was_d = depth_before + b * plane, *was_n = normal_before + b * 3 * plane;
        float *to = out + b * C * plane + pixel;
        uint8_t *found = valid + b * plane + pixel;
#pragma omp simd
        for (int x = 0; x < W; x++) {
            float u = target(mx[x]) + x, v = target(my[x]) + y, left = floorf(u), top = floorf(v);
            float f = u - left, g = v - top, total = 0, sum[C] = {0};
            float nx = n[x], ny = n[plane + x], nz = n[2 * plane + x], square = nx * nx + ny * ny + nz * nz;
#pragma GCC unroll 4
            for (int tap = 0; tap < 4; tap++) {
                int j = (int)left + tap % 2, i = (int)top + tap / 2;
                int inside = (i >= 0) & (i < H) & (j >= 0) & (j < W);
                int at = MIN(MAX(i, 0), H - 1) * W + MIN(MAX(j, 0), W - 1);
                float wd = was_d[at], wx = was_n[at], wy = was_n[at + plane], wz = was_n[at + 2 * plane];
                float length = sqrtf(square * (wx * wx + wy * wy + wz * wz));
                int near = fabsf(d[x] - wd) <= depth_tolerance * MAX(d[x], wd);
                int aligned = nx * wx + ny * wy + nz * wz >= normal_tolerance * length;
                int hit = d[x] > 0, was_hit = wd > 0;
                int same = inside & ((hit & was_hit & near & aligned) | (!hit & !was_hit));
                float weight = same ? (tap % 2 ? f : 1 - f) * (tap / 2 ? g : 1 - g) : 0;
                total += weight;
#pragma GCC unroll 8
                for (int c = 0; c < C; c++) sum[c] = fmaf(weight, from[c * plane + at], sum[c]);
            }
            found[x] = total >= least;
            float scale = total >= least ? 1 / total : 0;
#pragma GCC unroll 8
            for (int c = 0; c < C; c++) to[c * plane + x] = sum[c] * scale;
        }
    }
}
