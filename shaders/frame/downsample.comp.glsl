#version 430
// The next coarser scale of an image; one invocation per pixel of it.
#include "image.glsl"

#pragma reads vec4 fine     // [H, W]
#pragma writes vec4 coarse  // [⌈H/2⌉, ⌈W/2⌉]

#define TYPE vec4
vec4 fine_value(ivec2 pixel) {
    return fine[at(pixel, size)];
}
#include "pool.glsl"

void main() {
    ivec2 cell = ivec2(gl_GlobalInvocationID.xy);
    if (inside(cell, coarse_size())) coarse[at(cell, coarse_size())] = pool(cell);
}
