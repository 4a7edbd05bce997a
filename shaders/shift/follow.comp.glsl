#version 430
// Motion of light: that of its surface and its shift, which dual motion has none of. With DUAL 0 nothing has been uncovered.
#pragma constants DUAL
#include "image.glsl"

#pragma reads vec4 chosen    // [H, W] motion, uncovered
#pragma reads vec4 moved     // [H, W] pixels
#pragma writes vec4 followed  // [H, W] motion, uncovered

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;

    int i = at(pixel, size);
    float uncovered = DUAL == 1 ? chosen[i].z : 0.0;
    followed[i] = vec4(chosen[i].xy + (uncovered != 0.0 ? vec2(0.0) : moved[i].xy), uncovered, 0.0);
}
