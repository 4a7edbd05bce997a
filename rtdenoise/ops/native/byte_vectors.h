// Vectors of sums of products of bytes, for convolve_bytes.c, and its results. LANES may be given: 16, 8 or 4, for code of
// CPUs that have less. With PAIRS, for convolve_pairs.c, products are of two numbers of 16 bits.
typedef uint8_t value;  // of pictures that are read
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
// (VNNI); or two of 16 bits. `store` makes `many` results of them, at most LANES; compilers do not find its instructions by
// themselves.
#if defined __AVX512VNNI__ || defined __AVXVNNI__ || defined __AVX2__
#include <immintrin.h>
#endif
#ifndef PAIRS
#define PAIRS 0
#endif
#if defined __AVX512VNNI__ && !PAIRS && (!defined LANES || LANES == 16)
#undef LANES
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
#elif (defined __AVX512VNNI__ || defined __AVXVNNI__ || PAIRS && defined __AVX2__) && (!defined LANES || LANES == 8)
#undef LANES
#define LANES 8
#define PIXELS 6
typedef __m256i vector;
static inline vector repeated(int32_t x) { return _mm256_set1_epi32(x); }
#if PAIRS
static inline vector plus_products(vector sum, vector x, vector w) { return _mm256_add_epi32(sum, _mm256_madd_epi16(x, w)); }
#elif defined __AVXVNNI__
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
    if (PAIRS) return sum + (x << 16 >> 16) * (w << 16 >> 16) + (x >> 16) * (w >> 16);
    for (int k = 24; k >= 0; k -= 8) sum += (vector)((bits)x >> (24 - k) & 255) * ((vector)((bits)w << k) >> 24);
    return sum;
}
static inline void store(number *to, vector sum, const float *factor, const float *bias, int many) {
    for (int o = 0; o < many; o++) to[o] = result(fmaf((float)sum[o], factor[o], bias[o]));
}
#endif
