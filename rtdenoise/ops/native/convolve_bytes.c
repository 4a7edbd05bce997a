// A convolution of bytes, channels last, or one that doubles the size of a coarser picture and joins a finer one. The
// specification is ops/convolve_bytes.py. HALF is 1 for results in bfloat16, 0 for bytes; a picture has MOST channels at most.
// LANES may be given: 8 or 4, for code of CPUs that have less.
#include "common.h"

#if HALF
typedef uint16_t number;
static inline number result(float y) {  // rounded to nearest, ties to even
    uint32_t bits = bits_of(MAX(y, 0));
    return (number)((bits + 0x7fff + (bits >> 16 & 1)) >> 16);
}
#else
typedef uint8_t number;
static inline number result(float y) { return (number)rintf(MIN(MAX(y, 0), 255)); }
#endif

// Vectors of sums. `plus_products` adds four products of bytes to each, `x` unsigned and `w` signed: on x86 one instruction
// (VNNI). `store` makes `many` results of them, at most LANES; compilers do not find its instructions by themselves.
#if defined __AVX512VNNI__ || defined __AVXVNNI__
#include <immintrin.h>
#endif
#if defined __AVX512VNNI__ && !defined LANES
#define LANES 16
#define PIXELS 12  // times PARTS vectors of sums: they fill the registers
typedef __m512i vector;
static inline vector repeated(int32_t x) { return _mm512_set1_epi32(x); }
static inline vector plus_products(vector sum, vector x, vector w) { return _mm512_dpbusd_epi32(sum, x, w); }
static inline void store(number *to, vector sum, const float *factor, const float *bias, int many) {
    __mmask16 there = (__mmask16)((1u << many) - 1);
    __m512 y = _mm512_fmadd_ps(_mm512_cvtepi32_ps(sum), _mm512_maskz_loadu_ps(there, factor), _mm512_maskz_loadu_ps(there, bias));
    y = _mm512_max_ps(y, _mm512_setzero_ps());
#if HALF
    vector bits = _mm512_castps_si512(y), odd = _mm512_and_si512(_mm512_srli_epi32(bits, 16), repeated(1));
    bits = _mm512_srli_epi32(_mm512_add_epi32(bits, _mm512_add_epi32(odd, repeated(0x7fff))), 16);
    _mm256_mask_storeu_epi16(to, there, _mm512_cvtepi32_epi16(bits));
#else
    _mm_mask_storeu_epi8(to, there, _mm512_cvtusepi32_epi8(_mm512_cvtps_epi32(y)));  // to nearest, ties to even
#endif
}
#elif (defined __AVX512VNNI__ || defined __AVXVNNI__) && (!defined LANES || LANES == 8)
#undef LANES
#define LANES 8
#define PIXELS 6
typedef __m256i vector;
static inline vector repeated(int32_t x) { return _mm256_set1_epi32(x); }
#if defined __AVXVNNI__
static inline vector plus_products(vector sum, vector x, vector w) { return _mm256_dpbusd_avx_epi32(sum, x, w); }
#else
static inline vector plus_products(vector sum, vector x, vector w) { return _mm256_dpbusd_epi32(sum, x, w); }
#endif
static inline void store(number *to, vector sum, const float *factor, const float *bias, int many) {
    float padded[2][LANES];
    if (many < LANES) {
        memset(padded, 0, sizeof padded);
        for (int o = 0; o < many; o++) padded[0][o] = factor[o], padded[1][o] = bias[o];
        factor = padded[0], bias = padded[1];
    }
    __m256 y = _mm256_fmadd_ps(_mm256_cvtepi32_ps(sum), _mm256_loadu_ps(factor), _mm256_loadu_ps(bias));
    y = _mm256_max_ps(y, _mm256_setzero_ps());
#if HALF
    vector bits = _mm256_castps_si256(y), odd = _mm256_and_si256(_mm256_srli_epi32(bits, 16), repeated(1));
    bits = _mm256_srli_epi32(_mm256_add_epi32(bits, _mm256_add_epi32(odd, repeated(0x7fff))), 16);
#else
    vector bits = _mm256_cvtps_epi32(_mm256_min_ps(y, _mm256_set1_ps(255)));  // to nearest, ties to even
#endif
    __m128i results = _mm_packus_epi32(_mm256_castsi256_si128(bits), _mm256_extracti128_si256(bits, 1));
    if (!HALF) results = _mm_packus_epi16(results, results);
    if (many == LANES) memcpy(to, &results, LANES * sizeof *to);  // a constant: one instruction
    else memcpy(to, &results, many * sizeof *to);
}
#else
#undef LANES
#define LANES 4
#define PIXELS 4
typedef int32_t vector __attribute__((vector_size(LANES * 4)));
typedef uint32_t bits __attribute__((vector_size(LANES * 4)));
static inline vector repeated(int32_t x) { return (vector){0} + x; }
static inline vector plus_products(vector sum, vector x, vector w) {
    for (int k = 24; k >= 0; k -= 8) sum += (vector)((bits)x >> (24 - k) & 255) * ((vector)((bits)w << k) >> 24);
    return sum;
}
static inline void store(number *to, vector sum, const float *factor, const float *bias, int many) {
    for (int o = 0; o < many; o++) to[o] = result(fmaf((float)sum[o], factor[o], bias[o]));
}
#endif

