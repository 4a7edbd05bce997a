#version 430
// One scale, composed: let every pixel pick from the coarser scale, with a kernel predicted for it.
//
//     out = composed + share · (Σ_{dy,dx} w[k] · coarse(⌊x/2⌋ + dx - r, ⌊y/2⌋ + dy - r) - composed)
//
// takes    features, weights, biases: the head, KERNEL² logits and the logit of the share ·
//          coarse [⌈H/2⌉, ⌈W/2⌉] rgb
// changes  composed [H, W] rgb, α of this scale: its rgb
#pragma constants KERNEL
#define PARAMETERS PARAMETER(ivec2, feature_size) PARAMETER(int, groups)
#include "image.glsl"
#include "pyramid.glsl"
#define ROWS (KERNEL * KERNEL + 1)
#include "head.glsl"

layout(std430, binding = 3) restrict buffer Composed { vec4 composed[]; };
layout(std430, binding = 4) readonly restrict buffer Coarse { vec4 coarse[]; };

const float LOWEST = -3.402823466e38;

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;

    vec4 rows[FOURS];
    predict(pixel, rows);
    ivec2 corner = pixel / 2 - KERNEL / 2;
    float greatest = LOWEST;
    for (int k = 0; k < KERNEL * KERNEL; ++k) {
        bool counts = inside(corner + ivec2(k % KERNEL, k / KERNEL), coarse_size());
        greatest = max(greatest, counts ? rows[k >> 2][k & 3] : LOWEST);
    }
    float total = 0.0;
    vec3 sum = vec3(0.0);
    for (int k = 0; k < KERNEL * KERNEL; ++k) {
        ivec2 tap = corner + ivec2(k % KERNEL, k / KERNEL);
        if (!inside(tap, coarse_size())) continue;
        float w = exp(rows[k >> 2][k & 3] - greatest);
        total += w;
        sum += w * coarse[at(tap, coarse_size())].rgb;
    }
    float share = sigmoid(rows[(ROWS - 1) >> 2][(ROWS - 1) & 3]);
    composed[at(pixel, size)].rgb = mix(composed[at(pixel, size)].rgb, sum / total, share);
}
