// What differs between a kept frame and this one, summed up in cells, and how much of it is noise: ops/recall.py, `unchanged` and
// `white`.

static inline float root(float light) { return sqrtf(MAX(light, 0)); }

// The roots of this frame's light in a row of cells.
typedef float Roots[3][CELL][BLOCK];

static inline void roots(Job j, int cell_row, Roots out) {
    for (int c = 0; c < 3; c++)
        for (int y = cell_row * CELL; y < MIN((cell_row + 1) * CELL, j.H); y++) {
            const float *light = j.light + c * j.plane + (int64_t)y * j.W + j.from;
#pragma omp simd
            for (int x = 0; x < j.n; x++) out[c][y % CELL][x] = root(light[x]);
        }
}

// Sum up the differences between a kept frame and this one in a row of cells.
static inline void compare(Job j, int cell_row, int k, Roots now) {
    float sum[OF_CELL][BLOCK] = {{0}}, apart[2][3][BLOCK + 1] = {{{0}}};  // of an even row and of the odd one below it
    for (int y = cell_row * CELL; y < MIN((cell_row + 1) * CELL, j.H); y++) {
        const uint32_t *found = found_of(j, cell_row, k) + y % CELL * BLOCK;
        float (*mine)[BLOCK + 1] = apart[y % 2];
#pragma omp simd
        for (int x = 0; x < j.n; x++) {
            uint32_t other = found[CELL * BLOCK + x];
            float light[3] = {low(found[x]), high(found[x]), low(other)};
#pragma GCC unroll 3
            for (int c = 0; c < 3; c++) {
                float here = now[c][y % CELL][x], d = high(other) * (root(light[c]) - here);
                mine[c][x] = d;
                sum[c][x] += d;
                sum[3][x] += d * d + high(other) * (float)ROUNDING * here * here;
            }
        }
#pragma omp simd
        for (int x = 0; x < j.n; x++) {
            float beside = mine[0][x] * mine[0][x + 1] + mine[1][x] * mine[1][x + 1] + mine[2][x] * mine[2][x + 1];
            sum[4][x] += x % 2 ? 0 : beside;
        }
        if (y % 2)
#pragma omp simd
            for (int x = 0; x < j.n; x++)
                sum[4][x] += apart[0][0][x] * mine[0][x] + apart[0][1][x] * mine[1][x] + apart[0][2][x] * mine[2][x];
    }
    for (int i = 0; i < OF_CELL; i++)
        for (int x = 0; x < j.n; x += CELL) {
            float total = 0;
            for (int c = 0; c < CELL; c++) total += sum[i][x + c];
            cells_of(j, cell_row, k)[i * (BLOCK / CELL) + x / CELL] = total;
        }
}

// Multiply the weights of a row of cells by that of light that is unchanged in `side` × `side` cells and as many on each side
// of them.
static inline void unchanged(Job j, int cell_row, int k, int side, float alike, float changed, float *weight) {
    int top = cell_row / side * side, columns = (j.n + CELL - 1) / CELL;
    float column[4][BLOCK / CELL + 2 * WIDE] = {{0}};  // sums, from `side` columns before the first on
    for (int i = MAX(top - side, 0); i < MIN(top + 2 * side, j.rows); i++)
        for (int c = 0; c < 4; c++) {
            const float *row = cells_of(j, i, k) + c * (BLOCK / CELL);
            for (int x = 0; x < columns; x++) column[c][side + x] += row[x];
        }
    for (int x = 0; x < columns; x++) {
        float sum[4] = {0};
        for (int c = 0; c < 4; c++)
            for (int i = 0; i < 3 * side; i++) sum[c] += column[c][x / side * side + i];
        float q = (sum[0] * sum[0] + sum[1] * sum[1] + sum[2] * sum[2]) / MAX(sum[3], 1e-30f);
        weight[x] *= MIN(MAX((changed - q) / (changed - alike), 0), 1);
    }
}

// Likewise by that of light whose differences are white in a cell and those around it.
static inline void white(Job j, int cell_row, int k, float *weight) {
    int columns = (j.n + CELL - 1) / CELL;
    float column[2][BLOCK / CELL + 2] = {{0}};  // sums, from a column before the first on
    for (int i = MAX(cell_row - 1, 0); i < MIN(cell_row + 2, j.rows); i++)
        for (int c = 0; c < 2; c++) {
            const float *row = cells_of(j, i, k) + (3 + c) * (BLOCK / CELL);
            for (int x = 0; x < columns; x++) column[c][1 + x] += row[x];
        }
    for (int x = 0; x < columns; x++) {
        float sum[2];
        for (int c = 0; c < 2; c++) sum[c] = column[c][x] + column[c][x + 1] + column[c][x + 2];
        float r = sum[1] / MAX(sum[0], 1e-30f);
        weight[x] *= MIN(MAX((j.joined - r) / (j.joined - j.white), 0), 1);
    }
}
