#version 430
// Exposure (brightness.exposure) and mean distance of a frame, from its blocks: one work group for all of them.
//
//     exposure = 1 / max(1e-8, mean of the `kept` least block means)        distance = Σ depth / number of hits
//
// takes    blocks [count]: mean luminance, sum of the depths, number of hits
// returns  statistics [2]: exposure, distance
#pragma constants GROUP_X
layout(local_size_x = GROUP_X) in;

layout(std430, binding = 0) readonly restrict buffer Blocks { vec4 blocks[]; };
layout(std430, binding = 1) writeonly restrict buffer Statistics { float statistics[]; };

#ifdef VULKAN
layout(push_constant) uniform Pass { int count; int kept; };
#else
uniform int count;
uniform int kept;  // max(1, ⌊0.9 · count⌋)
#endif

float value(int i) {
    return blocks[i].x;
}
#include "select.glsl"

shared vec4 partial[GROUP_X];

void main() {
    int lane = int(gl_LocalInvocationIndex);
    // Of the means that equal the greatest one that is kept, as many are kept as there is room for.
    uint equals;
    float greatest = select(count, uint(kept) - 1u, equals);
    vec4 sum = lane == 0 ? vec4(float(equals + 1u) * greatest, 0.0, 0.0, 0.0) : vec4(0.0);
    for (int i = lane; i < count; i += GROUP_X) {
        vec4 block = blocks[i];
        sum += vec4(block.x < greatest ? block.x : 0.0, block.yz, 0.0);
    }
    partial[lane] = sum;
    for (int step = GROUP_X / 2; step > 0; step /= 2) {
        barrier();
        if (lane < step) partial[lane] += partial[lane + step];
    }
    if (lane == 0) {
        vec4 total = partial[0];
        statistics[0] = 1.0 / max(total.x / float(kept), 1e-8);
        statistics[1] = max(total.y / max(total.z, 1.0), 1e-12);
    }
}
