// As convolve_bytes.c, for CPUs that multiply no bytes but pairs of 16 bits (AVX2): Winograd's minimal filtering (Lavin and Gray
// 2016, Fast Algorithms for Convolutional Neural Networks), with 16 products instead of 36 for 2×2 results, with `below` 34
// instead of 52. Numbers are whole and keep all of their digits, so that results are the same to the bit.
//
// Two neighbours y along an axis, of inputs d and weights g, come from sums m of products of mixtures:
//     `beside` alone:  m = (d0 − d2)·2g0, (d1 + d2)·(g0 + g1 + g2), (d2 − d1)·(g0 − g1 + g2), (d1 − d3)·2g2
//                      2y = m0 + m1 + m2, m1 − m2 − m3
//     `below`:         m = (d0 − d1)·g0, d1·(g0 + g1), (d2 − d1)·g1
//     `beside` it:     m = (d0 − d2)·g0 + d1·g1, d2·(g0 + g2), d3·g1 + (d4 − d2)·g2
//                      y = m0 + m1, m1 + m2
// Along both axes, rows are mixed first and columns of what that gives then.
#include <stdlib.h>
#include "common.h"
#define PAIRS 1
#include "byte_vectors.h"

#define PARTS 2                // vectors of outputs at once
#define BLOCK (PARTS * LANES)  // outputs
#define TILES PIXELS           // of 2×2 results, at once
#define GROUP 16               // channels of a tile that lie side by side
#define SPAN (4 * TILES + 1 + GROUP / 4)
#include "windows.h"

typedef uint8_t bytes __attribute__((vector_size(GROUP)));
typedef int16_t inputs __attribute__((vector_size(GROUP * 2)));
typedef int16_t loose __attribute__((vector_size(GROUP * 2), aligned(2)));  // anywhere in memory
typedef int16_t weights __attribute__((vector_size(BLOCK * 8)));
typedef int32_t sums __attribute__((vector_size(LANES * 4)));

// A tile of a picture is `size` inputs wide: 4 of `beside` alone, 3 of `below`, 5 beside that. Its mixtures take the inputs'
// place, `step` from each other.
static inline __attribute__((always_inline)) void mix_inputs(int size, inputs *d, int step) {
    inputs d0 = d[0], d1 = d[step], d2 = d[2 * step];
    if (size == 3) d[0] = d0 - d1, d[2 * step] = d2 - d1;
    if (size == 4) d[0] = d0 - d2, d[step] = d1 + d2, d[2 * step] = d2 - d1, d[3 * step] = d1 - d[3 * step];
    if (size == 5) d[0] = d0 - d2, d[4 * step] -= d2;
}

// As `mix_inputs`; there are three weights, or two with a size of 3.
static inline __attribute__((always_inline)) void mix_weights(int size, weights *g, int step) {
    weights g0 = g[0], g1 = g[step], g2 = size == 3 ? g1 : g[2 * step];
    if (size == 3) g[step] = g0 + g1, g[2 * step] = g1;
    if (size == 4) g[0] = 2 * g0, g[step] = g0 + g1 + g2, g[2 * step] = g0 - g1 + g2, g[3 * step] = 2 * g2;
    if (size == 5) g[2 * step] = g0 + g2, g[3 * step] = g1, g[4 * step] = g2;
}

// The mixtures of a tile of a picture with C channels, whose top left pixel `row` points to, `further` apart.
static inline __attribute__((always_inline)) void
mixed(int size, const uint8_t *const *row, int64_t left, int C, int16_t *to, int64_t further) {
    for (int c = 0; c < C; c += GROUP, to += TILES * GROUP) {
        inputs d[25];
        for (int v = 0; v < size; v++) {
            for (int u = 0; u < size; u++) {
                bytes x;
                memcpy(&x, row[v] + left + u * C + c, sizeof x);
                d[v * size + u] = __builtin_convertvector(x, inputs);
            }
            mix_inputs(size, d + v * size, 1);
        }
        for (int u = 0; u < size; u++) mix_inputs(size, d + u, size);
        for (int k = 0; k < size * size; k++) *(loose *)(to + k * further) = d[k];
    }
}

// The order in which mixtures are multiplied: those of a sum after each other. `along` sums are of an axis.
typedef struct {
    const source *picture[2];
    int size[2], along, many, of[34], slot[34], ends[16];
} Order;

