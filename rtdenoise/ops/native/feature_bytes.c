// A picture's light and surfaces as bytes, channels last, in one pass over its planes. The specification is
// ops/feature_bytes.py, which gives LIGHT, ALBEDO, NORMAL and CHANNELS.
#include "common.h"
#include "log1p.h"

#define BLOCK 64  // pixels

static inline uint8_t byte(float steps) { return (uint8_t)MIN(MAX(steps, 0), 255); }

// planes: 9 pointers to `pixels` float32 each, radiance, albedo and normal; out [pixels, CHANNELS]
void feature_bytes(const float *const *planes, float scale, uint8_t *out, int64_t pixels, int threads) {
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int64_t from = 0; from < pixels; from += BLOCK) {
        int n = (int)MIN(BLOCK, pixels - from);
        uint8_t bytes[CHANNELS][BLOCK] = {0};
        for (int c = 0; c < 3; c++) {
            const float *radiance = planes[c] + from, *albedo = planes[3 + c] + from, *normal = planes[6 + c] + from;
#pragma omp simd
            for (int x = 0; x < n; x++) {
                float light = rintf(log1p_positive(radiance[x] * scale) * LIGHT), up = rintf(normal[x] * NORMAL);
                bytes[c][x] = byte(light);
                bytes[3 + c][x] = byte(light - 255);
                bytes[6 + c][x] = byte(rintf(albedo[x] * ALBEDO));
                bytes[9 + c][x] = byte(up);
                bytes[12 + c][x] = byte(-up);
            }
        }
        for (int x = 0; x < n; x++)
            for (int c = 0; c < CHANNELS; c++) out[(from + x) * CHANNELS + c] = bytes[c][x];
    }
}
