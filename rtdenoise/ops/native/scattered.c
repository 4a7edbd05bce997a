// The depths of surfaces that are hit here and there. The specification is ops/scattered.py; TOLERANCE is DEPTH_TOLERANCE of
// constants.py, ALIKE, REACH and APART are SCATTERED_ALIKE and so on.
#include "common.h"

static inline int near(float depth, float other) { return fabsf(depth - other) <= (float)TOLERANCE * MAX(depth, other); }

// How many of the eight pixels around each of row y have its depth in `others`.
static inline void alike_around(const float *depth, const float *others, int *count, int y, int H, int W) {
    const float *row = depth + (int64_t)y * W, *here = others + (int64_t)y * W;
    const float *above = y > 0 ? here - W : here, *below = y + 1 < H ? here + W : here;
    for (int x = 0; x < W; x += MAX(W - 1, 1)) {  // the borders, where columns are repeated
        count[x] = 0;
        for (int k = 0; k < 9; k++) {
            const float *other = k < 3 ? above : k < 6 ? here : below;
            count[x] += k != 4 && near(row[x], other[MIN(MAX(x + k % 3 - 1, 0), W - 1)]);
        }
    }
#pragma omp simd
    for (int x = 1; x < W - 1; x++) {
        float d = row[x];
        count[x] = near(d, above[x - 1]) + near(d, above[x]) + near(d, above[x + 1]) + near(d, here[x - 1]) +
                   near(d, here[x + 1]) + near(d, below[x - 1]) + near(d, below[x]) + near(d, below[x + 1]);
    }
}

// The depths of row y that are those of more than ALIKE pixels around, -1 elsewhere.
static inline void crowded_of_row(const float *depth, float *crowded, int y, int H, int W) {
    int count[W];
    alike_around(depth, depth, count, y, H, W);
    for (int64_t x = 0, i = (int64_t)y * W; x < W; x++, i++) crowded[i] = count[x] > ALIKE ? depth[i] : -1;
}

// The least and the greatest depth of lone samples within REACH columns of each pixel of row y.
static inline void of_row(const float *depth, const float *crowded, float *least, float *greatest, int y, int H, int W) {
    const float *here = depth + (int64_t)y * W, *many = crowded + (int64_t)y * W;
    float low[W + 2 * REACH], high[W + 2 * REACH];  // of each pixel, with a border of none
    int count[W];
    alike_around(depth, crowded, count, y, H, W);
    for (int i = 0; i < REACH; i++) low[i] = low[REACH + W + i] = INFINITY, high[i] = high[REACH + W + i] = 0;
#pragma omp simd
    for (int x = 0; x < W; x++) {
        int alone = (many[x] < 0) & (count[x] == 0) & (here[x] > 0);
        low[REACH + x] = alone ? here[x] : INFINITY;
        high[REACH + x] = alone ? here[x] : 0;
    }
#pragma omp simd
    for (int x = 0; x < W; x++) {
        float l = low[x], h = high[x];
        for (int i = 1; i <= 2 * REACH; i++) l = MIN(l, low[x + i]), h = MAX(h, high[x + i]);
        least[x] = l, greatest[x] = h;
    }
}

// depth and crowded [B, 1, H, W]; rows and out [B, 2, H, W]; all contiguous.
void scattered(const float *depth, float *crowded, float *rows, float *out, int B, int H, int W, int threads) {
    int64_t plane = (int64_t)H * W;
#pragma omp parallel num_threads(threads)
    {
#pragma omp for schedule(static)
        for (int line = 0; line < B * H; line++) {
            int64_t b = line / H;
            crowded_of_row(depth + b * plane, crowded + b * plane, line % H, H, W);
        }
#pragma omp for schedule(static)
        for (int line = 0; line < B * H; line++) {
            int64_t b = line / H, y = line % H;
            float *row = rows + 2 * b * plane + y * W;
            of_row(depth + b * plane, crowded + b * plane, row, row + plane, y, H, W);
        }
#pragma omp for schedule(static)
        for (int line = 0; line < B * H; line++) {
            int64_t b = line / H, y = line % H, top = MAX(y - REACH, 0), bottom = MIN(y + REACH, H - 1);
            const float *low = rows + 2 * b * plane, *high = low + plane;
            float *least = out + 2 * b * plane + y * W, *greatest = least + plane;
            memcpy(least, low + top * W, W * sizeof *least);
            memcpy(greatest, high + top * W, W * sizeof *greatest);
            for (int64_t i = top + 1; i <= bottom; i++)
#pragma omp simd
                for (int x = 0; x < W; x++) {
                    least[x] = MIN(least[x], low[i * W + x]);
                    greatest[x] = MAX(greatest[x], high[i * W + x]);
                }
#pragma omp simd
            for (int x = 0; x < W; x++) {
                int some = (greatest[x] > 0) & (greatest[x] <= (float)APART * least[x]);
                least[x] = some ? (1 - (float)TOLERANCE) * least[x] : 1;
                greatest[x] = some ? greatest[x] / (1 - (float)TOLERANCE) : 0;
            }
        }
    }
}
