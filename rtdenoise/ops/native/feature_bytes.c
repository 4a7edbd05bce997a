// A picture's light and surfaces as bytes, channels last, in one pass over its planes. The specification is
// ops/feature_bytes.py, which gives LIGHT, SURFACE and CHANNELS.
#include "common.h"
#include "log1p.h"

#define BLOCK 64              // pixels
#define WORDS (CHANNELS / 4)  // of a pixel, four bytes each: moving single bytes is slow

static inline uint32_t byte(float steps) { return (uint32_t)(int)MIN(MAX(steps, 0), 255); }
static inline uint32_t word(const float *steps) {
    return byte(steps[0]) | byte(steps[BLOCK]) << 8 | byte(steps[2 * BLOCK]) << 16 | byte(steps[3 * BLOCK]) << 24;
}

// planes: 9 pointers to `pixels` float32 each, light, albedo and normal; out [pixels, WORDS]
void feature_bytes(const float *const *planes, uint32_t *out, int64_t pixels, int threads) {
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int64_t from = 0; from < pixels; from += BLOCK) {
        int n = (int)MIN(BLOCK, pixels - from);
        float steps[CHANNELS][BLOCK] = {0};
        uint32_t words[WORDS][BLOCK];
        for (int c = 0; c < 3; c++) {
            const float *light = planes[c] + from, *albedo = planes[3 + c] + from, *normal = planes[6 + c] + from;
#pragma omp simd
            for (int x = 0; x < n; x++) {
                steps[c][x] = rintf(log1p_positive(light[x]) * LIGHT);
                steps[3 + c][x] = steps[c][x] - 255;
                steps[6 + c][x] = rintf(albedo[x] * SURFACE);
                steps[9 + c][x] = rintf((0.5f * normal[x] + 0.5f) * SURFACE);
            }
        }
        for (int w = 0; w < WORDS; w++)
#pragma omp simd
            for (int x = 0; x < BLOCK; x++) words[w][x] = word(steps[4 * w] + x);
        for (int x = 0; x < n; x++)
            for (int w = 0; w < WORDS; w++) out[(from + x) * WORDS + w] = words[w][x];
    }
}
