// Targets of motion vectors, in pixels; pixel (0, 0) is at 0, its edges at ±½. Twin of ops/targets.py.
#include <float.h>

// The target of pixel x in a row of n, clamped to the row; a motion that is not finite counts as zero.
static inline float clamped_target(float motion, int x, int n) {
    float u = (fabsf(motion) <= FLT_MAX ? motion : 0) + x;
    return MIN(MAX(u, 0), n - 1);
}

// motion.on_screen
static inline int on_screen(float u, float v, int H, int W) {
    return (u >= -0.5f) & (u <= W - 0.5f) & (v >= -0.5f) & (v <= H - 0.5f);
}
