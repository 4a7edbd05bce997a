// The motion that fetches history, in one pass over the motion vectors. The specification is splat.history_motion.
#include "common.h"
#include "targets.h"

#define BLOCK 64  // pixels

// motion, motion_next (of the previous frame), out [B, 2, H, W], seen, uncovered [B, 1, H, W] bool, contiguous.
void history_motion(const float *motion, const float *motion_next, float *out, uint8_t *seen, uint8_t *uncovered, int B,
                    int H, int W, float threshold, int threads) {
    int64_t plane = (int64_t)H * W;
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int64_t row = 0; row < (int64_t)B * H; row++) {
        int64_t b = row / H, y = row % H, pixel = b * 2 * plane + y * W;
        const float *mx = motion + pixel, *my = mx + plane, *nx = motion_next + b * 2 * plane, *ny = nx + plane;
        float *to_x = out + pixel, *to_y = to_x + plane;
        uint8_t *s = seen + row * W, *hidden = uncovered + row * W;
        for (int from = 0; from < W; from += BLOCK) {
            int n = MIN(BLOCK, W - from), at[BLOCK], looks_inside[BLOCK];
            const float *tx = mx + from, *ty = my + from;
            float there_x[BLOCK], there_y[BLOCK];
#pragma omp simd
            for (int x = 0; x < n; x++) {
                at[x] = (int)(clamped_target(ty[x], y, H) + 0.5f) * W + (int)(clamped_target(tx[x], from + x, W) + 0.5f);
                looks_inside[x] = on_screen(tx[x] + (from + x), ty[x] + y, H, W);
            }
#pragma omp simd
            for (int x = 0; x < n; x++) there_x[x] = nx[at[x]], there_y[x] = ny[at[x]];
#pragma omp simd
            for (int x = 0; x < n; x++) {
                float dual_x = looks_inside[x] ? -there_x[x] : tx[x], dual_y = looks_inside[x] ? -there_y[x] : ty[x];
                float dx = dual_x - tx[x], dy = dual_y - ty[x];
                int apart = dx * dx + dy * dy > threshold * threshold;
                float px = apart ? dual_x : tx[x], py = apart ? dual_y : ty[x];
                to_x[from + x] = px, to_y[from + x] = py;
                hidden[from + x] = apart;
                s[from + x] = on_screen(px + (from + x), py + y, H, W);
            }
        }
    }
}