static Order ordered(const source *below, const source *beside) {
    static const int sum_of[6][5] = {[3] = {0, 1, 2}, [4] = {0, 1, 2, 3}, [5] = {0, 0, 1, 2, 2}};
    Order o = {{below, beside}, {below->taps ? 3 : 0, below->taps ? 5 : 4}, below->taps ? 3 : 4, 0, {0}, {0}, {0}};
    for (int sum = 0; sum < o.along * o.along; o.ends[sum++] = o.many)
        for (int p = 0; p < 2; p++)
            for (int slot = 0; slot < o.size[p] * o.size[p]; slot++) {
                const int *of = sum_of[o.size[p]];
                if (of[slot / o.size[p]] * o.along + of[slot % o.size[p]] == sum) o.of[o.many] = p, o.slot[o.many++] = slot;
            }
    return o;
}

// Bytes of the weights of a block of outputs of a phase, as `arrange` leaves them.
static int64_t room(const Order *o) {
    int64_t all = 0;
    for (int k = 0; k < o->many; k++) all += o->picture[o->of[k]]->channels;
    return all * BLOCK * sizeof(int16_t);
}

// Mix the weights of a block of outputs, for pairs of channels one after the other.
static inline __attribute__((always_inline)) const int8_t *
arrange_picture(const Order *o, int p, int size, const int8_t *from, int stored, int16_t *to) {
    int taps = o->picture[p]->taps, quads = o->picture[p]->channels / 4;
    for (int q = 0; q < quads; q++) {
        weights g[25];
        for (int v = 0; v < taps; v++) {
            for (int u = 0; u < taps; u++) {
                const int8_t *its = from + ((int64_t)(v * taps + u) * quads + q) * stored * 4;
                for (int pair = 0; pair < 2; pair++)
                    for (int k = 0; k < BLOCK * 2; k++) g[v * size + u][pair * BLOCK * 2 + k] = its[k / 2 * 4 + pair * 2 + k % 2];
            }
            mix_weights(size, g + v * size, 1);
        }
        for (int u = 0; u < size; u++) mix_weights(size, g + u, size);
        int16_t *at = to + q * BLOCK * 4;
        for (int k = 0; k < o->many; at += o->picture[o->of[k++]]->channels * BLOCK)
            if (o->of[k] == p) memcpy(at, g + o->slot[k], sizeof *g);
    }
    return from + (int64_t)taps * taps * quads * stored * 4;
}

static void arrange(const Order *o, const int8_t *from, int stored, int16_t *to) {
    if (o->along == 4) arrange_picture(o, 1, 4, from, stored, to);
    else arrange_picture(o, 1, 5, arrange_picture(o, 0, 3, from, stored, to), stored, to);
}

// Add products to the sums of TILES tiles and a block of outputs; returns the weights after theirs.
static inline __attribute__((always_inline)) const int16_t *
add(vector total[TILES][PARTS], const int16_t *x, const int16_t *weight, int C) {
    for (int first = 0; first < C; first += GROUP, x += TILES * GROUP)
        for (int c = 0; c < MIN(GROUP, C - first); c += 2, weight += BLOCK * 2) {
            vector w[PARTS];
            for (int k = 0; k < PARTS; k++) memcpy(w + k, weight + k * LANES * 2, sizeof *w);
            _Pragma("GCC unroll 6") for (int t = 0; t < TILES; t++) {
                int32_t pair;
                memcpy(&pair, x + t * GROUP + c, sizeof pair);
                vector same = repeated(pair);
                for (int k = 0; k < PARTS; k++) total[t][k] = plus_products(total[t][k], same, w[k]);
            }
        }
    return weight;
}

// Two neighbours along an axis, of sums `step` from each other.
static inline __attribute__((always_inline)) void two(int along, const vector *m, int step, vector *y) {
    sums m0 = (sums)m[0], m1 = (sums)m[step], m2 = (sums)m[2 * step];
    y[0] = (vector)(along == 4 ? m0 + m1 + m2 : m0 + m1);
    y[1] = (vector)(along == 4 ? m1 - m2 - (sums)m[3 * step] : m1 + m2);
}

// The results of a row of tiles of a phase, whose top left one is at (i, j) of the phase's own, for the outputs from the first
// of `out` on.
typedef struct {
    const Order *order;
    const int16_t *weight;
    const float *factor, *bias;
    number *out;  // of the phase's first result
    int outputs, high, wide, scale, i, a, b;
} Row;

