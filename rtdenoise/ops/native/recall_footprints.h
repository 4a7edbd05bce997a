// Footprints: what kept frames hold of a pixel, whichever surface of it that was.

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
