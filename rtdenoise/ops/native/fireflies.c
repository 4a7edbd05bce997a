// A picture without fireflies. The specification is ops/fireflies.py; TOLERANCE, COSINE and LEAST are DEPTH_TOLERANCE,
// MIN_NORMAL_COSINE and FIREFLY_ALIKE of constants.py.
#include "common.h"
#include "alike.h"

// How many of the eight pixels around each of a row may show its surface; W: of a row.
static inline void surfaces(const float *depth, const float *normal, float *count, int64_t plane, int64_t W) {
    memset(count, 0, W * sizeof *count);
    for (int k = 0; k < 9; k++) {
        int64_t other = (k / 3 - 1) * W + k % 3 - 1;
        if (other == 0) continue;
#pragma omp simd
        for (int x = 1; x < W - 1; x++) {
            Surface here = surface_at(depth, normal, plane, x), there = surface_at(depth + other, normal + other, plane, x);
            count[x] += alike(here, there, TOLERANCE, COSINE);
        }
    }
}

#define RANK(value) second = MAX(second, MIN(greatest, value)), greatest = MAX(greatest, value)

// One channel of a row, where `count` says; the second greatest of eight pixels by one comparison after the other.
static inline void limit(const float *light, const float *depth, const float *known, const float *count, float *out, int64_t W) {
    const float *above = light - W, *below = light + W;
#pragma omp simd
    for (int x = 1; x < W - 1; x++) {
        float greatest = MAX(above[x - 1], above[x]), second = MIN(above[x - 1], above[x]);
        RANK(above[x + 1]);
        RANK(light[x - 1]);
        RANK(light[x + 1]);
        RANK(below[x - 1]);
        RANK(below[x]);
        RANK(below[x + 1]);
        float less = lerp(MIN(light[x], second), light[x], known[x]);
        out[x] = (count[x] >= LEAST) & (depth[x] > 0) ? less : light[x];
    }
    out[0] = light[0], out[W - 1] = light[W - 1];
}

// light, normal and out [B, 3, H, W], depth and known [B, 1, H, W], all contiguous; H and W ≥ 3.
void without_fireflies(const float *light, const float *depth, const float *normal, const float *known, float *out, int B,
                       int H, int W, int threads) {
    int64_t plane = (int64_t)H * W;
#pragma omp parallel for schedule(static) num_threads(threads)
    for (int line = 0; line < B * H; line++) {
        int64_t b = line / H, y = line % H, image = b * plane + y * W, images = 3 * b * plane + y * W;
        int inner = y > 0 && y < H - 1;
        float count[W];
        if (inner) surfaces(depth + image, normal + images, count, plane, W);
        for (int64_t at = images; at < images + 3 * plane; at += plane) {
            if (inner) limit(light + at, depth + image, known + image, count, out + at, W);
            else memcpy(out + at, light + at, W * sizeof *out);
        }
    }
}
