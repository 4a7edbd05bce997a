// The share that the noisy frame tells (`ops.mix.share_told`): sums over cells of pixels, their means around, and the share
// between them. CELL, DARK, LARGEST and NOISE are those of constants.py.
#define SUMS 3  // along, square, noise

typedef struct {
    const float *first, *other, *noisy;  // [3, H, W]
    float *cells, *around;               // [rows, SUMS, columns] each
    float scale, usual;
    int64_t plane;
    int H, W, rows, columns;
} Told;

// The terms of the sums in a row of cells, averaged over each; `sum` has SUMS · W values.
static inline void terms(Told j, int row, float *sum) {
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
static inline void smooth(Told j, int row) {
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
static inline void told(Told j, int y, float *between, float *share) {
    float v = MAX((y + 0.5f) / CELL - 0.5f, 0);
    int top = (int)v, bottom = MIN(top + 1, j.rows - 1), count = SUMS * j.columns;
    const float *above = j.around + (int64_t)top * count, *below = j.around + (int64_t)bottom * count;
    const float *along = between, *square = between + j.columns, *noisy = between + 2 * j.columns;
    for (int i = 0; i < count; i++) between[i] = (1 - (v - top)) * above[i] + (v - top) * below[i];
#pragma omp simd
    for (int x = 0; x < j.W; x++) {
        float u = MAX((x + 0.5f) / CELL - 0.5f, 0);
        int left = (int)u, right = MIN(left + 1, j.columns - 1);
        float near = 1 - (u - left), far = u - left, noise = near * noisy[left] + far * noisy[right] + (float)NOISE;
        float a = (j.usual * noise + near * along[left] + far * along[right]) / (noise + near * square[left] + far * square[right]);
        share[x] = MIN(MAX(a, 0), 1);
    }
}
