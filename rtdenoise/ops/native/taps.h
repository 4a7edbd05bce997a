// Loops over the taps of a K×K kernel and over C channels.

typedef struct { int y0, y1, x0, x1; } Taps;  // dy in [y0, y1), dx in [x0, x1)

#define FOR_TAPS(t) \
    _Pragma("GCC unroll 16") for (int dy = (t).y0; dy < (t).y1; dy++) \
    _Pragma("GCC unroll 16") for (int dx = (t).x0; dx < (t).x1; dx++)
#define FOR_CHANNELS _Pragma("GCC unroll 8") for (int c = 0; c < C; c++)

static const Taps ALL = {0, K, 0, K};

// The greatest logit of each pixel in a block, whose logits `read_logits` (logits.h) has read.
static inline void greatest(const float *values, int pixels, float *most) {
    _Pragma("omp simd") for (int x = 0; x < pixels; x++) {
        float v = -INFINITY;
        FOR_TAPS(ALL) v = MAX(values[(dy * K + dx) * BLOCK + x], v);
        most[x] = v;
    }
}
