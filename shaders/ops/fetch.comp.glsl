#version 430
// Nearest reprojection, for what must not be mixed across silhouettes. With (u, v) the clamped target:
//
//     out[b,c,y,x] = image[b, c, ⌊v + ½⌋, ⌊u + ½⌋]
//
// takes    image [B, CHANNELS, H, W] · motion [B, 2, H, W]
// returns  result [B, CHANNELS, H, W]
#pragma constants CHANNELS
#include "tensor.glsl"
#include "motion.glsl"

layout(std430, binding = 0) readonly restrict buffer Image { float image[]; };
layout(std430, binding = 2) writeonly restrict buffer Result { float result[]; };

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    int b = int(gl_GlobalInvocationID.z);
    if (!inside(pixel, size)) return;

    ivec2 nearest = ivec2(floor(target(b, pixel) + 0.5));
    for (int c = 0; c < CHANNELS; ++c) result[at(b, c, pixel, CHANNELS, size)] = image[at(b, c, nearest, CHANNELS, size)];
}
