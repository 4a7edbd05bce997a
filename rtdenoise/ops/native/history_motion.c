// Where history is found, in one pass over the motion vectors. The specification is motion_splat.history_motion. A plane
// has < 2³¹ pixels.
#include "common.h"

#define BLOCK 64  // pixels

static inline int on_screen(float u, float v, int H, int W) {
    return (u >= -0.5f) & (u <= W - 0.5f) & (v >= -0.5f) & (v <= H - 0.5f);
}

// motion, next_before, out [B, 2, H, W], seen, uncovered [B, 1, H, W] bool, contiguous.
void history_motion(const float *motion, const float *next_before, float *out, uint8_t *seen, uint8_t *uncovered, int B,
                    int H, int W, float threshold, int threads) {
    int64_t plane = (int64_t)H * W;
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int64_t row = 0; row < (int64_t)B * H; row++) {
        int64_t b = row / H, y = row % H, pixel = b * 2 * plane + y * W;
        const float *mx = motion + pixel, *my = mx + plane, *nx = next_before + b * 2 * plane, *ny = nx + plane;
        float *to_x = out + pixel, *to_y = to_x + plane;
        uint8_t *s = seen + row * W, *hidden = uncovered + row * W;
        for (int from = 0; from < W; from += BLOCK) {
            int n = MIN(BLOCK, W - from), at[BLOCK], known[BLOCK];
            const float *tx = mx + from, *ty = my + from;
            float there_x[BLOCK], there_y[BLOCK];
#pragma omp simd
            for (int x = 0; x < n; x++) {
                at[x] = (int)(clamped(ty[x], y, H) + 0.5f) * W + (int)(clamped(tx[x], from + x, W) + 0.5f);
                known[x] = on_screen(tx[x] + (from + x), ty[x] + y, H, W);
            }
#pragma omp simd
            for (int x = 0; x < n; x++) there_x[x] = nx[at[x]], there_y[x] = ny[at[x]];
#pragma omp simd
            for (int x = 0; x < n; x++) {
                float dual_x = known[x] ? -there_x[x] : tx[x], dual_y = known[x] ? -there_y[x] : ty[x];
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
