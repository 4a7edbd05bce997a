// One picture of two, and of the previous one. The specification is ops/mix.py; CELL, DARK, FAR, LARGEST, NOISE, TELLS and
// UNCOVERED are those of constants.py. BEFORE and NOISY are 1 where there is a previous picture, and the frame, else 0.
#include "common.h"
#include "expm1.h"
#include "log1p.h"

#define SUMS 3  // of share_told: along, square, noise

typedef struct {
    const float *first, *other, *before, *noisy;  // [3, H, W]; the last two may be NULL
    const float *trust, *held, *tells, *depth;    // [H, W]; the last three likewise
    float *cells, *around, *out;                  // [rows, SUMS, columns] twice; [3, H, W]
    float scale, usual, share, least;
    int64_t plane;
    int H, W, rows, columns;
} Job;

// The terms of the sums in a row of cells, averaged over each; `sum` has SUMS · W values.
static inline void terms(Job j, int row, float *sum) {
    int bottom = MIN((row + 1) * CELL, j.H);
    float *along = sum, *square = sum + j.W, *noisy = sum + 2 * j.W;
    memset(sum, 0, SUMS * (size_t)j.W * sizeof *sum);
    for (int y = row * CELL; y < bottom; y++) {
        const float *first = j.first + (int64_t)y * j.W, *other = j.other + (int64_t)y * j.W, *now = j.noisy + (int64_t)y * j.W;
#pragma omp simd
        for (int x = 0; x < j.W; x++) {
            float mixed[3];
#pragma GCC unroll 3
            for (int c = 0; c < 3; c++) mixed[c] = lerp(other[c * j.plane + x], first[c * j.plane + x], j.usual);
            float relative = j.scale / (j.scale * ((mixed[0] + mixed[1] + mixed[2]) / 3) + (float)DARK);
#pragma GCC unroll 3
            for (int c = 0; c < 3; c++) {
                int64_t i = c * j.plane + x;
                float apart = relative * (first[i] - other[i]);
                float left = MIN(relative * (now[i] - other[i]), (float)LARGEST);
                float noise = MIN(relative * (now[i] - mixed[c]), (float)LARGEST);
                along[x] += apart * left;
                square[x] += apart * apart;
                noisy[x] += noise * noise;
            }
        }
    }
    for (int i = 0; i < SUMS; i++)
        for (int column = 0; column < j.columns; column++) {
            int n = MIN(CELL, j.W - column * CELL);
            float total = 0;
            for (int x = 0; x < n; x++) total += sum[i * j.W + column * CELL + x];
            j.cells[((int64_t)row * SUMS + i) * j.columns + column] = total / (n * (bottom - row * CELL));
        }
}

// Means of a row of cells and the eight around each.
static inline void smooth(Job j, int row) {
    int top = MAX(row - 1, 0), bottom = MIN(row + 1, j.rows - 1);
    for (int i = 0; i < SUMS; i++)
        for (int column = 0; column < j.columns; column++) {
            int left = MAX(column - 1, 0), right = MIN(column + 1, j.columns - 1);
            float total = 0;
            for (int y = top; y <= bottom; y++)
                for (int x = left; x <= right; x++) total += j.cells[((int64_t)y * SUMS + i) * j.columns + x];
            j.around[((int64_t)row * SUMS + i) * j.columns + column] = total / ((bottom - top + 1) * (right - left + 1));
        }
}

// The share of the first picture in the pixels of row y; `between` has SUMS · columns values.
static inline void told(Job j, int y, float *between, float *share) {
    float v = MAX((y + 0.5f) / CELL - 0.5f, 0);
    int top = (int)v, bottom = MIN(top + 1, j.rows - 1), count = SUMS * j.columns;
    const float *above = j.around + (int64_t)top * count, *below = j.around + (int64_t)bottom * count;
    const float *along = between, *square = between + j.columns, *noisy = between + 2 * j.columns;
    const float *tells = j.tells + (int64_t)y * j.W;
    for (int i = 0; i < count; i++) between[i] = (1 - (v - top)) * above[i] + (v - top) * below[i];
#pragma omp simd
    for (int x = 0; x < j.W; x++) {
        float u = MAX((x + 0.5f) / CELL - 0.5f, 0);
        int left = (int)u, right = MIN(left + 1, j.columns - 1);
        float near = 1 - (u - left), far = u - left, noise = near * noisy[left] + far * noisy[right] + (float)NOISE;
        float a = (j.usual * noise + near * along[left] + far * along[right]) / (noise + near * square[left] + far * square[right]);
        a = MIN(MAX(a, 0), 1);
        share[x] = lerp(MIN(MAX(a, j.least), j.usual), a, tells[x]);
    }
}

