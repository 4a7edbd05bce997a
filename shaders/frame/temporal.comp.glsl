#version 430
// Filter the reprojected previous output with a kernel of its own and blend: the end of a frame.
//
//     out = max(0, α · now + (1 - α) · Σ_taps w · past)
//
// With REPLACE a tap that was off the screen takes `now` instead of `past`; without it (temporal_kpn) it takes the noise that
// `past` holds there.
#pragma constants REPLACE
#include "image.glsl"
#include "past.glsl"
#include "kernel_head.glsl"  // logits, and α
#include "giving_way.glsl"

#pragma reads vec4 past       // [H, W] rgb, flags
#pragma reads vec4 now        // [H, W] rgb
#pragma writes vec4 denoised  // [H, W] rgb: for history
#pragma writes float result   // [3, H, W]: the same

vec3 source(ivec2 p) {
    int i = at(p, size);
    return REPLACE == 1 && !is_on_screen(past[i]) ? now[i].rgb : past[i].rgb;
}
#include "gather.glsl"

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    load_tile();
    if (!inside(pixel, size)) return;

    predict(pixel);
    int i = at(pixel, size), plane = size.x * size.y;
    float alpha = giving_way(blend_weight(), pixel);
    vec3 radiance = max(alpha * now[i].rgb + (1.0 - alpha) * gathered(pixel), 0.0);
    denoised[i] = vec4(radiance, 1.0);
    for (int c = 0; c < 3; ++c) result[c * plane + i] = radiance[c];
}
