#version 430
// The next coarser scale of an image; one invocation per pixel of it.
//
// takes    fine [H, W]
// returns  coarse [⌈H/2⌉, ⌈W/2⌉]
#include "image.glsl"

layout(std430, binding = 0) readonly restrict buffer Fine { vec4 fine[]; };
layout(std430, binding = 1) writeonly restrict buffer Coarse { vec4 coarse[]; };
#include "image_pool.glsl"

void main() {
    ivec2 cell = ivec2(gl_GlobalInvocationID.xy);
    if (inside(cell, coarse_size())) coarse[at(cell, coarse_size())] = pool(cell);
}
