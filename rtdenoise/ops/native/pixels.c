// Ops in which every pixel stands alone. The specification is ops/pixels.py. C is the number of channels; GLOSS is that of
// constants.py. Images are contiguous: [B, C, H, W], but [B, 1, H, W] for depth, sharp, length, reset and
// numbers of frames.
#include "common.h"

// color.albedo_divisor
static inline float divisor(float albedo, float depth) { return depth > 0 ? albedo + (float)GLOSS : 1; }

#define BLOCK 1024  // pixels
#define EACH_BLOCK(B, plane) \
    _Pragma("omp parallel for num_threads(threads) schedule(static) collapse(2)") \
    for (int64_t b = 0; b < B; b++) \
        for (int64_t from = 0; from < plane; from += BLOCK)
#define EACH_PIXEL _Pragma("omp simd") for (int64_t x = from; x < to; x++)

void demodulate(const float *radiance, const float *albedo, const float *depth, float *out, int B, int64_t plane,
                int threads) {
    EACH_BLOCK(B, plane) {
        int64_t to = MIN(from + BLOCK, plane), first = b * C * plane;
        const float *r = radiance + first, *a = albedo + first, *d = depth + b * plane;
        float *o = out + first;
        for (int c = 0; c < C; c++, r += plane, a += plane, o += plane) EACH_PIXEL o[x] = r[x] / divisor(a[x], d[x]);
    }
}

void modulate(const float *irradiance, const float *albedo, const float *mean_albedo, const float *sharp,
              const float *depth, float *out, int B, int64_t plane, int threads) {
    EACH_BLOCK(B, plane) {
        int64_t to = MIN(from + BLOCK, plane), first = b * C * plane;
        const float *i = irradiance + first, *a = albedo + first, *m = mean_albedo + first;
        const float *s = sharp + b * plane, *d = depth + b * plane;
        float *o = out + first;
        for (int c = 0; c < C; c++, i += plane, a += plane, m += plane, o += plane)
            EACH_PIXEL o[x] = MAX(i[x], 0) * divisor(lerp(m[x], a[x], s[x]), d[x]);
    }
}

// `new`: B × C pointers to planes.
void accumulate(const float *const *new, const float *mean, const float *length, const float *reset, float *out, float *next_length,
                int B, int64_t plane, float max_length, float same, int threads) {
    EACH_BLOCK(B, plane) {
        int64_t to = MIN(from + BLOCK, plane), first = b * C * plane;
        const float *m = mean + first, *l = length + b * plane, *r = reset + b * plane;
        float *o = out + first, *next = next_length + b * plane, weight[BLOCK];
        EACH_PIXEL {
            float w = 1 / (1 + l[x]), a = fmaf(r[x], 1 - w, w);
            weight[x - from] = a;
            next[x] = MIN(1 / a, max_length);
        }
        for (int c = 0; c < C; c++, m += plane, o += plane) {
            const float *n = new[b * C + c];
            EACH_PIXEL {
                float before = fabsf(m[x] - n[x]) <= same * fabsf(n[x]) ? n[x] : m[x];
                o[x] = lerp(before, n[x], weight[x - from]);
            }
        }
    }
}

void joined(const float *mean, const float *count, const float *other, const float *others, float *out, float *total, int B,
            int64_t plane, int threads) {
    EACH_BLOCK(B, plane) {
        int64_t to = MIN(from + BLOCK, plane), first = b * C * plane;
        const float *a = mean + first, *n = count + b * plane, *o = other + first, *m = others + b * plane;
        float *to_mean = out + first, *to_count = total + b * plane, weight[BLOCK];
        EACH_PIXEL {
            to_count[x] = n[x] + m[x];
            weight[x - from] = m[x] / MAX(to_count[x], 1e-6f);
        }
        for (int c = 0; c < C; c++, a += plane, o += plane, to_mean += plane)
            EACH_PIXEL to_mean[x] = lerp(a[x], o[x], weight[x - from]);
    }
}

void nearness(const float *depth, float distance, float *out, int64_t plane, int threads) {
#pragma omp parallel for simd num_threads(threads) schedule(static)
    for (int64_t x = 0; x < plane; x++) out[x] = depth[x] > 0 ? distance / (distance + depth[x]) : 0;
}

// Whether all values are in [low, high]; NaN is outside.
int within(const float *values, int64_t n, float low, float high, int threads) {
    int outside = 0;
#pragma omp parallel for simd num_threads(threads) schedule(static) reduction(| : outside)
    for (int64_t x = 0; x < n; x++) outside |= !((values[x] >= low) & (values[x] <= high));
    return !outside;
}
