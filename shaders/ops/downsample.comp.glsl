#version 430
// D of eq. 4: out[b,c,y,x] = mean (POOL_MAX: maximum) of those of fine[b, c, 2y..2y+1, 2x..2x+1] that exist.
// One invocation per pixel of the result.
#pragma constants CHANNELS
#include "tensor.glsl"

#pragma reads float fine     // [B, CHANNELS, H, W]
#pragma writes float result  // [B, CHANNELS, ⌈H/2⌉, ⌈W/2⌉]

int b, c;  // the plane that is pooled
#define TYPE float
float fine_value(ivec2 pixel) {
    return fine[at(b, c, pixel, CHANNELS, size)];
}
#include "pool.glsl"

void main() {
    ivec2 cell = ivec2(gl_GlobalInvocationID.xy);
    b = int(gl_GlobalInvocationID.z);
    if (!inside(cell, coarse_size())) return;

    for (c = 0; c < CHANNELS; ++c) result[at(b, c, cell, CHANNELS, coarse_size())] = pool(cell);
}
