#version 430
// What is usually the brightest in a block of 8×8 pixels (brightness.limit_fireflies): one work group for all blocks.
//
//     usual = the k-th greatest of the blocks' maxima,    k = min(2 + ⌊count / 50⌋, count)
//
// takes    maxima [count]
// returns  usual [1]
#pragma constants GROUP_X
layout(local_size_x = GROUP_X) in;

layout(std430, binding = 0) readonly restrict buffer Maxima { float maxima[]; };
layout(std430, binding = 1) writeonly restrict buffer Usual { float usual[]; };

#ifdef VULKAN
layout(push_constant) uniform Pass { int count; };
#else
uniform int count;
#endif

float value(int i) {
    return maxima[i];
}
#include "select.glsl"

void main() {
    uint equals;
    float found = select(count, uint(count - min(2 + count / 50, count)), equals);
    if (gl_LocalInvocationIndex == 0u) usual[0] = found;
}
