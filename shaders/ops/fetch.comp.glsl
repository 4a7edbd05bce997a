#version 430
// Nearest reprojection, for values that must not be mixed across silhouettes. With (u, v) the clamped target:
//
//     out[b,c,y,x] = image[b, c, ⌊v + ½⌋, ⌊u + ½⌋]
#pragma constants CHANNELS
#include "tensor.glsl"

#pragma reads float image    // [B, CHANNELS, H, W]
#include "motion.glsl"
#pragma writes float result  // [B, CHANNELS, H, W]

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    int b = int(gl_GlobalInvocationID.z);
    if (!inside(pixel, size)) return;

    ivec2 nearest = ivec2(floor(target(b, pixel) + 0.5));
    for (int c = 0; c < CHANNELS; ++c) result[at(b, c, pixel, CHANNELS, size)] = image[at(b, c, nearest, CHANNELS, size)];
}
