// What a thread of recall.c works on: a block of pixels of a strip, and its scratch.

#define WIDE 2     // side of a wide cell in cells
#define MARGIN (WIDE * CELL)  // pixels of one of these
#define PART 16    // pixels of a block that are fetched at once; BLOCK is a multiple of it
#define FOUND 4   // rows of cells of which a thread keeps what it found
#define SUMS 6    // likewise the sums
#define OF_CELL 5 // of these: Σ d, Σ |d|², and of its products with that beside and that below
#define SAME 0x3f800000  // 1 as the high half of a word
#define SUMMED 10 // channels of a footprint, and their weight

typedef struct {
    const float *light, *motion, *depth, *normal;  // planes of the current frame
    const uint8_t *uncovered;                      // whether a pixel was just uncovered, for footprints
    const float *lone;                             // likewise, two planes: least and greatest depth of what is scattered, or NULL
    const uint32_t *const *kept;                   // K frames [H, W, words], two bfloat16 in each
    float *mean, *count, *footprint, *footprint_count;  // the last two are NULL where they are not wanted
    uint32_t *found;  // of a thread: [FOUND, K, 3 (red, green; blue, 1 or 0: same surface; s as float32), CELL, BLOCK]
    float *cells;     // likewise: [SUMS, K, OF_CELL, BLOCK / CELL]
    float depth_tolerance, normal_tolerance, alike, changed, wide_alike, wide_changed, white, joined, speed, misplaced;
    int64_t plane;
    int K, H, W, rows, words;
    int from, n;  // the block: its first column, and how many it has
} Job;

static inline uint32_t *found_of(Job j, int cell_row, int k) {
    return j.found + ((int64_t)(cell_row % FOUND) * j.K + k) * 3 * CELL * BLOCK;
}

static inline float *cells_of(Job j, int cell_row, int k) {
    return j.cells + ((int64_t)(cell_row % SUMS) * j.K + k) * OF_CELL * (BLOCK / CELL);
}

// Divide n sums of `channels` channels by the last one, their weight: the mean [channels - 1, H, W] and the weight, from pixel
// `at` on.
static inline void divide(float sum[][BLOCK], int channels, float *mean, float *weight, int64_t plane, int64_t at, int n) {
#pragma omp simd
    for (int x = 0; x < n; x++) {
        float total = sum[channels - 1][x], scale = 1 / MAX(total, 1e-6f);
        weight[at + x] = total;
#pragma GCC unroll 9
        for (int c = 0; c < channels - 1; c++) mean[c * plane + at + x] = sum[c][x] * scale;
    }
}
