#version 430
// Filter the reprojected history with its own kernel and blend: the end of a frame.
//
//     out = max(0, α · composed + (1 - α) · Σ_taps w · (valid ? past : composed))
//
// takes    features, weights, biases: the head, KERNEL² logits and the logit of α · past [H, W] rgb, flags · composed [H, W]
//          rgb · albedo [H, W] rgb, whether light was divided by it
// returns  denoised [H, W] rgb: what history keeps · result [3, H, W] radiance, the albedo multiplied back
#pragma constants KERNEL
#define PARAMETERS PARAMETER(ivec2, feature_size) PARAMETER(int, groups)
#include "image.glsl"
#include "past.glsl"
#include "albedo.glsl"
#define ROWS (KERNEL * KERNEL + 1)
#include "head.glsl"

layout(std430, binding = 3) readonly restrict buffer Past { vec4 past[]; };
layout(std430, binding = 4) readonly restrict buffer Composed { vec4 composed[]; };
layout(std430, binding = 5) readonly restrict buffer Albedo { vec4 albedo[]; };
layout(std430, binding = 6) writeonly restrict buffer Denoised { vec4 denoised[]; };
layout(std430, binding = 7) writeonly restrict buffer Result { float result[]; };

vec3 source(ivec2 p) {
    vec4 there = past[at(p, size)];
    return is_valid(there) ? there.rgb : composed[at(p, size)].rgb;
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
    vec3 light = max(alpha * composed[i].rgb + (1.0 - alpha) * gathered(pixel, rows), 0.0);
    denoised[i] = vec4(light, 1.0);
    vec3 radiance = light * divisor(albedo[i]);
    for (int c = 0; c < 3; ++c) result[c * plane + i] = radiance[c];
}
