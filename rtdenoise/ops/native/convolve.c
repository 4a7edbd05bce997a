// A 3×3 convolution of float32, channels last, and its ReLU, by Winograd's minimal filtering (Lavin and Gray 2016, Fast Algorithms
// for Convolutional Neural Networks): 16 products for 2×2 results instead of 36, and 9 in a picture that is enlarged. The
// specification is ops/convolve.py. A picture has MOST channels at most.
//
// Two neighbours y along an axis, of inputs d and weights g:
//     m = (d0 − d2)·g0, (d1 + d2)·(g0 + g1 + g2)/2, (d2 − d1)·(g0 − g1 + g2)/2, (d1 − d3)·g2
//     y = m0 + m1 + m2, m1 − m2 − m3
// Pixels x of a smaller picture, each repeated, are d = x0, x1, x1, x2, of which no m2 is left. Along both axes, rows are mixed
// first and columns of what that gives then. `ops.convolve.mixed` mixes the weights.
#include "common.h"

#ifndef LANES  // 16, 8 or 4 may be given
#if defined __AVX512F__
#define LANES 16
#elif defined __AVX__
#define LANES 8
#else
#define LANES 4
#endif
#endif
#define TILES (LANES == 16 ? 12 : 6)  // of 2×2 results at once: times PARTS vectors of sums they fill the registers
#ifdef __aarch64__
#define PARTS 4
#else
#define PARTS 2
#endif
#define BLOCK (PARTS * LANES)  // outputs at once
#define SPAN (2 * TILES + 2 + LANES)
#define ROOM (25 * TILES * MOST)  // mixtures of inputs
#define CACHED (1 << 18)          // weights
typedef float value;
#include "windows.h"
typedef float vector __attribute__((vector_size(LANES * 4)));
typedef float loose __attribute__((vector_size(LANES * 4), aligned(4)));  // anywhere in memory
typedef int32_t mask __attribute__((vector_size(LANES * 4)));

// The mixtures of `size` inputs `step` from each other take their place: 4, or 3 of a smaller picture.
static inline __attribute__((always_inline)) void mix(int size, vector *d, int step) {
    vector d1 = d[step], d2 = d[2 * step];
    if (size == 3) d[0] -= d1, d[2 * step] = d1 - d2;
    else d[0] -= d2, d[step] = d1 + d2, d[2 * step] = d2 - d1, d[3 * step] = d1 - d[3 * step];
}

// Those of the tiles of a window, LANES channels of all tiles side by side; `further` is from one mixture to the next.
static inline __attribute__((always_inline)) void mixed(int size, const float *const *rows, int C, float *to, int further) {
    for (int t = 0; t < TILES; t++)
        for (int c = 0; c < C; c += LANES) {
            vector d[16];
            for (int v = 0; v < size; v++) {
                for (int u = 0; u < size; u++) d[v * size + u] = *(const loose *)(rows[v] + (t * (size - 2) + u) * C + c);
                mix(size, d + v * size, 1);
            }
            for (int u = 0; u < size; u++) mix(size, d + u, size);
            for (int k = 0; k < size * size; k++) *(loose *)(to + k * further + c * TILES + t * LANES) = d[k];
        }
}

// Add products to the sums of TILES tiles and a block of outputs; weights of a channel are `stride` from those of the next.
static inline __attribute__((always_inline)) const float *
add(vector total[TILES][PARTS], const float *x, const float *weight, int stride, int C) {
    for (int first = 0; first < C; first += LANES, x += TILES * LANES)
        for (int c = 0; c < MIN(LANES, C - first); c++, weight += stride) {
            vector w[PARTS];
            for (int k = 0; k < PARTS; k++) w[k] = *(const loose *)(weight + k * LANES);
            _Pragma("GCC unroll 12") for (int t = 0; t < TILES; t++)
                for (int k = 0; k < PARTS; k++) total[t][k] += x[t * LANES + c] * w[k];
        }
    return weight;
}

// Two neighbours along an axis, of sums `step` from each other.
static inline __attribute__((always_inline)) void two(const vector *m, int step, vector *y) {
    y[0] = m[0] + m[step] + m[2 * step];
    y[1] = m[step] - m[2 * step] - m[3 * step];
}

