// What the passes of the splat have in common (motion_splat.splat_motion_next): motion_next of the previous frame, from the
// current motion read backwards. Every pixel p bids for its target with (mismatch of depth, index of p); the smallest wins.
#include "image.glsl"

layout(std430, binding = 0) readonly restrict buffer Vectors { vec4 vectors[]; };  // [H, W]: motion, ·
layout(std430, binding = 1) readonly restrict buffer Surface { vec4 surface[]; };  // [H, W]: ·, depth; 0: nothing hit
layout(std430, binding = 2) readonly restrict buffer SurfaceBefore { vec4 surface_before[]; };

const uint NOTHING = 0xffffffffu;

// Relative difference of two depths, in [0, 1]: 0 for two misses, 1 for a hit and a miss. Not negative: ordered as its bits.
float mismatch(float a, float b) {
    precise float result = a == b ? 0.0 : min(a, b) == 0.0 ? 1.0 : 1.0 - min(a, b) / max(a, b);
    return result;
}
