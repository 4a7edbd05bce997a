#version 430
// U of eq. 4: bilinear ×2. Fine pixel x samples the coarse row at u = clamp((x + ½)/2 - ½, 0, ·), borders repeated.
#pragma constants CHANNELS
#include "tensor.glsl"
#include "pyramid.glsl"

#pragma reads float coarse   // [B, CHANNELS, ⌈H/2⌉, ⌈W/2⌉]
#pragma writes float result  // [B, CHANNELS, H, W]

int b, c;  // the plane that is enlarged
#define TYPE float
float coarse_value(ivec2 cell) {
    return coarse[at(b, c, cell, CHANNELS, coarse_size())];
}
#include "enlarge.glsl"

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    b = int(gl_GlobalInvocationID.z);
    if (!inside(pixel, size)) return;

    for (c = 0; c < CHANNELS; ++c) result[at(b, c, pixel, CHANNELS, size)] = enlarged(pixel);
}
