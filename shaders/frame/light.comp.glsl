#version 430
// The light to filter: radiance without fireflies (exposure.limit_fireflies), divided by its texture; and sums over blocks of
// 8×8 pixels, for `statistics`. One work group per block.
//
//     bound = FIREFLY_LIMIT · max(brightest of the 8 neighbours, usual);    brighter pixels are scaled down to it
#pragma constants FIREFLY_LIMIT
#include "image.glsl"
#include "albedo.glsl"
#include "luminance.glsl"

#pragma reads vec4 clean, vec4 surface, vec4 guide  // [H, W]
#pragma reads float usual                           // [1]
#pragma writes vec4 light                           // [H, W] rgb, 1
#pragma writes vec4 blocks                          // [⌈H/8⌉, ⌈W/8⌉] mean luminance of the light, sum of depths, number of hits

shared vec4 partial[GROUP_X * GROUP_Y];

float brightest_neighbour(ivec2 pixel) {
    float brightest = 0.0;
    for (int k = 0; k < 9; ++k) {
        ivec2 p = pixel + ivec2(k % 3, k / 3) - 1;
        if (k != 4 && inside(p, size)) brightest = max(brightest, luminance(clean[at(p, size)].rgb));
    }
    return brightest;
}

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    int lane = int(gl_LocalInvocationIndex);
    partial[lane] = vec4(0.0);
    if (inside(pixel, size)) {
        int i = at(pixel, size);
        vec3 rgb = clean[i].rgb;
        float brightness = luminance(rgb), bound = FIREFLY_LIMIT * max(brightest_neighbour(pixel), usual[0]);
        if (brightness > bound && usual[0] > 0.0) rgb *= bound / brightness;
        rgb /= divisor(guide[i]);
        light[i] = vec4(rgb, 1.0);
        float depth = surface[i].w;
        partial[lane] = vec4(luminance(rgb), depth, depth > 0.0 ? 1.0 : 0.0, 1.0);
    }
    for (int step = GROUP_X * GROUP_Y / 2; step > 0; step /= 2) {
        barrier();
        if (lane < step) partial[lane] += partial[lane + step];
    }
    if (lane == 0) {
        vec4 sum = partial[0];
        blocks[gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x] = vec4(sum.x / sum.w, sum.yz, 0.0);
    }
}
