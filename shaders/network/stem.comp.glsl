#version 430
// 4×4 convolution with stride 2 and a zero padding of 1, and ReLU: from the image to the half-size grid of the network.
//
//     out[o, y, x] = max(0, bias[o] + Σ_{i; dy, dx ∈ 0..3} weight[o, i, dy, dx] · in[i, 2y + dy - 1, 2x + dx - 1])
//
// Where the result is larger than half the image, it repeats its border: the U-Net needs a multiple of its cell.
// One invocation per pixel and group of the result.
#pragma parameters ivec2 half_size  // (⌈W/2⌉, ⌈H/2⌉) of the image
#pragma parameters ivec2 groups     // of four input channels: those that may be other than zero, and all
#include "tensor.glsl"
#include "activations.glsl"

#pragma reads FOUR features  // [groups in, 2·half_size]
#pragma reads mat4 weights   // [groups out, groups in, 16]: 4×4 blocks as in conv3x3
#pragma reads vec4 biases    // [groups out]
#pragma writes FOUR result   // [groups out, H, W]

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
            sum += weights[(o * groups.y + g) * 16 + tap] * unpacked(features[in_group(g, p, 2 * half_size)]);
        }
    }
    result[in_group(o, pixel, size)] = packed_four(max(sum, 0.0));
}
