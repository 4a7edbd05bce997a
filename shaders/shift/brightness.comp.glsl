#version 430
// Sums of luminance over blocks of 8×8 pixels, for `scale`. One work group per block.
#include "image.glsl"
#include "luminance.glsl"

#pragma reads vec4 picture    // [H, W] rgb
#pragma writes float blocks   // [⌈H/8⌉, ⌈W/8⌉]

shared float partial[GROUP_X * GROUP_Y];

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    int lane = int(gl_LocalInvocationIndex);
    partial[lane] = inside(pixel, size) ? luminance(picture[at(pixel, size)].rgb) : 0.0;
    for (int step = GROUP_X * GROUP_Y / 2; step > 0; step /= 2) {
        barrier();
        if (lane < step) partial[lane] += partial[lane + step];
    }
    if (lane == 0) blocks[gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x] = partial[0];
}
