// Pixels that find another surface at the end of their motion. The specification is ops/unlike.py.
#include "common.h"
#include "alike.h"
#include "targets.h"

// depth and depth_before [B, 1, H, W], normal and normal_before [B, 3, H, W], motion [B, 2, H, W]; counts [B, 3]
void unlike(const float *depth, const float *normal, const float *motion, const float *depth_before, const float *normal_before,
            int64_t *counts, int B, int H, int W, float depth_tolerance, float normal_tolerance, float together, int threads) {
    int64_t plane = (int64_t)H * W;
    for (int b = 0; b < B; b++) {
        const float *d = depth + b * plane, *n = normal + 3 * b * plane, *mx = motion + 2 * b * plane, *my = mx + plane;
        const float *before = depth_before + b * plane, *its_normal = normal_before + 3 * b * plane;
        int64_t seen = 0, lost = 0, beside = 0;
#pragma omp parallel for num_threads(threads) schedule(static) reduction(+ : seen, lost, beside)
        for (int y = 0; y < H; y++) {
            int64_t row = (int64_t)y * W;
            int in_row[3] = {0};
#pragma omp simd
            for (int x = 0; x < W; x++) {
                float u = mx[row + x], v = my[row + x];
                int at = (int)(clamped_target(v, y, H) + 0.5f) * W + (int)(clamped_target(u, x, W) + 0.5f);
                int there = on_screen(u + x, v + y, H, W), here = (int)row + x;
                int same = alike(surface_at(d, n, plane, here), surface_at(before, its_normal, plane, at), depth_tolerance,
                                 normal_tolerance);
                in_row[0] += there;
                in_row[1] += there & !same;
            }
#pragma omp simd
            for (int x = 0; x < W - 1; x++) {
                int here = (int)row + x;
                float du = mx[here + 1] - mx[here], dv = my[here + 1] - my[here];
                int same = alike(surface_at(d, n, plane, here), surface_at(d, n, plane, here + 1), depth_tolerance,
                                 normal_tolerance);
                in_row[2] += !same & (du * du + dv * dv < together);
            }
            seen += in_row[0], lost += in_row[1], beside += in_row[2];
        }
        counts[3 * b] = seen, counts[3 * b + 1] = lost, counts[3 * b + 2] = beside;
    }
}
