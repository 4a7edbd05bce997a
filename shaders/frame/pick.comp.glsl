#version 430
// Blend every pixel of a composed scale with a weighted mean of coarser pixels; the kernel and the share are predicted.
//
//     out = composed + share · (Σ_{dy,dx} w[k] · coarse(⌊x/2⌋ + dx - r, ⌊y/2⌋ + dy - r) - composed)
#include "image.glsl"
#include "pyramid.glsl"
#include "kernel_head.glsl"  // logits, and the share
#include "softmax.glsl"

#pragma changes vec4 composed  // [H, W] rgb, α of this scale; its rgb is changed
#pragma reads vec4 coarse      // [⌈H/2⌉, ⌈W/2⌉] rgb

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy), corner = pixel / 2 - KERNEL / 2;
    if (!inside(pixel, size)) return;

    predict(pixel);
    float total = softmax(corner, coarse_size());
    vec3 sum = vec3(0.0);
    for (int k = 0; k < TAPS; ++k) {
        ivec2 read = clamp(corner + tap(k), ivec2(0), coarse_size() - 1);
        sum += weight[k] * coarse[at(read, coarse_size())].rgb;
    }
    composed[at(pixel, size)].rgb = mix(composed[at(pixel, size)].rgb, sum / total, blend_weight());
}
