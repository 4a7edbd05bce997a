#version 430
// The brightness that blocks of 8×8 pixels usually reach (exposure.limit_fireflies); one work group for all blocks.
//
//     usual = the k-th greatest of the blocks' maxima,    k = min(2 + ⌊count / 50⌋, count)
#pragma parameters int count
#pragma reads float maxima  // [count]
#pragma writes float usual  // [1]

float value(int i) {
    return maxima[i];
}
#include "select.glsl"

void main() {
    uint equals;
    float found = select(count, uint(count - min(2 + count / 50, count)), equals);
    if (gl_LocalInvocationIndex == 0u) usual[0] = found;
}
