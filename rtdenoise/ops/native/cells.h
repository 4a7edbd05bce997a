// Cells of CELL × CELL pixels. CELL is that of constants.py.

// The sums of a row of cells, [sums, columns], from those of its columns of pixels, [sums, W].
static inline void total_cells(const float *of_pixels, float *cells, int sums, int W, int columns) {
    for (int i = 0; i < sums; i++)
        for (int column = 0; column < columns; column++) {
            float total = 0;
            for (int x = column * CELL; x < MIN((column + 1) * CELL, W); x++) total += of_pixels[i * W + x];
            cells[i * columns + column] = total;
        }
}

// The sums over a cell and the eight around it, from those of all, [rows, sums, columns].
static inline void sum_around(const float *cells, float *sum, int sums, int row, int column, int rows, int columns) {
    for (int i = 0; i < sums; i++) sum[i] = 0;
    for (int y = MAX(row - 1, 0); y <= MIN(row + 1, rows - 1); y++)
        for (int i = 0; i < sums; i++)
            for (int x = MAX(column - 1, 0); x <= MIN(column + 1, columns - 1); x++)
                sum[i] += cells[((int64_t)y * sums + i) * columns + x];
}

// Give every pixel of a row of cells, of an image [H, W], the value of its cell.
static inline void spread_cells(const float *value, float *out, int row, int H, int W) {
    for (int y = row * CELL; y < MIN((row + 1) * CELL, H); y++)
        for (int x = 0; x < W; x++) out[(int64_t)y * W + x] = value[x / CELL];
}

// From the sums of all cells, [rows, sums, columns], one value for each cell of a row.
typedef void values_of_row(const float *cells, float *value, int row, int rows, int columns);

// Give every pixel of images [B, 1, H, W] the value of its cell; `cells` [B, rows, sums, columns]. All `threads` threads call it,
// each of which has space for `stride` values.
static inline void spread_values(values_of_row *values, const float *cells, float *out, float *space, int64_t stride, int sums,
                                 int B, int H, int W, int threads) {
    int rows = (H + CELL - 1) / CELL, columns = (W + CELL - 1) / CELL;
    int64_t plane = (int64_t)H * W, count = (int64_t)B * rows;
#pragma omp for schedule(static)
    for (int t = 0; t < threads; t++)
        for (int64_t i = count * t / threads; i < count * (t + 1) / threads; i++) {
            int row = i % rows;
            values(cells + i / rows * rows * sums * columns, space + t * stride, row, rows, columns);
            spread_cells(space + t * stride, out + i / rows * plane, row, H, W);
        }
}