// No share of the first where neither a pixel of row y nor one around it hit anything.
static inline void leave_the_sky(Job j, int y, float *share) {
    const float *here = j.depth + (int64_t)y * j.W, *above = y > 0 ? here - j.W : here, *below = y + 1 < j.H ? here + j.W : here;
    float greatest[j.W + 2];  // of each column, with a border of nothing
    greatest[0] = greatest[j.W + 1] = 0;
#pragma omp simd
    for (int x = 0; x < j.W; x++) greatest[x + 1] = MAX(MAX(above[x], here[x]), below[x]);
#pragma omp simd
    for (int x = 0; x < j.W; x++) share[x] = MAX(MAX(greatest[x], greatest[x + 1]), greatest[x + 2]) > 0 ? share[x] : 0;
}

// A row of one colour; `share` of the first picture in each pixel.
static inline void colour(Job j, int64_t row, int c, const float *share) {
    int64_t at = row + c * j.plane;
    const float *first = j.first + at, *other = j.other + at, *before = BEFORE ? j.before + at : NULL;
    const float *trust = j.trust + row, *held = BEFORE ? j.held + row : NULL, *tells = NOISY ? j.tells + row : NULL;
    float *out = j.out + at, scale = j.scale, part = j.share;
#pragma omp simd
    for (int x = 0; x < j.W; x++) {
        float p = log1p_positive(scale * MAX(first[x], 0)), q = log1p_positive(scale * MAX(other[x], 0));
        if (NOISY) p = tells[x] < (float)TELLS ? q + MIN(MAX(p - q, -(float)UNCOVERED), (float)UNCOVERED) : p;
        float mixed = lerp(q, p, trust[x] * share[x]);
        if (BEFORE) {
            float apart = log1p_positive(scale * MAX(before[x], 0)) - mixed;
            mixed += trust[x] * part * held[x] * MIN(MAX(apart, -(float)FAR), (float)FAR);
        }
        out[x] = expm1_positive(mixed) / scale;
    }
}

// first, other, before, noisy, out [B, 3, H, W], trust, held, tells, depth [B, 1, H, W], scale [B]; depth may be NULL. cells
// and around have rows · columns · SUMS values, `space` (SUMS + 1) · W for each of `threads` threads.
void mix(const float *first, const float *other, const float *scale, const float *trust, const float *before, const float *held,
         const float *noisy, const float *tells, const float *depth, float *cells, float *around, float *space, float *out, int B,
         int H, int W, float usual, float share, float least, int threads) {
    int64_t plane = (int64_t)H * W;
    int rows = (H + CELL - 1) / CELL, columns = (W + CELL - 1) / CELL;
    for (int b = 0; b < B; b++) {
        Job j = {first + 3 * b * plane, other + 3 * b * plane, BEFORE ? before + 3 * b * plane : NULL,
                 NOISY ? noisy + 3 * b * plane : NULL, trust + b * plane, BEFORE ? held + b * plane : NULL,
                 NOISY ? tells + b * plane : NULL, depth ? depth + b * plane : NULL, cells, around, out + 3 * b * plane, scale[b],
                 usual, share, least, plane, H, W, rows, columns};
        for (int step = NOISY ? 0 : 2; step < 3; step++) {
            int count = step < 2 ? rows : H;
#pragma omp parallel for num_threads(threads) schedule(static)
            for (int t = 0; t < threads; t++) {
                float *sums = space + (int64_t)t * (SUMS + 1) * W, *shares = sums + SUMS * W;
                for (int i = (int64_t)count * t / threads; i < (int64_t)count * (t + 1) / threads; i++) {
                    if (step == 0) terms(j, i, sums);
                    if (step == 1) smooth(j, i);
                    if (step < 2) continue;
                    for (int x = 0; x < W; x++) shares[x] = usual;
                    if (NOISY) told(j, i, sums, shares);
                    if (depth) leave_the_sky(j, i, shares);
                    for (int c = 0; c < 3; c++) colour(j, (int64_t)i * W, c, shares);
                }
            }
        }
    }
}
