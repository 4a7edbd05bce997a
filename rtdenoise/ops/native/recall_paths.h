// Paths of the pixels of a block through kept frames, and what they find there.

// The paths of a block of pixels: motion to the kept frame, and the share that the network has left of older light.
typedef struct { float mx[BLOCK], my[BLOCK], s[BLOCK]; } Paths;

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
