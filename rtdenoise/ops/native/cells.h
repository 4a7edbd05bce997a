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

// Give every pixel of a row of cells, of an image [H, W], the value of its cell.
static inline void spread_cells(const float *value, float *out, int row, int H, int W) {
    for (int y = row * CELL; y < MIN((row + 1) * CELL, H); y++)
        for (int x = 0; x < W; x++) out[(int64_t)y * W + x] = value[x / CELL];
}
