#version 430
// Replace the low frequencies of `fine` by those of `coarse`, to the extent of α (eq. 4):
//
//     out = fine - U[α · D fine] + U[α · coarse] = fine + U[α · (coarse - D fine)]
#pragma constants CHANNELS
#include "tensor.glsl"

#pragma reads float fine     // [B, CHANNELS, H, W]
#pragma reads float coarse   // [B, CHANNELS, ⌈H/2⌉, ⌈W/2⌉]
#pragma reads float alpha    // [B, 1, ⌈H/2⌉, ⌈W/2⌉] in [0, 1]
#pragma writes float result  // [B, CHANNELS, H, W]

int b, c;  // the plane that is composed
#define TYPE float
float fine_value(ivec2 pixel) {
    return fine[at(b, c, pixel, CHANNELS, size)];
}
#include "pool.glsl"

float coarse_value(ivec2 cell) {
    float difference = coarse[at(b, c, cell, CHANNELS, coarse_size())] - pool(cell);
    return alpha[at(b, 0, cell, 1, coarse_size())] * difference;
}
#include "enlarge.glsl"

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    b = int(gl_GlobalInvocationID.z);
    if (!inside(pixel, size)) return;

    for (c = 0; c < CHANNELS; ++c) result[at(b, c, pixel, CHANNELS, size)] = fine_value(pixel) + enlarged(pixel);
}
