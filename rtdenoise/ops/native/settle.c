// A picture and the one after it, mixed. The specification is ops/settle.py; BROAD, FINE, BROAD_NEW, FINE_NEW and FAR are
// those of constants.py, and what told.h needs.
#include "common.h"
#include "expm1.h"
#include "log1p.h"
#include "told.h"

// How far the following picture counts in row y; `space` has SUMS · columns values.
static inline void weights(Told j, int y, const float *alike, float *space, float *weight) {
    told(j, y, space, weight);
#pragma omp simd
    for (int x = 0; x < j.W; x++) weight[x] = alike[x] * MIN(weight[x] / j.usual, 1);
}

// A row of a colour: weight · clamp(f(following) - f(image)).
static inline void differences(const float *image, const float *following, const float *weight, float scale, int W, float *out) {
#pragma omp simd
    for (int x = 0; x < W; x++) {
        float d = log1p_positive(scale * MAX(following[x], 0)) - log1p_positive(scale * MAX(image[x], 0));
        out[x] = weight[x] * MIN(MAX(d, -(float)FAR), (float)FAR);
    }
}

// Sums of 3 × 3 values around each of row y of a plane; `sum` has a border of a value on either side.
static inline void around(const float *plane, int y, int H, int W, float *sum, float *out) {
    memset(sum, 0, (W + 2) * sizeof *sum);
    for (int row = MAX(y - 1, 0); row <= MIN(y + 1, H - 1); row++) {
        const float *own = plane + (int64_t)row * W;
        for (int x = 0; x < W; x++) sum[x + 1] += own[x];
    }
#pragma omp simd
    for (int x = 0; x < W; x++) out[x] = sum[x] + sum[x + 1] + sum[x + 2];
}

// A row of a colour. `own` and `broad` are its differences and the sums of those around, `weight` and `total` their weights.
static inline void mixed(const float *image, const float *own, const float *broad, const float *weight, const float *total,
                         const float *trusted, float scale, int W, float *out) {
#pragma omp simd
    for (int x = 0; x < W; x++) {
        float wide = weight[x] * broad[x] / MAX(total[x], 9e-6f);
        float a = (float)BROAD_NEW + ((float)BROAD - (float)BROAD_NEW) * trusted[x];
        float b = (float)FINE_NEW + ((float)FINE - (float)FINE_NEW) * trusted[x];
        float change = a * wide + b * (own[x] - wide);
        float shown = expm1_positive(MAX(log1p_positive(scale * MAX(image[x], 0)) + change, 0)) / scale;
        out[x] = change == 0 ? image[x] : shown;
    }
}

// image, following, noisy, out [B, 3, H, W]; alike, trusted [B, 1, H, W]; scale [B]. cells and around_cells have rows · columns
// · SUMS values, weight and apart 1 and 3 of each pixel, `space` 3 · (W + 2) for each of `threads` threads.
void settle(const float *image, const float *following, const float *noisy, const float *alike, const float *trusted,
            const float *scale, float *cells, float *around_cells, float *weight, float *apart, float *space, float *out, int B,
            int H, int W, int threads) {
    int64_t plane = (int64_t)H * W;
    int rows = (H + CELL - 1) / CELL, columns = (W + CELL - 1) / CELL;
    for (int b = 0; b < B; b++) {
        int64_t at = b * plane;
        const float *picture = image + 3 * at, *next = following + 3 * at;
        Told j = {next, picture, noisy + 3 * at, cells, around_cells, scale[b], (float)BROAD, plane, H, W, rows, columns};
        for (int step = 0; step < 4; step++) {
            int count = step < 2 ? rows : H;
#pragma omp parallel for num_threads(threads) schedule(static)
            for (int t = 0; t < threads; t++) {
                float *sum = space + (int64_t)t * 3 * (W + 2), *total = sum + W + 2, *broad = total + W + 2;
                for (int i = (int64_t)count * t / threads; i < (int64_t)count * (t + 1) / threads; i++) {
                    int64_t row = (int64_t)i * W;
                    if (step == 0) terms(j, i, sum);
                    if (step == 1) smooth(j, i);
                    if (step == 2) weights(j, i, alike + at + row, sum, weight + row);
                    if (step == 3) around(weight, i, H, W, sum, total);
                    for (int c = 0; step > 1 && c < 3; c++) {
                        int64_t here = c * plane + row;
                        float *own = apart + here, *shown = out + 3 * at + here;
                        if (step == 2) differences(picture + here, next + here, weight + row, scale[b], W, own);
                        if (step < 3) continue;
                        around(apart + c * plane, i, H, W, sum, broad);
                        mixed(picture + here, own, broad, weight + row, total, trusted + at + row, scale[b], W, shown);
                    }
                }
            }
        }
    }
}
