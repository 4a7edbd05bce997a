#version 430
// Replace values that no filter can use (sanitise.sanitise), and pack the layers into images. One work group per block of 8×8
// pixels.
#pragma constants DEMODULATE BRIGHTEST FAR GREATEST_ALBEDO LONGEST_NORMAL
#include "image.glsl"
#include "finite.glsl"
#include "luminance.glsl"

#pragma reads float radiance, float albedo, float normal  // [3, H, W]
#pragma reads float depth                                 // [1, H, W]
#pragma writes vec4 clean                                 // [H, W] radiance, 1
#pragma writes vec4 surface                               // [H, W] normal, depth
#pragma writes vec4 guide  // [H, W] albedo, and whether light is divided by it: with DEMODULATE where something was hit
#pragma writes float maxima                               // [⌈H/8⌉, ⌈W/8⌉] the greatest luminance of each block

shared float partial[GROUP_X * GROUP_Y];

void main() {
    ivec2 pixel = ivec2(gl_GlobalInvocationID.xy);
    int lane = int(gl_LocalInvocationIndex);
    partial[lane] = 0.0;
    if (inside(pixel, size)) {
        int i = at(pixel, size), plane = size.x * size.y;
        vec3 rgb, color, facing;
        for (int c = 0; c < 3; ++c) {
            rgb[c] = clamp(finite_or(radiance[c * plane + i], 0.0), 0.0, BRIGHTEST);
            color[c] = clamp(finite_or(albedo[c * plane + i], 0.0), 0.0, GREATEST_ALBEDO);
            facing[c] = clamp(finite_or(normal[c * plane + i], 0.0), -LONGEST_NORMAL, LONGEST_NORMAL);
        }
        float distance = finite_or(depth[i], 0.0);
        if (!(distance > 0.0 && distance < FAR)) distance = 0.0;
        clean[i] = vec4(rgb, 1.0);
        surface[i] = vec4(facing, distance);
        guide[i] = vec4(color, DEMODULATE == 1 && distance > 0.0 ? 1.0 : 0.0);
        partial[lane] = luminance(rgb);
    }
    for (int step = GROUP_X * GROUP_Y / 2; step > 0; step /= 2) {
        barrier();
        if (lane < step) partial[lane] = max(partial[lane], partial[lane + step]);
    }
    if (lane == 0) maxima[gl_WorkGroupID.y * gl_NumWorkGroups.x + gl_WorkGroupID.x] = partial[0];
}
