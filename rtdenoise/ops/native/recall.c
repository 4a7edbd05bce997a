// The mean light of recent frames along chained motion. The specification is ops/recall.py, whose CELL and FAR_AWAY these are;
// GLOSS is that of constants.py.
//
// Strip by strip, a row of wide cells at a time: a cell's weight needs the cells around it, so a strip has a wide cell more on
// either side, and a thread keeps what it found in two rows and the sums of three, small enough for its cache. Footprints need
// the weights alone, so their paths are followed when these are known, and what they lead to is summed up at once.
#include "common.h"
#include "alike.h"
#include "kept.h"
#include "kept_rows.h"
#include "recall_job.h"
#include "recall_paths.h"
#include "recall_unchanged.h"
#include "recall_footprints.h"

// The means over all kept frames, for n pixels of a row of cells from `first` of the block on, a multiple of CELL.
static inline void average(Job j, int cell_row, int first, int n) {
    int from = j.from + first;
    float weight[j.K][BLOCK];  // of unchanged light
    for (int k = 0; k < j.K; k++) {
        float cell[BLOCK / CELL];
        for (int x = 0; x < BLOCK / CELL; x++) cell[x] = 1;
        unchanged(j, cell_row, k, 1, j.alike, j.changed, cell);
        unchanged(j, cell_row, k, WIDE, j.wide_alike, j.wide_changed, cell);
        white(j, cell_row, k, cell);
        for (int x = 0; x < n; x++) weight[k][x] = cell[(first + x) / CELL];
    }
    for (int y = cell_row * CELL; y < MIN((cell_row + 1) * CELL, j.H); y++) {
        float sum[4][BLOCK] = {{0}};
        for (int k = 0; k < j.K; k++) {
            const uint32_t *found = found_of(j, cell_row, k) + y % CELL * BLOCK + first;
#pragma omp simd
            for (int x = 0; x < n; x++) {
                uint32_t other = found[CELL * BLOCK + x];
                float w = weight[k][x] * high(other) * from_bits(found[2 * CELL * BLOCK + x]);
                sum[0][x] += w * low(found[x]);
                sum[1][x] += w * high(found[x]);
                sum[2][x] += w * low(other);
                sum[3][x] += w;
            }
        }
        divide(sum, 4, j.mean, j.count, j.plane, (int64_t)y * j.W + from, n);
        if (j.footprint) footprints(j, y, from, n, weight);
    }
}

// Rows of wide cells [top, bottom) of a strip of n pixels from column `left` on, a multiple of MARGIN.
static void strip(Job j, int top, int bottom, int left, int n) {
    j.from = MAX(left - MARGIN, 0);
    j.n = MIN(left + n + MARGIN, j.W) - j.from;
    for (int wide = MAX(top - 1, 0); wide <= bottom; wide++) {
        for (int row = wide * WIDE; row < MIN((wide + 1) * WIDE, j.rows); row++) {
            Roots now;
            for (int y = row * CELL; y < MIN((row + 1) * CELL, j.H); y++) look(j, y);
            roots(j, row, now);
            for (int k = 0; k < j.K; k++) compare(j, row, k, now);
        }
        if (wide > top)
            for (int row = (wide - 1) * WIDE; row < MIN(wide * WIDE, j.rows); row++) average(j, row, left - j.from, n);
    }
}

// light [B, 3, H, W], motion [B, 2, H, W], depth [B, 1, H, W], normal [B, 3, H, W], misplaced [B], kept: B × K
// times [H, W, words], mean like light, count like depth; uncovered like depth, footprint [B, 9, H, W] and footprint_count like
// depth, or all three NULL; lone [B, 2, H, W] or NULL; all contiguous. found and cells hold the scratch of `threads` threads.
void recall(const float *light, const float *motion, const float *depth, const float *normal,
            const uint8_t *uncovered, const float *lone, const float *misplaced, const uint32_t *const *kept, float *mean,
            float *count, float *footprint, float *footprint_count, uint32_t *found, float *cells,
            int K, int B, int H, int W, int words, float depth_tolerance, float normal_tolerance, float alike, float changed,
            float wide_alike, float wide_changed, float white, float joined, float speed, int threads) {
    int64_t plane = (int64_t)H * W;
    int rows = (H + CELL - 1) / CELL, wide = (rows + WIDE - 1) / WIDE, width = BLOCK - 2 * MARGIN;
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int t = 0; t < threads; t++)
        for (int b = 0; b < B; b++) {
            Job j = {light + 3 * b * plane, motion + 2 * b * plane, depth + b * plane, normal + 3 * b * plane,
                     footprint ? uncovered + b * plane : NULL, lone ? lone + 2 * b * plane : NULL, kept + (int64_t)b * K,
                     mean + 3 * b * plane, count + b * plane,
                     footprint ? footprint + 9 * b * plane : NULL, footprint ? footprint_count + b * plane : NULL,
                     found + (int64_t)t * FOUND * K * 3 * CELL * BLOCK, cells + (int64_t)t * SUMS * K * OF_CELL * (BLOCK / CELL),
                     depth_tolerance, normal_tolerance, alike, changed, wide_alike, wide_changed, white, joined, speed,
                     misplaced[b],
                     plane, K, H, W, rows, words, 0, 0};
            int top = (int64_t)wide * t / threads, bottom = (int64_t)wide * (t + 1) / threads;
            for (int left = 0; left < W; left += width) strip(j, top, bottom, left, MIN(width, W - left));
        }
}
