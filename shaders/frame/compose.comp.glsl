#version 430
// Replace the low frequencies of a scale by the next coarser one, to the extent of its α (eq. 4):
//
//     out = fine + U[α · (coarse - D fine)]
#include "image.glsl"

#pragma reads vec4 fine       // [H, W] rgb, α of this scale
#pragma reads vec4 coarse     // [⌈H/2⌉, ⌈W/2⌉] rgb, α
#pragma writes vec4 composed  // [H, W] rgb, α of this scale

#define TYPE vec4
vec4 fine_value(ivec2 pixel) {
    return fine[at(pixel, size)];
}
#include "pool.glsl"

vec4 coarse_value(ivec2 cell) {
    vec4 value = coarse[at(cell, coarse_size())];
    return value.a * (value - pool(cell));
}
#include "enlarge.glsl"

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;

    vec4 value = fine[at(pixel, size)];
    composed[at(pixel, size)] = vec4(value.rgb + enlarged(pixel).rgb, value.a);
}
