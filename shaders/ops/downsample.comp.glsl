#version 430
// D of eq. 4: out[b,c,y,x] = mean (POOL_MAX: maximum) of fine[b, c, 2y..2y+1, 2x..2x+1], as far as those exist.
//
// takes    fine [B, CHANNELS, H, W]
// returns  result [B, CHANNELS, ⌈H/2⌉, ⌈W/2⌉]; one invocation per pixel of it
#pragma constants CHANNELS
#include "tensor.glsl"
#include "pyramid.glsl"

layout(std430, binding = 0) readonly restrict buffer Fine { float fine[]; };
layout(std430, binding = 1) writeonly restrict buffer Result { float result[]; };
#include "pool.glsl"

void main() {
    ivec2 cell = ivec2(gl_GlobalInvocationID.xy);
    int b = int(gl_GlobalInvocationID.z);
    if (!inside(cell, coarse_size())) return;

    for (int c = 0; c < CHANNELS; ++c) result[at(b, c, cell, CHANNELS, coarse_size())] = pool(b, c, cell);
}
