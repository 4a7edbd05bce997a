// Rows of kept frames: the words of each pixel, and the motion of its edges (ops/kept.py).

#define BLOCK 256  // pixels of a row at once
#define WORDS 8    // of a pixel of a kept frame, or LESS
#define LESS 5

typedef uint32_t row __attribute__((vector_size(4 * WORDS)));
#if defined __clang__
#define JOIN(a, b, ...) __builtin_shufflevector(a, b, __VA_ARGS__)
#else
#define JOIN(a, b, ...) __builtin_shuffle(a, b, (row){__VA_ARGS__})
#endif

// Transpose 8 rows of 8 words.
static inline void transpose(row r[WORDS]) {
    row s[WORDS];
    for (int i = 0; i < 8; i += 2) {
        s[i] = JOIN(r[i], r[i + 1], 0, 8, 1, 9, 4, 12, 5, 13);
        s[i + 1] = JOIN(r[i], r[i + 1], 2, 10, 3, 11, 6, 14, 7, 15);
    }
    for (int i = 0; i < 8; i += 4)
        for (int k = 0; k < 2; k++) {
            r[i + 2 * k] = JOIN(s[i + k], s[i + k + 2], 0, 1, 8, 9, 4, 5, 12, 13);
            r[i + 2 * k + 1] = JOIN(s[i + k], s[i + k + 2], 2, 3, 10, 11, 6, 7, 14, 15);
        }
    for (int i = 0; i < 4; i++) {
        row low = r[i], high = r[i + 4];
        r[i] = JOIN(low, high, 0, 1, 2, 3, 8, 9, 10, 11);
        r[i + 4] = JOIN(low, high, 4, 5, 6, 7, 12, 13, 14, 15);
    }
}

// n values of a row of a picture from column `from` on, with a column on each side; the picture's own edge stands for what is
// beyond it.
static inline void padded(const float *picture, int H, int W, int y, int from, int n, float *out) {
    const float *row = picture + (int64_t)MIN(MAX(y, 0), H - 1) * W;
    out[0] = row[MAX(from - 1, 0)];
    memcpy(out + 1, row + from, n * sizeof *out);
    out[n + 1] = row[MIN(from + n, W - 1)];
}

// The motion of the edges in n pixels of row y, from column `from` on, and the distance of what has it: ops/recall.py,
// edge_motion. `motion` has two planes.
static inline void edges(const float *motion, const float *depth, int64_t plane, int H, int W, int y, int from, int n,
                         float tolerance, float speed, float *mx, float *my, float *nearest) {
    float d[3][BLOCK + 2], u[3][BLOCK + 2], v[3][BLOCK + 2];
    for (int i = 0; i < 3; i++) {
        padded(depth, H, W, y + i - 1, from, n, d[i]);
        padded(motion, H, W, y + i - 1, from, n, u[i]);
        padded(motion + plane, H, W, y + i - 1, from, n, v[i]);
    }
#pragma omp simd
    for (int x = 0; x < n; x++) {
        float own = distance(d[1][x + 1]), near = own, its_u = u[1][x + 1], its_v = v[1][x + 1];
#pragma GCC unroll 4
        for (int i = 0; i < 4; i++) {
            int row = (int[]){0, 1, 1, 2}[i], column = x + (int[]){1, 0, 2, 1}[i];
            float other = distance(d[row][column]);
            int nearer = other < (1 - tolerance) * near;
            near = nearer ? other : near;
            its_u = nearer ? u[row][column] : its_u;
            its_v = nearer ? v[row][column] : its_v;
        }
        float du = its_u - u[1][x + 1], dv = its_v - v[1][x + 1];
        int slow = du * du + dv * dv <= speed * speed;
        mx[x] = slow ? its_u : u[1][x + 1];
        my[x] = slow ? its_v : v[1][x + 1];
        nearest[x] = slow ? near : own;
    }
}
