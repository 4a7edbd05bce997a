#version 430
// 3×3 convolution with zero padding, and ReLU:
//
//     out[o, y, x] = max(0, bias[o] + Σ_{i; dy, dx ∈ 0..2} weight[o, i, dy, dx] · in[i, y + dy - 1, x + dx - 1])
//
// SOURCE chooses the input `in`, so that neither pooled nor concatenated tensors are ever written:
//
//     0   near
//     1   near, of twice the size, in maxima of 2×2
//     2   far, of half the size, nearest ×2; then the channels of near
//
// An invocation computes eight output channels of four pixels: two 4×4 matrices, whose columns are pixels. A work group keeps
// four input channels at a time in shared memory, for 4·GROUP_X × GROUP_Y pixels and a border of one. The four pixels of an
// invocation lie GROUP_X apart, so that neighbours in the work group read neighbours in the tile.
// gl_GlobalInvocationID = (x, y, pair of output groups); weights are padded to an even number of these groups.
#pragma constants SOURCE
#pragma parameters ivec3 groups  // of four channels: of `far` (SOURCE 2), of all inputs, of the outputs
#include "tensor.glsl"
#include "activations.glsl"

#pragma reads FOUR near, FOUR far
#pragma reads mat4 weights  // [groups out, groups in, 9] 4×4 blocks: a column holds the weights from one input to four outputs
#pragma reads vec4 biases   // [groups out]
#pragma writes FOUR result

const ivec2 TILE = ivec2(4 * GROUP_X + 2, GROUP_Y + 2);
shared vec4 tile[TILE.x * TILE.y];

vec4 source(int g, ivec2 p) {
    if (!inside(p, size)) return vec4(0.0);
#if SOURCE == 0
    return unpacked(near[in_group(g, p, size)]);
#elif SOURCE == 1
    int i = in_group(g, 2 * p, 2 * size), below = i + 2 * size.x;
    return max(max(unpacked(near[i]), unpacked(near[i + 1])), max(unpacked(near[below]), unpacked(near[below + 1])));
#else
    return unpacked(g < groups.x ? far[in_group(g, p / 2, size / 2)] : near[in_group(g - groups.x, p, size)]);
#endif
}

void write(int group, ivec2 p, vec4 four) {
    if (group < groups.z && inside(p, size)) result[in_group(group, p, size)] = packed_four(max(four, 0.0));
}

void main() {
    int lane = int(gl_LocalInvocationIndex);
    ivec2 local = ivec2(gl_LocalInvocationID.xy);
    ivec2 corner = ivec2(gl_WorkGroupID.xy) * ivec2(4 * GROUP_X, GROUP_Y);
    int low = 2 * int(gl_WorkGroupID.z), high = low + 1;  // groups of output channels

    int taps = inside(corner + local, size) ? 9 : 0;  // at coarse levels most of a work group is beyond the border

    mat4 low_sum = mat4(biases[low], biases[low], biases[low], biases[low]);
    mat4 high_sum = mat4(biases[high], biases[high], biases[high], biases[high]);
    for (int g = 0; g < groups.y; ++g) {
        barrier();
        for (int i = lane; i < TILE.x * TILE.y; i += GROUP_X * GROUP_Y) {
            tile[i] = source(g, corner + ivec2(i % TILE.x, i / TILE.x) - 1);
        }
        barrier();
        for (int tap = 0; tap < taps; ++tap) {
            int i = (local.y + tap / 3) * TILE.x + local.x + tap % 3;
            mat4 pixels = mat4(tile[i], tile[i + GROUP_X], tile[i + 2 * GROUP_X], tile[i + 3 * GROUP_X]);
            low_sum += weights[(low * groups.y + g) * 9 + tap] * pixels;
            high_sum += weights[(high * groups.y + g) * 9 + tap] * pixels;
        }
    }
    for (int j = 0; j < 4; ++j) {
        ivec2 p = corner + local + ivec2(j * GROUP_X, 0);
        write(low, p, low_sum[j]);
        write(high, p, high_sum[j]);
    }
}
