// Kept frames, two bfloat16 in each word (ops/recall.py), and paths through them. FAR_AWAY is that of constants.py.

// The two bfloat16 of a word.
static inline float low(uint32_t word) { return from_bits(word << 16); }
static inline float high(uint32_t word) { return from_bits(word & 0xffff0000); }

static inline float bounded(float motion) {
    return isnan(motion) ? FAR_AWAY : MIN(MAX(motion, -FAR_AWAY), FAR_AWAY);
}

// 1 minus the distance to the nearest whole number.
static inline float covered(float motion) { return 1 - fabsf(bounded(motion) - nearbyintf(bounded(motion))); }

static inline float distance(float depth) { return depth > 0 ? depth : INFINITY; }
