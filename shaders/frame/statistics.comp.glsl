#version 430
// Exposure (exposure.exposure) and mean distance of a frame, from its blocks; one work group for all of them.
//
//     exposure = 1 / max(MIN_BRIGHTNESS, mean of the smallest block means)        distance = Σ depth / number of hits
#pragma constants BRIGHTNESS_TENTHS MIN_BRIGHTNESS MIN_DISTANCE
#pragma parameters int count
#pragma reads vec4 blocks               // [count] mean luminance, sum of depths, number of hits
#pragma writes float statistics         // [2] exposure, distance

float value(int i) {
    return blocks[i].x;
}
#include "select.glsl"

shared vec4 partial[GROUP_X];
shared uint black;

void main() {
    int lane = int(gl_LocalInvocationIndex);
    // Of black blocks only as many count as there are others (ops.ranks.exposure_of).
    if (lane == 0) black = 0u;
    barrier();
    for (int i = lane; i < count; i += GROUP_X)
        if (value(i) <= 0.0) atomicAdd(black, 1u);
    barrier();
    int dark = int(black), left_out = max(2 * dark - count, 0);
    int kept = max((count - left_out) * BRIGHTNESS_TENTHS / 10, min(dark, count - dark) + 1);
    // Several means may equal the greatest kept one; `equals + 1` of them are among the kept.
    uint equals;
    float greatest = select(count, uint(min(left_out + kept, count)) - 1u, equals);
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
        statistics[0] = 1.0 / max(total.x / float(kept), MIN_BRIGHTNESS);
        statistics[1] = max(total.y / max(total.z, 1.0), MIN_DISTANCE);
    }
}
