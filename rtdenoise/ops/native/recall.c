// The mean light of recent frames along chained motion. The specification is ops/recall.py, whose CELL and FAR_AWAY these are;
// GLOSS is that of constants.py.
//
// Strip by strip, a row of wide cells at a time: a cell's weight needs the cells around it, so a strip has a wide cell more on
// either side, and a thread keeps what it found in two rows and the sums of three, small enough for its cache. Footprints need
// the weights alone, so their paths are followed when these are known, and what they lead to is summed up at once.
#include "common.h"
#include "alike.h"
#include "kept.h"

#define WIDE 2     // side of a wide cell in cells
#define BLOCK 256  // pixels of a row of a strip and of the wide cells beside it
#define MARGIN (WIDE * CELL)  // pixels of one of these
#define PART 16   // pixels of a block that are fetched at once; BLOCK is a multiple of it
#define WORDS 8   // of a pixel of a kept frame, or LESS
#define LESS 5
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

// The paths of a block of pixels: motion to the kept frame, and the share that the network has left of older light.
typedef struct { float mx[BLOCK], my[BLOCK], s[BLOCK]; } Paths;

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

// Bring PART pixels of a kept frame near: paths of a row to come lead there where motion is even.
static inline void ahead(const uint32_t *kept, int words, int64_t at) {
    for (int i = 0; i < words; i++) __builtin_prefetch(kept + at * words + i * PART);
}

// The words of pixels at[0 ... n) of a kept frame; those of its first pixel up to a multiple of WORDS. `beyond`: from a pixel to
// the one that a row to come needs. All of a block at once: what was just written in halves of a vector is slow to read.
static inline void fetch(const uint32_t *kept, int64_t plane, int words, int n, const int *at, int64_t beyond,
                         uint32_t (*pixels)[BLOCK]) {
    for (int x = 0; x < n; x += WORDS) {
        if (x % PART == 0) ahead(kept, words, at[x] + beyond);
        row rows[WORDS];
        for (int i = 0; i < WORDS; i++) {
            int64_t from = x + i < n ? (int64_t)at[x + i] * words : 0;
            if (words == WORDS || from + WORDS <= plane * words) memcpy(rows + i, kept + from, sizeof *rows);
            else memcpy(rows + i, kept + from, words * sizeof *kept);
        }
        transpose(rows);
        for (int c = 0; c < WORDS; c++) memcpy(pixels[c] + x, rows + c, sizeof *rows);
    }
}

