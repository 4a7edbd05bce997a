#version 430
// A running mean of the noisy light, given up where the network says that it has changed:
//
//     w = 1 / (1 + length),    w' = w + reset · (1 - w),    mean' = w' · light + (1 - w') · mean,
//     length' = min(1 / w', longest - 1)
//
// takes    features, weights, biases: the head, the logit of reset · light [H, W] · running [H, W] rgb, length
// returns  mean [H, W] rgb, length
#define PARAMETERS PARAMETER(ivec2, feature_size) PARAMETER(int, groups) PARAMETER(float, longest)
#include "image.glsl"
#define ROWS 1
#include "head.glsl"

layout(std430, binding = 3) readonly restrict buffer Light { vec4 light[]; };
layout(std430, binding = 4) readonly restrict buffer Running { vec4 running[]; };
layout(std430, binding = 5) writeonly restrict buffer Mean { vec4 mean[]; };

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    if (!inside(pixel, size)) return;

    vec4 rows[FOURS];
    predict(pixel, rows);
    int i = at(pixel, size);
    float weight = 1.0 / (1.0 + running[i].w);
    weight += sigmoid(rows[0].x) * (1.0 - weight);
    vec3 rgb = weight * light[i].rgb + (1.0 - weight) * running[i].rgb;
    mean[i] = vec4(rgb, min(1.0 / weight, longest - 1.0));
}
