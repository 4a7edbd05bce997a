// Pixels that know less than those around them. The specification is ops/evened.py; CELL and SEEN_ONCE are those of
// constants.py. First the greatest value of each cell, then the pixels.
#include "common.h"

static inline float in_unit(float x) { return MIN(MAX(x, 0), 1); }

// The greatest value in each cell of a row of cells, of bytes or of numbers.
#define GREATEST(name, number)                                                                                         \
    static inline void name(const number *x, float *most, int row, int H, int W) {                                    \
        for (int from = 0; from < W; from += CELL) {                                                                   \
            number found = x[(int64_t)row * CELL * W + from];                                                          \
            for (int y = row * CELL; y < MIN((row + 1) * CELL, H); y++)                                                \
                for (int c = from; c < MIN(from + CELL, W); c++) found = MAX(found, x[(int64_t)y * W + c]);            \
            most[from / CELL] = found;                                                                                 \
        }                                                                                                              \
    }
GREATEST(of_bytes, uint8_t)
GREATEST(of_numbers, float)

// The greatest value of a cell and the eight around it.
static inline float around(const float *most, int row, int column, int rows, int columns) {
    float found = -INFINITY;
    for (int i = MAX(row - 1, 0); i <= MIN(row + 1, rows - 1); i++)
        for (int k = MAX(column - 1, 0); k <= MIN(column + 1, columns - 1); k++) found = MAX(found, most[i * columns + k]);
    return found;
}

// x [B, 1, H, W], bytes or numbers; most [B, rows, columns], of cells.
void greatest(const void *x, int flags, float *most, int B, int H, int W, int threads) {
    int rows = (H + CELL - 1) / CELL, columns = (W + CELL - 1) / CELL;
    int64_t plane = (int64_t)H * W;
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int i = 0; i < B * rows; i++)
        if (flags) of_bytes((const uint8_t *)x + i / rows * plane, most + (int64_t)i * columns, i % rows, H, W);
        else of_numbers((const float *)x + i / rows * plane, most + (int64_t)i * columns, i % rows, H, W);
}

// light, image, out [B, 3, H, W]; count, trust [B, 1, H, W]
void evened(const float *light, const float *count, const float *image, const float *trust, const float *most, float *out,
            int B, int H, int W, int threads) {
    int rows = (H + CELL - 1) / CELL, columns = (W + CELL - 1) / CELL;
    int64_t plane = (int64_t)H * W;
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int line = 0; line < B * H; line++) {
        int64_t b = line / H, y = line % H;
        for (int from = 0; from < W; from += CELL) {
            float near = around(most + b * rows * columns, y / CELL, from / CELL, rows, columns);
            float share = (1 - (float)SEEN_ONCE) * in_unit(near - 1);
            int64_t at = b * plane + y * W + from, first = at + 2 * b * plane;
            int n = MIN(CELL, W - from);
#pragma omp simd
            for (int x = 0; x < n; x++) {
                float weight = 1 - trust[at + x] * (1 - in_unit(count[at + x] - 1)) * share;
                for (int c = 0; c < 3; c++)
                    out[first + c * plane + x] = lerp(image[first + c * plane + x], light[first + c * plane + x], weight);
            }
        }
    }
}

// held, of bytes or numbers, numbers and tells [B, 1, H, W]
void held_and_tells(const void *held, int flags, const float *most, float *numbers, float *tells, int B, int H, int W,
                    int threads) {
    int rows = (H + CELL - 1) / CELL, columns = (W + CELL - 1) / CELL;
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int line = 0; line < B * H; line++)
        for (int from = 0; from < W; from += CELL) {
            float less = 1 - around(most + (int64_t)(line / H) * rows * columns, line % H / CELL, from / CELL, rows, columns);
            int64_t at = (int64_t)line * W + from;
            for (int x = 0; x < MIN(CELL, W - from); x++) {
                float own = flags ? ((const uint8_t *)held)[at + x] : ((const float *)held)[at + x];
                numbers[at + x] = own;
                tells[at + x] = own + (1 - own) * less;
            }
        }
}
