// The head `shares` of accumulated_kpn: logits of three blend weights.
#include "head.glsl"

const int ALPHA_TEMPORAL = 0;  // of the current frame against denoised history
const int RESET = 1;           // how far the running mean of light restarts
const int SHARP = 2;           // of the current albedo against its running mean