static inline __attribute__((always_inline)) void results(Row r, int along, vector m[16][TILES][PARTS], int j, int first) {
    int apart = TILES * PARTS, next = r.scale * r.outputs;
    for (int t = 0; t < TILES && j + 2 * t < r.wide; t++)
        for (int k = 0; k < PARTS && first + k * LANES < r.outputs; k++) {
            int at = first + k * LANES, many = MIN(LANES, r.outputs - at);
            vector across[2][4], y[2];
            for (int u = 0; u < along; u++) {
                two(along, m[u][t] + k, along * apart, y);
                across[0][u] = y[0], across[1][u] = y[1];
            }
            for (int v = 0; v < 2 && r.i + v < r.high; v++) {
                two(along, across[v], 1, y);
                number *to = r.out + ((int64_t)(r.i + v) * r.scale * r.wide + j + 2 * t) * next + at;
                for (int u = 0; u < 2 && j + 2 * t + u < r.wide; u++)
                    store(to + u * next, along == 4 ? (vector)((sums)y[u] >> 2) : y[u], r.factor + at, r.bias + at, many);
            }
        }
}

static void convolved(Row r) {
    int16_t spread[2][25 * TILES * MOST];
    uint8_t space[5][SPAN * MOST];
    const uint8_t *rows[5];
    const Order *o = r.order;
    const source *below = o->picture[0], *beside = o->picture[1];
    int C = beside->channels, D = below->channels;
    int64_t further[2] = {TILES * ((D + GROUP - 1) / GROUP * GROUP), TILES * ((C + GROUP - 1) / GROUP * GROUP)};
    for (int j = 0; j < r.wide; j += 2 * TILES) {
        int unread = (GROUP - 1) / C + 1;  // pixels after a window that its last vector holds, too
        if (o->along == 4) {
            window(beside, r.i - 1, j - 1, 4, 2 * TILES + 2 + unread, rows, space);
            for (int t = 0; t < TILES; t++) mixed(4, rows, 2 * t * C, C, spread[1] + t * GROUP, further[1]);
        } else {
            window(beside, 2 * r.i + r.a - 1, 2 * j + r.b - 1, 5, 4 * TILES + 1 + unread, rows, space);
            for (int t = 0; t < TILES; t++) mixed(5, rows, 4 * t * C, C, spread[1] + t * GROUP, further[1]);
            unread = (GROUP - 1) / D + 1;
            window(below, r.i + r.a - 1, j + r.b - 1, 3, 2 * TILES + 1 + unread, rows, space);
            for (int t = 0; t < TILES; t++) mixed(3, rows, 2 * t * D, D, spread[0] + t * GROUP, further[0]);
        }
        const int16_t *w = r.weight;
        for (int first = 0; first < r.outputs; first += BLOCK) {
            vector m[16][TILES][PARTS];
            for (int s = 0, k = 0; s < o->along * o->along; s++) {
                vector total[TILES][PARTS];
                for (int t = 0; t < TILES; t++)
                    for (int part = 0; part < PARTS; part++) total[t][part] = repeated(0);
                for (; k < o->ends[s]; k++)
                    w = add(total, spread[o->of[k]] + o->slot[k] * further[o->of[k]], w, o->picture[o->of[k]]->channels);
                memcpy(m[s], total, sizeof total);
            }
            if (o->along == 4) results(r, 4, m, j, first);
            else results(r, 3, m, j, first);
        }
    }
}

// As that of convolve_bytes.c. Returns 1 where there is no memory, else 0.
int convolve_bytes(const source *below, const source *beside, const int8_t *weight, const float *factor, const float *bias,
                   number *out, int quads, int stored, int outputs, int H, int W, int threads) {
    const Order order = ordered(below, beside);
    int scale = below->taps ? 2 : 1, phases = scale * scale, blocks = (outputs + BLOCK - 1) / BLOCK;
    int high = H / scale, tall = (high + 1) / 2;
    int64_t each = room(&order);
    char *mixtures = malloc((size_t)(phases * blocks * each));
    if (!mixtures) return 1;
#pragma omp parallel num_threads(threads)
    {
#pragma omp for schedule(static)
        for (int k = 0; k < phases * blocks; k++) {
            const int8_t *from = weight + ((int64_t)(k / blocks) * quads * stored + k % blocks * BLOCK) * 4;
            arrange(&order, from, stored, (int16_t *)(mixtures + k * each));
        }
#pragma omp for schedule(static)
        for (int k = 0; k < tall * phases; k++) {
            int phase = k % phases, a = phase / scale, b = phase % scale;
            Row r = {&order, (const int16_t *)(mixtures + phase * blocks * each), factor + phase * outputs, bias + phase * outputs,
                     out + ((int64_t)a * W + b) * outputs, outputs, high, W / scale, scale, k / phases * 2, a, b};
            convolved(r);
        }
    }
    free(mixtures);
    return 0;
}
