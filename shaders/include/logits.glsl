// Logits as a tensor [B, KERNEL², H, W]. `first_logit` is set to the index of the pixel's first one.
#pragma constants KERNEL LOGITS_HALF

int first_logit;

#if LOGITS_HALF
#pragma reads uint logits  // value i is the low (i even) or high (i odd) half of word ⌊i/2⌋: float16 as numpy has it
float stored_logit(int i) { return unpackHalf2x16(logits[i >> 1] >> (16 * (i & 1))).x; }
#else
#pragma reads float logits
float stored_logit(int i) { return logits[i]; }
#endif

float logit(int k) {
    return stored_logit(first_logit + k * size.x * size.y);
}
