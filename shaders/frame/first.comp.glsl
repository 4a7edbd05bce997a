#version 430
// The noisy radiance: in a first frame it stands in for the previous output, which was nowhere on the screen, and the next frame
// follows its light.
#include "image.glsl"
#include "albedo.glsl"

#pragma reads vec4 light, vec4 guide  // [H, W]
#pragma writes vec4 past              // [H, W] rgb, no flags

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;

    int i = at(pixel, size);
    past[i] = vec4(light[i].rgb * divisor(guide[i]), 0.0);
}
