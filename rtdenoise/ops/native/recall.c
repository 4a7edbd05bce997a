// The mean light of recent frames along chained motion. The specification is ops/recall.py, whose CELL and FAR_AWAY these are;
// GLOSS is that of constants.py.
//
// One pass over the frame, a row of cells at a time: a row's weights need the rows above and below it, so each thread keeps
// what it found in two rows and the sums of three, small enough for its cache.
#include "common.h"
#include "alike.h"

#define BLOCK 256  // pixels, a multiple of CELL
#define PART 16   // pixels of a block that are loaded together where they lie together; BLOCK is a multiple of it
#define FOUND 2   // rows of cells of which a thread keeps what it found
#define SUMS 3    // likewise the sums
#define SAME 0x3f800000  // 1 as the high half of a word
#define SUMMED 10 // channels of a footprint, and their weight

typedef struct {
    const float *light, *motion, *depth, *normal;  // planes of the current frame
    const uint8_t *uncovered;                      // whether a pixel was just uncovered, for footprints
    const uint32_t *const *kept;                   // K frames of 5 planes, or 8, two bfloat16 a pixel
    float *mean, *count, *footprint, *footprint_count;  // the last two are NULL where they are not wanted
    // Of a thread: [FOUND, K, words, CELL, W]. Words: red, green; blue, 1 or 0: same surface; s as float32. In footprints:
    // red, green; blue, 1 or 0: something was hit; albedo's red, green; its blue, normal's x; y, z; the weight as float32.
    uint32_t *found;
    float *cells;     // likewise: [SUMS, K, 4 (Σ d, Σ |d|²), columns]
    float depth_tolerance, normal_tolerance, alike, changed, speed;
    int64_t plane;
    int K, H, W, columns, rows, words;
} Job;

static inline float bounded(float motion) {
    return isnan(motion) ? FAR_AWAY : MIN(MAX(motion, -FAR_AWAY), FAR_AWAY);
}

static inline uint32_t *found_of(Job j, int cell_row, int k) {
    return j.found + ((int64_t)(cell_row % FOUND) * j.K + k) * j.words * CELL * j.W;
}

static inline float *cells_of(Job j, int cell_row, int k) {
    return j.cells + ((int64_t)(cell_row % SUMS) * j.K + k) * 4 * j.columns;
}

// The two bfloat16 of a word.
static inline float low(uint32_t word) { return from_bits(word << 16); }
static inline float high(uint32_t word) { return from_bits(word & 0xffff0000); }

// The paths of a block of pixels: motion to the kept frame, and the share that the network has left of older light.
typedef struct { float mx[BLOCK], my[BLOCK], s[BLOCK]; } Paths;

// Read pixels at[0 ... n) of a kept frame for those of this one from `first` on, whose paths are those from `p` on: light,
// whether they are the same surface, and the path beyond. `together`: they lie in a row from at[0] on, so that they are
// loaded instead of gathered.
static inline void read(Job j, const uint32_t *kept, int64_t first, int n, const int *at, const int *inside, Paths *paths,
                        int p, uint32_t *found, int together) {
    float *mx = paths->mx + p, *my = paths->my + p, *s = paths->s + p;
    int64_t plane = j.plane, stride = (int64_t)CELL * j.W;
    const uint32_t *planes[5];
    for (int c = 0; c < 5; c++) planes[c] = kept + c * plane + (together ? at[0] : 0);
#pragma omp simd
    for (int x = 0; x < n; x++) {
        int from = together ? x : at[x], in = together || inside[x];
        uint32_t blue = planes[1][from], forgets = planes[3][from];
        Surface here = surface_at(j.depth + first, j.normal + first, plane, x);
        Surface its = {high(blue), low(planes[2][from]), high(planes[2][from]), low(forgets)};
        found[x] = planes[0][from];
        found[stride + x] = (blue & 0xffff) | (in & alike(here, its, j.depth_tolerance, j.normal_tolerance) ? SAME : 0);
        found[2 * stride + x] = bits_of(s[x]);
        s[x] *= 1 - high(forgets);
        mx[x] = in ? mx[x] + low(planes[4][from]) : FAR_AWAY;
        my[x] = in ? my[x] + high(planes[4][from]) : FAR_AWAY;
    }
}

static inline float distance(float depth) { return depth > 0 ? depth : INFINITY; }

