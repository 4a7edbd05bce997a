// Where history is found, in one pass over the motion vectors. The specification is motion_splat.history_motion. A plane
// has < 2³¹ pixels.
#include "common.h"

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
#pragma omp simd
        for (int x = 0; x < W; x++) {
            int at = (int)(clamped(my[x], y, H) + 0.5f) * W + (int)(clamped(mx[x], x, W) + 0.5f);
            int known = on_screen(mx[x] + x, my[x] + y, H, W);
            float dual_x = known ? -nx[at] : mx[x], dual_y = known ? -ny[at] : my[x];
            float dx = dual_x - mx[x], dy = dual_y - my[x];
            int apart = dx * dx + dy * dy > threshold * threshold;
            float px = apart ? dual_x : mx[x], py = apart ? dual_y : my[x];
            to_x[x] = px, to_y[x] = py;
            hidden[x] = apart;
            s[x] = on_screen(px + x, py + y, H, W);
        }
    }
}
