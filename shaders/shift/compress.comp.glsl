#version 430
// Compressed luminance of a picture and of the one before (shift.displacement.compressed); with BLUR the mean of 3×3 pixels.
#pragma constants BLUR
#include "image.glsl"
#include "luminance.glsl"

#pragma reads vec4 picture, vec4 before  // [H, W] rgb
#pragma reads float scale                // [1]
#pragma writes vec4 pair                 // [H, W] this picture's, that of the one before, 0, 0

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;

    vec2 sum = vec2(0.0);
    for (int k = 0; k < (BLUR == 1 ? 9 : 1); ++k) {
        int i = at(BLUR == 1 ? clamp(pixel + ivec2(k % 3, k / 3) - 1, ivec2(0), size - 1) : pixel, size);
        sum += log(1.0 + scale[0] * vec2(luminance(picture[i].rgb), luminance(before[i].rgb)));
    }
    pair[at(pixel, size)] = vec4(BLUR == 1 ? sum / 9.0 : sum, 0.0, 0.0);
}
