// A convolution of bytes, channels last, or one that doubles the size of a coarser picture and joins a finer one. The
// specification is ops/convolve_bytes.py. HALF is 1 for results in bfloat16, 0 for bytes; a picture has MOST channels at most.
// EMULATED may be given, for code of CPUs that have tiles.
#include <stdlib.h>
#include "common.h"
#if EMULATED || defined __AMX_INT8__ && defined __linux__ && !defined LANES
#define TILES 1
#include "tiles.h"
#endif
#include "byte_vectors.h"

#define PARTS 2                // vectors of outputs at once
#define BLOCK (PARTS * LANES)  // outputs
#if TILES
#define SPAN (4 * TILE + 2)  // pixels of a row that a block reads at most
#else
#define SPAN (2 * PIXELS + 1)
#endif
#include "windows.h"

// Add a source's products to the sums of PIXELS pixels and `parts` vectors of outputs; returns the weights after its own.
// `stride`: bytes from the weights of four channels to those of the next four.
static inline __attribute__((always_inline)) const int8_t *
added(vector sums[PIXELS][PARTS], const uint8_t *const *rows, const int8_t *weight, int stride, int taps, int step, int parts,
      int C) {
    for (int v = 0; v < taps; v++)
        for (int u = 0; u < taps; u++)
            for (int c = 0; c < C; c += 4, weight += stride) {
                const uint8_t *x = rows[v] + u * C + c;
                vector w[PARTS];
                for (int k = 0; k < parts; k++) memcpy(w + k, weight + k * LANES * 4, sizeof *w);
                _Pragma("GCC unroll 12") for (int p = 0; p < PIXELS; p++) {
                    int32_t four;
                    memcpy(&four, x + p * step * C, 4);
                    vector same = repeated(four);
                    for (int k = 0; k < parts; k++) sums[p][k] = plus_products(sums[p][k], same, w[k]);
                }
            }
    return weight;
}

// As `added`; common numbers of channels are constants to the compiler, so that it need not keep PIXELS addresses. Few
// pictures end with less than PARTS vectors: that is not worth the time of compiling them all again.
static inline __attribute__((always_inline)) const int8_t *
add(vector sums[PIXELS][PARTS], const uint8_t *const *rows, const int8_t *weight, int stride, int taps, int step, int parts,
    int C) {
    if (parts < PARTS) return added(sums, rows, weight, stride, taps, step, parts, C);
    switch (C) {
#define CASE(channels) case channels: return added(sums, rows, weight, stride, taps, step, parts, channels);
        CASE(16) CASE(32) CASE(48) CASE(56) CASE(64) CASE(72) CASE(80) CASE(88) CASE(96) CASE(104) CASE(112)
        CASE(128) CASE(192)
        default: return added(sums, rows, weight, stride, taps, step, parts, C);
    }
}

// The result's pixels of a phase in a row, for `parts` vectors of outputs from the first of `out` on.
typedef struct {
    const source *below, *beside;
    const int8_t *weight;
    const float *factor, *bias;
    number *out;  // the first pixel of the row
    int stride, outputs, many, W, i, a, b;  // the row, and the phase; `many` of `outputs` are stored
} Row;

static inline __attribute__((always_inline)) void convolved(Row r, int parts) {
    int scale = r.below->taps ? 2 : 1;
    for (int j = 0; j * scale + r.b < r.W; j += PIXELS) {
        uint8_t space[3][SPAN * MOST];
        const uint8_t *rows[3];
        const int8_t *w = r.weight;
        vector sums[PIXELS][PARTS], totals[PIXELS][PARTS];
        for (int p = 0; p < PIXELS; p++)
            for (int k = 0; k < PARTS; k++) sums[p][k] = repeated(0);
        if (scale == 2) {
            window(r.below, r.i / 2 + r.a - 1, j + r.b - 1, 2, PIXELS + 1, rows, space);
            w = add(sums, rows, w, r.stride, 2, 1, parts, r.below->channels);
            window(r.beside, r.i - 1, j * 2 + r.b - 1, 3, 2 * PIXELS + 1, rows, space);
            add(sums, rows, w, r.stride, 3, 2, parts, r.beside->channels);
        } else {
            window(r.beside, r.i - 1, j - 1, 3, PIXELS + 2, rows, space);
            add(sums, rows, w, r.stride, 3, 1, parts, r.beside->channels);
        }
        memcpy(totals, sums, sizeof totals);  // registers have no index
        number *to = r.out + (int64_t)(j * scale + r.b) * r.outputs;
        for (int p = 0; p < PIXELS && (j + p) * scale + r.b < r.W; p++, to += scale * r.outputs)
            for (int k = 0; k < parts; k++)
                store(to + k * LANES, totals[p][k], r.factor + k * LANES, r.bias + k * LANES, MIN(LANES, r.many - k * LANES));
    }
}

#if TILES
#include "convolve_tiles.h"
#endif

// x is `beside`, a picture of the result's size; where `below` has taps, its weights come first. weight [phases, quads, stored,
// 4]; factor, bias [phases, outputs]; out [H, W, outputs]. A phase is the place of a result among the 2×2 in a pixel of
// `below`; without that there is one. Returns 0.
int convolve_bytes(const source *below, const source *beside, const int8_t *weight, const float *factor, const float *bias,
                    number *out, int quads, int stored, int outputs, int H, int W, int threads) {
    int scale = below->taps ? 2 : 1, block = BLOCK;
#if TILES
    const source *const sources[] = {below, beside};
    int64_t further = 0;  // from the tiles of TILE outputs to those of the next
    for (int k = 0; k < 2; k++) further += sources[k]->taps * tiles_across(sources[k]) * TILE * DEEP;
    int8_t *tiles = tiles_allowed() ? in_tiles(sources, weight, scale * scale, quads, stored, further) : NULL;
    if (tiles) block = 2 * TILE;
#endif
#pragma omp parallel num_threads(threads)
    {
#if TILES
        if (tiles) tiles_begin();
#endif
#pragma omp for schedule(static)
        for (int i = 0; i < H; i++)
            for (int b = 0; b < scale; b++)
                for (int first = 0; first < outputs; first += block) {
                    int a = i % scale, phase = a * scale + b, from = phase * outputs + first;
                    const int8_t *its = weight + ((int64_t)phase * quads * stored + first) * 4;
                    number *to = out + (int64_t)i * W * outputs + first;
                    Row r = {below, beside, its, factor + from, bias + from, to, stored * 4, outputs,
                             MIN(block, outputs - first), W, i, a, b};
#if TILES
                    if (tiles) {
                        r.weight = tiles + (phase * stored + first) / TILE * further;
                        convolved_by_tiles(r, further);
                        continue;
                    }
#endif
                    if (r.many > LANES) convolved(r, PARTS);
                    else convolved(r, 1);
                }
#if TILES
        if (tiles) tiles_end();
#endif
    }
#if TILES
    free(tiles);
#endif
    return 0;
}
