#version 430
// Maxima of 2×2 pixels of activations, where both convolution and skip connection read them. gl_GlobalInvocationID = (x, y, group).
#include "tensor.glsl"
#include "activations.glsl"

#pragma reads FOUR near     // [groups, 2 H, 2 W]
#pragma writes FOUR result  // [groups, H, W]

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;

    int g = int(gl_GlobalInvocationID.z), i = in_group(g, 2 * pixel, 2 * size), below = i + 2 * size.x;
    vec4 upper = max(unpacked(near[i]), unpacked(near[i + 1])), lower = max(unpacked(near[below]), unpacked(near[below + 1]));
    result[in_group(g, pixel, size)] = packed_four(max(upper, lower));
}
