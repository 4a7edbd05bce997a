#version 430
// Keep a share of the detail that only the finer scale has; the share is predicted.
//
//     composed = composed - (1 - share) · (fine - U[D fine])
#include "image.glsl"
#include "head.glsl"

#pragma changes vec4 composed  // [H, W] rgb, α of this scale; its rgb is changed
#pragma reads vec4 fine        // [H, W] rgb

#define TYPE vec4
vec4 fine_value(ivec2 pixel) {
    return fine[at(pixel, size)];
}
#include "pool.glsl"

vec4 coarse_value(ivec2 cell) {
    return pool(cell);
}
#include "enlarge.glsl"

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;

    predict(pixel);
    int i = at(pixel, size);
    composed[i].rgb -= (1.0 - sigmoid(row(0))) * (fine[i].rgb - enlarged(pixel).rgb);
}
