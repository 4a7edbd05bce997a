// Reads logits, N a pixel, into planes of float32, as vector code needs them. LOGIT is the type in memory (0: float32,
// 1: bfloat16, 2: float16).

#define BLOCK 64  // pixels

#if LOGIT == 0
typedef float logit;
static inline float value(logit v) { return v; }
#elif LOGIT == 1
typedef uint16_t logit;
static inline float value(uint32_t v) { return from_bits(v << 16); }
#else
// Integer arithmetic, because every compiler vectorises it. The product moves the exponent from bias 15 to 127 and is exact
// for subnormal numbers too; Inf and NaN get their exponent separately.
typedef uint16_t logit;
static inline float value(uint32_t v) {
    uint32_t size = (v & 0x7fff) << 13, sign = (v & 0x8000) << 16;
    float x = from_bits(size) * 0x1p112f;
    return from_bits(bits_of(x) | sign | (size >= 0x0f800000 ? 0x7f800000 : 0));
}
#endif

// Strides, in values, of logits by pixels or by cells of 2×2 (ops/logits.py).
typedef struct { int64_t batch, tap, cell_row, row, cell, pixel; } Layout;
#define OFFSET(l, b, y, x) \
    ((b) * (l).batch + (y) / 2 * (l).cell_row + (y) % 2 * (l).row + (x) / 2 * (l).cell + (x) % 2 * (l).pixel)

// Channels last: neighbouring values are moved in words of 64 bits, two float32 or four of 16 bits each.
#define PER ((int)(sizeof(uint64_t) / sizeof(logit)))
#define WORDS ((N + PER - 1) / PER)
#define READ (WORDS * PER)  // planes that `read_logits` writes

// The logits of one pixel to words. The last word may be partly filled; nothing beyond the logits is read.
static inline void pack(const logit *from, uint64_t *words) {
    _Pragma("GCC unroll 49") for (int i = 0; i < WORDS; i++)
        memcpy(words + i * BLOCK, from + i * PER, MIN(N - i * PER, PER) * sizeof *from);
}

static inline void unpack(const uint64_t *words, float *values) {
    for (int i = 0; i < WORDS; i++)
        _Pragma("omp simd") for (int x = 0; x < BLOCK; x++) {
            uint32_t low = (uint32_t)words[i * BLOCK + x], high = (uint32_t)(words[i * BLOCK + x] >> 32);
            float *to = values + i * PER * BLOCK + x;
#if LOGIT == 0
            to[0] = from_bits(low), to[BLOCK] = from_bits(high);
#else
            to[0] = value(low & 0xffff), to[BLOCK] = value(low >> 16);
            to[2 * BLOCK] = value(high & 0xffff), to[3 * BLOCK] = value(high >> 16);
#endif
        }
}

// Read `pixels` ≤ BLOCK pixels of a row, from pixel `from` on: logit k of pixel from + x to values[k * BLOCK + x]. Logits
// are neighbours in memory along x (planes) or along k (channels last).
static inline void read_logits(const logit *row, Layout at, int from, int pixels, float *values) {
    if (at.pixel == 1 && at.cell == 2) {
        for (int k = 0; k < N; k++) {
            const logit *plane = row + k * at.tap + from;
            for (int x = 0; x < pixels; x += 64 / sizeof *plane) __builtin_prefetch(plane + 2 * BLOCK + x);
            _Pragma("omp simd") for (int x = 0; x < pixels; x++) values[k * BLOCK + x] = value(plane[x]);
        }
    } else {
        uint64_t words[WORDS * BLOCK];
        for (int x = 0; x < pixels; x++) pack(row + OFFSET(at, 0, 0, from + x), words + x);
        unpack(words, values);
    }
}
