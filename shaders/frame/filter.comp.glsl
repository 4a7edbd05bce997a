#version 430
// Predict the kernel of every pixel and apply it: one scale of the spatial filter, or the edge kernel.
#include "image.glsl"
#include "kernel_head.glsl"  // logits, and α: how far this scale replaces the low frequencies of the finer one

#pragma reads vec4 image      // [H, W] rgb
#pragma writes vec4 filtered  // [H, W] rgb, α in [0, 1]

vec3 source(ivec2 p) {
    return image[at(p, size)].rgb;
}
#include "gather.glsl"

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    load_tile();
    if (!inside(pixel, size)) return;

    predict(pixel);
#if ROWS > KERNEL * KERNEL
    float alpha = blend_weight();
#else
    float alpha = 1.0;  // the finest scale and the edge kernel replace nothing
#endif
    filtered[at(pixel, size)] = vec4(gathered(pixel), alpha);
}