// The pixel whose motion the edge in pixel (x, y) of a picture has: ops/recall.py, edge_motion. `motion` has two planes.
static inline int64_t edge(const float *motion, const float *depth, int64_t plane, int W, int H, int x, int y,
                           float tolerance, float speed) {
    int64_t at = (int64_t)y * W + x, nearest = at;
    int64_t beside[4] = {y ? at - W : at, x ? at - 1 : at, x + 1 < W ? at + 1 : at, y + 1 < H ? at + W : at};
    for (int i = 0; i < 4; i++)
        if (distance(depth[beside[i]]) < (1 - tolerance) * distance(depth[nearest])) nearest = beside[i];
    float dx = motion[nearest] - motion[at], dy = motion[plane + nearest] - motion[plane + at];
    return dx * dx + dy * dy <= speed * speed ? nearest : at;
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

// 1 minus the distance to the nearest whole number.
static inline float covered(float motion) { return 1 - fabsf(bounded(motion) - nearbyintf(bounded(motion))); }

// Read what footprints of pixels of row y from column `from` on hold of a kept frame, and the path beyond.
// `nearest`: the least distance of what belongs to each pixel.
static inline void see(Job j, const uint32_t *kept, int y, int from, int n, const int *at, const int *inside, Paths *paths,
                       const float *nearest, uint32_t *found) {
    int64_t plane = j.plane, stride = (int64_t)CELL * j.W, first = (int64_t)y * j.W + from;
    int up = y ? -j.W : 0, down = y + 1 < j.H ? j.W : 0;
    const float *depth = j.depth + first, *normal = j.normal + first;
    float *mx = paths->mx, *my = paths->my, *s = paths->s;
#pragma omp simd
    for (int x = 0; x < n; x++) {
        uint32_t words[8];
#pragma GCC unroll 8
        for (int c = 0; c < 8; c++) words[c] = kept[c * plane + at[x]];
        Surface its = {high(words[1]), low(words[2]), high(words[2]), low(words[3])};
        int left = x - (from + x > 0), right = x + (from + x + 1 < j.W), beside = 0;
        beside |= alike(surface_at(depth, normal, plane, x), its, j.depth_tolerance, j.normal_tolerance);
        beside |= alike(surface_at(depth, normal, plane, x + up), its, j.depth_tolerance, j.normal_tolerance);
        beside |= alike(surface_at(depth, normal, plane, left), its, j.depth_tolerance, j.normal_tolerance);
        beside |= alike(surface_at(depth, normal, plane, right), its, j.depth_tolerance, j.normal_tolerance);
        beside |= alike(surface_at(depth, normal, plane, x + down), its, j.depth_tolerance, j.normal_tolerance);
        beside &= (distance(its.depth) >= nearest[x]) & !j.uncovered[first + x];
        found[3 * stride + x] = words[0];
        found[4 * stride + x] = (words[1] & 0xffff) | (its.depth > 0 ? SAME : 0);
        found[5 * stride + x] = words[5];
        found[6 * stride + x] = (words[6] & 0xffff) | words[2] << 16;
        found[7 * stride + x] = words[2] >> 16 | words[3] << 16;
        found[8 * stride + x] = bits_of(inside[x] & beside ? s[x] * covered(mx[x]) * covered(my[x]) : 0);
        s[x] *= 1 - high(words[3]);
        mx[x] = inside[x] ? mx[x] + high(words[6]) : FAR_AWAY;
        my[x] = inside[x] ? my[x] + low(words[7]) : FAR_AWAY;
    }
}

// Follow the paths of n pixels of row y through all kept frames.
static inline void look(Job j, int y, int from, int n) {
    int64_t first = (int64_t)y * j.W + from;
    Paths p, e;  // of the pixels, and of the edges in them
    float nearest[BLOCK];
    memcpy(p.mx, j.motion + first, n * sizeof *p.mx);
    memcpy(p.my, j.motion + j.plane + first, n * sizeof *p.my);
    for (int x = 0; x < n; x++) p.s[x] = e.s[x] = 1;
    if (j.footprint)
        for (int x = 0; x < n; x++) {
            int64_t its = edge(j.motion, j.depth, j.plane, j.W, j.H, from + x, y, j.depth_tolerance, j.speed);
            e.mx[x] = j.motion[its];
            e.my[x] = j.motion[j.plane + its];
            nearest[x] = (1 - j.depth_tolerance) * distance(j.depth[its]);
        }
    for (int k = 0; k < j.K; k++) {
        int at[BLOCK], inside[BLOCK];
        uint32_t *found = found_of(j, y / CELL, k) + y % CELL * j.W + from;
        places(j, y, from, n, &p, at, inside);
        for (int part = 0; part < n; part += PART) {
            int size = MIN(PART, n - part), apart = 0;
            const int *its = at + part, *in = inside + part;
            for (int x = 0; x < size; x++) apart |= !in[x] | (its[x] - x != its[0]);
            for (int c = 0; c < 5; c++) __builtin_prefetch(j.kept[k] + c * j.plane + its[0] + 2 * j.W);  // for a row to come
            if (apart || size < PART) read(j, j.kept[k], first + part, size, its, in, &p, part, found + part, 0);
            else read(j, j.kept[k], first + part, PART, its, in, &p, part, found + part, 1);
        }
        if (!j.footprint) continue;
        places(j, y, from, n, &e, at, inside);
        see(j, j.kept[k], y, from, n, at, inside, &e, nearest, found);
    }
}

// Sum up the differences between a kept frame and this one, in the cells of n pixels.
static inline void compare(Job j, int cell_row, int k, int from, int n) {
    int64_t plane = j.plane, stride = (int64_t)CELL * j.W;
    float sum[4][BLOCK] = {{0}};
    for (int y = cell_row * CELL; y < MIN((cell_row + 1) * CELL, j.H); y++) {
        const float *now = j.light + (int64_t)y * j.W + from;
        const uint32_t *found = found_of(j, cell_row, k) + y % CELL * j.W + from;
#pragma omp simd
        for (int x = 0; x < n; x++) {
            uint32_t other = found[stride + x];
            float light[3] = {low(found[x]), high(found[x]), low(other)};
#pragma GCC unroll 3
            for (int c = 0; c < 3; c++) {
                float d = high(other) * (light[c] - now[c * plane + x]);
                sum[c][x] += d;
                sum[3][x] += d * d;
            }
        }
    }
    for (int i = 0; i < 4; i++)
        for (int x = 0; x < n; x += CELL) {
            float total = 0;
            for (int c = 0; c < CELL; c++) total += sum[i][x + c];
            cells_of(j, cell_row, k)[i * j.columns + (from + x) / CELL] = total;
        }
}

// The weight of unchanged light in a cell, from it and its neighbours.
static inline float unchanged(Job j, int cell_row, int k, int column) {
    float sum[4] = {0};
    for (int i = MAX(cell_row - 1, 0); i <= MIN(cell_row + 1, j.rows - 1); i++)
        for (int c = 0; c < 4; c++) {
            const float *row = cells_of(j, i, k) + c * j.columns;
            sum[c] += (column ? row[column - 1] : 0) + row[column] + (column + 1 < j.columns ? row[column + 1] : 0);
        }
    float q = (sum[0] * sum[0] + sum[1] * sum[1] + sum[2] * sum[2]) / MAX(sum[3], 1e-30f);
    return MIN(MAX((j.changed - q) / (j.changed - j.alike), 0), 1);
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

// The mean over all kept frames, for n pixels of a row of cells.
static inline void average(Job j, int cell_row, int from, int n) {
    int64_t stride = (int64_t)CELL * j.W;
    float sum[CELL][4][BLOCK] = {{{0}}}, seen[CELL][SUMMED][BLOCK];
    int height = MIN(CELL, j.H - cell_row * CELL);
    if (j.footprint) memset(seen, 0, sizeof seen);
    for (int k = 0; k < j.K; k++) {
        float weight[BLOCK];
        for (int x = 0; x < n; x += CELL) {
            float w = unchanged(j, cell_row, k, (from + x) / CELL);
            for (int i = 0; i < CELL; i++) weight[x + i] = w;
        }
        for (int y = 0; y < height; y++) {
            const uint32_t *found = found_of(j, cell_row, k) + y * j.W + from;
#pragma omp simd
            for (int x = 0; x < n; x++) {
                uint32_t other = found[stride + x];
                float w = weight[x] * high(other) * from_bits(found[2 * stride + x]);
                sum[y][0][x] += w * low(found[x]);
                sum[y][1][x] += w * high(found[x]);
                sum[y][2][x] += w * low(other);
                sum[y][3][x] += w;
            }
            if (!j.footprint) continue;
#pragma omp simd
            for (int x = 0; x < n; x++) {
                uint32_t rg = found[3 * stride + x], b = found[4 * stride + x], a = found[5 * stride + x];
                uint32_t ax = found[6 * stride + x], yz = found[7 * stride + x];
                float w = weight[x] * from_bits(found[8 * stride + x]);
                float albedo[3] = {low(a), high(a), low(ax)}, light[3] = {low(rg), high(rg), low(b)};
#pragma GCC unroll 3
                for (int c = 0; c < 3; c++) {
                    seen[y][c][x] += w * light[c] * (high(b) > 0 ? albedo[c] + (float)GLOSS : 1);
                    seen[y][3 + c][x] += w * albedo[c];
                }
                seen[y][6][x] += w * high(ax);
                seen[y][7][x] += w * low(yz);
                seen[y][8][x] += w * high(yz);
                seen[y][9][x] += w;
            }
        }
    }
    for (int y = 0; y < height; y++) {
        int64_t at = (int64_t)(cell_row * CELL + y) * j.W + from;
        divide(sum[y], 4, j.mean, j.count, j.plane, at, n);
        if (j.footprint) divide(seen[y], SUMMED, j.footprint, j.footprint_count, j.plane, at, n);
    }
}

// Rows of cells [top, bottom).
static void band(Job j, int top, int bottom) {
    for (int row = MAX(top - 1, 0); row <= bottom; row++) {
        if (row < j.rows)
            for (int from = 0; from < j.W; from += BLOCK) {
                int n = MIN(BLOCK, j.W - from);
                for (int y = row * CELL; y < MIN((row + 1) * CELL, j.H); y++) look(j, y, from, n);
                for (int k = 0; k < j.K; k++) compare(j, row, k, from, n);
            }
        if (row > top)
            for (int from = 0; from < j.W; from += BLOCK) average(j, row - 1, from, MIN(BLOCK, j.W - from));
    }
}

// light [B, 3, H, W], motion [B, 2, H, W], depth [B, 1, H, W], normal [B, 3, H, W], kept: B × K times [5 or 8, H, W],
// mean like light, count like depth; uncovered like depth, footprint [B, 9, H, W] and footprint_count like depth, or all
// three NULL; all contiguous. found and cells hold the scratch of `threads` threads.
void recall(const float *light, const float *motion, const float *depth, const float *normal,
            const uint8_t *uncovered, const uint32_t *const *kept, float *mean, float *count, float *footprint,
            float *footprint_count, uint32_t *found, float *cells, int K, int B, int H, int W, int words,
            float depth_tolerance, float normal_tolerance, float alike, float changed, float speed, int threads) {
    int64_t plane = (int64_t)H * W;
    int rows = (H + CELL - 1) / CELL, columns = (W + CELL - 1) / CELL;
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int t = 0; t < threads; t++)
        for (int b = 0; b < B; b++) {
            Job j = {light + 3 * b * plane, motion + 2 * b * plane, depth + b * plane, normal + 3 * b * plane,
                     footprint ? uncovered + b * plane : NULL, kept + (int64_t)b * K, mean + 3 * b * plane, count + b * plane,
                     footprint ? footprint + 9 * b * plane : NULL, footprint ? footprint_count + b * plane : NULL,
                     found + (int64_t)t * FOUND * K * words * CELL * W, cells + (int64_t)t * SUMS * K * 4 * columns,
                     depth_tolerance, normal_tolerance, alike, changed, speed, plane, K, H, W, columns, rows, words};
            band(j, (int64_t)rows * t / threads, (int64_t)rows * (t + 1) / threads);
        }
}

static inline uint32_t half(float x) {  // bfloat16, the nearest, even in between
    uint32_t bits = bits_of(x);
    return isnan(x) ? 0x7fc0 : (bits + 0x7fff + (bits >> 16 & 1)) >> 16;
}

// light [B, 3, H, W], depth [B, 1, H, W], normal [B, 3, H, W], reset [B, 1, H, W], motion [B, 2, H, W], kept [B, 5, H, W]; or
// with albedo [B, 3, H, W], which may be NULL, [B, 8, H, W]; all contiguous.
void keep(const float *light, const float *depth, const float *normal, const float *reset, const float *motion,
          const float *albedo, uint32_t *kept, int B, int H, int W, float depth_tolerance, float speed, int threads) {
    int64_t plane = (int64_t)H * W;
    int words = albedo ? 8 : 5;
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int row = 0; row < B * H; row++) {
        int64_t b = row / H, y = row % H, first = y * W;
        const float *l = light + 3 * b * plane + first, *d = depth + b * plane + first, *r = reset + b * plane + first;
        const float *n = normal + 3 * b * plane + first, *whole = motion + 2 * b * plane, *m = whole + first;
        uint32_t *out = kept + words * b * plane + first;
#pragma omp simd
        for (int x = 0; x < W; x++) {
            out[x] = half(l[x]) | half(l[plane + x]) << 16;
            out[plane + x] = half(l[2 * plane + x]) | half(d[x]) << 16;
            out[2 * plane + x] = half(n[x]) | half(n[plane + x]) << 16;
            out[3 * plane + x] = half(n[2 * plane + x]) | half(r[x]) << 16;
            out[4 * plane + x] = half(m[x]) | half(m[plane + x]) << 16;
        }
        if (!albedo) continue;
        const float *a = albedo + 3 * b * plane + first;
        for (int x = 0; x < W; x++) {
            int64_t its = edge(whole, d - first, plane, W, H, x, y, depth_tolerance, speed);
            out[5 * plane + x] = half(a[x]) | half(a[plane + x]) << 16;
            out[6 * plane + x] = half(a[2 * plane + x]) | half(whole[its]) << 16;
            out[7 * plane + x] = half(whole[plane + its]);
        }
    }
}
