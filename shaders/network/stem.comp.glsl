#version 430
// 4×4 convolution with stride 2 and a zero padding of 1, and ReLU: from the image to the half-size grid of the network.
//
//     out[o, y, x] = max(0, bias[o] + Σ_{i; dy, dx ∈ 0..3} weight[o, i, dy, dx] · in[i, 2y + dy - 1, 2x + dx - 1])
//
// Where the result is larger than half the image, `out` repeats its border: what a U-Net of whole cells is fed.
//
// takes    image: activations [groups in, 2·half_size] · weights [groups out, groups in, 16] and biases as conv3x3
// returns  result: activations [groups out, H, W]; one invocation per pixel and group of it
// half_size: (⌈W/2⌉, ⌈H/2⌉) of the image; groups: of four input channels, those that are not zero everywhere and all
#define PARAMETERS PARAMETER(ivec2, half_size) PARAMETER(ivec2, groups)
#include "tensor.glsl"
#include "activations.glsl"

layout(std430, binding = 0) readonly restrict buffer Image { FOUR image[]; };
layout(std430, binding = 1) readonly restrict buffer Weights { mat4 weights[]; };
layout(std430, binding = 2) readonly restrict buffer Biases { vec4 biases[]; };
layout(std430, binding = 3) writeonly restrict buffer Result { FOUR result[]; };

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    int o = int(gl_GlobalInvocationID.z);
    if (!inside(pixel, size)) return;

    ivec2 corner = 2 * min(pixel, half_size - 1) - 1;
    vec4 sum = biases[o];
    for (int g = 0; g < groups.x; ++g) {
        for (int tap = 0; tap < 16; ++tap) {
            ivec2 p = corner + ivec2(tap % 4, tap / 4);
            if (!inside(p, 2 * half_size)) continue;
            sum += weights[(o * groups.y + g) * 16 + tap] * unpacked(image[in_group(g, p, 2 * half_size)]);
        }
    }
    result[in_group(o, pixel, size)] = packed_four(max(sum, 0.0));
}