#define PARTS 2                // vectors of outputs at once
#define BLOCK (PARTS * LANES)  // outputs
#define SPAN (2 * PIXELS + 1)  // pixels of a row that a block reads at most

// A picture that a convolution reads: bytes [height, width, channels], through windows of taps × taps pixels. Neighbouring
// outputs of a block read windows that are `step` pixels apart.
typedef struct {
    const uint8_t *bytes;
    int height, width, channels, taps, step;
} source;

// `rows[v]`: the pixels from column `left` of row `top + v`; zeros where there are none, for which `space` is used.
static inline void window(const source *s, int top, int left, const uint8_t **rows, uint8_t (*space)[SPAN * MOST]) {
    int pixels = (PIXELS - 1) * s->step + s->taps, from = MAX(left, 0), to = MIN(left + pixels, s->width), C = s->channels;
    for (int v = 0; v < s->taps; v++) {
        int y = top + v, inside = y >= 0 && y < s->height;
        const uint8_t *row = inside ? s->bytes + ((int64_t)y * s->width + from) * C : NULL;
        rows[v] = row;
        if (inside && from == left && to == left + pixels) continue;
        rows[v] = memset(space[v], 0, (size_t)pixels * C);
        if (inside && from < to) memcpy(space[v] + (from - left) * C, row, (size_t)(to - from) * C);
    }
}

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
            window(r.below, r.i / 2 + r.a - 1, j + r.b - 1, rows, space);
            w = add(sums, rows, w, r.stride, 2, 1, parts, r.below->channels);
            window(r.beside, r.i - 1, j * 2 + r.b - 1, rows, space);
            add(sums, rows, w, r.stride, 3, 2, parts, r.beside->channels);
        } else {
            window(r.beside, r.i - 1, j - 1, rows, space);
            add(sums, rows, w, r.stride, 3, 1, parts, r.beside->channels);
        }
        memcpy(totals, sums, sizeof totals);  // registers have no index
        number *to = r.out + (int64_t)(j * scale + r.b) * r.outputs;
        for (int p = 0; p < PIXELS && (j + p) * scale + r.b < r.W; p++, to += scale * r.outputs)
            for (int k = 0; k < parts; k++)
                store(to + k * LANES, totals[p][k], r.factor + k * LANES, r.bias + k * LANES, MIN(LANES, r.many - k * LANES));
    }
}

// x is `beside`, a picture of the result's size; where `below` has taps, its weights come first. weight [phases, quads, stored,
// 4]; factor, bias [phases, outputs]; out [H, W, outputs]. A phase is the place of a result among the 2×2 in a pixel of
// `below`; without that there is one.
void convolve_bytes(const source *below, const source *beside, const int8_t *weight, const float *factor, const float *bias,
                    number *out, int quads, int stored, int outputs, int H, int W, int threads) {
    int scale = below->taps ? 2 : 1;
#pragma omp parallel for num_threads(threads) schedule(static)
    for (int i = 0; i < H; i++)
        for (int b = 0; b < scale; b++)
            for (int first = 0; first < outputs; first += BLOCK) {
                int a = i % scale, phase = a * scale + b, from = phase * outputs + first;
                const int8_t *its = weight + ((int64_t)phase * quads * stored + first) * 4;
                number *to = out + (int64_t)i * W * outputs + first;
                Row r = {below, beside, its, factor + from, bias + from, to, stored * 4, outputs, MIN(BLOCK, outputs - first), W,
                         i, a, b};
                if (r.many > LANES) convolved(r, PARTS);
                else convolved(r, 1);
            }
}
