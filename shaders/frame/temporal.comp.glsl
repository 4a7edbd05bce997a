#version 430
// Filter the reprojected previous output with its own kernel and blend: the end of a frame.
//
//     out = max(0, α · now + (1 - α) · Σ_taps w · past)
//
// With REPLACE a tap whose past was off the screen counts as `now` does there; without (temporal_kpn) it counts as it is: noise.
//
// takes    features, weights, biases: the head, KERNEL² logits and the logit of α · past [H, W] rgb, flags · now [H, W] rgb
// returns  denoised [H, W] rgb: what history keeps · result [3, H, W]: the same
#pragma constants KERNEL REPLACE
#define PARAMETERS PARAMETER(ivec2, feature_size) PARAMETER(int, groups)
#include "image.glsl"
#include "past.glsl"
#define ROWS (KERNEL * KERNEL + 1)
#include "head.glsl"

layout(std430, binding = 3) readonly restrict buffer Past { vec4 past[]; };
layout(std430, binding = 4) readonly restrict buffer Now { vec4 now[]; };
layout(std430, binding = 5) writeonly restrict buffer Denoised { vec4 denoised[]; };
layout(std430, binding = 6) writeonly restrict buffer Result { float result[]; };

vec3 source(ivec2 p) {
    int i = at(p, size);
    return REPLACE == 1 && !is_on_screen(past[i]) ? now[i].rgb : past[i].rgb;
}
#include "gather.glsl"

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    load_tile();
    if (!inside(pixel, size)) return;

    vec4 rows[FOURS];
    predict(pixel, rows);
    int i = at(pixel, size), plane = size.x * size.y;
    float alpha = sigmoid(rows[(ROWS - 1) >> 2][(ROWS - 1) & 3]);
    vec3 radiance = max(alpha * now[i].rgb + (1.0 - alpha) * gathered(pixel, rows), 0.0);
    denoised[i] = vec4(radiance, 1.0);
    for (int c = 0; c < 3; ++c) result[c * plane + i] = radiance[c];
}