// Results of TILES tiles from (i, j) on, for `many` outputs from the first of `out` on.
static inline void
store(vector m[16][TILES][PARTS], const float *bias, float *out, int i, int j, int H, int W, int outputs, int many) {
    for (int t = 0; t < TILES && j + 2 * t < W; t++)
        for (int k = 0; k < PARTS && k * LANES < many; k++) {
            vector across[2][4], y[2], added = {0};
            size_t size = MIN(LANES, many - k * LANES) * sizeof *out;
            memcpy(&added, bias + k * LANES, size);
            for (int u = 0; u < 4; u++) {
                two(&m[u][t][k], 4 * TILES * PARTS, y);
                across[0][u] = y[0], across[1][u] = y[1];
            }
            for (int v = 0; v < 2 && i + v < H; v++) {
                two(across[v], 1, y);
                float *to = out + ((int64_t)(i + v) * W + j + 2 * t) * outputs + k * LANES;
                for (int u = 0; u < 2 && j + 2 * t + u < W; u++, to += outputs) {
                    vector z = y[u] + added;
                    z = (vector)((mask)z & ~(z < 0));
                    if (size == sizeof z) *(loose *)to = z;
                    else memcpy(to, &z, size);
                }
            }
        }
}

// The results of two rows from `i` on. Where weights are more than a cache near the processor holds, inputs of several groups of
// TILES tiles are mixed before any is multiplied, so that each weight is read once for all of them.
static void convolved(const source *below, const source *beside, const float *weight, const float *bias, float *out, int stored,
                      int outputs, int i, int H, int W) {
    float inputs[ROOM], space[4][SPAN * MOST];
    const float *rows[4];
    int C = beside->channels, D = below->channels;
    int of_beside = (C + LANES - 1) / LANES * LANES * TILES, of_below = (D + LANES - 1) / LANES * LANES * TILES;
    int each = 16 * of_beside + 9 * of_below, groups = (16 * C + 9 * D) * (int64_t)stored > CACHED ? ROOM / each : 1;
    for (int first = 0; first < W; first += groups * 2 * TILES) {
        groups = MIN(groups, (W - first + 2 * TILES - 1) / (2 * TILES));
        for (int g = 0; g < groups; g++) {
            int j = first + g * 2 * TILES, unread = (LANES - 1) / C + 1;  // pixels after a window that its last vector holds, too
            window(beside, i - 1, j - 1, 4, 2 * TILES + 2 + unread, rows, space);
            mixed(4, rows, C, inputs + g * each, of_beside);
            if (!D) continue;
            unread = (LANES - 1) / D + 1;
            window(below, i / 2 - 1, j / 2 - 1, 3, TILES + 2 + unread, rows, space);
            mixed(3, rows, D, inputs + g * each + 16 * of_beside, of_below);
        }
        for (int o = 0; o < outputs; o += BLOCK)
            for (int g = 0; g < groups; g++) {
                const float *x = inputs + g * each, *smaller = x + 16 * of_beside, *w = weight + o;
                vector m[16][TILES][PARTS];
                for (int s = 0; s < 16; s++, x += of_beside) {
                    vector total[TILES][PARTS];
                    for (int t = 0; t < TILES; t++)
                        for (int k = 0; k < PARTS; k++) total[t][k] = (vector){0};
                    w = add(total, x, w, stored, C);
                    if (D && s / 4 != 2 && s % 4 != 2) {
                        w = add(total, smaller, w, stored, D);
                        smaller += of_below;
                    }
                    memcpy(m[s], total, sizeof total);
                }
                store(m, bias + o, out + o, i, first + g * 2 * TILES, H, W, outputs, MIN(BLOCK, outputs - o));
            }
    }
}

// x is `beside`, a picture of the result's size; `below` has channels where a smaller one is enlarged and joined to it. weight
// [rows, stored]; bias [outputs]; out [H, W, outputs].
void convolve(const source *below, const source *beside, const float *weight, const float *bias, float *out, int stored,
              int outputs, int H, int W, int threads) {
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int i = 0; i < (H + 1) / 2; i++) convolved(below, beside, weight, bias, out, stored, outputs, 2 * i, H, W);
}
