#version 430
// One scale of the spatial filter, or the edge kernel: predict the kernel of every pixel, and apply it.
//
// takes    features, weights, biases: the head of this scale, KERNEL² logits and the logit of α · image [H, W] rgb
// returns  filtered [H, W] rgb, and α in [0, 1]: how far this scale replaces the low frequencies of the finer one; of the
//          finest scale and of the edge kernel nobody reads it
#pragma constants KERNEL
#define PARAMETERS PARAMETER(ivec2, feature_size) PARAMETER(int, groups)
#include "image.glsl"
#define ROWS (KERNEL * KERNEL + 1)
#include "head.glsl"

layout(std430, binding = 3) readonly restrict buffer Image { vec4 image[]; };
layout(std430, binding = 4) writeonly restrict buffer Filtered { vec4 filtered[]; };

vec3 source(ivec2 p) {
    return image[at(p, size)].rgb;
}
#include "gather.glsl"

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    load_tile();
    if (!inside(pixel, size)) return;

    vec4 rows[FOURS];
    predict(pixel, rows);
    float alpha = sigmoid(rows[(ROWS - 1) >> 2][(ROWS - 1) & 3]);
    filtered[at(pixel, size)] = vec4(gathered(pixel, rows), alpha);
}
