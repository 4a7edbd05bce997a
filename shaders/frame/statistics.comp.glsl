#version 430
// Exposure (color.exposure) and mean distance of a frame, from its blocks: one work group for all of them.
//
//     exposure = 1 / max(1e-8, mean of the `kept` least block means)        distance = Σ depth / number of hits
//
// The greatest mean that is kept is found digit by digit: floats ≥ 0 are ordered as their bits are.
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

shared uint bins[256];
shared uint digit, rank;
shared vec4 partial[GROUP_X];

void main() {
    int lane = int(gl_LocalInvocationIndex);
    if (lane == 0) rank = uint(kept) - 1u;  // of the value that is looked for, among those with its leading digits
    uint leading = 0u, mask = 0u;
    for (int shift = 24; shift >= 0; shift -= 8) {
        for (int i = lane; i < 256; i += GROUP_X) bins[i] = 0u;
        barrier();
        for (int i = lane; i < count; i += GROUP_X) {
            uint bits = floatBitsToUint(blocks[i].x);
            if ((bits & mask) == leading) atomicAdd(bins[(bits >> shift) & 255u], 1u);
        }
        barrier();
        uint wanted = rank;
        barrier();
        for (int i = lane; i < 256; i += GROUP_X) {
            uint below = 0u;
            for (int j = 0; j < i; ++j) below += bins[j];
            if (below <= wanted && wanted < below + bins[i]) {
                digit = uint(i);
                rank = wanted - below;
            }
        }
        barrier();
        leading |= digit << shift;
        mask |= 255u << shift;
    }

    // Of the means that equal the greatest one as many are kept as its rank says.
    float greatest = uintBitsToFloat(leading);
    vec4 sum = lane == 0 ? vec4(float(rank + 1u) * greatest, 0.0, 0.0, 0.0) : vec4(0.0);
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
