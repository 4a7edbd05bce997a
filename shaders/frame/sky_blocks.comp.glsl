#version 430
// The radiance of the open sky in blocks of 8×8 pixels, for `sky`. One work group per block.
#include "image.glsl"
#pragma reads vec4 light, vec4 surface     // [H, W] rgb; normal, depth
#pragma writes vec4 lowest, vec4 highest   // [⌈H/8⌉, ⌈W/8⌉] rgb over the open pixels; where there is none lowest > highest
#include "open_sky.glsl"
#include "extremes.glsl"

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    int lane = int(gl_LocalInvocationIndex);
    low[lane] = vec3(3e38);
    high[lane] = vec3(-1.0);
    if (inside(pixel, size) && is_open(pixel)) low[lane] = high[lane] = light[at(pixel, size)].rgb;
    reduce_extremes(lane);
    if (lane == 0) {
        int block = int(gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x);
        lowest[block] = vec4(low[0], 0.0);
        highest[block] = vec4(high[0], 0.0);
    }
}
