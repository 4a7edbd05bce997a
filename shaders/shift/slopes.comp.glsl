#version 430
// What `sums` looks up: the picture before, its slopes, which are central differences, and its depth.
#include "image.glsl"

#pragma reads vec4 pair            // [H, W] of `compress`
#pragma reads vec4 surface_before  // [H, W] normal, depth
#pragma writes vec4 known          // [H, W] value, ∂/∂x, ∂/∂y, depth

float value(ivec2 pixel) {
    return pair[at(clamp(pixel, ivec2(0), size - 1), size)].y;
}

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;

    float x = 0.5 * (value(pixel + ivec2(1, 0)) - value(pixel - ivec2(1, 0)));
    float y = 0.5 * (value(pixel + ivec2(0, 1)) - value(pixel - ivec2(0, 1)));
    known[at(pixel, size)] = vec4(value(pixel), x, y, surface_before[at(pixel, size)].w);
}
