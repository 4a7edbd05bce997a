// Inputs of the splat (splat.splat_motion_next): motion_next of the previous frame, from the current motion read backwards.
// Every pixel p bids for its target with (mismatch of depth, index of p); the smallest bid wins.
#include "image.glsl"

#pragma reads vec4 vectors         // [H, W] motion, ·
#pragma reads vec4 surface         // [H, W] ·, depth; 0 where nothing was hit
#pragma reads vec4 surface_before  // the same, of the previous frame

const uint NOTHING = 0xffffffffu;  // no bid, no pixel

// Relative difference of two depths, in [0, 1]: 0 for two misses, 1 for a hit and a miss. Never negative, so that its bits
// have the same order.
float mismatch(float a, float b) {
    precise float result = a == b ? 0.0 : min(a, b) == 0.0 ? 1.0 : 1.0 - min(a, b) / max(a, b);
    return result;
}
