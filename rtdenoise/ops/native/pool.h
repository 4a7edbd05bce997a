// D of eq. 4 for one row; twin of shaders/include/pool.glsl. POOL is 0 for the mean, 1 for the maximum.

// Row y of the coarse plane from pixels (2y..2y+1, 2x..2x+1) of `image`, as far as those exist.
static inline void pool_row(const float *image, float *out, int y, int H, int W) {
    const float *top = image + 2 * (int64_t)y * W, *bottom = 2 * y + 1 < H ? top + W : top;
#pragma omp simd
    for (int x = 0; x < W / 2; x++) {
        float a = top[2 * x], b = top[2 * x + 1], c = bottom[2 * x], d = bottom[2 * x + 1];
        out[x] = POOL ? MAX(MAX(a, b), MAX(c, d)) : (a + b + c + d) * 0.25f;
    }
    if (W % 2) out[W / 2] = POOL ? MAX(top[W - 1], bottom[W - 1]) : (top[W - 1] + bottom[W - 1]) * 0.5f;
}
