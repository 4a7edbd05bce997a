// Logits [B, KERNEL², H, W] in binding 1, float or packed half (LOGITS_HALF).
#pragma constants KERNEL LOGITS_HALF

const int TAPS = KERNEL * KERNEL;
const float LOWEST = -3.402823466e38;

#if LOGITS_HALF
// Value i is the low (i even) or high (i odd) half of word ⌊i/2⌋: a float16 array as it lies in memory.
layout(std430, binding = 1) readonly restrict buffer Logits { uint logits[]; };
float logit(int i) { return unpackHalf2x16(logits[i >> 1] >> (16 * (i & 1))).x; }
#else
layout(std430, binding = 1) readonly restrict buffer Logits { float logits[]; };
float logit(int i) { return logits[i]; }
#endif