// Read pixels of a kept frame for n pixels of this one from `first` on: light, whether they are the same surface, and the path
// beyond.
static inline void read(Job j, uint32_t (*pixels)[BLOCK], int64_t first, int n, const int *inside, Paths *paths,
                        uint32_t *found) {
    float *mx = paths->mx, *my = paths->my, *s = paths->s;
    int64_t plane = j.plane;
#pragma omp simd
    for (int x = 0; x < n; x++) {
        int in = inside[x];
        uint32_t blue = pixels[1][x], normal = pixels[2][x], forgets = pixels[3][x], motion = pixels[4][x];
        Surface here = surface_at(j.depth + first, j.normal + first, plane, x);
        Surface there = surface(high(blue), low(normal), high(normal), low(forgets));
        found[x] = pixels[0][x];
        found[CELL * BLOCK + x] = (blue & 0xffff) | (in & alike(here, there, j.depth_tolerance, j.normal_tolerance) ? SAME : 0);
        found[2 * CELL * BLOCK + x] = bits_of(s[x]);
        s[x] *= 1 - high(forgets);
        mx[x] = in ? mx[x] + low(motion) : FAR_AWAY;
        my[x] = in ? my[x] + high(motion) : FAR_AWAY;
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

// The pixels that n paths of row y lead to, from column `from` on.
static inline void places(Job j, int y, int from, int n, const Paths *paths, int *at, int *inside) {
#pragma omp simd
    for (int x = 0; x < n; x++) {
        float u = nearbyintf(bounded(paths->mx[x])) + (from + x), v = nearbyintf(bounded(paths->my[x])) + y;
        inside[x] = (u >= 0) & (u < j.W) & (v >= 0) & (v < j.H);
        at[x] = inside[x] ? (int)v * j.W + (int)u : 0;
    }
}

// Follow the paths of row y through all kept frames.
static inline void look(Job j, int y) {
    int from = j.from, n = j.n;
    int64_t first = (int64_t)y * j.W + from;
    Paths p;
    memcpy(p.mx, j.motion + first, n * sizeof *p.mx);
    memcpy(p.my, j.motion + j.plane + first, n * sizeof *p.my);
    for (int x = 0; x < n; x++) p.s[x] = 1;
    for (int k = 0; k < j.K; k++) {
        int at[BLOCK], inside[BLOCK];
        uint32_t pixels[WORDS][BLOCK];
        places(j, y, from, n, &p, at, inside);
        if (j.words == WORDS) fetch(j.kept[k], j.plane, WORDS, n, at, 2 * (int64_t)j.W, pixels);
        else fetch(j.kept[k], j.plane, LESS, n, at, 2 * (int64_t)j.W, pixels);
        read(j, pixels, first, n, inside, &p, found_of(j, y / CELL, k) + y % CELL * BLOCK);
    }
}

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

// The surfaces of a block of pixels of a row, of the row above and of that below, `padded`.
typedef struct {
    float depth[3][BLOCK + 2], x[3][BLOCK + 2], y[3][BLOCK + 2], z[3][BLOCK + 2], square[3][BLOCK + 2];
} Surroundings;

static inline void surroundings(Job j, int y, int from, int n, Surroundings *s) {
    for (int i = 0; i < 3; i++) {
        padded(j.depth, j.H, j.W, y + i - 1, from, n, s->depth[i]);
        padded(j.normal, j.H, j.W, y + i - 1, from, n, s->x[i]);
        padded(j.normal + j.plane, j.H, j.W, y + i - 1, from, n, s->y[i]);
        padded(j.normal + 2 * j.plane, j.H, j.W, y + i - 1, from, n, s->z[i]);
#pragma omp simd
        for (int x = 0; x < n + 2; x++) s->square[i][x] = squared(s->x[i][x], s->y[i][x], s->z[i][x]);
    }
}

// Add to n sums what pixels of a kept frame hold, for footprints of the pixels of a block, and go on along their paths.
// `nearest`: the least distance of what belongs to each pixel, `least` and `greatest`: depths of what is scattered there; the
// first two are NaN where nothing belongs to it.
static inline void see(Job j, uint32_t (*pixels)[BLOCK], int n, const int *inside, Paths *paths,
                       const Surroundings *around, const float *nearest, const float *least, const float *greatest,
                       const float *weight, float sum[][BLOCK]) {
    float *mx = paths->mx, *my = paths->my, *s = paths->s;
#pragma omp simd
    for (int x = 0; x < n; x++) {
        int in = inside[x], beside = 0;
        uint32_t words[WORDS];
#pragma GCC unroll 8
        for (int c = 0; c < WORDS; c++) words[c] = pixels[c][x];
        Surface its = surface(high(words[1]), low(words[2]), high(words[2]), low(words[3]));
#pragma GCC unroll 5
        for (int i = 0; i < 5; i++) {
            int row = (int[]){1, 0, 1, 1, 2}[i], column = x + (int[]){1, 1, 0, 2, 1}[i];
            Surface here = {around->depth[row][column], around->x[row][column], around->y[row][column], around->z[row][column],
                            around->square[row][column]};
            beside |= alike(here, its, j.depth_tolerance, j.normal_tolerance);
        }
        beside &= distance(its.depth) >= nearest[x];
        beside |= (its.depth >= least[x]) & (its.depth <= greatest[x]);
        beside &= in;
        float cover_x = covered(mx[x]), cover_y = covered(my[x]);
        float off = (1 - cover_x) * (1 - cover_x) + (1 - cover_y) * (1 - cover_y);
        float w = beside ? weight[x] * (s[x] * cover_x * cover_y) / (1 + j.misplaced * off) : 0;
        float albedo[3] = {low(words[5]), high(words[5]), low(words[6])};
        float light[3] = {low(words[0]), high(words[0]), low(words[1])};
#pragma GCC unroll 3
        for (int c = 0; c < 3; c++) {
            sum[c][x] += w * light[c] * (its.depth > 0 ? albedo[c] + (float)GLOSS : 1);
            sum[3 + c][x] += w * albedo[c];
        }
        sum[6][x] += w * its.x;
        sum[7][x] += w * its.y;
        sum[8][x] += w * its.z;
        sum[9][x] += w;
        s[x] *= 1 - high(words[3]);
        mx[x] = in ? mx[x] + high(words[6]) : FAR_AWAY;
        my[x] = in ? my[x] + low(words[7]) : FAR_AWAY;
    }
}

// The footprints of n pixels of row y. `weight`: of unchanged light in each kept frame.
static inline void footprints(Job j, int y, int from, int n, float weight[][BLOCK]) {
    int64_t first = (int64_t)y * j.W + from;
    Paths paths;
    Surroundings around;
    float nearest[BLOCK], least[BLOCK], greatest[BLOCK], sum[SUMMED][BLOCK] = {{0}};
    surroundings(j, y, from, n, &around);
    edges(j.motion, j.depth, j.plane, j.H, j.W, y, from, n, j.depth_tolerance, j.speed, paths.mx, paths.my, nearest);
    for (int x = 0; x < n; x++) {
        paths.s[x] = 1;
        nearest[x] = j.uncovered[first + x] ? NAN : (1 - j.depth_tolerance) * nearest[x];
        least[x] = j.uncovered[first + x] || !j.lone ? NAN : j.lone[first + x];
        greatest[x] = j.lone ? j.lone[j.plane + first + x] : 0;
    }
    for (int k = 0; k < j.K; k++) {
        int at[BLOCK], inside[BLOCK];
        uint32_t pixels[WORDS][BLOCK];
        places(j, y, from, n, &paths, at, inside);
        fetch(j.kept[k], j.plane, WORDS, n, at, j.W, pixels);
        see(j, pixels, n, inside, &paths, &around, nearest, least, greatest, weight[k], sum);
    }
    divide(sum, SUMMED, j.footprint, j.footprint_count, j.plane, first, n);
}

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

static inline uint32_t half(float x) {  // bfloat16, the nearest, even in between
    uint32_t bits = bits_of(x);
    return isnan(x) ? 0x7fc0 : (bits + 0x7fff + (bits >> 16 & 1)) >> 16;
}

// light [B, 3, H, W], depth [B, 1, H, W], normal [B, 3, H, W], reset [B, 1, H, W], motion [B, 2, H, W], kept [B, H, W, LESS];
// or with albedo [B, 3, H, W], which may be NULL, [B, H, W, WORDS]; all contiguous.
void keep(const float *light, const float *depth, const float *normal, const float *reset, const float *motion,
          const float *albedo, uint32_t *kept, int B, int H, int W, float depth_tolerance, float speed, int threads) {
    int64_t plane = (int64_t)H * W;
    int words = albedo ? WORDS : LESS;
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int line = 0; line < B * H; line++) {
        int64_t b = line / H, y = line % H, first = y * W;
        const float *l = light + 3 * b * plane + first, *d = depth + b * plane + first, *r = reset + b * plane + first;
        const float *n = normal + 3 * b * plane + first, *m = motion + 2 * b * plane + first;
        const float *a = albedo ? albedo + 3 * b * plane + first : NULL;
        uint32_t *out = kept + words * (b * plane + first);
        for (int from = 0; from < W; from += BLOCK) {
            int many = MIN(BLOCK, W - from);
            float u[BLOCK], v[BLOCK], nearest[BLOCK];
            if (a) edges(m - first, d - first, plane, H, W, y, from, many, depth_tolerance, speed, u, v, nearest);
            for (int part = 0; part < many; part += WORDS) {
                int size = MIN(WORDS, many - part);
                row rows[WORDS];
                uint32_t found[WORDS][WORDS] = {{0}};
#pragma omp simd
                for (int x = 0; x < size; x++) {
                    int i = from + part + x;
                    found[0][x] = half(l[i]) | half(l[plane + i]) << 16;
                    found[1][x] = half(l[2 * plane + i]) | half(d[i]) << 16;
                    found[2][x] = half(n[i]) | half(n[plane + i]) << 16;
                    found[3][x] = half(n[2 * plane + i]) | half(r[i]) << 16;
                    found[4][x] = half(m[i]) | half(m[plane + i]) << 16;
                }
                for (int x = 0; a && x < size; x++) {
                    int i = from + part + x;
                    found[5][x] = half(a[i]) | half(a[plane + i]) << 16;
                    found[6][x] = half(a[2 * plane + i]) | half(u[part + x]) << 16;
                    found[7][x] = half(v[part + x]);
                }
                memcpy(rows, found, sizeof rows);
                transpose(rows);
                for (int x = 0; x < size; x++, out += words) memcpy(out, rows + x, words * sizeof *out);
            }
        }
    }
}
